"""Scenarios of the study of walks: the walk, the errors, and the question; and how much a study does.

The bad start is that of all comparisons: scales off by 12 %, offsets by 1.5 N, drift of 2 % and 1 N per
square root of a minute, a centre of mass off by 3 mm, a mass off by 0.5 %, a NAO's IMU, telemetry 20 +- 4 ms
late.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from surefoot.calibration.online import METHODS, method_entry
from surefoot.experiments.logs.format import write_log
from surefoot.experiments.study.page import Words
from surefoot.experiments.study.sources import code_of
from surefoot.experiments.walks.record import CONDITIONS, Condition, record_walk
from surefoot.experiments.walks.walkers import FEEDS, STAND_TIME
from surefoot.sensors import Fault, ForceTorque, Imu, Link, LoadCells
from surefoot.sensors.presets import HX711_LOAD_CELLS

CHIPS = Condition("chips", "on the chips' own clocks", HX711_LOAD_CELLS, "nominal")
"""The bad start: scales off by 12 %, offsets by 1.5 N, drift of 2 % and 1 N per square root of a minute. Each
converter runs at 78 to 94 Hz by itself, as HX711 chips do."""

INSTANT = Condition("instant", "converted when the host reads", LoadCells(rate=None), "nominal")
"""The same cells with an ideal converter."""

MEAN = Condition("mean", "that read means of control steps", LoadCells(rate=None, averaged=True), "nominal")
"""The same cells for feet that hit the ground hard: no instant and no old conversion says much of these."""


@dataclass(frozen=True)
class Walk:
    """A walk to record."""

    name: str  # for files
    speed: float = 0.04  # in m/s
    duration: float | None = None  # in s with standing; ``None`` for the study's
    env: Mapping[str, Any] = field(default_factory=dict)  # options of NaoWalkEnv
    sensors: Mapping[str, Any] = field(default_factory=dict)  # of FootSensors: IMU, encoders, link
    beliefs: Mapping[str, Any] = field(default_factory=dict)  # of SelfCalibration
    clock_error: float = 0.0  # s by which telemetry is later (even seeds) or earlier than assumed
    held: tuple[float, float, float] = (0.0, 0.0, 0.0)  # by a share of its weight, from and to times in s
    policy: str = ""  # of a G1 in place of the NAO
    conditions: tuple[Condition, ...] = (CHIPS,)

    def length(self, duration: float) -> float:
        """Return how long it takes in s, where the study's walks take ``duration``."""
        return duration if self.duration is None else self.duration


def log_paths(walk: Walk, seed: int, duration: float, folder: Path) -> dict[str, Path]:
    """Name the files of a walk's logs, by condition, whether they are there or not; ``duration`` is in s."""
    made_of = (walk, seed, walk.length(duration), STAND_TIME, code_of(record_walk.__module__))
    key = sha256(repr(made_of).encode()).hexdigest()[:12]
    return {c.name: folder / f"{walk.name}_{c.name}_seed{seed}_{key}.parquet" for c in walk.conditions}


def record_missing(walk: Walk, seed: int, duration: float, folder: Path) -> dict[str, Path]:
    """Record a walk unless its logs are there, and return them as :func:`log_paths` does."""
    paths = log_paths(walk, seed, duration, folder)
    if not all(path.is_file() for path in paths.values()):
        logs = record_walk(
            walk.speed,
            seed,
            walk.length(duration),
            walk.conditions,
            sensors=walk.sensors,
            beliefs=walk.beliefs,
            clock_error=walk.clock_error * (-1.0) ** seed,
            held=walk.held,
            policy=walk.policy,
            **walk.env,
        )
        for name, log in logs.items():
            write_log(log, paths[name])
    return paths


PLAIN = "speed-0.04"  # the scenario without anything special, which others are held against
SPEEDS = (0.02, 0.04, 0.1)  # speeds of the CoP paper in m/s

_FAULT_STREAM = 0xFA17

_question = Words("walks", "questions")


