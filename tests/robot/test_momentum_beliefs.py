"""What the robot believes of its momentum, against the truth of walking in the simulator."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest

from surefoot.calibration import MomentumReference
from surefoot.robot.beliefs.strapdown import touching
from surefoot.wrappers import FootSensors, SelfCalibration


def walking(seconds=10.0, **options):
    env = gym.make("surefoot/NaoWalk-v0", duration=seconds, disable_env_checker=True)
    return SelfCalibration(FootSensors(env), "moment", **options)


def run(env, steps, seed=0):
    """Walk, and return beliefs and truth of the same moments."""
    env.reset(seed=seed)
    truth, beliefs = [], []
    for _ in range(steps):
        env.step(np.zeros(env.action_space.shape))
        now = env.unwrapped.truth
        truth.append((now.com_velocity[-1], now.angular_momentum[-1], now.position_sole[-1], now.com[-1]))
        beliefs.append(env.robot.reference)
    late = env.robot.late
    return beliefs[late:], truth[: len(truth) - late]


def test_velocity_and_momentum_agree_with_the_simulator():
    beliefs, truth = run(walking(), 400)
    assert all(isinstance(one, MomentumReference) for one in beliefs)
    late = slice(160, None)  # two seconds after the start
    velocity = np.array([one.com_velocity for one in beliefs])[late]
    off = velocity - np.array([one[0] for one in truth])[late]
    # What is slow says nothing of forces: the mean of a block of eight, from block to block.
    blocks = off[: len(off) // 8 * 8].reshape(-1, 8, 3).mean(axis=1)
    noise = np.diff(blocks, axis=0).std(axis=0) / np.sqrt(2.0)
    assert (noise < (0.02, 0.02, 0.006)).all(), noise
    assert (np.abs(off.mean(axis=0)) < (0.05, 0.05, 0.1)).all()
    spin = (
        np.array([one.angular_momentum for one in beliefs])[late] - np.array([one[1] for one in truth])[late]
    )
    assert (spin.std(axis=0) < 0.03).all()


def test_the_frame_stands_still():
    beliefs, _ = run(walking(), 280)
    standing = [one for one in beliefs if one.stance[0] and np.isfinite(one.com).all()]
    moved = np.diff([one.position_sole[0] for one in standing], axis=0)
    assert np.abs(np.median(moved, axis=0)).max() < 2e-4


def test_it_calibrates_a_robot_that_walks():
    env = walking()
    env.reset(seed=3)
    off = {"moment": [], "start": []}
    for step in range(760):
        env.step(np.zeros(env.action_space.shape))
        if step > 520:
            true = env.unwrapped.truth.force_cell.mean(axis=0)
            start = env.robot.initial.force(env.env.robot.raw)
            off["moment"].append(env.robot.estimate.force - true)
            off["start"].append(start - true)
    found, before = (np.sqrt(np.mean(np.square(part))) for part in off.values())
    assert found < 0.8 * before
    assert env.robot.estimate.undetermined.mean() < 0.6


def test_copies_and_saved_robots_go_on(tmp_path):
    env = walking()
    env.reset(seed=0)
    still = np.zeros(env.action_space.shape)
    for _ in range(120):
        env.step(still)
    env.save(tmp_path / "robot.npz")
    beliefs = pickle.loads(pickle.dumps(env.robot.beliefs))
    np.testing.assert_array_equal(beliefs.info()["com"], env.robot.reference.com)
    one, two = env, copy.deepcopy(env)
    for _ in range(60):
        first, second = one.step(still), two.step(still)
        np.testing.assert_array_equal(first[0]["foot_force"], second[0]["foot_force"])
    other = walking()
    other.reset(seed=1)
    other.load(tmp_path / "robot.npz")
    other.step(still)
    assert np.abs(other.robot.estimate.scale / other.robot.initial.scale - 1.0).max() > 1e-3


@pytest.mark.slow  # on a walk; a robot at rest is above
def test_the_centre_of_mass_lies_over_the_soles_where_an_accelerometer_is_wrong():
    """A usual error of 0.07 m/s^2 would tilt the robot, and move the centre of mass by 2 mm."""
    errors = {"mass": 0.0, "com": 0.0}
    beliefs, truth = run(walking(18.0, errors=errors), 1300)
    late = slice(900, None)
    found = np.array([one.com - one.position_sole.mean(axis=0) for one in beliefs])[late]
    com = np.array([one[3] - one[2].mean(axis=0) for one in truth])[late]
    assert np.abs((found - com).mean(axis=0)[:2]).max() < 0.8e-3


@pytest.mark.parametrize("foot", [0, 1])
def test_the_lowest_points_stand_still(foot):
    sites = np.array([(0.0, 0.1, -0.5), (0.0, -0.1, -0.5)])
    sites[1 - foot, 2] += 0.05
    twist = np.zeros((2, 6))
    twist[foot] = (0.0, 1.0, 0.0, 0.3, 0.0, 0.0)  # rolls over its toes
    corners = np.array([[(0.1, 0.0, 0.0), (-0.1, 0.0, 0.0)]] * 2)
    axes = np.tile(np.eye(3), (2, 1, 1))
    axes[foot] = [(np.cos(0.3), 0.0, -np.sin(0.3)), (0.0, 1.0, 0.0), (np.sin(0.3), 0.0, np.cos(0.3))]
    velocity = touching(sites, axes, twist, corners, np.array([0.0, 0.0, 1.0]))
    toe = 0.1 * axes[foot, 0]
    asked = np.array([0.3, 0.0, 0.0]) + np.cross((0.0, 1.0, 0.0), toe)
    np.testing.assert_allclose(velocity, asked, atol=1e-3)
