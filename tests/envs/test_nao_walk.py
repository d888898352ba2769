"""The walking environment: its contract, and that the robot walks."""

import numpy as np
import pytest

import surefoot  # noqa: F401
from surefoot.controllers import Stabiliser, zero_action
from surefoot.envs.nao.walk import NaoWalkEnv

QUIET = {"push_impulse": (0.0, 0.0), "joint_noise": 0.0, "velocity_noise": 0.0}


def walk(env, controller=zero_action, seed=0, bias=(0.0, 0.0)):
    """Walk to the end; errors of the CoP where one foot carries, joint errors, steps, and whether it fell."""
    observation, _ = env.reset(seed=seed)
    robot = env.unwrapped
    layout = robot.state_layout
    cop_error, joint_error, terminated, truncated = [], [], False, False
    steps = 0
    while not (terminated or truncated):
        seen = observation | {"cop": observation["cop"] + np.float32(bias)}
        observation, _, terminated, truncated, _ = env.step(controller(seen))
        steps += 1
        state = observation["state"]
        if state[layout["stance"]].sum() == 1 and min(robot.truth.vgrf()) < 5:
            cop_error.append(observation["cop"] - state[layout["cop_reference"]])
        joint_error.append(
            robot.truth.joint_position[-1] - robot.pattern.qpos[min(steps, robot.pattern.ticks - 1), 7:]
        )
    return np.array(cop_error), np.array(joint_error), steps, terminated


def rms(error):
    return np.sqrt((error**2).sum(axis=-1).mean())


@pytest.mark.parametrize("speed", [0.02, 0.04, 0.1])
def test_the_open_loop_walker_goes_as_fast_as_planned_to_the_end_of_its_plan(speed):
    env = NaoWalkEnv(speed=speed, duration=6.0, **QUIET)
    env.reset(seed=0)
    start = env.truth.com[-1, 0]
    cop_error, joint_error, steps, terminated = walk(env)
    assert (steps, terminated) == (env.pattern.ticks, False) == (480, False)
    assert env.truth.com[-1, 0] - start == pytest.approx(np.ptp(env.pattern.com[:, 0]), rel=0.03)
    assert rms(cop_error) < 0.01
    # The motors' lead makes up for load and lag: legs are where the pattern has them.
    assert np.abs(joint_error[:, :12]).max() < 0.03
    assert np.sqrt((joint_error[:, :12] ** 2).mean()) < 0.008


@pytest.mark.parametrize(("speed", "turn_rate"), [(0.1, 0.0), (0.0, 0.2), (0.04, -0.1)])
def test_the_stabilised_walker_follows_its_cop_reference(speed, turn_rate):
    env = NaoWalkEnv(speed=speed, turn_rate=turn_rate, duration=6.0)
    cop_error, _, _, terminated = walk(env, Stabiliser(env.state_layout), seed=5)
    assert not terminated
    assert rms(cop_error) < 0.01


def test_a_biased_cop_throws_the_stabilised_walker():
    env = NaoWalkEnv(speed=0.1, duration=6.0)
    for side in (-1.0, 1.0):
        assert walk(env, Stabiliser(env.state_layout), seed=6, bias=(0.0, 0.03 * side))[3]


def test_it_turns():
    env = NaoWalkEnv(speed=0.0, turn_rate=0.2, duration=6.0, **QUIET)
    assert not walk(env)[3]
    ahead = env.truth.R_world_torso[-1, :2, 0]
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(env.pattern.yaw_sole[-1].mean(), abs=0.03)


def test_rewards_are_the_sum_of_their_terms_and_highest_on_the_pattern():
    env = NaoWalkEnv(speed=0.04, duration=6.0, **QUIET)
    env.reset(seed=0)
    rewards = []
    for _ in range(200):
        _, reward, _, _, info = env.step(np.zeros(11, dtype=np.float32))
        terms = {name: value for name, value in info.items() if name.startswith("reward_")}
        assert set(terms) == {f"reward_{x}" for x in ("alive", "progress", "upright", "cop", "action")}
        assert reward == pytest.approx(sum(terms.values()))
        rewards.append(reward)
    assert 3.5 < np.mean(rewards) <= 4.0
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    wild = [env.step(rng.uniform(-0.5, 0.5, 11).astype(np.float32))[1] for _ in range(60)]
    assert np.mean(wild) < np.mean(rewards[:60]) - 0.2


def test_the_reward_does_not_depend_on_where_in_the_world_the_robot_walks():
    env = NaoWalkEnv(speed=0.04, duration=6.0, **QUIET)
    action = np.zeros(11, dtype=np.float32)
    rewards = []
    for turn in (0.0, 2.0):
        env.reset(seed=0)
        env.data.qpos[:2] += (1.0, -2.0) if turn else (0.0, 0.0)
        env.data.qpos[3:7] = (np.cos(turn / 2), 0, 0, np.sin(turn / 2))
        c, s = np.cos(turn), np.sin(turn)
        env.data.qpos[:2] = np.array([[c, -s], [s, c]]) @ env.data.qpos[:2]
        rewards.append([env.step(action)[1] for _ in range(120)])
    assert rewards[0] == pytest.approx(rewards[1], abs=1e-3)


def test_a_longer_stand_starts_the_walk_later():
    env = NaoWalkEnv(duration=6.0, stand_time=2.0)
    assert env.pattern.stance[:160].all()
    assert np.ptp(env.pattern.cop[:160], axis=0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed": 0.3}, "walk at most"),
        ({"speed": float("nan")}, "'speed' must be finite"),
        ({"turn_rate": 2.0}, "turn at most"),
        ({"duration": -3.0}, "'duration' must be a positive number of seconds"),
        ({"stand_time": 0.1}, "'stand_time' must be at least 0.5 s"),
        ({"push_impulse": (1.0, 0.5), "duration": 8.0}, "push_impulse"),
    ],
)
def test_impossible_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        NaoWalkEnv(**options)
