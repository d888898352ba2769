"""How much a study of walks does: of all scenarios, of the CoP paper's, and a first one."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from surefoot.calibration.online import METHODS, method_entry
from surefoot.experiments.walks.scenarios import SCENARIOS, SPEEDS, TRUE_MAP
from surefoot.experiments.walks.walkers import FEEDS, STAND_TIME

# Without weights there is no calibration from them.
LOOPED = tuple(feed for feed in FEEDS if feed != "weights")


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
    film_duration: float = 0.0  # in s; 0 for no film

    def __post_init__(self) -> None:
        """Check the numbers and the names."""
        for name in ("seeds", "jobs"):
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
            film_duration=min(self.film_duration, STAND_TIME + 2.0),
        )


def paper_names(*speeds: float) -> tuple[str, ...]:
    """Names of the CoP paper's scenarios at speeds in m/s."""
    return tuple(
        scenario.name for scenario in SCENARIOS.values() if scenario.paper and scenario.speed in speeds
    )


def full_options(
    out: Path = Path("out/compare-walking-full"), seeds: int = 10, jobs: int = 2
) -> WalkStudyOptions:
    """Return the CoP paper's study in full: three speeds, closed loops, a film."""
    return WalkStudyOptions(
        out=out,
        seeds=seeds,
        jobs=jobs,
        scenarios=paper_names(*SPEEDS),
        loops={3.0: LOOPED, 1.0: ("none", "window")},
        film_duration=STAND_TIME + 12.0,
    )


def demo_options(out: Path = Path("out/demo"), seeds: int = 8, jobs: int = 2) -> WalkStudyOptions:
    """Return the same at one speed, with fewer walks: less than two minutes on two cores."""
    return replace(
        full_options(out, seeds, jobs),
        scenarios=paper_names(0.04),
        loops={3.0: LOOPED},
        loop_seeds=4,
        film_duration=STAND_TIME + 10.0,
    )
