"""The rig of in-situ calibration: its figures, its truth against Newton and Euler, its environment."""

import re

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from _refusals import refusals

from surefoot.envs.leg_rig.env import CONTROL_STEP, PRIOR_INFORMATION, LegRigEnv
from surefoot.envs.leg_rig.spec import (
    ADDED_MASSES,
    CONTACT_ANGLE,
    CONTACT_STIFFNESS,
    FOOT_IN_LEG,
    HIP_RANGE,
    SENSORS,
    limb_beyond,
    load_leg_rig_spec,
    place_added_mass,
    read_wrenches,
    sensor_frames,
)

STILL = np.zeros(2, dtype=np.float32)


def gravity_wrench(mass, mass_com, gravity):
    """M(m, c) g (in-situ paper, Eqs. 3-5)."""
    return np.concatenate([mass * gravity, np.cross(mass_com, gravity)])


def wrench_of_bodies(model, data, sensor):
    """Newton and Euler, body by body, from MuJoCo's accelerations, at and in the sensor's frame."""
    site = data.site(f"{sensor}_ft")
    R = site.xmat.reshape(3, 3)
    first = int(model.site(f"{sensor}_ft").bodyid[0])
    force, torque = np.zeros(3), np.zeros(3)
    acceleration, velocity = np.zeros(6), np.zeros(6)
    kind = mujoco.mjtObj.mjOBJ_BODY
    # The leg is a chain: whatever comes later hangs further down.
    for body in range(first, model.nbody):
        mujoco.mj_objectAcceleration(model, data, kind, body, acceleration, 0)
        mujoco.mj_objectVelocity(model, data, kind, body, velocity, 0)
        axes = data.ximat[body].reshape(3, 3)
        inertia = axes * model.body_inertia[body] @ axes.T
        omega = velocity[:3]
        # MuJoCo's accelerations hold gravity: a - g, at the centre of mass.
        push = -model.body_mass[body] * acceleration[3:]
        twist = -inertia @ acceleration[:3] - np.cross(omega, inertia @ omega)
        force += push
        torque += twist + np.cross(data.xipos[body] - site.xpos, push)
    return np.concatenate([R.T @ force, R.T @ torque])


def rollout(env, seed, actions, options=None):
    """All that an episode returns, as one array."""
    observation, info = env.reset(seed=seed, options=options)
    parts = [observation, *info["surefoot"]["truth"].values()]
    for action in actions:
        observation, reward, _, _, info = env.step(action)
        parts += [observation, reward, *info["surefoot"]["truth"].values()]
    return np.concatenate([np.ravel(part) for part in parts])


def test_published_masses_lie_where_both_sensors_see_them():
    published_leg = {
        2: (-0.0215, 0.108341707, 0.367376111),
        4: (0.2585, 0.025223889, 0.269720028),
        5: (0.3865, -0.0347, 0.3926),
        8: (-0.0435, 0.0, 0.4273),
    }
    for configuration, com_leg in published_leg.items():
        np.testing.assert_allclose(ADDED_MASSES[configuration].com_leg, com_leg, atol=1e-12)
    masses = [0, *[0.703] * 3, *[0.51102] * 2, 0, 0.51102]
    assert [load.mass for load in ADDED_MASSES.values()] == masses
    # A cube of steel with the published mass is as wide as beam and published places leave room for.
    assert ADDED_MASSES[6].width == pytest.approx(0.0402, abs=5e-5)
    assert ADDED_MASSES[6].inertia == pytest.approx(0.51102 * 0.0402**2 / 6.0, rel=0.01)


