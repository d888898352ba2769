"""Walks in closed loop: the stabilised walk of a NAO on its own feet."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from surefoot.envs.nao.env import CONTROL_STEP
from surefoot.experiments.evaluate.episode import EpisodeStep, Stage, run_episode
from surefoot.experiments.evaluate.setup import Setup
from surefoot.experiments.walks.walkers import STAND_TIME

WALK = "surefoot/NaoWalk-v0"
SHORTEST = 2.0  # shortest walk in s that a pattern is planned for
TABLE = "episodes"  # name of the table of a study's store that holds the rows


class Walk(NamedTuple):
    """A walk on the feet of a feed; durations include the standing before it."""

    feed: str
    speed: float  # m/s
    seed: int
    duration: float  # s
    severity: float = 1.0  # factor of all errors of the cells

    @property
    def setup(self) -> Setup:
        """The environment; its plan goes on beyond the end of the walk."""
        planned = max(self.duration, SHORTEST) + 2 * STAND_TIME
        options = {"speed": self.speed, "duration": planned, "stand_time": STAND_TIME}
        longest = max(self.duration, STAND_TIME + CONTROL_STEP)
        return Setup(WALK, options, "hx711-load-cells", settle=STAND_TIME, duration=longest)

    def steps(self, **drawing: Any) -> Iterator[EpisodeStep]:
        """Run it; drawing options change nothing but pictures."""
        stage = Stage.make(self.setup, "stabiliser", self.feed, self.severity, **drawing)
        try:
            yield from stage.steps(self.seed)
        finally:
            stage.env.close()


def loop_row(walk: Walk) -> dict[str, list[dict[str, Any]]]:
    """Return the row of a walk; its time counts from the beginning, standing included."""
    row = run_episode(walk.setup, "stabiliser", walk.feed, walk.severity, walk.seed)
    return {TABLE: [{**row, "speed": walk.speed, "time": row["time"] + STAND_TIME}]}
