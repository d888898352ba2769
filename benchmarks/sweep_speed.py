"""How much faster a sweep is on two cores than on one.

    python benchmarks/sweep_speed.py              # three rounds, about five minutes
    python benchmarks/sweep_speed.py --rounds 1 --seeds 6 --duration 10

Rounds are interleaved: in each the same cells are swept by one worker and by two, which begins changing from
round to round. Workers are up before the clock starts, as they are for all but the first seconds of a sweep.

Times on the wall are worth something on a machine that does nothing else. What others do takes more from two
workers than from one, so each round also says what the sweeps cost whatever the load: the processor time of
the cells, and the share of the workers' time that went into cells (the rest is waiting for work and for the
disk). Two cores of one's own make the sweep faster by

    2 (processor time by one worker / by two) (share of time in cells by two / by one).
"""

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from rich.console import Console

from surefoot.experiments.sweep import Cell, SweepPlan, run_cell
from surefoot.experiments.sweep.backends import workers
from surefoot.experiments.sweep.run import rows_of
from surefoot.experiments.sweep.store import SweepStore


class Swept(NamedTuple):
    """A sweep: time from the first cell on in s, processor time in s, share of the time in cells, rows."""

    seconds: float
    processor: float
    busy: float
    rows: pd.DataFrame


def timed_cell(cell: Cell) -> dict[str, Any]:
    """Run a cell and add its processor time in s."""
    began = time.process_time()
    row = run_cell(cell)
    return row | {"processor_time": time.process_time() - began}


def sweep_once(plan: SweepPlan, jobs: int) -> Swept:
    """Sweep a plan, journal and table included, by workers who are up already."""
    with tempfile.TemporaryDirectory() as folder, workers("local", jobs) as crew:
        list(rows_of(crew, timed_cell, list(plan.grid[:4])))
        began = time.perf_counter()
        with SweepStore(Path(folder)).opened(plan.fingerprint, plan.as_dict()) as store:
            for row in rows_of(crew, timed_cell, list(plan.grid)):
                store.add(row)
        seconds, rows = time.perf_counter() - began, store.frame()
    busy = float(rows["wall_time"].sum()) / (jobs * seconds)
    return Swept(
        seconds,
        float(rows["processor_time"].sum()),
        busy,
        rows.drop(columns=["wall_time", "processor_time"]),
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--duration", type=float, default=14.0, help="of an episode, in s")
    options = parser.parse_args()
    plan = SweepPlan(seeds=tuple(range(options.seeds)), severities=(1.0,), duration=options.duration)
    console = Console(width=140)
    console.print(f"{len(plan.grid)} cells of {options.duration:g} s on {os.cpu_count()} cores")
    measured, free, tables = [], [], []
    for turn in range(options.rounds):
        swept = {jobs: sweep_once(plan, jobs) for jobs in ((1, 2) if turn % 2 == 0 else (2, 1))}
        one, two = swept[1], swept[2]
        tables += [one.rows, two.rows]
        measured.append(one.seconds / two.seconds)
        free.append(2.0 * one.processor / two.processor * two.busy / one.busy)
        console.print(
            f"round {turn + 1}: {one.seconds:.1f} s by one, {two.seconds:.1f} s by two, ratio "
            f"{measured[-1]:.2f}; processor {one.processor:.1f} and {two.processor:.1f} s, in cells "
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
