"""The experiment of the CoP paper, simulated: Tables 4 to 6 at three speeds, and walks in closed loop.

    python benchmarks/cop_paper.py --seeds 10 --jobs 2          # half an hour
    python benchmarks/cop_paper.py --quick
    python docs/study_tables.py out/results

Two conditions. *The paper's*: cells were calibrated from known weights before the walk and drift mildly since
(0.5 % in scale and 0.2 N in offset per square root of a minute); methods start from that calibration. *Bad
start*: never calibrated (scales off by 12 %, offsets by 1.5 N) and drifting by 2 % and 1 N per square root of
a minute.

Two yardsticks. Against the baseline, as in the paper: the calibration from known weights, applied to the same
readings, takes the place of the truth, so that a method is charged for following the drift. Against the
truth: the forces of MuJoCo at the cells. The reference is what the robot's motion requires (Eqs. 9 to 11),
compared with the truth of the moment that it describes.

In closed loop a stabiliser holds the centre of pressure in its observation against the planned one and moves
the ankles. Only the feet differ. Severity 1 is the bad start, severity 3 has three times its errors.
"""

from typing import Any, NamedTuple

import bench
import numpy as np
from streams import TRUE_MAP, Stream, play
from walks import SCENARIOS, Walk, streams_of, walks_of

from surefoot.arrays import Floats
from surefoot.calibration import METHODS, ground_reference
from surefoot.experiments.study.figures import by_way, look_of
from surefoot.experiments.study.statistics import survival
from surefoot.experiments.study.tables import (
    Cell,
    Frame,
    Table,
    count_of,
    decimal,
    mean_of,
    number,
    plural,
    table_of,
    with_interval,
)
from surefoot.experiments.walks.loop import Walk as LoopWalk
from surefoot.experiments.walks.replay import age_of, starting_map
from surefoot.experiments.walks.score import cop_world, rms, score_forces, vertical_forces
from surefoot.experiments.walks.walkers import STAND_TIME

SPEEDS: tuple[float, ...] = (0.02, 0.04, 0.1)  # in m/s
SEVERITIES = {
    3.0: ("true", "none", "tare", "quasi-static", "window", "moment"),
    1.0: ("none", "window"),
}
"""Feeds of the closed loop by severity."""

LOOP_DURATION = STAND_TIME + 20.0  # in s


class Published(NamedTuple):
    """Errors of the CoP in mm and of the vertical force in N in the paper, against its baseline."""

    cop: float
    vgrf: float


PUBLISHED = {
    0.02: {"window": Published(5.9, 0.4339), "quasi-static": Published(10.8, 1.2949)},
    0.04: {"window": Published(10.8, 0.5324), "quasi-static": Published(16.6, 1.8646)},
    0.1: {"window": Published(13.4, 1.0387), "quasi-static": Published(19.9, 2.5220)},
}
"""The paper's Tables 4 to 6 by walking speed in m/s."""


def score(walk: Walk) -> bench.Rows:
    """Record a walk and score all methods, the baseline and the reference against truth and baseline."""
    rows: list[dict[str, Any]] = []
    for scenario, stream in streams_of(walk):
        if stream is None:
            continue
        about = {"condition": scenario.condition, "speed": scenario.speed, "seed": walk.seed}
        log, truth = stream.log, stream.truth
        known: Any = {"layout": log.layout, "time": log.time, "settle": walk.settle}
        known |= {"position_sole": truth.position_sole, "R_world_sole": truth.R_world_sole}
        baseline = starting_map(log, "calibrated").force(log.raw)
        forces = {method: play(stream, method).force for method in (TRUE_MAP, *METHODS)}
        for way, force in {**forces, "baseline": baseline}.items():
            others = {"truth": truth.force} | ({"baseline": baseline} if way in METHODS else {})
            rows += [
                {**about, "method": way, "against": against, **score_forces(force, other, **known)._asdict()}
                for against, other in others.items()
            ]
        rows.append({**about, "method": "reference", "against": "truth", **score_reference(stream, walk)})
    return {"yardsticks": rows}


def score_reference(stream: Stream, walk: Walk) -> dict[str, float]:
    """Score the calibrators' references, placed under the true soles of the moment that they describe."""
    log, truth = stream.log, stream.truth
    asked = ground_reference(log.reference, log.mass)
    moment = log.time - log.lag * log.dt - age_of(log)

    def then(values: Floats) -> Floats:
        return np.column_stack([np.interp(moment, log.time, column) for column in values.T])

    true_cop = then(cop_world(truth.force, log.layout, truth.position_sole, truth.R_world_sole))
    feet = vertical_forces(truth.force, log.layout, truth.R_world_sole)
    true_vgrf = then(feet.sum(axis=-1)[:, None])[:, 0]
    origin = then(truth.position_sole[..., :2].mean(axis=1))
    ahead = then(truth.R_world_sole[..., :2, 0].sum(axis=1))
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    x, y = asked.cop[:, 0], asked.cop[:, 1]
    placed = origin + np.column_stack([ahead[:, 0] * x - ahead[:, 1] * y, ahead[:, 1] * x + ahead[:, 0] * y])
    counted = (log.time >= walk.settle) & np.isfinite(placed).all(axis=1) & np.isfinite(true_cop).all(axis=1)
    off = np.linalg.norm((placed - true_cop)[counted], axis=1)
    nothing = {"cop_foot": float("nan"), "cell": float("nan")}
    return {"cop": rms(off), "vgrf": rms((asked.vgrf - true_vgrf)[counted]), **nothing}


