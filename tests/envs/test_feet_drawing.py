"""``surefoot view --feet``: which bodies were taken for feet, and a picture of them."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from surefoot.envs import FeetDrawing, NaoStandEnv
from surefoot.experiments.cli.app import app


def test_words_tell_what_was_guessed_and_what_is_under_it() -> None:
    head, left, right = FeetDrawing("surefoot/NaoStand-v0").words()
    assert head.endswith(
        "feet 'l_ankle', 'r_ankle' (guessed, left first), torso 'torso', seen in its keyframe 'stand'"
    )
    assert left.startswith("'l_ankle': sole 170 x 98 mm, cells at (")
    own = NaoStandEnv().drawing.position_cell_sole
    assert own is not None
    x, y = 1e3 * own[1, 3, :2]
    assert right.endswith(f"({x:.0f}, {y:.0f}) mm")
    assert "(as named, left first)" in FeetDrawing("nao", ("r_ankle", "l_ankle")).words()[0]
    assert "has no area" in FeetDrawing("Humanoid-v5").words()[1]
    assert "'left_foot': sole 259 x 103 mm" in FeetDrawing("Humanoid-v5", soles=True).words()[1]


def test_the_command_draws_the_robot_and_its_soles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    picture = tmp_path / "new" / "feet.png"
    result = CliRunner().invoke(app, ["view", "--feet", "nao", "--image", str(picture)])
    if "No picture can be drawn" in result.output:
        pytest.skip("no OpenGL here")
    assert result.exit_code == 0
    assert "feet 'l_ankle', 'r_ankle' (guessed" in result.output
    pixels = np.asarray(Image.open(picture)).astype(int)
    assert pixels.shape == (480, 1280, 3)
    near = pixels[:, 640:]
    blue = (near[..., 2] > 100) & (near[..., 0] < 60)
    yellow = (near[..., 0] > 150) & (near[..., 1] > 150) & (near[..., 2] < 60)
    assert blue.sum() > 100
    assert yellow.sum() > 50


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["HumanoidStandup-v5"], "the robot lies"),
        (["Foo-v1"], "doesn't exist"),
        (["gone.xml"], "There is no file 'gone.xml'."),
        ([__file__], "test_feet_drawing.py' is not MJCF that MuJoCo can read: "),
        (["CartPole-v1"], "needs an environment on MuJoCo"),
        (["nao", "--soles"], "soles are put under the feet of environments"),
        (["surefoot/NaoStand-v0", "--soles"], "has feet with soles of its own"),
        (["Humanoid-v5", "--foot", "paw"], "each once, got ['paw']"),
    ],
)
def test_what_cannot_be_shown_is_told_in_one_line(arguments: list[str], text: str) -> None:
    result = CliRunner().invoke(app, ["view", "--feet", *arguments])
    assert result.exit_code == 2
    assert text in result.output.replace("\n", " ")


def test_feet_are_named_of_a_robot_alone() -> None:
    result = CliRunner().invoke(app, ["view", "--soles"])
    assert result.exit_code == 2
    assert "need --feet ENV" in result.output
