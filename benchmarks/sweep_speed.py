"""How much faster a sweep is on two cores than on one.

    python benchmarks/sweep_speed.py              # three rounds, about five minutes
    python benchmarks/sweep_speed.py --rounds 1 --seeds 6 --duration 10

Rounds are interleaved: in each the same episodes are swept by one worker and by two, and the order changes
from round to round. Workers are up before the clock starts, as for all but the first seconds of a sweep.

Times on the wall are worth something on a machine that does nothing else. Other work takes more from two
workers than from one, so each round also gives a cost that does not depend on the load: the processor time of
the episodes, and the share of the workers' time that went into them (the rest is waiting for work). Two cores
of one's own make the sweep faster by

    2 (processor time by one worker / by two) (share of time in episodes by two / by one).
"""

import argparse
import os
import time
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from rich.console import Console

from surefoot.experiments.episodes import Episode, EpisodePlan
from surefoot.experiments.episodes.episode import episode_row
from surefoot.experiments.study.runner import runner


class Swept(NamedTuple):
    """A sweep: time from the first episode on in s, processor time in s, share in episodes, rows."""

    seconds: float
    processor: float
    busy: float
    rows: pd.DataFrame


def time_row(episode: Episode) -> dict[str, Any]:
    """Run an episode and add its processor time in s."""
    began = time.process_time()
    row = episode_row(episode)
    return row | {"processor_time": time.process_time() - began}


def sweep_once(plan: EpisodePlan, jobs: int) -> Swept:
    """Sweep a plan by workers who are up already."""
    with runner(jobs, backend="local") as crew:
        work = [(time_row, (episode,)) for episode in plan.episodes]
        crew.do("warm up", work[:4])
        began = time.perf_counter()
        rows = pd.DataFrame(crew.do("sweep", work))
        seconds = time.perf_counter() - began
    busy = float(rows["wall_time"].sum()) / (jobs * seconds)
    processor = float(rows["processor_time"].sum())
    return Swept(seconds, processor, busy, rows.drop(columns=["wall_time", "processor_time"]))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--duration", type=float, default=14.0, help="of an episode, in s")
    options = parser.parse_args()
    plan = EpisodePlan(seeds=tuple(range(options.seeds)), severities=(1.0,), duration=options.duration)
    console = Console(width=140)
    console.print(f"{len(plan.episodes)} episodes of {options.duration:g} s on {os.cpu_count()} cores")
    measured, free, tables = [], [], []
    for turn in range(options.rounds):
        swept = {jobs: sweep_once(plan, jobs) for jobs in ((1, 2) if turn % 2 == 0 else (2, 1))}
        one, two = swept[1], swept[2]
        tables += [one.rows, two.rows]
        measured.append(one.seconds / two.seconds)
        free.append(2.0 * one.processor / two.processor * two.busy / one.busy)
        console.print(
            f"round {turn + 1}: {one.seconds:.1f} s by one, {two.seconds:.1f} s by two, ratio "
            f"{measured[-1]:.2f}; processor {one.processor:.1f} and {two.processor:.1f} s, in episodes "
            f"{100 * one.busy:.1f} and {100 * two.busy:.1f} %, on free cores {free[-1]:.2f}; "
            f"load {os.getloadavg()[0]:.1f}"
        )
    for table in tables[1:]:
        pd.testing.assert_frame_equal(tables[0], table, check_exact=True)
    console.print(
        f"median ratio {np.median(measured):.2f}, on free cores {np.median(free):.2f}; all results are the "
        "same to the last digit"
    )


if __name__ == "__main__":
    main()