@pytest.mark.parametrize("configuration", list(ADDED_MASSES))
def test_the_compiled_rig_has_the_figures_that_it_claims(configuration):
    model = load_leg_rig_spec(configuration).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    origins, rotations = sensor_frames(data)
    hip = data.body("hip_front_back").xpos
    np.testing.assert_allclose(origins[1] - hip, (0.0, 0.0, -0.0743), atol=1e-12)
    for R in rotations:
        np.testing.assert_allclose(R, np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    np.testing.assert_allclose(rotations[1].T @ (origins[0] - origins[1]), FOOT_IN_LEG, atol=1e-12)
    assert limb_beyond(model, data, "leg").mass == pytest.approx(4.72, abs=1e-9)
    assert limb_beyond(model, data, "foot").mass == pytest.approx(0.59, abs=1e-9)
    load, body = ADDED_MASSES[configuration], model.body("added_mass").id
    assert model.body_mass[body] == load.mass
    for origin, R, com in zip(origins, rotations, (load.com_foot, load.com_leg), strict=True):
        np.testing.assert_allclose(R.T @ (data.xipos[body] - origin), com, atol=1e-12)
    np.testing.assert_allclose(model.actuator_ctrlrange.T, [-HIP_RANGE / 2, HIP_RANGE / 2], atol=1e-12)


def test_swinging_forward_and_outward_is_positive():
    model = load_leg_rig_spec().compile()
    data = mujoco.MjData(model)
    data.qpos[:] = 0.3, 0.2
    mujoco.mj_kinematics(model, data)
    toe = data.site("foot_ft").xpos - data.body("hip_front_back").xpos
    assert toe[0] > 0.1
    assert toe[1] < -0.05


@pytest.mark.parametrize("knee_slack", [0.0, 0.02])
def test_exchanging_the_masses_is_building_another_rig(knee_slack):
    changed = load_leg_rig_spec(2, knee_slack=knee_slack, floor=True).compile()
    place_added_mass(changed, mujoco.MjData(changed), 5)
    built = load_leg_rig_spec(5, knee_slack=knee_slack, floor=True).compile()
    names = ("body_mass", "body_pos", "body_inertia", "body_invweight0", "dof_M0", "geom_size", "geom_rbound")
    for name in names:
        np.testing.assert_allclose(getattr(changed, name), getattr(built, name), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("options", [{"configuration": 3}, {"configuration": 5, "knee_slack": 0.02}])
def test_in_motion_a_wrench_obeys_newton_and_euler(options):
    env = LegRigEnv(speed_deg=60.0, **options)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    strongest = 0.0
    for _ in range(60):
        observation, _, _, _, info = env.step(rng.uniform(-1.0, 1.0, 2))
        truth = info["surefoot"]["truth"]
        for sensor in SENSORS:
            expected = wrench_of_bodies(env.model, env.data, sensor)
            np.testing.assert_allclose(truth[f"wrench_{sensor}"], expected, atol=1e-6)
        strongest = max(strongest, abs(np.linalg.norm(observation[4:7]) - 9.81))
    assert strongest > 0.05


def test_in_motion_the_limbs_mass_moment_and_inertia_explain_the_wrench():
    """w = M (g - a) less the inertia of rotation, with the origin's acceleration from finite differences."""
    model = load_leg_rig_spec(5).compile()
    data = mujoco.MjData(model)

    def pose(time):
        phase = np.array([4.0, 6.0]) * time
        angle = 0.3 * np.sin(phase)
        rate = 0.3 * np.array([4.0, 6.0]) * np.cos(phase)
        return angle, rate, -0.3 * np.array([16.0, 36.0]) * np.sin(phase)

    def frames(time):
        data.qpos[:] = pose(time)[0]
        mujoco.mj_kinematics(model, data)
        return sensor_frames(data)

    time, step = 0.37, 1e-4
    before, now, after = frames(time - step), frames(time), frames(time + step)
    acceleration_world = (before[0] - 2.0 * now[0] + after[0]) / step**2
    spin = (after[1] - before[1]) / (2.0 * step)
    change = (before[1] - 2.0 * now[1] + after[1]) / step**2
    data.qpos[:], data.qvel[:], data.qacc[:] = pose(time)
    mujoco.mj_inverse(model, data)
    wrenches = read_wrenches(data.sensordata)
    load = ADDED_MASSES[5]
    for i, sensor in enumerate(SENSORS):
        R = now[1][i]
        # R' dR/dt = [w]x and R' d2R/dt2 = [alpha]x + [w]x [w]x.
        skew = R.T @ spin[i]
        omega = 0.5 * np.array([skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1]])
        skew = R.T @ change[i]
        alpha = 0.5 * np.array([skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1]])
        limb = limb_beyond(model, data, sensor)
        com = np.array(load.com_foot if sensor == "foot" else load.com_leg)
        mass, mass_com = limb.mass + load.mass, limb.mass_com + load.mass * com
        about_com = load.inertia * np.eye(3)
        inertia = limb.inertia + about_com + load.mass * (com @ com * np.eye(3) - np.outer(com, com))
        wrench = gravity_wrench(mass, mass_com, R.T @ (model.opt.gravity - acceleration_world[i]))
        wrench[:3] -= np.cross(alpha, mass_com) + np.cross(omega, np.cross(omega, mass_com))
        wrench[3:] -= inertia @ alpha + np.cross(omega, inertia @ omega)
        np.testing.assert_allclose(wrenches[i], wrench, atol=2e-4)
        assert np.abs(wrench - gravity_wrench(mass, mass_com, R.T @ model.opt.gravity)).max() > 0.5


