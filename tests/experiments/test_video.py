"""Films: joined, cut to one length, and done without where nothing can be drawn."""

from collections.abc import Iterator
from pathlib import Path

import imageio.v2 as imageio
import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from surefoot.experiments.walks import video
from surefoot.experiments.walks.video import FILM, FRAMES_PER_SECOND, STILL, Reel, join_reels


def reel(count: int, shade: int, fell: bool = False) -> Reel:
    return Reel([np.full((32, 32, 3), shade + k, dtype=np.uint8) for k in range(count)], fell)


def test_two_walks_side_by_side(tmp_path: Path) -> None:
    join_reels(tmp_path, reel(8, 20, fell=True), reel(24, 200))
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / FILM))
    assert frames == 24
    assert seconds == pytest.approx(24 / FRAMES_PER_SECOND, abs=0.5 / FRAMES_PER_SECOND)
    still = np.asarray(imageio.imread(tmp_path / STILL))
    assert still.shape == (32, 64, 3)
    # A quarter of a second after the fall: the left one lies there still, the right one walks on.
    assert (still[:, :32] == 27).all()
    assert (still[:, 32:] == 212).all()


@pytest.mark.parametrize("suffix", video.ANIMATIONS)
def test_an_animation_takes_every_other_picture_and_goes_round(tmp_path: Path, suffix: str) -> None:
    shades = np.linspace(0, 255, 9, dtype=np.uint8)
    path = video.write_film(tmp_path / f"walk{suffix}", np.full((9, 32, 32, 3), shades[:, None, None, None]))
    with Image.open(path) as film:
        assert (film.n_frames, film.info["loop"], film.size) == (5, 0, (32, 32))


def test_a_driver_that_fails_is_named_with_a_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> Iterator[object]:
        raise RuntimeError("no context\nand much more")
        yield

    monkeypatch.setattr(video.Walk, "steps", broken)
    with pytest.raises(OSError, match=r"can be drawn here \(RuntimeError: no context\); install an OpenGL"):
        video.film_walks(Path("walk.mp4"), ["true"], speed=0.04, seed=0, duration=4.0)
