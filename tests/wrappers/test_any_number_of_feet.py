"""Robots on more feet than two, which touch at points: Ant-v5, on six-axis sensors and on one cell a foot."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from surefoot.calibration import Reference
from surefoot.envs import InstrumentedEnv
from surefoot.native import CALIBRATION, SENSORS
from surefoot.robot.beliefs.contacts import CONTACT_MARGIN, Kinematics
from surefoot.robot.beliefs.errors import NO_ERRORS
from surefoot.robot.beliefs.native import NativeBeliefs
from surefoot.robot.beliefs.strapdown import touching
from surefoot.robot.native import NativeSample
from surefoot.sensors import preset, sized
from surefoot.sensors.presets import PERFECT_FORCE_TORQUE
from surefoot.wrappers import (
    FootSensors,
    SelfCalibration,
    TruthRow,
    VectorFootSensors,
    VectorSelfCalibration,
)

FEET = ("front left", "front right", "rear left", "rear right")
ONE_CELL = replace(sized(preset("hx711-load-cells"), 9.0), channels=4, rate=None, averaged=True)
PERFECT = {"imu": "perfect", "encoders": "perfect"}


def ant() -> InstrumentedEnv:
    blind = {"include_cfrc_ext_in_observation": False}
    env = gym.make("Ant-v5", max_episode_steps=10_000, terminate_when_unhealthy=False, **blind)
    spec = mujoco.MjSpec.from_file(env.unwrapped.fullpath)
    for body, name in zip([body for body in spec.bodies if not body.name], FEET, strict=True):
        body.name = name
    spec.add_key(name="stand", qpos=env.unwrapped.model.numeric("init_qpos").data)
    return InstrumentedEnv(env, FEET, spec=spec)


def trot(env: gym.Env[Any, Any], step: int) -> np.ndarray[Any, Any]:
    """Command a trot in place by feedback of joints: diagonal feet are lifted in turn."""
    data, time = env.unwrapped.data, 0.05 * step
    phase = 2.0 * np.pi * 0.8 * time + np.array([0.0, np.pi, 0.0, np.pi])
    size = min(1.0, time)
    wanted = np.zeros((4, 2))
    wanted[:, 0] = 0.25 * size * np.sin(phase)
    wanted[:, 1] = [1.0, -1.0, -1.0, 1.0] * (1.0 - 0.35 * size * np.maximum(0.0, np.cos(phase)))
    torque = 1.5 * (wanted.ravel() - data.qpos[7:]) - 0.15 * data.qvel[6:]
    # Motors are those of the last leg first.
    return np.clip(np.roll(torque, 2), -1.0, 1.0).astype(np.float32)


def walk(env: SelfCalibration, count: int, seed: int = 0) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    env.reset(seed=seed)
    seen = []
    for step in range(count):
        observation, _, _, _, info = env.step(trot(env, step))
        seen.append((observation, info["surefoot"]))
    return seen


def test_what_a_layout_cannot_show_is_absent_and_said() -> None:
    env = SelfCalibration(FootSensors(ant(), "icub-force-torque"))
    assert set(env.observation_space.spaces) == {"state", "foot_force", "cop", "cop_valid"}
    assert env.observation_space["foot_force"].shape == (24,)
    assert env.observation_space["cop_valid"].shape == (5,)
    with pytest.raises(ValueError, match=r"'cop_foot' cannot be shown\. .* no area.* Show 'cop', .* 'vgrf'"):
        SelfCalibration(FootSensors(ant(), ONE_CELL), show=("cop_foot",))
    with pytest.raises(ValueError, match=r"no area.* or one load cell a foot, .* polarity=\(1,\)"):
        FootSensors(ant())


def test_exact_beliefs_and_sensors_show_the_forces_of_all_feet() -> None:
    cells = replace(preset("perfect"), channels=4)
    env = SelfCalibration(
        FootSensors(ant(), cells, **PERFECT), errors=NO_ERRORS, show=("vgrf", "cop", "cop_valid")
    )
    seen = walk(env, 160)[40:]
    shown, true = (
        np.array([one["vgrf"] for one, _ in seen]),
        np.array([told["truth"]["vgrf"] for _, told in seen]),
    )
    weight = env.env.source.drawing.weight
    assert np.sqrt(np.mean((shown - true) ** 2)) < 0.05 * weight
    both = [one for one in seen if one[0]["cop_valid"][0] and one[1]["truth"]["cop_valid"][0]]
    cop, true_cop = (
        np.array(part) for part in zip(*((o["cop"], t["truth"]["cop"]) for o, t in both), strict=True)
    )
    # Feet reach 0.9 m from each other.
    assert np.median(np.linalg.norm(cop - true_cop, axis=1)) < 0.03
    assert not any(one[0]["cop_valid"][1:].any() for one in seen)
    swings = np.array([one[1]["reference"]["swing"] for one in seen])
    lag = env.calibrator.setup.lag
    carried = true[:-lag][swings[lag:]]
    assert swings.any(axis=0).all(), "each foot swings"
    assert np.median(carried) == 0.0


def test_zeros_of_single_cells_are_learnt() -> None:
    wrong = replace(preset("perfect"), channels=4, initial_offset_std=0.3)
    env = SelfCalibration(FootSensors(ant(), wrong), show=("foot_force", "contact_probability"))
    env.reset(seed=1)
    (cells,), off = env.env.instruments.parts, []
    for step in range(240):
        env.step(trot(env, step))
        raw, true = env.env.robot.raw, cells.force(env.env.source.truth)
        off.append([env.robot.initial.force(raw) - true, env.estimate.force - true])
    before, found = np.sqrt(np.mean(np.square(off[160:]), axis=0))
    assert found.mean() < 0.6 * before.mean()
    # By 0.2 % of the largest load.
    assert (found < before + 0.02).all()


def test_a_robot_is_the_same_alone_and_among_others() -> None:
    def calibrated(envs: Any) -> VectorSelfCalibration:
        return VectorSelfCalibration(VectorFootSensors(envs, ONE_CELL), show=("vgrf", "cop", "cop_valid"))

    many = calibrated(gym.vector.SyncVectorEnv([lambda: TruthRow(ant())] * 2))
    alone = SelfCalibration(FootSensors(ant(), ONE_CELL), show=("vgrf", "cop", "cop_valid"))
    seen, _ = many.reset(seed=[3, 4])
    one, _ = alone.reset(seed=4)
    for step in range(30):
        np.testing.assert_array_equal(seen["vgrf"][1], one["vgrf"])
        np.testing.assert_array_equal(seen["cop"][1], one["cop"])
        action = 0.1 * np.sin(0.3 * step + np.arange(8)).astype(np.float32)
        seen = many.step(np.stack([action, action]))[0]
        one = alone.step(action)[0]
    many.close()


@pytest.mark.skipif(
    CALIBRATION.installed() is None or SENSORS.installed() is None, reason="needs the libraries"
)
@pytest.mark.parametrize("config", [ONE_CELL, "icub-force-torque"], ids=["one cell", "six axes"])
def test_the_library_does_all_of_it_as_python_does(config: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[list[Any]] = []
    for native in (True, False):
        if not native:
            for library in (CALIBRATION, SENSORS):
                monkeypatch.setattr(library, "_found", (None,))
        env = SelfCalibration(
            FootSensors(ant(), config), show=("foot_force", "vgrf", "cop", "cop_std", "wrench")
        )
        env.reset(seed=2)
        seen.append([env.step(trot(env, step))[0] for step in range(40)])
        assert isinstance(env.beliefs, NativeBeliefs) == native
        assert isinstance(env.robot.backend, NativeSample) == native
        assert (env.env.robot.packet_rows() is not None) == native
        env.close()
    for one, two in zip(*seen, strict=True):
        for name, part in one.items():
            np.testing.assert_allclose(part, two[name], rtol=1e-6, atol=1e-6, err_msg=name)


def test_presets_have_a_sensor_for_each_foot() -> None:
    sensed = FootSensors(ant(), replace(PERFECT_FORCE_TORQUE, sensors=4))
    observation, _ = sensed.reset(seed=0)
    truth = sensed.source.truth.wrench_ankle.mean(axis=0).ravel()
    np.testing.assert_allclose(observation["foot_raw"], truth, rtol=1e-6, atol=1e-5)
    assert FootSensors(ant(), "ati-mini45").instruments.channels == 24


def test_the_lowest_point_of_a_ball_that_rolls_stands_still() -> None:
    radius, spin, up = 0.1, np.array([0.0, 2.0, 0.0]), np.array([0.0, 0.0, 1.0])
    tilted = np.array([[np.cos(0.7), 0.0, -np.sin(0.7)], [0.0, 1.0, 0.0], [np.sin(0.7), 0.0, np.cos(0.7)]])
    centre = np.array([0.05, 0.0, 0.02])
    velocity = np.cross(spin, radius * up) - np.cross(spin, centre @ tilted)
    twist = np.concatenate([spin, velocity])[None]
    found = touching(np.zeros((1, 3)), tilted[None], twist, centre[None, None], up, np.array([[radius]]))
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_round_feet_stand_on_any_side_and_swing_from_their_radius_on() -> None:
    none, round_feet = np.zeros(3), np.tile([0.0, 0.0, 0.02, 0.02], (4, 1, 1))
    roll = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(0.8), -np.sin(0.8)], [0.0, np.sin(0.8), np.cos(0.8)]])
    height = np.array([0.0, 0.02 - 0.02 * np.cos(0.8), 0.015, 0.03])
    moment = Reference(
        np.array([0.0, 0.0, 0.6]), none, none, np.column_stack([np.zeros((4, 2)), height]),
        np.stack([np.eye(3), roll, np.eye(3), np.eye(3)]), np.zeros(4, bool), np.zeros(4, bool),
        np.array([0.0, 0.0, 9.81]), none,
    )  # fmt: skip
    kinematics = Kinematics(round_feet, rolls=True)
    for _ in range(CONTACT_MARGIN + 1):
        stance, swing = kinematics.at(moment, np.array([0.0, 0.0, 1.0]))
    assert stance.tolist() == [True, True, False, False]
    assert swing.tolist() == [False, False, False, True]
