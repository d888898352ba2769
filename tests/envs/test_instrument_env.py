"""Sensors around any MuJoCo environment: its episodes stay what they are, and the truth is beside them."""

import pickle
from contextlib import nullcontext
from copy import deepcopy

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from _toy import Toy, warned
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import data_equivalence

from surefoot.envs import FeetTruth, InstrumentedEnv, instrument, load_robot_spec


def change(env):
    """Change a robot's numbers as an environment may do on its compiled model."""
    model = env.unwrapped.model
    model.body_mass[2:] *= 1.3
    model.geom_friction[:, 0] = 0.4
    model.dof_damping[:] *= 0.7
    model.actuator_gear[0, 0] *= 1.1
    model.opt.gravity[2] = -8.0
    model.opt.iterations = 30
    model.stat.meaninertia *= 1.01


@pytest.mark.parametrize(
    ("in_place", "changed"),
    [(None, False), (None, True), (False, False)],
    ids=["sensors", "changed model", "beside"],
)
@pytest.mark.parametrize("name", ["Humanoid-v5", "Walker2d-v5"])
def test_an_environments_episodes_stay_bit_for_bit_what_they_are(name, in_place, changed):
    bare, base = gym.make(name), gym.make(name)
    if changed:
        change(bare)
        change(base)
    env = InstrumentedEnv(base, in_place=in_place)
    assert bool(env.untouched) == (in_place is False)
    rng = np.random.default_rng(7)
    seed, resets = 3, 0
    for _ in range(200):
        if seed is not None:
            ours, _ = bare.reset(seed=seed if resets == 0 else None)
            theirs, info = env.reset(seed=seed if resets == 0 else None)
            np.testing.assert_array_equal(ours, theirs)
            assert info["surefoot"]["truth"]["vgrf"].shape == (2,)
            seed, resets = None, resets + 1
        action = rng.uniform(-0.4, 0.4, env.action_space.shape).astype(np.float32)
        ours, theirs = bare.step(action), env.step(action)
        np.testing.assert_array_equal(ours[0], theirs[0])
        assert ours[1:4] == theirs[1:4]
        assert {**ours[4], "surefoot": 0}.keys() == theirs[4].keys()
        if ours[2] or ours[3]:
            seed = 0
    assert resets > 2


def test_an_episode_that_is_wrapped_on_its_way_goes_on():
    bare, base = gym.make("Humanoid-v5"), gym.make("Humanoid-v5")
    for env in (bare, base):
        env.reset(seed=1)
        env.step(np.zeros(17))
    env = InstrumentedEnv(base)
    for _ in range(5):
        ours, theirs = bare.step(np.full(17, 0.1)), env.step(np.full(17, 0.1))
        np.testing.assert_array_equal(ours[0], theirs[0])
        assert ours[1] == theirs[1]


@pytest.mark.parametrize("in_place", [None, False])
def test_truth_is_of_the_instant_that_is_documented(in_place):
    env = InstrumentedEnv(gym.make("Walker2d-v5"), in_place=in_place)
    env.reset(seed=0)
    instrumentation = instrument(load_robot_spec("walker2d"))
    model = instrumentation.spec.compile()
    data = mujoco.MjData(model)
    for step in range(60):
        at_start = env.truth
        assert env.truth.time[-1] == pytest.approx(env.data.time - (step > 0 and in_place is None) * 0.002)
        for joint, angle in zip(env.joint_names, env.truth.joint_position[-1], strict=True):
            assert angle == env.data.joint(joint).qpos[0]
        data.qpos[:], data.qvel[:], data.ctrl[:] = env.data.qpos, env.data.qvel, 0.5
        data.qacc_warmstart[:] = env.data.qacc_warmstart
        data.time = env.data.time
        mujoco.mj_step(model, data, env.unwrapped.frame_skip)
        if in_place is False:
            mujoco.mj_forward(model, data)
        env.step(np.full(6, 0.5))
        expected = instrumentation.read(model, data)
        np.testing.assert_allclose(env.truth.wrench_sole[-1], expected.wrench_sole, rtol=1e-9, atol=1e-7)
        inertial = np.hstack([env.truth.accelerometer, env.truth.gyroscope])
        np.testing.assert_array_equal(env.truth.inertial, inertial)
        assert env.truth is not at_start
    assert env.truth.wrench_sole.shape == (4 if in_place is None else 1, 2, 6)
    assert expected.vgrf().max() > 10.0
    assert env.dt == pytest.approx(0.008)
    assert env.joint_names == env.drawing.joint_names
    assert (env.model, env.data) == (env.unwrapped.model, env.unwrapped.data)
    renderer = env.unwrapped.mujoco_renderer
    assert (renderer.model, renderer.data) == (env.model, env.data)


