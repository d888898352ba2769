"""Wrapped environments as Gymnasium wants them: specs, spaces, seeds, checks."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from surefoot.calibration import Parameters
from surefoot.robot.beliefs.errors import NO_ERRORS, BeliefErrors
from surefoot.robot.sensing.foot_equipment import FootOptions
from surefoot.sensors import Fault, ForceTorque, Imu, LoadCells, preset
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers import FootEquipment, FootSensors, SelfCalibration, TruthRow

STACKS = {
    "preset": lambda env: FootSensors(env),
    "config": lambda env: FootSensors(env, LoadCells(rate=None, polarity=(1,)), imu=Imu(gyroscope_noise=0.0)),
    "mapping": lambda env: FootSensors(env, {"rate": (80.0, 90.0)}, link={"delay": 0.01}, stream=7),
    "none": lambda env: SelfCalibration(FootSensors(env), "none"),
    "window": lambda env: SelfCalibration(FootSensors(env), "window", initial="calibrated", every=2, lag=5),
    "errors": lambda env: SelfCalibration(FootSensors(env), "none", errors=BeliefErrors(mass=0.02)),
    "ankles": lambda env: SelfCalibration(FootSensors(env, "icub-force-torque")),
    "both": lambda env: SelfCalibration(
        FootSensors(env, ankles=ForceTorque(), faults=[Fault("dead", 2, start=0.05)], severity=0.5),
        show=("wrench", "foot_force_std", "cop_std", "foot_flags", "vgrf"),
    ),
    "parameters": lambda env: SelfCalibration(
        FootSensors(env),
        "tare",
        initial=Parameters(HX711_LOAD_CELLS.nominal_scale, HX711_LOAD_CELLS.nominal_offset),
    ),
}


def steps(env: gym.Env, count: int = 12, seed: int = 3) -> list[dict[str, np.ndarray]]:
    observation, _ = env.reset(seed=seed)
    seen = [observation]
    rng = np.random.default_rng(seed)
    for _ in range(count):
        action = rng.uniform(-0.1, 0.1, env.action_space.shape).astype(np.float32)
        observation, *_ = env.step(action)
        seen.append(observation)
    return seen


def assert_same(one: list[dict[str, np.ndarray]], other: list[dict[str, np.ndarray]]) -> None:
    for first, second in zip(one, other, strict=True):
        assert first.keys() == second.keys()
        for key in first:
            np.testing.assert_array_equal(first[key], second[key], err_msg=key)


@pytest.mark.parametrize("name", STACKS)
def test_specs_survive_pickle_and_json_and_make_the_same_environment(name: str, make_bare) -> None:
    env = STACKS[name](make_bare())
    expected = steps(env)
    for spec in (pickle.loads(pickle.dumps(env.spec)), EnvSpec.from_json(env.spec.to_json())):
        again = gym.make(spec)
        assert type(again) is type(env)
        assert_same(steps(again), expected)


@pytest.mark.parametrize("name", STACKS)
def test_observations_lie_in_their_space_and_are_nobody_elses(name: str, make_bare) -> None:
    env = STACKS[name](make_bare())
    # VecNormalize, VecFrameStack and skrl take nothing else.
    assert all(isinstance(part, spaces.Box) for part in env.observation_space.values())
    observation, _ = env.reset(seed=0)
    kept = []
    for _ in range(20):
        assert env.observation_space.contains(observation)
        for key, part in observation.items():
            kinds = {"foot_flags": np.int32}
            assert part.dtype == kinds.get(key, np.float32), key
        kept.append((observation, {key: part.copy() for key, part in observation.items()}))
        observation, *_ = env.step(env.action_space.sample() * 0.1)
    for seen, copy in kept:
        for key in seen:
            np.testing.assert_array_equal(seen[key], copy[key])
    arrays = [part for seen, _ in kept for part in seen.values()]
    assert not any(np.shares_memory(a, b) for i, a in enumerate(arrays) for b in arrays[:i])


def test_equipment_is_a_value_and_its_fields_are_keywords(make_bare) -> None:
    value = FootEquipment("icub-force-torque", severity=(0.5, 2.0), faults=["at t=1 s cell left/fz dies"])
    env = FootSensors(make_bare(), value, fresh=True)
    same = FootSensors(make_bare(), **value.options | {"fresh": True})
    assert env.spec.to_json() == same.spec.to_json()
    assert_same(steps(env), steps(same))
    assert FootOptions.__annotations__.keys() | {"config"} == value.options.keys()


def test_equipment_refuses_what_has_no_meaning(make_bare) -> None:
    with pytest.raises(
        ValueError,
        match=r"^'severity' is given twice, in FootEquipment\(...\) and as a keyword; leave one out.$",
    ):
        FootSensors(make_bare(), FootEquipment(severity=0.5), severity=2.0)
    with pytest.raises(ValueError, match=r"^'severity' must be finite and not negative, got -1.0.$"):
        FootEquipment(severity=-1)
    with pytest.raises(TypeError, match="have no option 'sevrity'"):
        FootSensors(make_bare(), sevrity=2.0)


def test_what_only_truth_has_is_gone(make_bare) -> None:
    bare = make_bare()
    sensed = FootSensors(bare)
    assert set(sensed.observation_space) == {"state", "foot_raw"}
    calibrated = SelfCalibration(sensed)
    assert set(calibrated.observation_space) == set(bare.observation_space)
    shown = SelfCalibration(sensed, show=("cop", "foot_raw")).observation_space
    assert set(shown) == {"state", "cop", "foot_raw"}
    assert shown["foot_raw"] == sensed.observation_space["foot_raw"]
    for key in ("foot_force", "cop", "cop_foot", "cop_valid"):
        assert calibrated.observation_space[key] == bare.observation_space[key]


@pytest.mark.parametrize("name", STACKS)
def test_the_wrapped_truth_is_the_bare_one_bit_for_bit(name: str, make_bare) -> None:
    bare, wrapped = make_bare(), STACKS[name](make_bare())
    bare.reset(seed=5)
    wrapped.reset(seed=5)
    rng = np.random.default_rng(0)
    for _ in range(30):
        action = rng.uniform(-0.2, 0.2, bare.action_space.shape).astype(np.float32)
        _, reward, *_ = bare.step(action)
        _, wrapped_reward, *_ = wrapped.step(action)
        np.testing.assert_array_equal(wrapped.unwrapped.truth.rows, bare.unwrapped.truth.rows)
        assert wrapped_reward == reward
    state, wrapped_state = (env.unwrapped.np_random.bit_generator.state for env in (bare, wrapped))
    assert state == wrapped_state


def test_the_same_seed_is_the_same_episode_and_another_stream_other_sensors(make_bare) -> None:
    env = FootSensors(make_bare())
    first = steps(env)
    assert_same(steps(env), first)
    other = steps(FootSensors(make_bare(), stream=1))
    assert not np.array_equal(first[0]["foot_raw"], other[0]["foot_raw"])
    joints = env.unwrapped.state_layout["cop_reference"]
    np.testing.assert_array_equal(first[5]["state"][joints], other[5]["state"][joints])


def test_perfect_instruments_and_no_calibration_show_what_the_bare_environment_shows(make_bare) -> None:
    """Forces of the whole step, centres of pressure but for the inertia of the plates and a step's delay."""
    perfect = FootSensors(make_bare(), "perfect", imu="perfect", encoders="perfect", link="perfect")
    env = SelfCalibration(perfect, "none", errors=NO_ERRORS)
    bare = make_bare()
    (observation, info), expected = env.reset(seed=2), bare.reset(seed=2)[0]
    layout, far, true = env.unwrapped.state_layout, [], expected["foot_force"]
    for step in range(240):
        np.testing.assert_allclose(observation["foot_force"], true, atol=1e-4)
        # Cells feel the inertia of their plate, the ground does not: it matters where a foot carries little.
        load, valid = true.reshape(2, 4).sum(axis=1), expected["cop_valid"]
        if step:
            valid = info["surefoot"]["truth"]["cop_valid"]
        clear, firm = np.abs(load - 5.0) > 0.5, load > 20.0
        np.testing.assert_array_equal(observation["cop_valid"][0], valid[0])
        np.testing.assert_array_equal(observation["cop_valid"][1:][clear], valid[1:][clear])
        if step > 10:  # The robot begins above the ground, and its landing shakes the plates.
            told = info["surefoot"]["truth"]
            np.testing.assert_allclose(observation["cop_foot"][firm], told["cop_foot"][firm], atol=1.5e-3)
            np.testing.assert_allclose(observation["cop"], told["cop"], atol=1.5e-3)
            far.append(observation["cop"] - told["cop"])
        state, truth = observation["state"], expected["state"]
        for part in ("joint_position", "com_reference", "cop_reference", "stance", "phase"):
            np.testing.assert_array_equal(state[layout[part]], truth[layout[part]])
        np.testing.assert_allclose(state[layout["tilt"]], truth[layout["tilt"]], atol=0.02)
        action = np.zeros(11, dtype=np.float32)
        observation, _, _, _, info = env.step(action)
        expected, true = bare.step(action)[0], info["surefoot"]["truth"]["force_cell"].ravel()
    assert np.sqrt(np.mean(np.square(far))) < 3e-4


