"""Robots whose sensors are as bad as chance or a curriculum says: what is drawn, kept, set and told."""

import copy

import gymnasium as gym
import numpy as np
import pytest

import surefoot  # noqa: F401
from surefoot.native import CALIBRATION, SENSORS
from surefoot.native.threads import LEAST
from surefoot.robot.native import NativeSample
from surefoot.robot.sensing.native import NativeSensing
from surefoot.sensors.faults.channels import KINDS
from surefoot.wrappers import FootSensors, TruthRow, VectorFootSensors, VectorSelfCalibration

STILL = np.zeros(11, dtype=np.float32)


def robot(**options):
    return FootSensors(gym.make("surefoot/NaoStand-v0"), **options)


def robots(count=4, **options):
    copies = gym.make_vec(
        "surefoot/NaoStand-v0", num_envs=count, vectorization_mode="sync", wrappers=[TruthRow]
    )
    return VectorFootSensors(copies, **options)


def drawn(info):
    truth = info["surefoot"]["truth"]
    return truth["severity"].copy(), truth["fault"].copy()


def reset(env, **options):
    return drawn(env.reset(**options)[1])


def test_a_severity_is_that_of_the_sensors_and_faults_are_of_the_episode():
    env = robot(severity=(0.5, 2.0), faults={"dies": 0.3})
    first, broken = reset(env, seed=1)
    assert 0.5 <= first <= 2.0
    error = env.true_parameters()[0]
    episodes = [reset(env) for _ in range(6)]
    assert all(severity == first for severity, _ in episodes)
    assert len({tuple(fault) for _, fault in episodes}) > 1
    np.testing.assert_allclose(env.true_parameters()[0], error, rtol=5e-3)
    again, same = reset(env, seed=1)
    assert again == first
    np.testing.assert_array_equal(same, broken)
    assert reset(env, options={"surefoot": {"sensors": "fresh"}})[0] != first


def test_errors_are_as_large_as_the_severity_says():
    env, plain = robot(severity=(0.0, 2.0)), robot()
    found = []
    for seed in range(8):
        severity, _ = reset(env, seed=seed)
        plain.reset(seed=seed)
        nominal = plain.instruments.nominal.scale
        # A scale is undone by 1 / (1 + error): its error is in proportion to the severity.
        error, expected = (nominal / one.true_parameters()[0] - 1.0 for one in (env, plain))
        np.testing.assert_allclose(error, severity * expected, atol=1e-3)
        found.append(float(severity))
    assert max(found) - min(found) > 0.8


def test_a_channel_reads_as_the_fault_that_was_drawn():
    env = robot(config="perfect", faults={"at t=0.2 s dies": 0.5})
    _, fault = reset(env, seed=0)
    dead = fault == 1 + KINDS.index("dead")
    assert dead.any()
    assert not dead.all()
    for _ in range(30):
        observation, *_, info = env.step(STILL)
    np.testing.assert_array_equal(drawn(info)[1], fault)
    np.testing.assert_array_equal(observation["foot_raw"] == env.instruments.zero_code, dead)


def test_a_curriculum_sets_robots_by_their_numbers():
    env = robots()
    assert "severity" not in env.reset(seed=0)[1]["surefoot"]["truth"]
    env.set_severity(np.array(1.0))
    env.set_severity(np.array([0.0, 3.0]), robots=[1, 2])
    env.set_faults({"sticks": 1.0}, robots=[3])
    severity, fault = reset(env)
    assert severity.tolist() == [1.0] * 4, "sensors were kept"
    assert (fault[3] == 1 + KINDS.index("stuck")).all()
    assert not fault[:3].any()
    fresh = {"options": {"surefoot": {"sensors": "fresh"}}}
    assert reset(env, **fresh)[0].tolist() == [1.0, 0.0, 3.0, 1.0]
    env.set_severity((2.0, 2.5))
    severity, _ = reset(env, **fresh)
    assert (severity >= 2.0).all()
    assert len(set(severity.tolist())) == 4
    *_, infos = env.step(np.tile(STILL, (4, 1)))
    np.testing.assert_array_equal(drawn(infos)[0], severity)