@dataclass(frozen=True)
class Scenario:
    """One line of the table."""

    name: str  # for files and the command
    title: str
    walk: Walk
    condition: str = CHIPS.name  # name of the cells that read it
    faults: tuple[Fault, ...] = ()  # of one channel; channel and start are drawn
    options: Mapping[str, Any] = field(default_factory=dict)  # that every method is given
    method_options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # of single methods
    most_seeds: int | None = None  # for long ones
    long: bool = False  # no part of a quick run
    paper: bool = False  # scored as the CoP paper scores, too

    @property
    def answers(self) -> str:
        """The question, and where it is asked."""
        if self.faults:
            return _question("fault", kind=self.faults[0].kind)
        return _question("paper" if self.paper else self.name.partition("-0")[0])  # of all speeds one

    def seeds(self, seeds: int) -> range:
        """Number its walks, where ``seeds`` are asked for."""
        return range(seeds if self.most_seeds is None else min(seeds, self.most_seeds))

    def options_of(self, method: str) -> dict[str, Any]:
        """Return the options that a method is given."""
        return {**self.options, **self.method_options.get(method, {})}

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


def _fault(kind: str, title: str, **options: float) -> Scenario:
    # Only a swap needs another channel; both are drawn later.
    other = 1 if kind.startswith("swapped") else None
    fault = Fault(kind.partition("-")[0], 0, other=other, **options)
    return Scenario(f"fault-{kind}", title, _PLAIN_WALK, faults=(fault,))


def _speed(speed: float) -> Walk:
    return Walk(f"speed{speed:g}", speed, conditions=(CHIPS, INSTANT))


_PLAIN_WALK = _speed(0.04)
_WARM = Condition(
    "warming",
    "warming up by 20 K in ten minutes",
    replace(HX711_LOAD_CELLS, offset_tempco=0.03, scale_tempco=5e-4, temperature_ramp=20.0 / 600.0),
    "nominal",
)
_SHEARED = Condition("shear", "feeling shear", replace(HX711_LOAD_CELLS, shear_std=0.1), "nominal")
_STILL = {"route": ((1.0, 0.0, 0.0),)}
_HELD = STAND_TIME + 11.0, STAND_TIME + 19.0
_ANKLE = Condition("ankle", "six-axis sensors in the ankles", None, "nominal", ForceTorque(averaged=False))
_BOTH = Condition(
    "both", "cells and six-axis sensors", HX711_LOAD_CELLS, "nominal", ForceTorque(averaged=False)
)
_WIDE_OFFSETS = {"moment": {"offset_std": 0.1}}  # of some 5 N, a tenth of the weight

_FOOT_LENGTH = {"foot_length": 0.17}
_ROUTE = ((6.0, 0.04, 0.0), (2.0, 0.0, 0.0), (6.0, 0.0, 0.2), (6.0, 0.04, 0.1), (2.0, 0.0, 0.0))

