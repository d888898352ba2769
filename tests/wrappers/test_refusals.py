"""What a user may get wrong: each message names the thing, the rule, what was given and the way out."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.wrappers.vector import FlattenObservation
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from surefoot.sensors import LoadCells
from surefoot.wrappers import FootSensors, SampleHistory, SelfCalibration, TruthRow, VectorFootSensors
from surefoot.wrappers.vector.sb3 import VecFootSensors

NAME = "surefoot/NaoBalance-v0"


def one(**options):
    return gym.make(NAME, disable_env_checker=True, **options)


def many(count=2, **options):
    pytest.importorskip("mujoco.batch", reason="BatchVectorEnv needs MuJoCo 3.17")
    return gym.make_vec(NAME, count, **options)


def feet(**options):
    return FootSensors(one(), **options)


def sb3(around=lambda venv: venv):
    return VecFootSensors(around(DummyVecEnv([lambda: TruthRow(one())] * 2)))


@pytest.mark.parametrize(
    ("attempt", "error", "words"),
    [
        (lambda: VecFootSensors(sb3()), TypeError, "VecFootSensors found VecFootSensors below it"),
        (lambda: FootSensors(NAME), TypeError, f"go around one environment, .* got '{NAME}'"),
        (lambda: FootSensors(many()), TypeError, "for those that gym.make_vec.* there is VectorFootSensors"),
        (lambda: FootSensors(one(), 5), TypeError, "'config' must be .* or ForceTorque.*, got 5"),
        (lambda: FootSensors(one(), LoadCells), TypeError, r"call it: LoadCells\(\.\.\.\)"),
        (lambda: feet(faults=3), TypeError, "'faults' must be a sequence of faults or a mapping .* got 3"),
        (lambda: feet(fresh="no"), TypeError, "'fresh' must be True or False, got 'no'"),
        (lambda: feet(noise=2), TypeError, r"have no option 'noise'; they have \['config', 'ankles'"),
        (lambda: SelfCalibration(feet()).calibrator, ResetNeeded, "no calibrator .* before the first"),
        (lambda: SampleHistory(feet(), ["foot_raw"], period="a"), TypeError, "'period' must be a number"),
        (lambda: many(0), ValueError, "'num_envs' must be a whole number from 1 on, got 0"),
        (lambda: many(autoreset_mode="never"), ValueError, r"'autoreset_mode' must be one of \['NextStep', "),
        (lambda: VectorFootSensors(one()), TypeError, r"goes around many robots, .* there is FootSensors"),
        (lambda: VectorFootSensors(many()).reset(options=["fresh"]), TypeError, "must be a mapping, got"),
        (lambda: VecFootSensors(many()), TypeError, "goes around a vector environment of Stable-Baselines3"),
        (lambda: VecFootSensors(DummyVecEnv([one])), TypeError, r"DummyVecEnv\(\[lambda: TruthRow"),
        (lambda: FootSensors(DummyVecEnv([one])), TypeError, "for Stable-Baselines3's VecFootSensors in"),
        (lambda: sb3(VecNormalize).reset(), TypeError, "a wrapper between them has changed them; put"),
        (lambda: VectorFootSensors(VectorFootSensors(many())), TypeError, "robot's feet are read once"),
        (lambda: VectorFootSensors(FlattenObservation(many())), TypeError, "a wrapper below it has made"),
        (lambda: sb3().set_options([{}]), ValueError, "'options' must be of each of 2 robots, got 1"),
    ],
)  # fmt: skip
def test_messages_of_odd_arguments(attempt, error, words) -> None:
    with pytest.raises(error, match=words):
        attempt()


def test_an_action_that_is_no_number_is_refused() -> None:
    env = one()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"An action holds numbers, .* got 'left'"):
        env.step("left")


def test_hardware_of_more_robots_is_refused(tmp_path) -> None:
    robots, alone = VectorFootSensors(many(3)), feet()
    robots.reset(seed=0)
    alone.reset(seed=0)
    robots.save(tmp_path / "three.npz")
    with pytest.raises(
        ValueError, match=r"three.npz' holds the state of 3 robot\(s\), but there are 1; load it into"
    ):
        alone.load(tmp_path / "three.npz")
    robots.load(tmp_path / "three.npz")
    assert np.isfinite(robots.true_parameters().scale).all()
