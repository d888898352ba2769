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

UP = np.array([0.0, 0.0, 1.0])


def normal(slope: float) -> np.ndarray:
    """Return the normal of ground that rises ahead by an angle in rad."""
    return np.array([-np.sin(slope), 0.0, np.cos(slope)])


def believed(left: float, right: float, *, roll: float = 0.0, force: float = 9.81) -> Reference:
    none = np.zeros(3)
    tilted = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    return Reference(
        com=np.array([0.0, 0.0, left + 0.7]),
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
        seen = kinematics.at(moment, UP)
        assert not np.any(seen)
    stood, swung = kinematics.at(moment, UP)
    assert stood.tolist() == stance
    assert swung.tolist() == swing
    assert not np.any(kinematics.at(believed(np.nan, np.nan), np.full(3, np.nan)))


def test_a_small_robot_lifts_its_feet_in_proportion() -> None:
    """Of a robot of a sixth of the size, a foot that is 3 mm higher is in the air."""
    kinematics, moment = Kinematics(np.zeros((2, 1, 4))), believed(0.0, 0.003)
    for _ in range(CONTACT_MARGIN + 1):
        stood, swung = kinematics.at(moment._replace(com=np.array([0.0, 0.0, 0.1])), UP)
    assert (stood.tolist(), swung.tolist()) == ([True, False], [False, True])


@pytest.mark.parametrize(("lift", "stance", "swing"), [(0.0, [True, True], 0), (0.02, [True, False], 1)])
def test_heights_are_measured_from_ground_that_slopes(lift: float, stance: list[bool], swing: int) -> None:
    """On a slope of 9 degrees the front foot of a stride of 0.3 m is 47 mm higher than the other."""
    slope = 0.157
    along = np.array([np.cos(slope), 0.0, np.sin(slope)])
    R = np.column_stack([along, (0.0, 1.0, 0.0), normal(slope)])
    soles = np.array([(0.0, 0.05, 0.0), 0.3 * along + (0.0, -0.05, 0.0) + lift * normal(slope)])
    moment = believed(0.0, 0.0)._replace(position_sole=soles, R_level_sole=np.stack([R, R]))
    kinematics = Kinematics(np.zeros((2, 1, 4)))
    for _ in range(CONTACT_MARGIN + 1):
        stood, swung = kinematics.at(moment, normal(slope))
    assert stood.tolist() == stance
    assert swung.sum() == swing


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


def at_height(height: float, acceleration: float = 0.0) -> Reference:
    """What a robot believes whose centre of mass has a height and an acceleration ahead."""
    moved = np.array([acceleration, 0.0, 0.0])
    return believed(0.0, 0.0)._replace(com_acceleration=moved, com=np.array([0.0, 0.0, height]))


@pytest.mark.parametrize(
    ("moment", "slope", "upright"),
    [
        (at_height(0.8), 0.0, True),
        (at_height(0.8), 0.16, True),
        (at_height(0.8), -0.3, True),
        (at_height(0.8), 0.6, False),
        (at_height(0.8), 1.5, False),
        (at_height(0.6), 0.0, True),
        (at_height(0.4), 0.0, False),
        (at_height(0.8, 6.0), 0.0, False),
        (at_height(0.8, np.nan), 1.5, True),
    ],
)
def test_who_lies_sits_or_falls_is_not_upright(moment: Reference, slope: float, upright: bool) -> None:
    gate = Upright(0.02)
    for _ in range(100):
        gate.at(at_height(0.8), UP)
    seen = [gate.at(moment, normal(slope)) for _ in range(60)]
    assert seen[-1] == upright


def test_a_fall_is_reported_once() -> None:
    gate = Upright(0.02)
    reported = []
    for slope in [0.0] * 50 + [1.0] * 50 + [0.0] * 200 + [1.0] * 50:
        gate.at(at_height(0.8), normal(slope))
        reported.append(gate.fell)
    assert np.sum(reported) == 2


def test_a_push_is_not_a_fall() -> None:
    gate = Upright(0.0125)
    seen = [gate.at(at_height(0.8, 6.0 if 40 <= k < 48 else 0.0), UP) for k in range(100)]
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
