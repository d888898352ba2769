"""The stabilised walk of a NAO in closed loop, on the feet of a feed."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from surefoot.envs.nao.env import CONTROL_STEP
from surefoot.experiments.evaluate.episode import EpisodeStep, Stage, run_episode
from surefoot.experiments.evaluate.setup import Setup
from surefoot.experiments.walks.walkers import STAND_TIME

SHORTEST = 2.0  # shortest walk in s for which a pattern is planned


class Walk(NamedTuple):
    """A walk on the feet of a feed; its duration includes the standing before it."""

    feed: str
    speed: float  # m/s
    seed: int
    duration: float  # s
    severity: float = 1.0  # factor of all errors of the cells

    @property
    def setup(self) -> Setup:
        """The environment, whose plan continues beyond the end of the walk."""
        planned = max(self.duration, SHORTEST) + 2 * STAND_TIME
        options = {"speed": self.speed, "duration": planned, "stand_time": STAND_TIME}
        longest = max(self.duration, STAND_TIME + CONTROL_STEP)
        return Setup("surefoot/NaoWalk-v0", options, "hx711-load-cells", settle=STAND_TIME, duration=longest)

    def steps(self, **drawing: Any) -> Iterator[EpisodeStep]:
        """Run the walk; options of drawing change nothing but pictures."""
        stage = Stage.make(self.setup, "stabiliser", self.feed, self.severity, **drawing)
        try:
            yield from stage.steps(self.seed)
        finally:
            stage.env.close()

    def row(self) -> dict[str, Any]:
        """Run the walk, and return its row; its time includes the standing."""
        row = run_episode(self.setup, "stabiliser", self.feed, self.severity, self.seed)
        return {**row, "feed": self.feed, "speed": self.speed, "time": row["time"] + STAND_TIME}