_TABLE = (
    *(Scenario(f"speed-{speed:g}", f"{speed:g} m/s", _speed(speed)) for speed in SPEEDS),
    *(
        Scenario(f"instant-{speed:g}", f"{speed:g} m/s, ideal converters", _speed(speed), INSTANT.name)
        for speed in SPEEDS
    ),
    Scenario(
        "start-stop-turn",
        "start, stop and turn",
        Walk("route", duration=STAND_TIME + 30.0, env={"route": (*_ROUTE, *_ROUTE[:2])}),
    ),
    Scenario("pushes", "pushes", Walk("pushes", env={"push_impulse": (0.1, 0.3)})),
    Scenario("soft-ground", "soft ground", Walk("soft", env={"ground_time_constant": 0.06})),
    Scenario("slippery-ground", "slippery ground", Walk("slippery", env={"friction": (0.04, 0.06)})),
    Scenario("rolling-feet", "rolling from heel to toe", Walk("rolling", env={"foot_roll": 0.05})),
    Scenario(
        "imu-bias",
        "IMU bias and tilt",
        Walk(
            "imu",
            sensors={
                "imu": Imu(accelerometer_bias_std=0.2, gyroscope_bias_std=4e-3, accelerometer_walk=2e-3)
            },
        ),
    ),
    Scenario(
        "delay-jitter",
        "delay off by 10 ms, and jitter",
        Walk("delay", sensors={"link": Link(jitter=0.008)}, clock_error=0.010),
    ),
    Scenario("mass-error", "mass off by 2 %", Walk("mass", beliefs={"errors": {"mass": 0.02}})),
    Scenario(
        "payload", "a payload of 0.3 kg picked up", Walk("payload", env={"payload": (0.3, STAND_TIME + 12.0)})
    ),
    Scenario("com-error", "centre of mass off by 10 mm", Walk("com", beliefs={"errors": {"com": 0.010}})),
    Scenario("standing", "standing", Walk("standing", 0.0, env=_STILL)),
    Scenario(
        "standing-held",
        "standing, held by a fifth of its weight",
        Walk("standing-held", 0.0, env=_STILL, held=(0.2, *_HELD)),
    ),
    Scenario(
        "walking-held", "walking, held by 15 % of its weight", Walk("walking-held", held=(0.15, *_HELD))
    ),
    Scenario("shear", "cells that feel shear", Walk("shear", 0.1, conditions=(_SHEARED,)), _SHEARED.name),
    *(
        _fault(kind, title, **options)
        for kind, title, options in (
            ("dead", "a cell goes dead", {}),
            ("stuck", "a cell is stuck", {}),
            ("saturated", "a cell saturates at 8 N", {"level": 8.0}),
            ("saturated-rail", "a cell goes to its rail", {}),
            ("spiking", "a cell spikes five times a second", {"rate": 5.0}),
            ("dropped", "a cell's readings no longer arrive", {}),
            ("swapped", "two cells are swapped", {}),
            ("flipped", "a cell's sign flips", {}),
        )
    ),
    Scenario(
        "ankle-ft",
        "six-axis sensors in the ankles",
        Walk("ankle", conditions=(_ANKLE, _BOTH)),
        _ANKLE.name,
        options=_FOOT_LENGTH,
        method_options=_WIDE_OFFSETS,
    ),
    Scenario(
        "cells-and-ankle-ft",
        "cells and six-axis sensors",
        Walk("ankle", conditions=(_ANKLE, _BOTH)),
        _BOTH.name,
        options=_FOOT_LENGTH,
        method_options=_WIDE_OFFSETS,
    ),
    Scenario(
        "temperature-ramp",
        "ten minutes, warming by 20 K",
        Walk("warming", duration=STAND_TIME + 600.0, conditions=(_WARM,)),
        _WARM.name,
        most_seeds=3,
        long=True,
    ),
    Scenario(
        "half-an-hour",
        "half an hour",
        Walk("half-hour", duration=STAND_TIME + 1800.0),
        most_seeds=3,
        long=True,
    ),
)
if "SUREFOOT_STRANGERS" in os.environ:
    _TABLE += (
        Scenario(
            "g1-policy",
            "a G1 by a published policy",
            Walk("g1-policy", 0.4, policy="ppo_g1_29dof", conditions=(MEAN,)),
            MEAN.name,
        ),
    )

PAPER_SCENARIOS = {
    (condition.name, speed): Scenario(
        f"{condition.name}-{speed:g}",
        f"{speed:g} m/s, {condition.title}",
        Walk(f"both-{speed:g}", speed, conditions=CONDITIONS),
        condition.name,
        paper=True,
    )
    for speed in SPEEDS
    for condition in CONDITIONS
}
"""Scenarios that are scored as the CoP paper scores as well, by condition and speed in m/s."""

SCENARIOS = MappingProxyType({scenario.name: scenario for scenario in _TABLE})
"""The scenarios of the comparison by name, in the order of the page."""


def find_scenarios(names: tuple[str, ...], *, quick: bool) -> tuple[Scenario, ...]:
    """Return scenarios by names, or raise ValueError with their names; all for none, quick without long."""
    known = {**SCENARIOS, **{scenario.name: scenario for scenario in PAPER_SCENARIOS.values()}}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"There is no scenario '{unknown[0]}'. Available: {', '.join(known)}.")
    if names:
        return tuple(known[name] for name in dict.fromkeys(names))
    return tuple(scenario for scenario in SCENARIOS.values() if not (quick and scenario.long))


TRUE_MAP = "floor"
"""Name of the row of the map that would undo the cells' errors at every moment, of readings as they are."""


