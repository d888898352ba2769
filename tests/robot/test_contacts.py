"""Which feet stand and swing, by where they are."""

from typing import Any, cast

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from surefoot.calibration import Reference
from surefoot.envs import InstrumentedEnv
from surefoot.robot.beliefs.contacts import CONTACT_MARGIN, Kinematics, Upright
from surefoot.wrappers import FootSensors, SelfCalibration


def believed(left: float, right: float, *, roll: float = 0.0, force: float = 9.81) -> Reference:
    none = np.zeros(3)
    tilted = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    return Reference(
        com=none,
        com_acceleration=none,
        angular_momentum_rate=none,
        position_sole=np.array([[0.0, 0.05, left], [0.0, -0.05, right]]),
        R_level_sole=np.stack([np.eye(3), tilted]),
        stance=np.zeros(2, dtype=bool),
        swing=np.zeros(2, dtype=bool),
        accelerometer=np.array([0.0, 0.0, force]),
        gyroscope=none,
    )


@pytest.mark.parametrize(
    ("moment", "stance", "swing"),
    [
        (believed(0.0, 0.0), [True, True], [False, False]),
        (believed(0.5, 0.502), [True, True], [False, False]),
        (believed(0.0, 0.02), [True, False], [False, True]),
        (believed(0.03, 0.0), [False, True], [True, False]),
        (believed(0.0, 0.006), [True, False], [False, False]),
        (believed(0.0, 0.0, roll=0.1), [True, False], [False, False]),
        (believed(0.0, 0.02, force=2.0), [False, False], [False, False]),
        (believed(np.nan, np.nan), [False, False], [False, False]),
    ],
)
def test_a_foot_is_sure_after_some_samples(moment: Reference, stance: list[bool], swing: list[bool]) -> None:
    kinematics = Kinematics(np.zeros((2, 1, 4)))
    for _ in range(CONTACT_MARGIN):
        seen = kinematics.at(moment, moment.accelerometer)
        assert not np.any(seen)
    stood, swung = kinematics.at(moment, moment.accelerometer)
    assert stood.tolist() == stance
    assert swung.tolist() == swing
    assert not np.any(kinematics.at(believed(np.nan, np.nan), np.full(3, np.nan)))


class Planless(gym.Wrapper):
    """Hides what is planned: a source of truth like any other."""

    def __init__(self, env):
        super().__init__(env)
        self.drawing, self.state_layout = env.unwrapped.drawing, env.unwrapped.state_layout
        self.joint_names, self.dt, self.model = (
            env.unwrapped.joint_names,
            env.unwrapped.dt,
            env.unwrapped.model,
        )

    @property
    def truth(self):
        return self.unwrapped.truth


def test_kinematics_see_the_swings_of_a_walk_and_never_contradict_the_contacts(make_bare) -> None:
    env = SelfCalibration(FootSensors(Planless(make_bare())), "tare")
    assert not hasattr(env.env.source, "command")
    env.reset(seed=0)
    stands, swings, load = [], [], []
    for _ in range(480):
        env.step(np.zeros(11, dtype=np.float32))
        stands.append(env.reference.stance)
        swings.append(env.reference.swing)
        load.append(env.unwrapped.truth.vgrf())
    swings, late = np.array(swings[20:]), env.calibrator.setup.lag
    carried = np.array(load)[20 - late : -late]
    assert swings.sum() > 40, "swings are seen"
    assert carried[swings].max() < 2.0, "a foot that surely swings carries nothing"
    assert np.array(stands[20:]).any(axis=1).mean() > 0.6


def leaning(angle: float, height: float = 0.8) -> Reference:
    """What a robot believes that leans with its feet: gravity comes from the side."""
    off = 9.81 * np.array([np.sin(angle), 0.0, np.cos(angle) - 1.0])
    moment = believed(0.0, 0.0)
    return moment._replace(com_acceleration=off, com=np.array([0.0, 0.0, height]))


@pytest.mark.parametrize(
    ("moment", "bias", "upright"),
    [
        (leaning(0.0), 0.0, True),
        (leaning(0.3), 0.0, True),
        (leaning(0.6), 0.0, False),
        (leaning(1.5), 0.0, False),
        (leaning(0.0), 0.5, True),
        (leaning(0.0), 5.0, False),
        (leaning(0.0, 0.6), 0.0, True),
        (leaning(0.0, 0.4), 0.0, False),
        (leaning(float("nan")), 5.0, True),
    ],
)
def test_who_leans_lies_or_sits_is_not_upright(moment: Reference, bias: float, upright: bool) -> None:
    gate = Upright(0.02)
    for _ in range(100):
        gate.at(leaning(0.0), np.zeros(3))
    seen = [gate.at(moment, np.array([bias, 0.0, 0.0])) for _ in range(60)]
    assert seen[-1] == upright


def test_a_fall_is_told_once() -> None:
    gate = Upright(0.02)
    told = []
    for moment in [leaning(0.0)] * 50 + [leaning(1.0)] * 50 + [leaning(0.0)] * 200 + [leaning(1.0)] * 50:
        gate.at(moment, np.zeros(3))
        told.append(gate.fell)
    assert np.sum(told) == 2


def test_a_push_is_no_fall() -> None:
    gate = Upright(0.0125)
    hard = believed(0.0, 0.0)._replace(com_acceleration=np.array([6.0, 0.0, 0.0]), com=np.array([0, 0, 0.8]))
    seen = [gate.at(hard if 40 <= k < 48 else leaning(0.0), np.zeros(3)) for k in range(100)]
    assert all(seen)


BLIND = {"include_cfrc_ext_in_observation": False}


def lying() -> gym.Env[Any, Any]:
    """Make a humanoid that was drawn lying, with a keyframe in which it stands."""
    env = gym.make("HumanoidStandup-v5", **BLIND)
    spec = mujoco.MjSpec.from_file(cast(Any, env.unwrapped).fullpath)
    half = np.sqrt(0.5)
    spec.add_key(name="stand", qpos=[0.0, 0.0, 1.3, half, 0.0, half, 0.0, *np.zeros(17)])
    return InstrumentedEnv(env, ("left_foot", "right_foot"), spec=spec)


@pytest.mark.parametrize("name", ["Humanoid-v5", "HumanoidStandup-v5"])
def test_nothing_is_learnt_from_a_robot_that_lies(name: str) -> None:
    standing = name == "Humanoid-v5"
    bare = gym.make(name, terminate_when_unhealthy=False, **BLIND) if standing else lying()
    env = SelfCalibration(FootSensors(bare, "icub-force-torque"))
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(250):
        env.step(rng.uniform(-0.4, 0.4, 17).astype(np.float32))
    start = env.env.instruments.nominal.scale
    np.testing.assert_allclose(env.estimate.scale, start, rtol=0.02)
