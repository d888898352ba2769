"""Single episodes on film."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from surefoot.experiments.episodes.episode import Episode, Step, episode_steps
from surefoot.experiments.policy.controllers import short_name
from surefoot.experiments.study.figures import look_of
from surefoot.experiments.walks.video import FRAMES_PER_SECOND, mark_cop, prepare_rendering, write_film

__all__ = ["film_episode"]

WIDTH, HEIGHT = 480, 352

LAST_SECONDS = 12.0
"""What is kept of a long episode, in s: its end, where the fall is."""

_BAR = 24
"""Height of the heading in pixels."""


def film_episode(path: Path, episode: Episode, *, until: float | None = None) -> Path:
    """Run an episode again and film its end, with the true (black) and the fed centre of pressure.

    Args:
        path: Where the film goes, ending in .mp4.
        episode: Which one.
        until: When it is known to end, in s: what is shown begins 12 s before. ``None`` shows all.

    Raises:
        OSError: If nothing can be drawn on this machine.
        ValueError: If something in the episode is refused.
    """
    prepare_rendering()
    from_time = 0.0 if until is None else until - LAST_SECONDS
    frames = []
    try:
        steps = episode_steps(episode, render_mode="rgb_array", width=WIDTH, height=HEIGHT)
        for k, step in enumerate(steps):
            bare = step.moment.bare
            if k == 0:
                # Shadows take a software renderer ten times as long as all the rest.
                bare.model.vis.quality.shadowsize = 0
            shown = k % round(1.0 / (bare.dt * FRAMES_PER_SECOND)) == 0 and step.moment.time > from_time
            if shown or step.moment.fell:
                frames.append(_frame(episode, step))
    except ValueError:
        raise  # An episode that is refused is no fault of the driver.
    except Exception as error:  # Drivers fail in as many ways as there are drivers.
        raise OSError(
            f"nothing can be drawn here ({type(error).__name__}: {error}); install an OpenGL driver such as "
            "libegl1 and libgl1-mesa-dri, or set MUJOCO_GL."
        ) from error
    return write_film(path, frames, quality=6)


def _frame(episode: Episode, step: Step) -> NDArray[np.uint8]:
    moment = step.moment
    mark_cop(episode.feed, moment)
    picture = Image.fromarray(moment.bare.render())
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(size=14)
    draw.rectangle((0, 0, WIDTH, _BAR), fill="white")
    who = f"{short_name(episode.controller)}, {look_of(episode.feed).label}, {episode.scenario}"
    draw.text((8, 4), f"case {episode.number}: {who}", fill="black", font=font)
    draw.text((WIDTH - 60, 4), f"{moment.time:5.1f} s", fill="black", font=font)
    if moment.fell:
        draw.text((WIDTH - 60, 30), "fallen", fill="#b34700", font=font)
    return np.asarray(picture)
