"""Maps of known weights, from their file: in simulated cells, in wrappers and in a calibrator."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import surefoot  # noqa: F401  (registers the environments)
from surefoot.calibration import FootCalibrator, Parameters
from surefoot.calibration.contacts import reference_of_contacts
from surefoot.calibration.weights.known_map import read_map
from surefoot.wrappers import FootSensors, SelfCalibration

SCALE, OFFSET = 3e-5 * (1.0 + 0.1 * np.arange(8)) * (-1.0) ** np.arange(8), np.full(8, -250.0)
OFFSET = OFFSET * np.sign(SCALE)
CURVE = {"count": [8e6, 8.5e6, 9e6], "straight_count": [8e6, 8.4e6, 9e6]}

Make = Callable[..., Path]


@pytest.fixture
def feet() -> FootSensors:
    return FootSensors(gym.make("surefoot/NaoStand-v0"))


@pytest.fixture
def file(feet: FootSensors, tmp_path: Path) -> Make:
    """Write the file of `surefoot calibrate weights`; its channels stand in another order."""

    def write(**changes: Any) -> Path:
        names = [name.replace("/", "_").replace("-", "_") for name in feet.instruments.layout.channel_names]
        told = {"channels": names, "scale_N_per_count": SCALE.tolist(), "offset_N": OFFSET.tolist()} | changes
        for key, values in told.items():
            told[key] = values[::-1]
        path = tmp_path / "scales.map.json"
        path.write_text(json.dumps(told))
        return path

    return write


def test_simulated_cells_are_those_of_the_file(feet: FootSensors, file: Make) -> None:
    env = SelfCalibration(feet, "none", initial=str(file()))
    env.reset(seed=3)
    feet.load(file())
    np.testing.assert_allclose(feet.true_parameters(), (SCALE, OFFSET), rtol=1e-12)
    for _ in range(40):
        observation, *_, info = env.step(env.action_space.sample() * 0.0)
    # They drift on from there, and read to their noise what the file says.
    np.testing.assert_allclose(observation["foot_force"], SCALE * feet.raw + OFFSET, atol=1e-3)
    truth = info["surefoot"]["truth"]["force_cell"]
    assert np.abs(observation["foot_force"] - truth).max() < 0.2
    assert feet.robot.true_parameters().scale[0] != SCALE[0]


def test_a_map_starts_a_wrapper_as_file_contents_or_numbers(feet: FootSensors, file: Make) -> None:
    given = (str(file()), json.loads(file().read_text()), Parameters(SCALE, OFFSET))
    starts = [SelfCalibration(feet, "none", initial=one).robot for one in given]
    for robot in starts:
        known = robot._setup.start.known
        np.testing.assert_array_equal(known.scale, SCALE)
        np.testing.assert_array_equal(known.offset, OFFSET)


def test_a_calibrator_takes_the_file_with_its_curves(feet: FootSensors, file: Make) -> None:
    layout, raw, standing = feet.instruments.layout, np.full(8, 8.5e6), np.ones(2, dtype=bool)
    reference = reference_of_contacts(standing, ~standing, np.zeros((2, 3)))
    curves = [CURVE, *[None] * 7]
    for initial in (file(curves=curves), json.loads(file(curves=curves).read_text())):
        calibrator = FootCalibrator(layout, "none", mass=5.0, initial=initial, lag=0)
        force = calibrator.update(raw, reference).force
        np.testing.assert_allclose(force, SCALE * np.r_[8.4e6, raw[1:]] + OFFSET)


@pytest.mark.parametrize(
    ("channels", "scale", "said"),
    [
        (["left/front", "left_front"], [1.0, 2.0], "the channel 'left_front' stands in it more than once"),
        (["left/front", "left/rear"], [10**400, 1.0], "is no map (OverflowError"),
    ],
)
def test_contents_that_are_no_map_are_refused(channels: list[str], scale: list[float], said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        read_map({"channels": channels, "scale_N_per_count": scale, "offset_N": [0.0, 0.0]}, ["left/front"])


def test_what_cannot_be_taken_is_refused(feet: FootSensors, file: Make) -> None:
    feet.reset(seed=0)
    with pytest.raises(ValueError, match=r"has curves, and simulated cells have none; leave 'curves' out"):
        feet.load(file(curves=[CURVE, *[None] * 7]))
    with pytest.raises(ValueError, match="holds no map for the channel 'left_front_left'; it has "):
        feet.load(file(channels=[f"cell{i}" for i in range(8)]))
    with pytest.raises(
        ValueError, match=re.escape("is no map (ValueError scales must be finite and not zero")
    ):
        feet.load(file(scale_N_per_count=[0.0] * 8))
    with pytest.raises(ValueError, match=r"Unloaded, these cells read .* choose 'coding' and 'adc_bits'"):
        feet.load(file(offset_N=(-OFFSET).tolist()))
    ankles = FootSensors(gym.make("surefoot/NaoStand-v0"), "icub-force-torque")
    ankles.reset(seed=0)
    names = list(ankles.instruments.layout.channel_names)
    with pytest.raises(ValueError, match="A map of known weights is of load cells alone"):
        ankles.load(file(channels=names, scale_N_per_count=[1.0] * 12, offset_N=[0.0] * 12))