# Without weights there is no calibration from them.
LOOPED = tuple(feed for feed in FEEDS if feed != "weights")
PAPER_CONDITIONS = ("paper", "bad-start")  # names of the conditions of the CoP paper's study


@dataclass(frozen=True)
class WalkStudyOptions:
    """How much a study of walks does; raise ValueError at a number out of range or an unknown method."""

    out: Path = Path("out/compare-walking")
    seeds: int = 20  # walks of a scenario and of each closed loop: 0, 1, ...
    scenarios: tuple[str, ...] = ()  # none for all but those of the CoP paper
    methods: tuple[str, ...] = ()  # none for all; the true map comes on top
    jobs: int = 2
    duration: float = STAND_TIME + 30.0  # of a walk in s, with the standing before it
    settle: float = STAND_TIME + 10.0  # errors count from this time in s on
    quick: bool = False  # without long scenarios
    loops: Mapping[float, tuple[str, ...]] = field(default_factory=dict)  # feeds by severity
    loop_seeds: int | None = None  # of each closed loop at most
    loop_duration: float = STAND_TIME + 20.0  # in s, standing included
    factors: tuple[float, ...] = ()  # of the window's weights
    sensitivity_seeds: int = 5  # walks on which each weight is scaled
    film_duration: float = 0.0  # in s; 0 for no film

    def __post_init__(self) -> None:
        """Check the numbers and the names."""
        for name in ("seeds", "jobs", "sensitivity_seeds"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, got {getattr(self, name)}.")
        if not STAND_TIME < self.settle < self.duration:
            raise ValueError(
                f"'settle' must lie between {STAND_TIME:g} s of standing and the walk's end at "
                f"{self.duration:g} s, got {self.settle:g} s."
            )
        for name in self.methods:
            if name != TRUE_MAP:
                method_entry(name)

    @property
    def logs(self) -> Path:
        """The folder that recorded walks are kept in."""
        return self.out / "logs"

    @property
    def rows(self) -> tuple[str, ...]:
        """The scored methods, in order: the true map and the methods, by default all."""
        return tuple(dict.fromkeys((TRUE_MAP, *(self.methods or METHODS))))

    def quickly(self) -> "WalkStudyOptions":
        """Return the same with two seeds, short walks and one speed, to see whether all works."""
        few = replace(self, seeds=min(self.seeds, 2), quick=True)
        if not self.loops:
            return replace(few, duration=STAND_TIME + 14.0, settle=STAND_TIME + 6.0)
        return replace(
            few,
            scenarios=paper_names(0.04),
            duration=STAND_TIME + 8.0,
            settle=STAND_TIME + 4.0,
            loops={3.0: LOOPED},
            loop_duration=STAND_TIME + 4.0,
            factors=(0.2, 1.0, 5.0) if self.factors else (),
            sensitivity_seeds=1,
            film_duration=min(self.film_duration, STAND_TIME + 2.0),
        )


def paper_names(*speeds: float) -> tuple[str, ...]:
    """Return the names of the CoP paper's scenarios at speeds in m/s."""
    return tuple(f"{condition}-{speed:g}" for speed in speeds for condition in PAPER_CONDITIONS)


def full_options(
    out: Path = Path("out/compare-walking-full"), seeds: int = 10, jobs: int = 2
) -> WalkStudyOptions:
    """Return the CoP paper's study in full: three speeds, closed loops, the window's weights, a film."""
    return WalkStudyOptions(
        out=out,
        seeds=seeds,
        jobs=jobs,
        scenarios=paper_names(0.02, 0.04, 0.1),
        loops={3.0: LOOPED, 1.0: ("none", "window")},
        factors=(0.2, 0.5, 1.0, 2.0, 5.0),
        film_duration=STAND_TIME + 12.0,
    )


def demo_options(out: Path = Path("out/demo"), seeds: int = 8, jobs: int = 2) -> WalkStudyOptions:
    """Return the same at one speed, with fewer walks: less than two minutes on two cores."""
    return replace(
        full_options(out, seeds, jobs),
        scenarios=paper_names(0.04),
        loops={3.0: LOOPED},
        loop_seeds=4,
        factors=(),
        film_duration=STAND_TIME + 10.0,
    )
