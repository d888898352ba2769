"""Calibration methods on the same recorded walks, in the scenarios of ``scenarios.toml``.

    python benchmarks/walks.py --seeds 10 --jobs 2                # half an hour
    python benchmarks/walks.py --quick --scenario fault-dead --method none --method my_feet:slow-tare
    python docs/study_tables.py out/results

A NAO-class biped walks in MuJoCo on feet whose scales and offsets are wrong and drift. Each walk is recorded
once, and every method gets the same stream. Methods get what a robot knows about itself; the truth is only
used for scores. Unless a scenario says otherwise, scales are off by 12 % and offsets by 1.5 N, they drift by
2 % and 1 N per square root of a minute, the centre of mass is off by 3 mm and the mass by 0.5 %, the IMU is
noisy and biased, and telemetry is 20 +- 4 ms late. The row "true map" reads the same readings by the map that
undoes the errors at every moment: what it leaves comes from the noise and the age of readings. Other methods
bring readings to the present and may be better.
"""

import os
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import bench
import numpy as np
from scipy import stats
from streams import TRUE_MAP, Stream, play, score_run

from surefoot.calibration.online import METHODS, method_entry
from surefoot.experiments.study.figures import by_way, in_order, look_of, short_label
from surefoot.experiments.study.page import ReportFigure
from surefoot.experiments.study.sources import own_code
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import (
    NOTHING,
    Cell,
    Frame,
    Table,
    Valued,
    Verdict,
    count_of,
    decimal,
    interval_text,
    mean_of,
    number,
    sentence,
    share,
    table_of,
    with_interval,
)
from surefoot.experiments.walks.figures import error_curves
from surefoot.experiments.walks.record import CONDITIONS, Condition, record_walk
from surefoot.experiments.walks.score import running_errors
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.sensors import Fault, ForceTorque, LoadCells, apply_faults
from surefoot.sensors.presets import HX711_LOAD_CELLS, resolve

DURATION = STAND_TIME + 30.0  # of a walk in s, including the standing before it
SETTLE = STAND_TIME + 10.0  # time in s from which errors count
FALLING = 1.0  # time in s before the end of a walk that ended in a fall, which is cut off
LEAST_JUDGED = 4.0  # shortest part of a walk in s that is scored
FAULT_DELAY = 4.0  # s after settling until which a fault may come; at most a third of what is left
DRAWN = ("speed-0.1",)  # scenarios with a figure of errors over time
SLICE = 2.0  # time in s between the points of that figure

_IDEAL = LoadCells(rate=None)
_SIX_AXES = ForceTorque(averaged=False)
_WARMING = replace(HX711_LOAD_CELLS, offset_tempco=0.03, scale_tempco=5e-4, temperature_ramp=20.0 / 600.0)
CELLS = {
    condition.name: condition
    for condition in (
        *CONDITIONS,
        Condition("chips", "on the chips' own clocks", HX711_LOAD_CELLS, "nominal"),
        Condition("instant", "converted when the host reads", _IDEAL, "nominal"),
        Condition("mean", "that read means of control steps", replace(_IDEAL, averaged=True), "nominal"),
        Condition("warming", "warming up by 20 K in ten minutes", _WARMING, "nominal"),
        Condition("shear", "feeling shear", replace(HX711_LOAD_CELLS, shear_std=0.1), "nominal"),
        Condition("ankle", "six-axis sensors in the ankles", None, "nominal", _SIX_AXES),
        Condition("both", "cells and six-axis sensors", HX711_LOAD_CELLS, "nominal", _SIX_AXES),
    )
}
"""Cells by name. "chips" are the usual ones: their converters run at 78 to 94 Hz on clocks of their own, as
HX711s do. "mean" is for feet that hit the ground so hard that a single conversion says little."""

_RECORDED = ("options", "sensors", "beliefs", "cells", "duration", "clock_error", "held", "policy")
"""Fields that make a recorded walk another one."""

