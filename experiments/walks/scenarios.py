"""Scenarios: the task, the errors and the question of walks that are recorded.

They are declared in ``scenarios.toml``. The bad start is that of all
comparisons: scales off by 12 %, offsets by 1.5 N, drift of 2 % and 1 N per square root of a minute, a centre
of mass off by 3 mm, a mass off by 0.5 %, a NAO's IMU, telemetry 20 +- 4 ms late.
"""

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from surefoot.experiments.logs.format import write_log
from surefoot.experiments.study.sources import code_of
from surefoot.experiments.study.tables import flat
from surefoot.experiments.walks.record import CONDITIONS, Condition, record_walk
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.sensors import Fault, ForceTorque, LoadCells
from surefoot.sensors.presets import HX711_LOAD_CELLS, resolve

PLAIN = "speed-0.04"  # the scenario without anything special, which others are held against
SPEEDS = (0.02, 0.04, 0.1)  # speeds of the CoP paper in m/s

_IDEAL = LoadCells(rate=None)
_SIX_AXES = ForceTorque(averaged=False)
_WARMING = replace(HX711_LOAD_CELLS, offset_tempco=0.03, scale_tempco=5e-4, temperature_ramp=20.0 / 600.0)
_CELLS = {
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
"""Cells by name. "chips" are those of the bad start: converters run at 78 to 94 Hz by themselves, as HX711s.
"mean" is for feet that hit the ground hard: no instant and no old conversion says much of these."""

_RECORDED = ("options", "sensors", "beliefs", "cells", "duration", "clock_error", "held", "policy")
"""Fields that make a recorded walk another one."""

_FAULT_STREAM = 0xFA17

TRUE_MAP = "true-map"
"""Name of the row of the map that would undo the cells' errors at every moment, of readings as they are."""


@dataclass(frozen=True)
class Scenario:
    """A task and its circumstances; a walk that is recorded serves all scenarios that have it."""

    name: str  # for files and the command
    title: str
    question: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)  # of the environment
    sensors: Mapping[str, Any] = field(default_factory=dict)  # of FootSensors: IMU, encoders, link
    beliefs: Mapping[str, Any] = field(default_factory=dict)  # of SelfCalibration
    setup: Mapping[str, Any] = field(default_factory=dict)  # options of every method that replays
    methods: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # of single methods or feeds
    faults: tuple[Fault, ...] = ()  # of one channel; channel and start are drawn
    study: str = "walks"  # or "paper", scored as the CoP paper scores, too
    walk: str = ""  # for files of the recording
    cells: tuple[Condition, ...] = (_CELLS["chips"],)  # that read a recorded walk, at once
    condition: str = "chips"  # name of those of them that count
    duration: float | None = None  # of a recorded walk in s with standing; ``None`` for the study's
    clock_error: float = 0.0  # s by which telemetry is later (even seeds) or earlier than assumed
    held: tuple[float, float, float] = (0.0, 0.0, 0.0)  # by a share of its weight, from and to times in s
    policy: str = ""  # of a G1 in place of the NAO
    most_seeds: int | None = None  # for long ones
    long: bool = False  # no part of a quick run

    @property
    def answers(self) -> str:
        """The question, and where it is asked."""
        return flat(self.question).replace("{kind}", self.faults[0].kind if self.faults else "")

    @property
    def speed(self) -> float:
        """Walking speed in m/s."""
        return float(self.options.get("speed", 0.04))

    @property
    def paper(self) -> bool:
        """Whether it is scored as the CoP paper scores, too."""
        return self.study == "paper"

    def length(self, duration: float) -> float:
        """Return how long a recorded walk takes in s, where the study's walks take ``duration``."""
        return duration if self.duration is None else self.duration

    def seeds(self, seeds: int) -> range:
        """Number its walks, where ``seeds`` are asked for."""
        return range(seeds if self.most_seeds is None else min(seeds, self.most_seeds))

    def options_of(self, method: str) -> dict[str, Any]:
        """Return the options that a method is given in a replay."""
        return {**self.setup, **self.methods.get(method, {})}

    def faults_of(self, seed: int, earliest: float) -> tuple[Fault, ...]:
        """Draw which cell a fault befalls, and when: within one stride from a time in s on."""
        rng = np.random.default_rng([_FAULT_STREAM, seed])
        channel, start = int(rng.integers(8)), earliest + rng.uniform(0.0, 1.6)
        # The other one of a swap is a cell of the same foot: plugs of one foot are within reach.
        other = 4 * (channel // 4) + (channel + int(rng.integers(1, 4))) % 4
        return tuple(
            replace(fault, channel=channel, start=start, other=other if fault.kind == "swapped" else None)
            for fault in self.faults
        )


def scenario_from(name: str, table: Mapping[str, Any], base: Scenario | None = None) -> Scenario:
    """Make a scenario of a table of its fields, the others as in a base, by default those of a plain walk."""
    base = Scenario(name, name) if base is None else base
    given: dict[str, Any] = {"title": name, **table}
    for part in ("options", "sensors", "beliefs", "methods"):
        given[part] = {**getattr(base, part), **table.get(part, {})}
    if "cells" in table:
        given["cells"] = tuple(_CELLS[one] for one in table["cells"])
        given.setdefault("condition", table["cells"][0])
    if "faults" in table:
        given["faults"] = tuple(resolve({"channel": 0, **one}, Fault) for one in table["faults"])
    if not base.walk or any(key in table for key in _RECORDED):
        given.setdefault("walk", name)
    return replace(base, name=name, **given)


def _read() -> dict[str, Scenario]:
    """Read the scenarios; a policy's only where its robot is."""
    text = files("surefoot.experiments.walks").joinpath("scenarios.toml").read_text(encoding="utf-8")
    found: dict[str, Scenario] = {}
    for name, table in tomllib.loads(text).items():
        base = found.get(table.pop("based_on", ""))
        if "policy" not in table or "SUREFOOT_STRANGERS" in os.environ:
            found[name] = scenario_from(name, table, base)
    return found


SCENARIOS: Mapping[str, Scenario] = MappingProxyType(_read())
"""All scenarios by name, in the order of the pages."""


def find_scenarios(names: tuple[str, ...], *, quick: bool) -> tuple[Scenario, ...]:
    """Return scenarios of recorded walks by names, or raise ValueError with their names.

    For no names these are all but those of the CoP paper; quick, without long ones.
    """
    unknown = [name for name in names if name not in SCENARIOS]
    if unknown:
        raise ValueError(f"There is no scenario '{unknown[0]}'. Available: {', '.join(SCENARIOS)}.")
    if names:
        return tuple(SCENARIOS[name] for name in dict.fromkeys(names))
    return tuple(one for one in SCENARIOS.values() if not (one.paper or (quick and one.long)))


def log_paths(scenario: Scenario, seed: int, duration: float, folder: Path) -> dict[str, Path]:
    """Name the files of a walk's logs, by condition, whether they are there or not; ``duration`` is in s."""
    recorded = [getattr(scenario, name) for name in _RECORDED if name != "duration"]
    made_of = (recorded, seed, scenario.length(duration), STAND_TIME, code_of(__name__))
    key = sha256(repr(made_of).encode()).hexdigest()[:12]
    return {c.name: folder / f"{scenario.walk}_{c.name}_seed{seed}_{key}.parquet" for c in scenario.cells}


def record_missing(scenario: Scenario, seed: int, duration: float, folder: Path) -> dict[str, Path]:
    """Record a walk unless its logs are there, and return them as :func:`log_paths` does."""
    paths = log_paths(scenario, seed, duration, folder)
    if not all(path.is_file() for path in paths.values()):
        logs = record_walk(
            scenario.speed,
            seed,
            scenario.length(duration),
            scenario.cells,
            sensors=scenario.sensors,
            beliefs=scenario.beliefs,
            clock_error=scenario.clock_error * (-1.0) ** seed,
            held=scenario.held,
            policy=scenario.policy,
            **{name: value for name, value in scenario.options.items() if name != "speed"},
        )
        for name, log in logs.items():
            write_log(log, paths[name])
    return paths
