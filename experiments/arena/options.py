"""How much a study of walks does."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from surefoot.calibration.online import METHODS, method_entry
from surefoot.experiments.walks.walkers import STAND_TIME

TRUE_MAP = "floor"
"""Name of the row of the map that would undo the cells' errors at every moment, of readings as they are."""


@dataclass(frozen=True)
class ArenaOptions:
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
        """What is scored, in order: the true map and the methods, by default all."""
        return tuple(dict.fromkeys((TRUE_MAP, *(self.methods or METHODS))))

    def quickly(self) -> "ArenaOptions":
        """Return the same with two seeds and short walks, to see whether all works."""
        few, duration, settle = min(self.seeds, 2), STAND_TIME + 14.0, STAND_TIME + 6.0
        return replace(self, seeds=few, duration=duration, settle=settle, quick=True)
