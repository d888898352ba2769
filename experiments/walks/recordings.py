"""The walks of the arena: recorded once, read by cells of several kinds, and kept.

Files are named by a hash of all that made them: code and options.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

from surefoot.experiments.logs.format import write_log
from surefoot.experiments.study.sources import code_of
from surefoot.experiments.walks.record import Condition, record_walk
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.sensors import LoadCells
from surefoot.sensors.presets import HX711_LOAD_CELLS

INSTANT = Condition("instant", "converted when the host reads", LoadCells(rate=None), "nominal")
"""The bad start: scales off by 12 %, offsets by 1.5 N, drift of 2 % and 1 N per square root of a minute."""

CHIPS = Condition("chips", "on the chips' own clocks", HX711_LOAD_CELLS, "nominal")
"""The same cells behind converters that run at 78 to 94 Hz, each on its own, as HX711 chips do."""


@dataclass(frozen=True)
class Walk:
    """A walk to record."""

    name: str  # for files
    speed: float = 0.04  # in m/s
    duration: float | None = None  # in s with standing; ``None`` for the arena's
    env: Mapping[str, Any] = field(default_factory=dict)  # options of NaoWalkEnv
    sensors: Mapping[str, Any] = field(default_factory=dict)  # of FootSensors: IMU, encoders, link
    beliefs: Mapping[str, Any] = field(default_factory=dict)  # of SelfCalibration
    clock_error: float = 0.0  # s by which telemetry is later (even seeds) or earlier than assumed
    conditions: tuple[Condition, ...] = (INSTANT,)

    def lasting(self, duration: float) -> float:
        """Return how long it takes in s, where the arena's walks take ``duration``."""
        return duration if self.duration is None else self.duration


def log_paths(walk: Walk, seed: int, duration: float, folder: Path) -> dict[str, Path]:
    """Name the files of a walk's logs, by condition, whether they are there or not; ``duration`` is in s."""
    made_of = (walk, seed, walk.lasting(duration), STAND_TIME, code_of("surefoot.experiments.walks.record"))
    key = sha256(repr(made_of).encode()).hexdigest()[:12]
    return {c.name: folder / f"{walk.name}_{c.name}_seed{seed}_{key}.parquet" for c in walk.conditions}


def record_missing(walk: Walk, seed: int, duration: float, folder: Path) -> dict[str, Path]:
    """Record a walk unless its logs are there, and return them as :func:`log_paths` does."""
    paths = log_paths(walk, seed, duration, folder)
    if not all(path.is_file() for path in paths.values()):
        logs = record_walk(
            walk.speed,
            seed,
            walk.lasting(duration),
            walk.conditions,
            sensors=walk.sensors,
            beliefs=walk.beliefs,
            clock_error=walk.clock_error * (-1.0) ** seed,
            **walk.env,
        )
        for name, log in logs.items():
            write_log(log, paths[name])
    return paths
