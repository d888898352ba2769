"""Hardware and what was learnt of it over the episodes of a robot's life."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from surefoot.sensors import Fault
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers import FootSensors, SelfCalibration

STILL = np.zeros(11, dtype=np.float32)
STAND = "surefoot/NaoStand-v0"


def steps(env: gym.Env[Any, Any], count: int) -> list[dict[str, Any]]:
    return [env.step(STILL)[0] for _ in range(count)]


def scale(env: Any) -> np.ndarray:
    return env.true_parameters()[0]


def test_hardware_is_kept_over_resets_and_fresh_with_a_seed(make_bare) -> None:
    env = FootSensors(make_bare(STAND))
    env.reset(seed=1)
    first = scale(env)
    steps(env, 10)
    env.reset()
    np.testing.assert_allclose(scale(env), first, rtol=0.03)
    assert not np.array_equal(scale(env), first), "it has drifted"
    env.reset(seed=1)
    np.testing.assert_array_equal(scale(env), first)
    env.reset(seed=2)
    assert np.abs(scale(env) / first - 1.0).max() > 0.05


@pytest.mark.parametrize(
    ("always", "options", "seed", "stays"),
    [
        (False, None, None, True),
        (True, None, None, False),
        (False, {"surefoot": {"sensors": "fresh"}}, None, False),
        (True, {"surefoot": {"sensors": "keep"}}, None, True),
        (False, {"surefoot": {"sensors": "keep"}}, 5, True),
        (False, {"surefoot": {"calibration": "fresh"}}, None, True),
    ],
)
def test_a_reset_may_choose(always: bool, options: Any, seed: Any, stays: bool, make_bare) -> None:
    env = FootSensors(make_bare(STAND), {"scale_drift": 0.0}, fresh=always)
    env.reset(seed=1)
    first = scale(env)
    env.reset(seed=seed, options=options)
    assert np.array_equal(scale(env), first) == stays
    assert env.sensors_fresh != stays


def test_an_imu_and_encoders_keep_their_biases(make_bare) -> None:
    env = SelfCalibration(FootSensors(make_bare(STAND)))
    env.reset(seed=3)
    steps(env, 5)
    before = env.env.robot.hardware().telemetry
    env.reset()
    after = env.env.robot.hardware().telemetry
    np.testing.assert_allclose(after.imu.bias, before.imu.bias, atol=2e-3)
    assert np.abs(after.imu.bias).max() > 0.01


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """What a robot of seed 0 has learnt, and its sensors, after it stood for 4 s."""
    folder = tmp_path_factory.mktemp("learnt")
    env = SelfCalibration(FootSensors(gym.make(STAND)))
    env.reset(seed=0)
    steps(env, 320)
    env.env.save(folder / "sensors.npz")
    env.save(folder / "learnt.npz")
    return folder


@pytest.fixture
def stood(files) -> SelfCalibration:
    """The robot that goes on from these files."""
    env = SelfCalibration(FootSensors(gym.make(STAND)))
    env.reset(seed=0)
    env.env.load(files / "sensors.npz")
    env.load(files / "learnt.npz")
    steps(env, 20)
    return env


def test_what_was_learnt_is_kept_and_nothing_is_learnt_across_a_reset(stood) -> None:
    env = stood
    learnt = env.estimate
    assert np.abs(learnt.offset - env.env.instruments.nominal.offset).max() > 0.1
    _, info = env.reset()
    late = info["surefoot"]["lag"]
    # The lag, the sample between two episodes, and a reading's own age.
    for _ in range(late + 2):
        np.testing.assert_allclose(env.estimate.scale, learnt.scale, rtol=1e-9)
        assert np.isnan(env.reference.com).all()
        steps(env, 1)
    steps(env, 40)  # an attitude that is not at rest at the start takes up to half a second
    assert np.isfinite(env.reference.com).all()
    env.reset(options={"surefoot": {"calibration": "fresh"}})
    np.testing.assert_array_equal(env.estimate.scale, env.env.instruments.nominal.scale)


def test_calibration_of_fresh_sensors_starts_fresh(stood) -> None:
    env = stood
    env.reset(options={"surefoot": {"sensors": "fresh"}})
    np.testing.assert_array_equal(env.estimate.offset, env.env.instruments.nominal.offset)
    steps(env, 5)
    env.reset(options={"surefoot": {"sensors": "fresh", "calibration": "keep"}})
    assert env.env.sensors_fresh


def test_who_is_frozen_learns_nothing_and_still_corrects(stood) -> None:
    env = stood
    env.freeze()
    # What was measured by then is still learnt, with the block that it belongs to, and then handed out.
    steps(env, 20)
    kept = env.estimate
    for _ in range(60):
        (observation,) = steps(env, 1)
        np.testing.assert_allclose(env.estimate.scale, kept.scale, rtol=1e-12)
        force = kept.scale * env.env.raw + kept.offset
        np.testing.assert_allclose(observation["foot_force"], force, atol=2e-3)
    env.freeze(False)
    steps(env, 60)
    assert not np.array_equal(env.estimate.offset, kept.offset)


def test_hardware_and_what_was_learnt_survive_in_files(tmp_path, stood, make_bare) -> None:
    old = stood
    old.env.save(tmp_path / "sensors.npz")
    old.save(tmp_path / "learnt.npz")
    new = SelfCalibration(FootSensors(make_bare(STAND)))
    for seed in range(1, 20):
        new.reset(seed=seed)
        if abs(new.beliefs.model.mass - old.beliefs.model.mass) > 0.01:
            break
    else:
        pytest.fail("no other mass was drawn")
    new.env.load(tmp_path / "sensors.npz")
    new.load(tmp_path / "learnt.npz")
    np.testing.assert_array_equal(scale(new.env), scale(old.env))
    assert new.beliefs.model.mass == old.beliefs.model.mass
    new.reset()
    np.testing.assert_allclose(new.estimate.scale, old.estimate.scale, rtol=1e-9)
    np.testing.assert_allclose(new.estimate.offset, old.estimate.offset, rtol=1e-6, atol=1e-6)
    steps(new, 60)
    error = new.estimate.vgrf.sum() - new.unwrapped.truth.vgrf().sum()
    assert abs(error) < 3.0


def test_files_of_other_robots_and_sensors_are_refused(tmp_path, make_bare) -> None:
    env = FootSensors(make_bare(STAND))
    with pytest.raises(RuntimeError, match=r"no sensors before the first reset\(\)"):
        env.save(tmp_path / "a.npz")
    env.reset(seed=0)
    env.save(tmp_path / "a.npz")
    other = FootSensors(make_bare(STAND), "icub-force-torque")
    other.reset(seed=0)
    with pytest.raises(ValueError, match="was saved for sensors 'LoadCells"):
        other.load(tmp_path / "a.npz")
    calibrated = SelfCalibration(FootSensors(make_bare(STAND)))
    with pytest.raises(RuntimeError, match=r"no calibrator before the first reset\(\)"):
        calibrated.load(tmp_path / "a.npz")
    calibrated.reset(seed=0)
    with pytest.raises(ValueError, match="has no note of its method, and 'moment"):
        calibrated.load(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        ({"sensor": "fresh"}, r"must be a mapping with keys among \('sensors', 'calibration'\)"),
        ("fresh", "must be a mapping with keys among"),
        ({"sensors": "new"}, r"\['sensors'\] must be one of \('fresh', 'keep'\), got 'new'"),
    ],
)
def test_a_choice_that_does_not_exist_is_refused(asked: Any, text: str, make_bare) -> None:
    env = FootSensors(make_bare(STAND))
    with pytest.raises(ValueError, match=text):
        env.reset(seed=0, options={"surefoot": asked})


def test_a_cell_dies_on_time_and_stays_dead(make_bare) -> None:
    env = FootSensors(
        make_bare(STAND), faults=[Fault("dead", 5, start=0.5), {"kind": "flipped", "channel": 0}]
    )
    env.reset(seed=0)
    zero = HX711_LOAD_CELLS.zero_code
    raw = np.array([observation["foot_raw"] for observation in steps(env, 60)])
    assert np.flatnonzero(raw[:, 5] == zero)[0] in (38, 39)
    assert (raw[40:, 5] == zero).all()
    env.reset()
    assert steps(env, 1)[0]["foot_raw"][5] == zero
    with pytest.raises(ValueError, match=r"Fault.channel must be one of the instrument's 8 channels"):
        FootSensors(make_bare(STAND), faults=[Fault("dead", 8)])


def test_severity_scales_the_errors(make_bare) -> None:
    spread = {}
    for severity in (0.0, 0.5, 1.0):
        env = FootSensors(make_bare(STAND), severity=severity)
        env.reset(seed=0)
        spread[severity] = HX711_LOAD_CELLS.nominal_scale / scale(env) - 1.0
    np.testing.assert_allclose(spread[0.0], 0.0, atol=1e-12)
    np.testing.assert_allclose(spread[0.5], 0.5 * spread[1.0], rtol=1e-9)
    with pytest.raises(ValueError, match="'severity' must be finite and not negative"):
        FootSensors(make_bare(STAND), severity=-1.0)


def test_faults_in_words_and_readings_that_do_not_arrive(make_bare) -> None:
    wire = {"wire": {"packet_loss": 0.3, "delay": 0.02}}
    faults = ["at t=0.25 s cell right/front-right dies", "at t=0.5 s cell left/4 drops"]
    env = FootSensors(make_bare(STAND), wire, faults=faults)
    observation, _ = env.reset(seed=0)
    missing, seen = [], [observation["foot_raw"]]
    for _ in range(60):
        observation = steps(env, 1)[0]
        assert env.observation_space.contains(observation)
        missing.append(np.isnan(env.raw))
        lost = missing[-1]
        np.testing.assert_array_equal(observation["foot_raw"][lost], seen[-1][lost])
        np.testing.assert_array_equal(observation["foot_raw"][~lost], env.raw[~lost].astype(np.float32))
        seen.append(observation["foot_raw"])
    assert 0.1 < np.mean(missing) < 0.6
    assert np.all(np.array(missing)[41:, 3])
    assert (np.array(seen)[30:, 5] == HX711_LOAD_CELLS.zero_code).all()
    with pytest.raises(ValueError, match="left/front-left"):
        FootSensors(make_bare(STAND), faults=["at t=1 s cell left/9 dies"])


def test_one_may_listen_later(make_bare) -> None:
    sensed = FootSensors(gym.make("Humanoid-v5", include_cfrc_ext_in_observation=False), "icub-force-torque")
    with pytest.raises(gym.error.ResetNeeded, match="no readings before the first reset"):
        _ = sensed.raw
    sensed.reset(seed=0)
    env = SelfCalibration(sensed)
    env.reset()
    for _ in range(12):
        env.step(np.zeros(17, dtype=np.float32))
    assert np.isfinite(env.estimate.force).all()


def test_files_of_another_body_or_with_other_faults_are_refused(tmp_path, make_bare) -> None:
    env = FootSensors(make_bare(STAND), faults=["at t=1 s cell left/2 dies"])
    env.reset(seed=0)
    env.save(tmp_path / "a.npz")
    other = FootSensors(make_bare(STAND), faults=["at t=1 s cell left/1 dies"])
    other.reset(seed=0)
    with pytest.raises(ValueError, match="was saved for faults 'Fault"):
        other.load(tmp_path / "a.npz")
    humanoid = FootSensors(
        gym.make("Humanoid-v5", include_cfrc_ext_in_observation=False),
        soles=True,
        faults=["at t=1 s cell left/2 dies"],
    )
    humanoid.reset(seed=0)
    with pytest.raises(ValueError, match="was saved for robot 'torso with"):
        humanoid.load(tmp_path / "a.npz")
    with pytest.raises(TypeError, match="'faults' must be a sequence of faults"):
        FootSensors(make_bare(STAND), faults="at t=1 s cell left/2 dies")


@pytest.mark.parametrize("heavier", [0.6, 20.0])
def test_another_battery_keeps_what_was_learnt_and_another_robot_is_named(tmp_path, heavier: float) -> None:
    """A humanoid of 40 kg with soles of its own."""
    text = (Path(gym.__file__).parent / "envs" / "mujoco" / "assets" / "humanoid.xml").read_text()
    battery = f'<geom name="battery" type="sphere" size="0.03" mass="{heavier}" contype="0" conaffinity="0"/>'
    joint = '<joint armature="0" damping="0" limited="false" name="root"'
    (tmp_path / "heavier.xml").write_text(text.replace(joint, battery + joint))

    def robot(**options: Any) -> SelfCalibration:
        bare = gym.make("Humanoid-v5", include_cfrc_ext_in_observation=False, **options)
        env = SelfCalibration(FootSensors(bare, "icub-force-torque"))
        env.reset(seed=0)
        for _ in range(20):
            env.step(np.zeros(17, dtype=np.float32))
        return env

    light, heavy = robot(), robot(xml_file=str(tmp_path / "heavier.xml"))
    light.save(tmp_path / "state.npz")
    mass = heavy.robot.model.mass
    if heavier > 10.0:
        with pytest.raises(ValueError, match=r"was saved for mass '4\d\.\d+' kg, but this is '6\d\.\d+' kg"):
            heavy.load(tmp_path / "state.npz")
        return
    with pytest.warns(UserWarning, match=r"The map of its channels is kept"):
        heavy.load(tmp_path / "state.npz")
    heavy.reset()
    assert heavy.robot.model.mass == mass
    heavy.step(np.zeros(17, dtype=np.float32))
    assert np.isfinite(heavy.estimate.force).all()


def test_a_wire_that_is_too_short_is_refused_at_the_door(make_bare) -> None:
    with pytest.raises(ValueError, match="under_way"):
        FootSensors(make_bare(STAND), {"wire": {"delay": 0.2, "under_way": 3}})