def test_info_has_the_truth_as_a_dict_of_its_own(path):
    env = InstrumentedEnv(Toy(fullpath=path))
    assert not env.untouched
    env.reset()
    for _ in range(200):
        info = env.step(None)[4]
    given = info["surefoot"]["truth"]
    assert set(given) == {
        *("force_cell", "vgrf", "cop", "cop_world", "cop_foot", "cop_valid", "com"),
        *("wrench_sole", "wrench_ankle"),
    }
    assert given["cop_valid"].all()
    weight = 9.81 * env.model.body_subtreemass[0]
    assert given["vgrf"].sum() == pytest.approx(weight, rel=1e-3)
    np.testing.assert_allclose(given["force_cell"], env.truth.force_cell.mean(axis=0))
    mean = env.truth.wrench_sole.mean(axis=0)
    np.testing.assert_allclose(given["cop_foot"], np.stack([-mean[:, 4], mean[:, 3]], axis=1) / mean[:, 2:3])
    np.testing.assert_allclose(given["cop_world"], env.truth.cop_world(), atol=1e-5)
    kept = deepcopy(given)
    env.step(None)
    assert data_equivalence(given, kept, exact=True)
    assert not data_equivalence(given, env.reset()[1]["surefoot"]["truth"])


@pytest.mark.parametrize(
    ("keep", "reason"),
    [
        (lambda env: setattr(env, "angles", env.data.qpos[7:]), "Toy.angles holds a view of it"),
        (lambda env: setattr(env, "robot", [{"trunk": env.data.body("trunk")}]), "Toy.robot holds a view"),
        (lambda env: setattr(env, "sim", (env.model, 3)), "Toy.sim holds a view"),
        (lambda env: None, ""),
    ],
    ids=["array", "body", "model", "nothing"],
)
def test_a_model_that_an_environment_holds_on_to_is_left_alone(path, keep, reason):
    base = Toy(fullpath=path)
    keep(base)
    model = base.model
    with warned(reason):
        env = InstrumentedEnv(base)
    assert bool(env.untouched) == bool(reason) == (base.model is model)
    env.reset()
    env.step(None)
    assert env.truth.vgrf().sum() > 10.0
    if reason:
        with pytest.raises(ValueError, match=f"cannot be replaced: {reason}"):
            InstrumentedEnv(base, in_place=True)
    assert env.untouched.startswith(reason)


IMU = '<site name="imu"/>', '<sensor><gyro site="imu"/></sensor>'


class Showing(Toy):
    """Shows more than its posture after a step, as a subclass chooses."""

    def step(self, action):
        posture, *rest = super().step(action)
        return np.concatenate([posture, self.shown()]), *rest


class AllSensors(Showing):
    def shown(self):
        return self.data.sensordata


class OwnSensor(Showing):
    def shown(self):
        return self.data.sensor(0).data


class SiteByNumber(Showing):
    """Keeps the number of a site that stands behind those that are added to the feet."""

    def shown(self):
        return self.data.site_xpos[0]


class NotComputed(Showing):
    """Shows what MuJoCo computes for some sensors alone."""

    def shown(self):
        return self.data.subtree_linvel[0]


class Chance(Showing):
    count = 0

    def shown(self):
        Chance.count += 1
        return [float(Chance.count)]


class Broken(Toy):
    def reset(self, *, seed=None, options=None):
        if seed is not None:
            raise RuntimeError("no seeds here")
        return super().reset()


def with_site_behind(kind, path):
    """Give a toy a site on a body behind its feet."""
    base = kind(fullpath=path)
    base.xml = base.xml.replace("</worldbody>", '<body name="box"><site name="mark"/></body></worldbody>')
    base.make()
    path.write_text(base.xml)
    return base


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda path: Toy(*IMU, path), ""),
        (lambda path: OwnSensor(*IMU, path), ""),
        (lambda path: AllSensors(*IMU, path), "with sensors in its model its observation differs"),
        (lambda path: with_site_behind(SiteByNumber, path), "with sensors in its model its observation diff"),
        (lambda path: NotComputed(fullpath=path), "with sensors in its model its observation differs"),
        (lambda path: Chance(fullpath=path), "it is not the same twice"),
        (
            lambda path: Broken(fullpath=path),
            "a copy of it could not be stepped (RuntimeError: no seeds here)",
        ),
    ],
    ids=["own sensor unseen", "own sensor shown", "all sensors", "site", "not computed", "chance", "broken"],
)
def test_whether_an_environment_would_notice_is_tried(path, make, reason):
    base = make(path)
    with warned(reason):
        env = InstrumentedEnv(base)
    assert env.untouched.startswith(reason)
    assert bool(env.untouched) == bool(reason) == env.seldom
    env.reset()
    env.step(None)
    assert env.truth.rows.shape[0] == (1 if reason else 5)
    if not isinstance(base, Broken):
        assert not InstrumentedEnv(make(path), in_place=True).untouched