def test_the_imu_reads_gravity_and_the_motion_of_its_axes():
    env = LegRigEnv(speed_deg=20.0)
    observation, info = env.reset(seed=1)
    np.testing.assert_allclose(observation[4:7], -info["surefoot"]["truth"]["gravity_foot"], atol=1e-5)
    for _ in range(20):
        observation, _, _, _, info = env.step(np.array([1.0, -0.5]))
    rates, lateral = observation[2:4], observation[1]
    assert (rates * (1.0, -1.0) > 0.05).all()
    # Forward turns about the world's -y, which is the sensors' +y, and outward about the leg's own -x.
    expected = [-rates[1], rates[0] * np.cos(lateral), rates[0] * np.sin(lateral)]
    np.testing.assert_allclose(observation[7:10], expected, atol=1e-5)


def test_a_slack_knee_bends_and_a_held_one_does_not():
    straight, bent = LegRigEnv(configuration=3), LegRigEnv(configuration=3, knee_slack=0.02)
    for env, largest in ((straight, 0.0), (bent, np.inf)):
        _, info = env.reset(seed=0)
        truth = info["surefoot"]["truth"]
        com = truth["mass_com_leg"] + truth["added_mass"] * truth["added_com_leg"]
        mass = truth["mass_leg"] + truth["added_mass"]
        missed = np.abs(gravity_wrench(mass, com, truth["gravity_leg"]) - truth["wrench_leg"]).max()
        assert missed <= largest + 1e-9
        up = [truth[f"gravity_{sensor}"] / np.linalg.norm(truth[f"gravity_{sensor}"]) for sensor in SENSORS]
        apart = np.degrees(np.arccos(np.clip(up[0] @ up[1], -1.0, 1.0)))
        assert (apart > 1.0) == (env is bent)
    assert missed > 0.03


@pytest.mark.parametrize("configuration", [1, 2, 5, 8])
def test_the_floor_is_a_spring_at_the_rear_end(configuration):
    model = load_leg_rig_spec(configuration, floor=True).compile()
    data = mujoco.MjData(model)
    for angle in np.radians([-35.0, -25.0, -16.0, -14.0, 0.0, 35.0]):
        data.qpos[:] = angle, 0.0
        data.qvel[:] = data.qacc[:] = 0.0
        mujoco.mj_inverse(model, data)
        wrench = read_wrenches(data.sensordata)[0]
        R = data.site("foot_ft").xmat.reshape(3, 3)
        push = (R @ wrench[:3])[2] + (0.59 + ADDED_MASSES[configuration].mass) * 9.81
        tip = data.geom("beam_tip").xpos[2] - model.geom("beam_tip").size[0]
        depth = 2.0 * model.geom("floor").size[2] - tip
        assert (depth > 0.0) == (angle < CONTACT_ANGLE)
        assert push == pytest.approx(max(depth, 0.0) * CONTACT_STIFFNESS, rel=0.2, abs=1e-9)


def test_the_floor_can_be_stepped_on():
    env = LegRigEnv(floor=True, speed_deg=10.0)
    env.reset(seed=0)
    touched = []
    for _ in range(120):
        observation, _, _, _, info = env.step(np.array([-1.0, 0.0]))
        truth = info["surefoot"]["truth"]
        weight = gravity_wrench(truth["mass_foot"], truth["mass_com_foot"], truth["gravity_foot"])
        touched.append(np.linalg.norm((truth["wrench_foot"] - weight)[:3]))
    assert observation[0] == pytest.approx(-HIP_RANGE[0] / 2.0, abs=0.005)
    assert touched[0] < 0.2
    assert 2.0 < touched[-1] < 15.0


