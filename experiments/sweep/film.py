"""Single episodes on film."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from surefoot.experiments.policy.controllers import short_name
from surefoot.experiments.study.figures import look_of
from surefoot.experiments.sweep.episode import Cell, Step, cell_steps
from surefoot.experiments.walks.video import FRAMES_PER_SECOND, mark_cop, prepare_rendering, write_film

__all__ = ["film_cell"]

WIDTH, HEIGHT = 480, 352
_LAST_SECONDS = 12.0
"""What is kept of a long episode, in s: its end, where the fall is."""


def film_cell(path: Path, cell: Cell, *, until: float | None = None) -> Path:
    """Run an episode again and film its end, with the true (black) and the fed centre of pressure.

    Args:
        path: Where the film goes, ending in .mp4.
        cell: The episode.
        until: When it is known to end, in s: what is shown begins 12 s before. ``None`` shows all.

    Raises:
        OSError: If nothing can be drawn on this machine.
        ValueError: If something in the cell is refused.
    """
    prepare_rendering()
    from_time = 0.0 if until is None else until - _LAST_SECONDS
    every = round(80 / FRAMES_PER_SECOND)
    frames = []
    try:
        for k, step in enumerate(cell_steps(cell, render_mode="rgb_array", width=WIDTH, height=HEIGHT)):
            if k == 0:
                # Shadows take a software renderer ten times as long as all the rest.
                step.moment.bare.model.vis.quality.shadowsize = 0
            if (k % every == 0 and step.moment.time > from_time) or step.moment.fell:
                frames.append(_frame(cell, step))
    except ValueError:
        raise  # A cell that is refused is no fault of the driver.
    except Exception as error:  # Drivers fail in as many ways as there are drivers.
        raise OSError(
            f"nothing can be drawn here ({type(error).__name__}: {error}); install an OpenGL driver such as "
            "libegl1 and libgl1-mesa-dri, or set MUJOCO_GL."
        ) from error
    return write_film(path, frames, quality=6)


def _frame(cell: Cell, step: Step) -> NDArray[np.uint8]:
    moment = step.moment
    mark_cop(cell.feed, moment)
    picture = Image.fromarray(moment.bare.render())
    draw = ImageDraw.Draw(picture)
    draw.rectangle((0, 0, WIDTH, 24), fill="white")
    text = f"cell {cell.number}: {short_name(cell.controller)}, {look_of(cell.feed).label}, {cell.scenario}"
    draw.text((8, 4), text, fill="black", font=ImageFont.load_default(size=14))
    draw.text((WIDTH - 60, 4), f"{moment.time:5.1f} s", fill="black", font=ImageFont.load_default(size=14))
    if moment.fell:
        draw.text((WIDTH - 60, 30), "fallen", fill="#b34700", font=ImageFont.load_default(size=14))
    return np.asarray(picture)
