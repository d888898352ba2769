"""Record videos of episodes: one robot, or several side by side, with the centre of pressure (CoP).

A typical video compares a walk with drifting raw readings and a walk with calibrated ones. Below each robot
is a view of its soles from above. Feet that carry weight are filled. A black dot is the true CoP, and a
coloured dot is the CoP fed to the controller.
"""

import os
import sys
from collections.abc import Iterable, Sequence
from ctypes.util import find_library
from pathlib import Path
from typing import Any, NamedTuple

import imageio.v2 as imageio
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from surefoot.arrays import Floats
from surefoot.experiments.evaluate.episode import EpisodeStep, Stage
from surefoot.experiments.study.figures import look_of
from surefoot.experiments.walks.loop import Walk
from surefoot.files import atomic_path

FILM, STILL = "walk.mp4", "walk.png"  # video and picture of two walks in a study's folder
FRAMES_PER_SECOND = 16
ANIMATIONS = (".webp", ".gif")
WIDTH, HEIGHT, BELOW = 480, 352, 176
SIZE = {"width": 3 * WIDTH // 2, "height": 3 * HEIGHT // 2}
"""Rendering options of an environment: larger frames that are reduced are smooth in a third of the time that
a software renderer needs for multisampling."""
AFTER_FALL = 4  # number of frames between a fall and the still picture
FIRST_MOMENT = 3.0  # time in s at which the video starts; the robot stands before
PIXELS_PER_METRE = 700  # scale of the view from above
OVERSAMPLING = 2  # factor by which the view from above is drawn larger and then reduced, for smooth edges


class Reel(NamedTuple):
    """Video of one episode: frames of shape (height, width, 3), and whether the robot falls at the end."""

    frames: list[NDArray[np.uint8]]
    fell: bool


def prepare_rendering() -> None:
    """Select offscreen rendering if there is no screen and the user has not selected a backend.

    Call this before MuJoCo renders for the first time. If EGL is missing, nothing is selected, because MuJoCo
    cannot be imported with a backend that does not exist.
    """
    if sys.platform == "linux" and not _has_screen() and find_library("EGL"):
        os.environ.setdefault("MUJOCO_GL", "egl")


def shoot(steps: Iterable[EpisodeStep], feed: str, begin: float = 0.0, title: str = "") -> Reel:
    """Record an episode of an environment that renders.

    Args:
        steps: Steps of the episode.
        feed: Feed of the controller.
        begin: Time in s at which the video starts.
        title: Title of the video, by default the name of the feed.

    Raises:
        OSError: If rendering fails.
        ValueError: If the episode is invalid, or ends before the video starts.
    """
    frames, fell = [], False
    try:
        for k, step in enumerate(steps):
            bare: Any = step.feet.unwrapped
            quality, fell = bare.model.vis.quality, step.fell
            # With a software renderer, shadows take ten times as long as everything else.
            quality.shadowsize, quality.offsamples = 0, 0 if getattr(bare, "width", 0) > WIDTH else 4
            dt = step.time / len(step.feet.fed)
            shown = k % max(round(1.0 / (dt * FRAMES_PER_SECOND)), 1) == 0 and step.time > begin
            if shown or fell:
                frames.append(_sheet(feed, step, title))
    except ValueError:
        raise  # An invalid episode is not an error of the driver.
    except Exception as error:  # The type of the exception depends on the OpenGL driver.
        reason = (str(error).splitlines() or [""])[0]
        raise OSError(
            f"nothing can be drawn here ({type(error).__name__}: {reason}); install an OpenGL driver such as "
            "libegl1 and libgl1-mesa-dri, or set MUJOCO_GL."
        ) from error
    if not frames:
        raise ValueError(f"A film begins at {begin:g} s, when the robot has stood: make it longer.")
    return Reel(frames, fell)


def shoot_walk(walk: Walk) -> Reel:
    """Record a walk, starting after its standing phase. Raises the errors of :func:`shoot`."""
    prepare_rendering()
    return shoot(walk.steps(render_mode="rgb_array", **SIZE), walk.feed, FIRST_MOMENT)


def join_reels(folder: Path, *reels: Reel) -> None:
    """Write walks side by side to :data:`FILM`, and one frame (first fall or middle) to :data:`STILL`."""
    frames = _side_by_side(reels)
    falls = [len(reel.frames) + AFTER_FALL for reel in reels if reel.fell]
    shown = min(falls, default=len(frames) // 2)
    write_film(folder / FILM, frames)
    with atomic_path(folder / STILL) as part:
        Image.fromarray(frames[min(shown, len(frames) - 1)]).save(part)


def film_walks(path: Path, feeds: Sequence[str], **walk: Any) -> Path:
    """Record the same walk with one or more feeds side by side. ``walk`` contains fields of :class:`Walk`."""
    return write_film(path, _side_by_side([shoot_walk(Walk(feed, **walk)) for feed in feeds]))


def film_stage(path: Path, stage: Stage, feed: str, seed: int, title: str) -> Path:
    """Record an episode of an evaluation whose environment renders. Raises the errors of :func:`shoot`."""
    return write_film(path, shoot(stage.steps(seed), feed, title=title).frames)


def write_film(path: Path, frames: Sequence[NDArray[np.uint8]] | NDArray[np.uint8]) -> Path:
    """Write frames (height, width, 3) to an .mp4, or every second frame to an animated .webp or .gif."""
    with atomic_path(path) as part:
        if path.suffix in ANIMATIONS:
            stills = [Image.fromarray(frame) for frame in frames[::2]]
            options: Any = {"save_all": True, "append_images": stills[1:], "loop": 0, "method": 6}
            stills[0].save(part, duration=2000 // FRAMES_PER_SECOND, **options)
            return path
        writer: Any = imageio.get_writer(part, fps=FRAMES_PER_SECOND, codec="libx264", quality=7)
        try:
            for frame in frames:
                writer.append_data(frame)
        finally:
            writer.close()
    return path


def _has_screen() -> bool:
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _side_by_side(reels: Sequence[Reel]) -> list[NDArray[np.uint8]]:
    """Join walks side by side. A walk that has ended continues to show its last frame."""
    count = max(len(reel.frames) for reel in reels)
    return [np.hstack([reel.frames[min(k, len(reel.frames) - 1)] for reel in reels]) for k in range(count)]


def _sheet(feed: str, step: EpisodeStep, title: str) -> NDArray[np.uint8]:
    """Draw one frame with the robot, a title with the time, and the view from above."""
    sheet, look = Image.new("RGB", (WIDTH, HEIGHT + BELOW), "white"), look_of(feed)
    bare: Any = step.feet.unwrapped
    sheet.paste(Image.fromarray(bare.render()).resize((WIDTH, HEIGHT)), (0, 0))
    sheet.paste(_from_above(feed, step), (0, HEIGHT))
    name = {"true": "true CoP", "none": "drifting raw CoP", "raw": "drifting raw CoP"}.get(
        feed, f"CoP by {look.label}"
    )
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=14 if title else 18)
    draw.rectangle((0, 0, WIDTH, 30), fill="white")
    draw.ellipse((10, 10, 20, 20), fill=look.colour)
    draw.text((28, 4), title or name, fill="black", font=font)
    draw.text((WIDTH - 76, 4), f"{step.time:5.1f} s", fill="black", font=font)
    if step.fell:
        draw.text((WIDTH - 64, 38), "fallen", fill="#b34700", font=font)
    draw.line((WIDTH - 1, 0, WIDTH - 1, HEIGHT + BELOW), fill="white", width=2)
    return np.asarray(sheet)


def _from_above(feed: str, step: EpisodeStep) -> Image.Image:
    """Draw the soles and the CoP from above. Forward is to the right, and the view follows the robot."""
    size = np.array([WIDTH, BELOW]) * OVERSAMPLING
    scale = PIXELS_PER_METRE * OVERSAMPLING
    truth, drawing = step.feet.source.truth, step.feet.source.drawing
    sole, R = truth.position_sole[-1], truth.R_world_sole[-1]
    centre = sole[:, :2].mean(axis=0)

    def at(point: Floats) -> tuple[float, float]:
        x, y = (point[:2] - centre) * scale
        return float(0.42 * size[0] + x), float(0.5 * size[1] - y)

    picture = Image.new("RGB", (int(size[0]), int(size[1])), "#f6f8fa")
    draw = ImageDraw.Draw(picture)
    cells, force = drawing.position_cell_sole, truth.contacts()[:, 2]
    for foot in range(len(sole)) if cells is not None else ():
        corners = sole[foot] + cells[foot][[0, 1, 3, 2]] @ R[foot].T
        fill = "#dfe4ea" if force[foot] > 1.0 else None
        draw.polygon([at(corner) for corner in corners], fill, outline="#5b6775", width=2 * OVERSAMPLING)
    dots = ((step.fed_cop_world, look_of(feed).colour, 7), (step.true_cop_world, "black", 4))
    for place, colour, radius in dots:
        if np.isfinite(place).all():
            x, y = at(place)
            r = radius * OVERSAMPLING
            draw.ellipse((x - r, y - r, x + r, y + r), fill=colour, outline="white", width=OVERSAMPLING)
    small = picture.resize((WIDTH, BELOW), Image.Resampling.LANCZOS)
    label = ImageDraw.Draw(small)
    label.text((8, BELOW - 20), "feet from above; black: true CoP", fill="#5b6775")
    return small