def test_a_trial_leaves_no_trace(path):
    class Drawing(Toy):
        drawn = 0

        def step(self, action):
            type(self).drawn += 1  # copies share their class
            return super().step(action)

    base, state = Drawing(fullpath=path), np.random.get_state()[1].copy()  # noqa: NPY002
    base.reset(seed=3)
    before = base.np_random.bit_generator.state
    mujoco.mj_step(base.model, base.data, 7)
    qpos, time = base.data.qpos.copy(), base.data.time
    env = InstrumentedEnv(base)
    assert Drawing.drawn > 0
    np.testing.assert_array_equal(env.data.qpos, qpos)
    assert env.data.time == time
    assert base.np_random.bit_generator.state == before
    np.testing.assert_array_equal(np.random.get_state()[1], state)  # noqa: NPY002


def test_every_substep_is_read_and_their_mean_told(path):
    env = InstrumentedEnv(Toy(*IMU, path))
    env.reset()
    own = mujoco.MjData(env.model)
    columns = env.instrumentation.columns(env.model)
    own.qpos[:] = env.data.qpos
    for _ in range(60):
        info = env.step(None)[4]
        expected = []
        for _ in range(5):
            mujoco.mj_step(env.model, own)
            expected.append(own.sensordata[columns].copy())
        rows = env.truth.rows
        forces = slice(0, 54)
        np.testing.assert_array_equal(rows[:, forces], np.array(expected)[:, forces])
        np.testing.assert_array_equal(env.truth.time, np.array(expected)[:, -1])
        vertical = -np.array(expected)[:, [8, 35]]
        np.testing.assert_allclose(info["surefoot"]["truth"]["vgrf"], vertical.mean(axis=0), atol=1e-9)
        np.testing.assert_allclose(env.truth.gyroscope[-1], env.data.qvel[3:6], rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("substeps", [2, 5, 8])
def test_a_step_of_another_length_is_read_as_far_as_it_is_known(path, substeps):
    base = Toy(fullpath=path)
    env = InstrumentedEnv(base)
    env.reset()
    env.step(None)
    before, base.frame_skip = env.data.time, substeps
    more = r"took 8 physics steps, and 5 were expected: the truth covers the last of them only"
    with pytest.warns(UserWarning, match=more) if substeps > 5 else nullcontext():
        env.step(None)
    times = env.truth.time
    assert len(times) == 5
    assert times[-1] == pytest.approx(env.data.time - 0.002)
    assert times[0] == pytest.approx(max(before, env.data.time - 5 * 0.002))
    mujoco.mj_resetData(env.model, env.data)
    env.step(None)
    assert env.truth.time[0] == pytest.approx(max(0.0, (substeps - 5) * 0.002))


def test_without_a_description_the_model_is_read_from_beside(path):
    with warned("there is no description of it"):
        env = InstrumentedEnv(Toy())
    assert env.untouched.startswith("there is no description of it")
    assert env.instrumentation is None
    beside = Toy()
    given = InstrumentedEnv(beside, spec=mujoco.MjSpec.from_string(beside.xml))
    assert not given.untouched
    assert given.drawing.xml == env.drawing.xml
    for option in ("soles", "in_place"):
        with pytest.raises(ValueError, match=f"'{option}' changes the model, for which its description"):
            InstrumentedEnv(Toy(), **{option: True})
    with pytest.raises(ValueError, match="'soles' changes the model: leave 'in_place' alone"):
        InstrumentedEnv(Toy(fullpath=path), soles=True, in_place=False)
    with pytest.raises(ValueError, match=r"not that of the environment's robot: its bodies are"):
        InstrumentedEnv(Toy(), spec=load_robot_spec("humanoid"))
    other = mujoco.MjSpec.from_string(beside.xml)
    other.body("foot_l").geoms[0].type = mujoco.mjtGeom.mjGEOM_CAPSULE
    with pytest.raises(ValueError, match=r"its geom_type is \[0, 2, 3, 6\], the environment's"):
        InstrumentedEnv(Toy(), spec=other)
    # A file that the environment changed before it compiled is no reason to refuse.
    base = Toy(fullpath=path)
    path.write_text(base.xml.replace("foot_l", "paw_l"))
    with warned("its file is of another robot"):
        assert InstrumentedEnv(base).untouched.startswith("its file is of another robot: its bodies are")


def test_soles_give_round_feet_an_area():
    env = InstrumentedEnv(gym.make("Humanoid-v5", terminate_when_unhealthy=False), soles=True)
    assert env.drawing.flaw == ""
    env.reset(seed=0)
    for _ in range(150):
        info = env.step(np.zeros(17))[4]
        if env.truth.vgrf().min() > 50.0:
            break
    given = info["surefoot"]["truth"]
    assert given["force_cell"].reshape(2, 4).sum(axis=1) == pytest.approx(given["wrench_sole"][:, 2])
    bare = gym.make("Humanoid-v5").unwrapped.model
    np.testing.assert_array_equal(env.model.body_mass, bare.body_mass)
    box = env.model.geom("surefoot/left_foot_sole")
    up = np.zeros(3)
    mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), box.quat)
    top = box.pos + box.size[2] * up
    sphere = bare.geom("left_foot")
    np.testing.assert_allclose((sphere.pos - top) @ up, sphere.size[0], atol=1e-9)
    own = InstrumentedEnv(gym.make("Humanoid-v5"), soles={"left_foot": (0.25, 0.1, 0.02)})
    np.testing.assert_allclose(own.model.geom("surefoot/left_foot_sole").size, (0.125, 0.05, 0.01))
    assert own.drawing.position_cell_sole is None
    assert "force_cell" not in own.reset(seed=0)[1]["surefoot"]["truth"]
    for soles, match in (
        ({"hand": (0.2, 0.1, 0.01)}, r"\['hand'\], which are no feet here; the feet are \['left_foot', 'ri"),
        ({"left_foot": (0.2, -0.1, 0.01)}, r"'left_foot' needs a positive \(length, width, thickness\)"),
    ):
        with pytest.raises(ValueError, match=match):
            InstrumentedEnv(gym.make("Humanoid-v5"), soles=soles)