def test_the_hip_follows_the_commanded_speed_and_stops_gently_at_its_ends():
    env = LegRigEnv(speed_deg=5.0)
    env.reset(seed=3)
    angles, rough = [], []
    for step in range(300):
        observation, *_ = env.step(np.array([1.0, -1.0]))
        angles.append(observation[:2])
        rough.append(abs(np.linalg.norm(observation[4:7]) - 9.81))
        if step == 20:
            np.testing.assert_allclose(observation[2:4], np.radians([5.0, -5.0]), rtol=0.02)
    np.testing.assert_allclose(angles[-1], HIP_RANGE / 2.0 * (1.0, -1.0), atol=0.005)
    assert np.abs(angles).max() < HIP_RANGE[1] / 2.0 + 0.01
    assert max(rough) < 0.2
    assert np.abs(np.diff(angles, axis=0)).max() <= np.radians(5.0) * CONTROL_STEP * 1.1


def test_the_reward_is_the_gain_of_information():
    env = LegRigEnv()
    _, info = env.reset(seed=0)
    rows, rewards = [info["surefoot"]["truth"]["gravity_foot"]], []
    rng = np.random.default_rng(0)
    for _ in range(50):
        _, reward, _, _, info = env.step(rng.uniform(-1.0, 1.0, 2))
        rows.append(info["surefoot"]["truth"]["gravity_foot"])
        rewards.append(reward)
    h = np.column_stack([np.array(rows) / 9.81, np.ones(len(rows))])
    prior = PRIOR_INFORMATION * np.eye(4)
    total = np.linalg.slogdet(prior + h.T @ h)[1] - np.linalg.slogdet(prior + np.outer(h[0], h[0]))[1]
    assert sum(rewards) == pytest.approx(total, rel=1e-9)


def test_exciting_all_directions_pays_best():
    """Standing still pays less than one axis, and one axis less than both."""
    returns = []
    for lateral, forward in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)):
        env = LegRigEnv(speed_deg=10.0)
        env.reset(seed=0)
        total = 0.0
        for step in range(300):
            action = np.array(
                [forward * np.sign(np.sin(step / 40.0)), lateral * np.sign(np.cos(step / 30.0))]
            )
            total += env.step(action)[1]
        returns.append(total)
    assert returns[0] + 2.0 < returns[1]
    assert returns[1] + 2.0 < returns[2]


def test_episodes_are_truncated_and_never_terminated():
    env = gym.make("surefoot/LegRig-v0", max_episode_steps=3)
    env.reset(seed=0)
    ends = [env.step(STILL)[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_a_reset_changes_the_masses_and_same_seeds_give_same_episodes():
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (10, 2))
    env = LegRigEnv()
    first = rollout(env, 2, actions)
    loaded = rollout(env, 2, actions, {"configuration": 6})
    assert env.configuration == 6
    np.testing.assert_array_equal(loaded, rollout(env, 2, actions))
    np.testing.assert_allclose(loaded, rollout(LegRigEnv(configuration=6), 2, actions), rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(first, rollout(env, 2, actions, {"configuration": 1}))
    assert not np.array_equal(first, rollout(env, 3, actions))


def test_the_table_in_the_docstring_is_the_space():
    rows = re.findall(r"\| (\d+)(?:-(\d+))? \| [^|]+ \| (-[\d.]+) \| ([\d.]+) \|", LegRigEnv.__doc__)
    low, high = [], []
    for first, last, least, most in rows:
        number = int(last or first) - int(first) + 1
        low += [float(least)] * number
        high += [float(most)] * number
    space = LegRigEnv().observation_space
    np.testing.assert_array_equal(space.low, low)
    np.testing.assert_array_equal(space.high, high)


test_bad_options_are_refused = refusals(
    lambda options: LegRigEnv(**options),
    ({"configuration": 9}, r"no configuration 9; the paper's data sets are \[1, 2"),
    ({"speed_deg": 0.0}, "'speed_deg' must be finite and positive"),
    ({"knee_slack": -0.1}, "'knee_slack' must be finite and zero or positive"),
    ({"camera": "roof"}, "no camera 'roof'; choose one of .*'side'"),
    ({"render_mode": "ascii"}, "no render mode 'ascii'"),
)


def test_bad_resets_are_refused():
    env = LegRigEnv()
    with pytest.raises(ValueError, match="no configuration 0"):
        env.reset(options={"configuration": 0})
    with pytest.raises(ValueError, match="'configuration' alone, got \\['mass'\\]"):
        env.reset(options={"mass": 1.0})
