"""How much the demo does."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from surefoot.experiments.walks.walkers import FEEDS, STAND_TIME, check_study

__all__ = ["DemoOptions"]

_LOOPED = tuple(feed for feed in FEEDS if feed != "weights")


@dataclass(frozen=True)
class DemoOptions:
    """How much the demo does.

    Attributes:
        out: Folder for everything that is made.
        seeds: Number of walks at each speed and in each closed loop; the seeds are 0, 1, ...
        jobs: Processes that work at the same time.
        speeds: Walking speeds in m/s.
        duration: Length of a recorded walk in s, the standing before it included.
        settle: Errors count from this time in s on.
        loop_duration: Length of a walk in the closed loop in s, standing included.
        loops: What the controller is given in the closed loop, by how bad the cells are: 1 is the bad start,
            3 three times as bad.
        factors: What the window's weights are scaled by.
        sensitivity_seeds: Walks of each cell of the sensitivity study.
        film_duration: Length of the film in s; 0 for none.
    """

    out: Path = Path("out/demo")
    seeds: int = 10
    jobs: int = 2
    speeds: tuple[float, ...] = (0.02, 0.04, 0.1)
    duration: float = STAND_TIME + 30.0
    settle: float = STAND_TIME + 10.0
    loop_duration: float = STAND_TIME + 20.0
    loops: Mapping[float, tuple[str, ...]] = field(
        default_factory=lambda: {3.0: _LOOPED, 1.0: ("none", "window")}
    )
    factors: tuple[float, ...] = (0.2, 0.5, 1.0, 2.0, 5.0)
    sensitivity_seeds: int = 5
    film_duration: float = STAND_TIME + 12.0

    def __post_init__(self) -> None:
        """Refuse what cannot be done."""
        check_study(self, "seeds", "jobs", "sensitivity_seeds")

    def quick(self) -> "DemoOptions":
        """The same with one speed, two seeds and short walks: half a minute, to see whether all works."""
        return replace(
            self,
            seeds=min(self.seeds, 2),
            speeds=(0.04,),
            duration=STAND_TIME + 8.0,
            settle=STAND_TIME + 4.0,
            loop_duration=STAND_TIME + 4.0,
            loops={3.0: _LOOPED},
            factors=(0.2, 1.0, 5.0),
            sensitivity_seeds=1,
            film_duration=STAND_TIME + 2.0,
        )