def test_hardware_that_is_saved_keeps_its_severity(tmp_path):
    old, new = (robots(2, severity=(0.0, 2.0), faults={"dies": 0.2}) for _ in range(2))
    severity, _ = reset(old, seed=1)
    new.reset(seed=5)
    old.save(tmp_path / "feet.npz")
    new.load(tmp_path / "feet.npz")
    np.testing.assert_array_equal(new.true_parameters().scale, old.true_parameters().scale)
    assert reset(new)[0].tolist() == severity.tolist()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"severity": (2.0, 1.0)},
            r"^'severity' must be a number or \(lowest, highest\).*got \(2\.0, 1\.0\)\.$",
        ),
        (
            {"severity": (0.0, 1.0, 2.0)},
            r"must be a number or \(lowest, highest\), got \(0\.0, 1\.0, 2\.0\)\.$",
        ),
        ({"severity": -1.0}, r"^'severity' must be finite and not negative, got -1\.0\.$"),
        ({"severity": (0.0, float("inf"))}, r"finite, not negative and in this order"),
        ({"faults": {"dies": 2.0}}, r"from 0 to 1; got 2\.0\.$"),
    ],
)
def test_what_cannot_be_drawn_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        robot(**options)


def test_what_cannot_be_set_changes_nothing():
    env = robots(2)
    env.reset(seed=0)
    with pytest.raises(IndexError, match=r"^There are robots 0 to 1, got \[2\]\.$"):
        env.set_severity(0.5, robots=[0, 2])
    with pytest.raises(TypeError, match=r"^'robots' must be their numbers, got .*flatnonzero"):
        env.set_faults({"dies": 0.5}, robots=np.array([False, True]))
    with pytest.raises(ValueError, match=r"one a robot: got 3 for 2 robots\.$"):
        env.set_severity([1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="not negative"):
        env.set_severity([0.5, -1.0])
    with pytest.raises(ValueError, match="from 0 to 1"):
        env.set_faults({"dies": -0.1})
    assert not any(own.differs for own in env.sensors.robots)


def test_the_number_of_threads_changes_nothing():
    seen, count = [], 2 * LEAST
    copies = robots(count).env
    for threads in (1, 3):
        feet = VectorFootSensors(copies, severity=(0.0, 2.0), faults={"dies": 0.1})
        feet.sensors.threads = threads
        env = VectorSelfCalibration(feet)
        env.reset(seed=0)
        found = [env.step(np.tile(STILL, (count, 1)))[0] for _ in range(20)]
        env.reset(options={"reset_mask": np.arange(count) % 5 == 0})
        observation, *_, infos = env.step(np.tile(STILL, (count, 1)))
        told = infos["surefoot"]
        learnt = {"flags": told["flags"], "covariance": told["covariance"], **told["parameters"]}
        seen.append([*found, observation, feet.true_parameters()._asdict(), learnt])
    for one, other in zip(*seen, strict=True):
        for name, part in one.items():
            np.testing.assert_array_equal(part, other[name], err_msg=name)


@pytest.mark.skipif(not (SENSORS.installed() and CALIBRATION.installed()), reason="needs the libraries")
def test_who_reads_and_calibrates_stays_over_steps_resets_files_and_copies(tmp_path):
    feet = robots(2, severity=(0.0, 2.0))
    env = VectorSelfCalibration(feet)

    def step(env):
        return env.step(np.zeros(env.action_space.shape, np.float32))[0]["foot_force"]

    def backends(env):
        return [robot.backend for robot in (*env.env.sensors.robots, *env.calibration.robots)]

    env.reset(seed=1)
    chosen, severities = backends(env), [robot.condition.severity for robot in feet.sensors.robots]
    step(env)
    env.reset()
    step(env)
    assert backends(env) == chosen
    feet.save(tmp_path / "feet.npz")
    env.save(tmp_path / "learnt.npz")
    env.reset(seed=2)
    feet.load(tmp_path / "feet.npz")
    env.load(tmp_path / "learnt.npz")
    assert [robot.condition.severity for robot in feet.sensors.robots] == severities
    feet.env.env_fns = ()  # of Gymnasium 1.2 a generator, which nobody can copy
    other = copy.deepcopy(env)
    np.testing.assert_array_equal(step(other), step(env))
    for now in (env, other):
        assert list(map(type, backends(now))) == 2 * [NativeSensing] + 2 * [NativeSample]
        assert not set(backends(now)) & set(chosen)