def test_a_wrapped_environment_is_made_again_from_its_spec():
    cells = {"left_foot": np.array([(0.1, 0.03), (0.1, -0.03), (-0.05, 0.03), (-0.05, -0.03)])}
    soles = {"left_foot": (0.25, 0.1, 0.01), "right_foot": (0.25, 0.1, 0.01)}
    env = InstrumentedEnv(gym.make("Humanoid-v5"), ("left_foot", "right_foot"), cells=cells, soles=soles)
    for spec in (pickle.loads(pickle.dumps(env.spec)), EnvSpec.from_json(env.spec.to_json())):
        again = gym.make(spec)
        np.testing.assert_array_equal(
            again.get_wrapper_attr("drawing").position_cell_sole, env.drawing.position_cell_sole
        )
        np.testing.assert_array_equal(again.reset(seed=4)[0], env.reset(seed=4)[0])


def test_a_single_row_reads_as_many_do():
    env = InstrumentedEnv(gym.make("Walker2d-v5"))
    env.reset(seed=0)
    rows = []
    for _ in range(40):
        env.step(np.zeros(6))
        rows.append(env.truth)
    batch = FeetTruth(np.concatenate([truth.rows for truth in rows]), env.truth.layout)
    single = np.concatenate([truth.wrench_sole for truth in rows])
    assert np.abs(single).max() > 10.0
    np.testing.assert_allclose(batch.wrench_sole, single, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("integrator", ["EULER", "RK4", "IMPLICIT", "IMPLICITFAST"])
@pytest.mark.parametrize("in_place", [None, False])
def test_the_imu_measures_the_motion_that_the_integrator_makes(integrator, in_place):
    base = gym.make("Humanoid-v5")
    base.unwrapped.model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    base.unwrapped.model.dof_damping[6:] *= 1.0 if integrator == "RK4" else 30.0  # RK4 is explicit
    env = InstrumentedEnv(base, in_place=in_place)
    env.reset(seed=5)
    rng = np.random.default_rng(5)
    model, data, own = env.model, env.data, mujoco.MjData(env.model)
    gravity, h, off = model.opt.gravity, model.opt.timestep, []
    for _ in range(30):
        start, expected = data.qvel[:3].copy(), []
        env.step(rng.uniform(-0.4, 0.4, 17).astype(np.float32))
        if in_place is False:  # what the coming substep will do
            own.qpos[:], own.qvel[:], own.ctrl[:] = data.qpos, data.qvel, data.ctrl
            own.qacc_warmstart[:] = data.qacc_warmstart
            mujoco.mj_step(model, own)
            expected = (own.qvel[:3] - data.qvel[:3]) / h - gravity
        else:
            expected = (data.qvel[:3] - start) / env.dt - gravity
        R = env.truth.R_world_torso
        felt = (R @ env.truth.accelerometer[:, :, None])[:, :, 0].mean(axis=0)
        off.append(np.linalg.norm(felt - expected) / np.linalg.norm(expected))
    # The rest is that the torso turns within a control step.
    assert np.median(off) < 0.01