def close_loop(walk: LoopWalk) -> bench.Rows:
    """Run a walk in closed loop."""
    return {"loop": [walk.row()]}


def walking_table(scores: Frame, speed: float) -> Table:
    """Return one speed as one of the paper's Tables 4 to 6, beside errors against the truth."""
    rows: list[tuple[str, ...]] = []
    here = scores[scores["speed"] == speed]
    errors = {"cop": ("CoP", "mm", 1e3), "vgrf": ("vGRF", "N", 1.0)}
    more = {"cop_foot": ("foot's CoP", "mm", 1e3), "cell": ("single cell", "N", 1.0)}
    for condition, title in (("paper", "the paper's"), ("bad-start", "bad start")):
        for method, runs in by_way(here[here["condition"] == condition]).items():
            baseline, truth = (runs[runs["against"] == against] for against in ("baseline", "truth"))
            cells = [title, look_of(method).label]
            for name, (_, _, factor) in errors.items():
                same = len(baseline) and float(baseline[name].max()) < 1e-9
                cells.append("0 *" if same else with_interval(baseline[name], factor))
                paper = PUBLISHED[speed].get(method) if condition == "paper" else None
                cells.append("" if paper is None else number(getattr(paper, name)))
            cells += [with_interval(truth[name], factor) for name, (_, _, factor) in (errors | more).items()]
            rows.append(tuple(cells))
    columns = ["condition", "method"]
    for what, unit, _ in errors.values():
        columns += [f"{what} against baseline ({unit})", "paper"]
    columns += [f"{what} against truth ({unit})" for what, unit, _ in (errors | more).values()]
    seeds = plural(here["seed"].nunique(), "seed")
    note = f"Rmse over {seeds}. * By construction: these readings are the baseline."
    title = f"Table {4 + SPEEDS.index(speed)}: {speed:g} m/s"
    return Table(f"walking_{speed:g}".replace(".", "_"), title, tuple(columns), tuple(rows), note)


def loop_table(runs: Frame, horizon: float) -> Table:
    """Return the closed loop: who fell, and when, of walks that last so many s at most."""

    def half_time(part: Frame) -> str:
        curve = survival(part["time"], part["fell"])
        times = curve.time[curve.share <= 0.5]
        return number(float(times[0])) if len(times) else f"> {horizon:g}"

    columns: dict[str, Cell] = {
        "severity": lambda part: decimal(part["severity"].iloc[0]),
        "speed (m/s)": lambda part: decimal(part["speed"].iloc[0]),
        "CoP fed back": lambda part: look_of(part["feed"].iloc[0]).label,
        "falls": count_of("fell"),
        "half have fallen after (s)": half_time,
        f"time on its feet (s), of {horizon:g}": mean_of("time"),
        "error of the CoP fed back (mm)": mean_of("cop_error", 1e3),
    }
    note = "Paired: the same seeds, pushes, ground and sensors for every feed. Errors count up to the fall."
    groups = runs.groupby(["severity", "speed"], sort=False)
    parts = [part for _, walks in groups for part in by_way(walks, "feed").values()]
    return table_of("closed_loop", "The walker on different feet", columns, parts, note)


def main() -> None:
    """Run the experiment, and write its tables."""
    given = bench.options(__doc__, "full", 10).parse_args()
    speeds, seeds, horizon = SPEEDS, given.seeds, LOOP_DURATION
    quick: Any = {}
    if given.quick:
        speeds, seeds, horizon = (0.04,), min(given.seeds, 2), STAND_TIME + 4.0
        quick = {"duration": STAND_TIME + 8.0, "settle": STAND_TIME + 4.0}
    scenarios = [one for one in SCENARIOS.values() if one.study == "paper" and one.speed in speeds]
    walks = [(walk,) for walk in walks_of(scenarios, seeds, **quick)]
    yardsticks = bench.run(given.out, "walks", score, walks, jobs=given.jobs)["yardsticks"]
    loops = [
        (LoopWalk(feed, speed, seed, horizon, severity),)
        for severity, feeds in SEVERITIES.items()
        for speed in speeds
        for feed in feeds
        for seed in range(seeds)
    ]
    loop = bench.run(given.out, "closed loop", close_loop, loops, jobs=given.jobs)["loop"]
    tables = [*(walking_table(yardsticks, speed) for speed in speeds), loop_table(loop, horizon)]
    text = "The conditions of the CoP paper, and a bad start."
    bench.publish(given.out, "Walking on bad feet, and on calibrated ones", text, tables)


if __name__ == "__main__":
    bench.start(__file__)