_FAULT_STREAM, _NOISE_STREAM = 0xFA17, 0xFA18


@dataclass(frozen=True)
class Scenario:
    """A task and its circumstances. A recorded walk serves all scenarios with the same ``walk``."""

    name: str
    title: str
    question: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)  # of the environment
    sensors: Mapping[str, Any] = field(default_factory=dict)  # of FootSensors: IMU, encoders, link
    beliefs: Mapping[str, Any] = field(default_factory=dict)  # of SelfCalibration
    setup: Mapping[str, Any] = field(default_factory=dict)  # options of every method
    methods: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # options of single methods
    faults: tuple[Fault, ...] = ()  # channel and start are drawn
    study: str = "walks"  # or "paper": a part of cop_paper.py
    walk: str = ""  # name of the recording
    cells: tuple[Condition, ...] = (CELLS["chips"],)  # that read the walk at the same time
    condition: str = "chips"  # name of the cells that are scored
    duration: float | None = None  # of the walk in s; ``None`` for that of the study
    clock_error: float = 0.0  # s by which telemetry is later (even seeds) or earlier than assumed
    held: tuple[float, float, float] = (0.0, 0.0, 0.0)  # share of the weight, from and to times in s
    policy: str = ""  # of a G1 in place of the NAO
    most_seeds: int | None = None  # for long ones
    long: bool = False  # left out of a quick run

    @property
    def speed(self) -> float:
        """Walking speed in m/s."""
        return float(self.options.get("speed", 0.04))

    def options_of(self, method: str) -> dict[str, Any]:
        """Return the options of a method in this scenario."""
        return {**self.setup, **self.methods.get(method, {})}

    def faults_of(self, seed: int, earliest: float) -> tuple[Fault, ...]:
        """Draw the cell of a fault and its start, within one stride from a time in s on."""
        rng = np.random.default_rng([_FAULT_STREAM, seed])
        channel, start = int(rng.integers(8)), earliest + rng.uniform(0.0, 1.6)
        # The other cell of a swap is one of the same foot, whose plugs are within reach.
        other = 4 * (channel // 4) + (channel + int(rng.integers(1, 4))) % 4
        return tuple(
            replace(fault, channel=channel, start=start, other=other if fault.kind == "swapped" else None)
            for fault in self.faults
        )


def scenario_from(name: str, table: Mapping[str, Any], base: Scenario | None = None) -> Scenario:
    """Make a scenario from a table of its fields; others are those of a base, by default a plain walk."""
    base = Scenario(name, name) if base is None else base
    given: dict[str, Any] = {"title": name, **table}
    for part in ("options", "sensors", "beliefs", "methods"):
        given[part] = {**getattr(base, part), **table.get(part, {})}
    if "cells" in table:
        given["cells"] = tuple(CELLS[one] for one in table["cells"])
        given.setdefault("condition", table["cells"][0])
    if "faults" in table:
        given["faults"] = tuple(resolve({"channel": 0, **one}, Fault) for one in table["faults"])
    if not base.walk or any(key in table for key in _RECORDED):
        given.setdefault("walk", name)
    return replace(base, name=name, **given)


def _read() -> dict[str, Scenario]:
    """Read the scenarios; those of a policy only where its robot is installed."""
    found: dict[str, Scenario] = {}
    for name, table in tomllib.loads((bench.HERE / "scenarios.toml").read_text(encoding="utf-8")).items():
        base = found.get(table.pop("based_on", ""))
        if "policy" not in table or "SUREFOOT_STRANGERS" in os.environ:
            found[name] = scenario_from(name, table, base)
    return found


SCENARIOS: Mapping[str, Scenario] = _read()
"""All scenarios by name, in the order of the tables."""


def find_scenarios(names: Sequence[str], *, quick: bool) -> list[Scenario]:
    """Return scenarios by name, by default all but those of the CoP paper; ValueError at an unknown name."""
    unknown = [name for name in names if name not in SCENARIOS]
    if unknown:
        raise ValueError(f"There is no scenario '{unknown[0]}'. Available: {', '.join(SCENARIOS)}.")
    if names:
        return [SCENARIOS[name] for name in dict.fromkeys(names)]
    return [one for one in SCENARIOS.values() if one.study != "paper" and not (quick and one.long)]


class Walk(NamedTuple):
    """A walk to record, and the scenarios that it serves."""

    scenarios: tuple[str, ...]
    seed: int
    duration: float = DURATION
    settle: float = SETTLE


def walks_of(scenarios: Sequence[Scenario], seeds: int, **times: float) -> list[Walk]:
    """Return the walks that scenarios need, seed by seed."""
    by_walk: dict[tuple[int, str], list[Scenario]] = defaultdict(list)
    for scenario in scenarios:
        most = seeds if scenario.most_seeds is None else min(seeds, scenario.most_seeds)
        for seed in range(most):
            by_walk[seed, scenario.walk].append(scenario)
    return [
        Walk(tuple(one.name for one in served), seed, **times)
        for (seed, _), served in sorted(by_walk.items(), key=lambda item: item[0][0])
    ]


def streams_of(walk: Walk) -> Iterator[tuple[Scenario, Stream | None]]:
    """Record a walk, and yield the stream of each scenario; ``None`` if the robot fell before a score."""
    served = [SCENARIOS[name] for name in walk.scenarios]
    first = served[0]
    logs = record_walk(
        first.speed,
        walk.seed,
        walk.duration if first.duration is None else first.duration,
        first.cells,
        sensors=first.sensors,
        beliefs=first.beliefs,
        clock_error=first.clock_error * (-1.0) ** walk.seed,
        held=first.held,
        policy=first.policy,
        **{name: value for name, value in first.options.items() if name != "speed"},
    )
    for scenario in served:
        log = logs[scenario.condition]
        fell = bool(log.about["fell"])
        if fell:
            log = log.cut(slice(int(np.sum(log.time <= log.time[-1] - FALLING))))
        if (float(log.time[-1]) if len(log) else 0.0) < walk.settle + LEAST_JUDGED:
            yield scenario, None
            continue
        faults = scenario.faults_of(
            walk.seed, walk.settle + min(FAULT_DELAY, (walk.duration - walk.settle) / 3.0)
        )
        if faults:
            cells = next(one.cells for one in scenario.cells if one.name == scenario.condition)
            assert cells is not None, "faults befall load cells"
            rng = np.random.default_rng([_NOISE_STREAM, walk.seed])
            log = replace(log, raw=apply_faults(log.raw, log.time, faults, cells, rng))
        yield scenario, Stream(log, walk.seed, log.time >= walk.settle, STAND_TIME, faults, fell)


def score(walk: Walk, methods: tuple[str, ...]) -> bench.Rows:
    """Record a walk and score methods on it: a row per scenario and method; errors over time where drawn."""
    found: dict[str, list[dict[str, Any]]] = {"scores": [], "errors": [], "left_out": []}
    for scenario, stream in streams_of(walk):
        if stream is None:
            found["left_out"].append({"scenario": scenario.name})
            continue
        for method in methods:
            row = {"scenario": scenario.name, "method": method}
            played = play(stream, method, **scenario.options_of(method))
            found["scores"].append(row | score_run(stream, played))
            if scenario.name in DRAWN:
                cop = stream.errors(played.force).cop
                errors = running_errors(stream.log.time, cop, SLICE)
                found["errors"] += [row | {"seed": walk.seed} | error for error in errors]
    return found


METRICS = {
    "cop": ("CoP", "mm", 1e3),
    "cop_foot": ("foot's CoP", "mm", 1e3),
    "vgrf": ("vGRF", "N", 1.0),
    "cell": ("cell", "N", 1.0),
}
"""Errors with their name, unit and factor to this unit."""


def _method(runs: Frame) -> str:
    return str(runs["method"].iloc[0])


def _of_methods(cell: Cell) -> Cell:
    """Leave a cell out for the true map, which is no method."""
    return lambda runs: NOTHING if _method(runs) == TRUE_MAP else cell(runs)


def _nees(runs: Frame) -> str:
    """Return the mean NEES, and in brackets where 95 % of the means of a consistent estimator lie."""
    known = runs["nees_end"].notna()
    if not known.any():
        return NOTHING
    degrees = float((known * runs["parameters"]).sum())
    low, high = (float(end) for end in stats.chi2.ppf([0.025, 0.975], degrees) / degrees)
    mean = float(runs["nees_end"].mean())
    text = f"{number(mean)} [{number(low)}, {number(high)}]"
    return Valued.of(text, {"value": mean, "from": low, "to": high})


def scenario_table(scores: Frame, scenario: Scenario) -> Table:
    """Return all scores of a scenario."""
    own = scores[scores["scenario"] == scenario.name]
    cop = own.pivot(index="seed", columns="method", values="cop")

    def behind(runs: Frame) -> str:
        method = _method(runs)
        if method == "moment" or not {method, "moment"} <= set(cop):
            return ""
        gap = mean_interval(cop[method] - cop["moment"])
        said = interval_text(gap, 1e3)
        return Verdict.of(gap.mean > 0.0, said) if gap.apart else said

    columns: dict[str, Cell] = {
        "method": lambda runs: look_of(_method(runs)).label,
        **{f"{what} ({unit})": mean_of(name, factor) for name, (what, unit, factor) in METRICS.items()},
        "scale (%)": mean_of("scale", 1e2),
        "offset (N)": mean_of("offset"),
        "NEES": _nees,
        "ends worse": _of_methods(count_of("worse_cop")),
        "feet end worse": _of_methods(count_of("worse_cop_foot")),
        "CoP, more than moment, paired (mm)": _of_methods(behind),
    }
    falls = int(own.drop_duplicates("seed")["fell"].sum())
    note = " ".join(scenario.question.split()) + (f" Walks that end in a fall: {falls}." if falls else "")
    title = f"{sentence(scenario.title)}: means over walks and their 95 % intervals"
    return table_of(f"scenario_{scenario.name}", title, columns, by_way(own).values(), note)


def overview_table(scores: Frame, scenarios: Sequence[Scenario], metric: str) -> Table:
    """Return one error of all scenarios and methods."""
    what, unit, factor = METRICS[metric]

    def error_of(method: str) -> Cell:
        return lambda item: with_interval(item[1][item[1]["method"] == method][metric], factor)

    columns: dict[str, Cell] = {
        "scenario": lambda item: item[0].title,
        "runs": lambda item: decimal(item[1]["seed"].nunique(), "d"),
        **{look_of(method).label: error_of(method) for method in in_order(scores["method"])},
    }
    parts = [(scenario, scores[scores["scenario"] == scenario.name]) for scenario in scenarios]
    name = "overview" if metric == "cop" else f"overview_{metric.removeprefix('cop_')}"
    title = f"{what} rmse ({unit}), all scenarios"
    return table_of(name, title, columns, [part for part in parts if len(part[1])])


def fault_table(scores: Frame, scenarios: Sequence[Scenario]) -> Table | None:
    """Return the faults that were found and missed, or ``None`` where there were none."""
    titles = {scenario.name: scenario.title for scenario in scenarios if scenario.faults}
    parts = [runs for name in titles for runs in by_way(scores[scores["scenario"] == name]).values()]

    def median(runs: Frame) -> str:
        known = runs["found"][np.isfinite(runs["found"])]
        return number(float(known.median())) if len(known) else NOTHING

    columns: dict[str, Cell] = {
        "fault, method": lambda runs: f"{titles[runs['scenario'].iloc[0]]}, {short_label(_method(runs))}",
        "found within 1 s": _of_methods(lambda runs: share(int((runs["found"] <= 1.0).sum()), len(runs))),
        "found after (s), median": _of_methods(median),
        "right cell": _of_methods(count_of("isolated")),
        "right name": _of_methods(count_of("named")),
        "CoP afterwards (mm)": mean_of("after", 1e3),
        "foot's CoP afterwards (mm)": mean_of("after_foot", 1e3),
    }
    note = "CoP afterwards: rmse from 1 s after the fault to the end of the walk."
    return (
        table_of("faults", "Cells that fail while the robot walks", columns, parts, note) if parts else None
    )


def alarm_table(scores: Frame) -> Table:
    """Return how often a sound cell was accused."""

    def exact(runs: Frame) -> str:
        # Interval of a Poisson rate (Garwood, 1936).
        alarms, hours = float(runs["alarms"].sum()), float(runs["hours"].sum())
        low = stats.chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0
        ends = float(low / hours), float(stats.chi2.ppf(0.975, 2 * alarms + 2) / 2 / hours)
        return Valued.of(" to ".join(map(number, ends)), dict(zip(("from", "to"), ends, strict=True)))

    columns: dict[str, Cell] = {
        "method": lambda runs: look_of(_method(runs)).label,
        "hours without a fault": lambda runs: decimal(runs["hours"].sum(), ".2f"),
        "alarms": lambda runs: decimal(runs["alarms"].sum(), ".0f"),
        "per hour": lambda runs: number(float(runs["alarms"].sum() / runs["hours"].sum())),
        "95 % interval": exact,
    }
    parts = by_way(scores[scores["method"] != TRUE_MAP]).values()
    return table_of("alarms", "False alarms in all walks", columns, parts)


def depends(walk: Walk, methods: tuple[str, ...]) -> Any:
    """Return the arguments, the scenarios and the code of users' methods, which decide the scores."""
    return walk, methods, [SCENARIOS[name] for name in walk.scenarios], own_code(*methods)


def main() -> None:
    """Record the walks, score the methods, and write the tables."""
    parser = bench.options(__doc__, "walking", 10)
    parser.add_argument("--scenario", action="append", default=[], help="all by default, repeatable")
    parser.add_argument("--method", action="append", default=[], help="or module:name, repeatable")
    given = parser.parse_args()
    for method in given.method:
        method_entry(method)
    methods = tuple(dict.fromkeys((TRUE_MAP, *(given.method or METHODS))))
    scenarios = find_scenarios(given.scenario, quick=given.quick)
    quick: Any = {"duration": STAND_TIME + 14.0, "settle": STAND_TIME + 6.0} if given.quick else {}
    walks = walks_of(scenarios, min(given.seeds, 2) if given.quick else given.seeds, **quick)
    arguments = [(walk, methods) for walk in walks]
    found = bench.run(given.out, "walks", score, arguments, jobs=given.jobs, depends=depends)
    scores, curves = found["scores"], found["errors"]
    tables = [overview_table(scores, scenarios, metric) for metric in METRICS]
    tables += [scenario_table(scores, one) for one in scenarios if one.name in set(scores["scenario"])]
    faults = fault_table(scores, scenarios)
    tables += [alarm_table(scores), *([] if faults is None else [faults])]
    figures = []
    for name in DRAWN if len(curves) else ():
        path = given.out / "figures" / f"curves_{name}.svg"
        error_curves(path, {SCENARIOS[name].title: curves[curves["scenario"] == name]})
        figures.append(
            ReportFigure(path, SCENARIOS[name].title, "Rmse of the last 2 s: median and quartiles.")
        )
    left_out = len(found.get("left_out", ()))
    text = f"{len(walks)} walks; {left_out} streams ended in a fall before they could be scored."
    bench.publish(given.out, "Calibrators on the same walks", text, tables, figures)


if __name__ == "__main__":
    bench.start(__file__)
