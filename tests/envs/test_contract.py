"""What every environment of the package keeps: Gymnasium's contract, seeds, and values that are handed out.

``tests/wrappers/test_gymnasium.py`` asks the same of specifications, Stable-Baselines3 and wrappers.
"""

import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import surefoot  # noqa: F401

LOADED = {"payload_time": (0.1, 0.3)}
OPTIONS: dict[str, dict[str, Any]] = {
    "NaoStand": {"push_impulse": (0.1, 0.3), "push_interval": 0.3},
    "NaoWalk": {"duration": 6.0},
    "NaoBalance": {"stand_time": 0.1, **LOADED},
    "NaoCarry": {"speeds": (0.02, 0.04), "stand_time": 0.5, "duration": 2.5, **LOADED},
    "Exercise": {"robot": "nao"},
    "G1Lean": {"marches": 0, "wait": 0.2},
}
# Gymnasium takes NaN for a difference: nothing may lift a foot in the first step.
CALM = {"push_impulse": (0.0, 0.0), "joint_noise": 0.0, "velocity_noise": 0.0}
STEPS = 60

each = pytest.mark.parametrize("name", OPTIONS)


def make(name: str, **options: Any) -> Any:
    return gym.make(f"surefoot/{name}-v0", **{**OPTIONS[name], **options}).unwrapped


def actions(env: Any) -> np.ndarray:
    return np.random.default_rng(2).choice([-1.0, 1.0], (STEPS, *env.action_space.shape))


def roll(env: Any, seed: int) -> list[Any]:
    observation, info = env.reset(seed=seed)
    returned = [(observation, info["surefoot"]["truth"])]
    for action in actions(env):
        observation, reward, terminated, truncated, info = env.step(action)
        returned.append((observation, reward, terminated, truncated, info["surefoot"]["truth"]))
        if terminated or truncated:
            break
    return returned


@each
def test_gymnasium_finds_nothing_wrong(name: str) -> None:
    check_env(make(name, **(CALM if name.startswith("Nao") else {})), skip_render_check=True)


@each
def test_an_episode_is_its_seed(name: str) -> None:
    env = make(name)
    first, other = pickle.dumps(roll(env, 11)), pickle.dumps(roll(env, 12))
    assert first != other
    assert pickle.dumps(roll(make(name), 11)) == first
    # An episode leaves nothing behind for the next, whatever the robot carried.
    assert pickle.dumps(roll(env, 11)) == first


@each
def test_values_that_were_handed_out_stay_and_lie_in_their_space(name: str) -> None:
    env = make(name)
    observation, info = env.reset(seed=4)
    held = observation, info["surefoot"]["truth"]
    before = pickle.dumps(held)
    for action in actions(env):
        observation, reward, terminated, truncated, _ = env.step(action)
        assert env.observation_space.contains(observation)
        assert np.isfinite(reward)
        if terminated or truncated:
            break
    assert pickle.dumps(held) == before


@each
def test_wrong_actions_are_refused(name: str) -> None:
    env = make(name)
    still = np.zeros(env.action_space.shape)
    with pytest.raises(gym.error.ResetNeeded, match=r"Call reset\(\) before"):
        env.step(still)
    env.reset(seed=0)
    with pytest.raises(
        ValueError, match=rf"has shape \({still.size},\), a .* got shape \({still.size + 1},\)"
    ):
        env.step(np.zeros(still.size + 1))
    for wrong in (np.nan, np.inf):
        still[-1] = wrong
        with pytest.raises(ValueError, match=r"An action must be finite, got .*; .*zeros"):
            env.step(still)


@each
def test_an_environment_draws_if_it_was_asked_to(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    env = make(name)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="without a render mode"):
        assert env.render() is None
    monkeypatch.setenv("MUJOCO_GL", "egl")
    env = make(name, render_mode="rgb_array", width=160, height=120)
    env.reset(seed=0)
    try:
        frame = env.render()
    except Exception as error:
        pytest.skip(f"no OpenGL here: {error}")
    assert frame.shape == (120, 160, 3)
    assert frame.std() > 5.0
    for action in actions(env)[:40]:
        env.step(action)
    assert not np.array_equal(frame, env.render())
    env.close()
