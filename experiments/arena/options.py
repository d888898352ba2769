"""How much the arena does."""

from dataclasses import dataclass, replace
from pathlib import Path

from surefoot.calibration.online import METHODS, method_name
from surefoot.experiments.walks.walkers import STAND_TIME, check_study

__all__ = ["TRUE_MAP", "ArenaOptions"]

TRUE_MAP = "floor"
"""Name of the row that no method reaches: the map that would undo the cells' errors at every moment."""


@dataclass(frozen=True)
class ArenaOptions:
    """How much the arena does.

    Attributes:
        out: Folder for everything that is made.
        seeds: Number of walks of a scenario; the seeds are 0, 1, ...
        scenarios: Names of scenarios; none for all.
        methods: Names of methods; none for all. The true map comes on top.
        jobs: Processes that work at the same time.
        duration: Length of a walk in s, the standing before it included.
        settle: Errors count from this time in s on.
        quick: Whether long scenarios are left out.
    """

    out: Path = Path("out/arena")
    seeds: int = 20
    scenarios: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    jobs: int = 2
    duration: float = STAND_TIME + 30.0
    settle: float = STAND_TIME + 10.0
    quick: bool = False

    def __post_init__(self) -> None:
        """Refuse what cannot be done."""
        check_study(self, "seeds", "jobs")
        object.__setattr__(self, "methods", tuple(map(method_name, self.methods)))
        unknown = [name for name in self.methods if name not in METHODS and name != TRUE_MAP]
        if unknown:
            available = ", ".join(map(repr, METHODS))
            raise ValueError(f"Method '{unknown[0]}' does not exist. Available: {available}.")

    @property
    def rows(self) -> tuple[str, ...]:
        """What is scored, in order: the true map and the methods."""
        return tuple(dict.fromkeys((TRUE_MAP, *(self.methods or METHODS))))

    def quickly(self) -> "ArenaOptions":
        """The same with two seeds and short walks, to see whether all works."""
        return replace(
            self,
            seeds=min(self.seeds, 2),
            duration=STAND_TIME + 14.0,
            settle=STAND_TIME + 6.0,
            quick=True,
        )