def test_a_perfect_link_brings_the_last_instant(make_bare) -> None:
    env = FootSensors(make_bare(), imu="perfect", encoders="perfect", link="perfect")
    env.reset(seed=0)
    for _ in range(5):
        observation, *_ = env.step(np.zeros(11, dtype=np.float32))
        truth = env.unwrapped.truth
        seen = observation["state"][env.unwrapped.state_layout["joint_position"]]
        np.testing.assert_array_equal(seen, truth.joint_position[-1].astype(np.float32))
        seen = observation["state"][env.unwrapped.state_layout["gyroscope"]]
        np.testing.assert_allclose(seen, truth.gyroscope.mean(axis=0), atol=1e-6)


def test_counts_are_exact_in_float32(make_bare) -> None:
    env = FootSensors(make_bare())
    env.reset(seed=0)
    observation, *_ = env.step(np.zeros(11, dtype=np.float32))
    np.testing.assert_array_equal(observation["foot_raw"].astype(np.float64), env.raw)
    assert env.observation_space["foot_raw"].high[0] == 2**24 - 1


def test_the_order_of_wrappers_matters_and_is_explained(make_bare) -> None:
    bare = make_bare()
    with pytest.raises(
        TypeError, match=r"found none below it; wrap in this order: SelfCalibration\(FootSensors"
    ):
        SelfCalibration(bare)
    with pytest.raises(TypeError, match="InstrumentedEnv needs an environment on MuJoCo"):
        FootSensors(gym.make("CartPole-v1"))
    for inner in (FootSensors(bare), SelfCalibration(FootSensors(make_bare()))):
        for outer in (FootSensors, TruthRow):
            with pytest.raises(
                TypeError, match="found FootSensors below it, and a robot's feet are read once"
            ):
                outer(inner)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda env: FootSensors(env, "hx712"), "no foot sensor preset 'hx712'; there are"),
        (
            lambda env: FootSensors(env, LoadCells(channels=4)),
            "has room for 8 cells, four a foot, or for 2, one a foot, but LoadCells.channels is 4",
        ),
        (
            lambda env: SelfCalibration(FootSensors(env), "windows"),
            "Method 'windows' does not exist. Available",
        ),
        (lambda env: SelfCalibration(FootSensors(env), typo=1), "no option 'typo'. Available"),
        (lambda env: SelfCalibration(FootSensors(env), mass=5.3), "'mass' is no option of SelfCalibration"),
        (
            lambda env: SelfCalibration(FootSensors(env), errors={"mass": -0.1}),
            "BeliefErrors.mass must lie in 0 to 1",
        ),
    ],
)
def test_bad_options_are_refused_before_the_first_step(make, text: str, make_bare) -> None:
    with pytest.raises(ValueError, match=text):
        make(make_bare())


def test_the_perfect_preset_reads_in_newtons() -> None:
    np.testing.assert_array_equal(preset("perfect").nominal_scale, np.ones(8))
    np.testing.assert_array_equal(preset("perfect").nominal_offset, np.zeros(8))
