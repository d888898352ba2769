"""Single episodes on film."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from surefoot.experiments.episodes.episode import Episode, episode_moments
from surefoot.experiments.policy.controllers import short_name
from surefoot.experiments.study.figures import look_of
from surefoot.experiments.walks.closed_loop import Moment
from surefoot.experiments.walks.video import HEIGHT, WIDTH, headed, mark_cop, pictures, write_film

LAST_SECONDS = 12.0  # what is kept of a long episode, in s: its end, where the fall is


def film_episode(path: Path, episode: Episode, *, until: float | None = None) -> Path:
    """Film the last 12 s of an episode, or all, with true (black) and fed CoP, as .mp4; OSError as drawn."""
    who = f"{short_name(episode.controller)}, {look_of(episode.feed).label}, {episode.scenario}"

    def draw(moment: Moment) -> NDArray[np.uint8]:
        mark_cop(episode.feed, moment)
        picture = Image.fromarray(moment.bare.render())
        headed(picture, f"case {episode.number}: {who}", moment, 24, 14)
        return np.asarray(picture)

    size: Any = {"width": WIDTH, "height": HEIGHT}
    begin = 0.0 if until is None else until - LAST_SECONDS
    drawn = pictures(lambda: episode_moments(episode, render_mode="rgb_array", **size), draw, begin)
    return write_film(path, [frame for frame, _ in drawn], quality=6)
