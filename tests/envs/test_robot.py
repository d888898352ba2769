"""The robot is the one that the vendor describes."""

import mujoco
import numpy as np
import pytest

from surefoot.envs.robots.nao import (
    CELLS,
    FEET,
    LEG_MOTORS,
    cell_positions,
    hinge_joint_names,
    load_nao_spec,
    motor_names,
    motor_of_joint,
    place_on_ground,
)

# Mass in kg, centre of mass in m and inertia about it in kg m^2 (xx, yy, zz, xy, xz, yz): the URDF's tables.
LINKS = {
    "torso": (
        1.04956,
        (-0.00413, 0.0, 0.04342),
        (0.00308361, 0.0028835, 0.0015924, 1.43116e-05, -3.30211e-05, -2.70793e-05),
    ),
    "LThigh": (
        0.38968,
        (0.00138, 0.00221, -0.05373),
        (0.000509844, 0.000465358, 0.000301098, 2.11296e-06, 5.64129e-05, -7.91029e-06),
    ),
    "RTibia": (
        0.30142,
        (0.00453, -0.00225, -0.04936),
        (0.000446921, 0.000387711, 0.000183741, -3.96872e-06, -3.94009e-05, -5.00034e-06),
    ),
    "l_ankle": (
        0.17184,
        (0.02542, 0.0033, -0.03239),
        (8.72911e-05, 0.000353024, 0.000412846, 8.71925e-06, -2.10563e-06, 3.73459e-07),
    ),
    "r_ankle": (
        0.17184,
        (0.02542, -0.0033, -0.03239),
        (8.71513e-05, 0.000352156, 0.000412125, -8.53992e-06, -2.35184e-06, -4.81708e-07),
    ),
}

# Angles in rad, torque in N m and speed in rad/s: the URDF's limits.
JOINTS = {
    "LHipYawPitch": (-1.14529, 0.740718, 3.348, 4.16174),
    "RHipRoll": (-0.79046, 0.379435, 3.348, 4.16174),
    "LKneePitch": (-0.0923279, 2.11255, 3.023, 6.40239),
    "RAnklePitch": (-1.1863, 0.932006, 3.0226, 6.40239),
    "LAnkleRoll": (-0.397761, 0.768992, 3.348, 4.16174),
    "HeadPitch": (-0.671952, 0.514872, 1.532, 7.19407),
    "RWristYaw": (-1.82387, 1.82387, 0.4075, 24.6229),
}


def inertia_about(point, model, data, body):
    """Inertia of one body about a point of the world, in the world's axes."""
    rotation = data.ximat[body].reshape(3, 3)
    arm = data.xipos[body] - point
    own = rotation @ np.diag(model.body_inertia[body]) @ rotation.T
    return own + model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def test_the_whole_robot_has_the_published_mass_and_centre_of_mass(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    torso = model.body("torso").id
    assert model.body_subtreemass[torso] == pytest.approx(5.30535, abs=1e-9)
    np.testing.assert_allclose(
        data.subtree_com[torso] - data.xpos[torso], [0.02118, 0.0, -0.03555], atol=1e-5
    )
    assert data.subtree_com[torso][2] - data.site("left_sole").xpos[2] == pytest.approx(0.2975, abs=1e-4)


@pytest.mark.parametrize("name", LINKS)
def test_links_have_the_published_inertia_with_the_sole_plates_counted_in(model, name):
    mass, com, (xx, yy, zz, xy, xz, yz) = LINKS[name]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    bodies = [model.body(name).id]
    if name.endswith("_ankle"):
        bodies.append(model.body("left_plate" if name.startswith("l") else "right_plate").id)
    masses = model.body_mass[bodies]
    centre = masses @ data.xipos[bodies] / masses.sum()
    assert masses.sum() == pytest.approx(mass, abs=1e-9)
    np.testing.assert_allclose(centre - data.xpos[bodies[0]], com, atol=1e-7)
    inertia = sum(inertia_about(centre, model, data, body) for body in bodies)
    np.testing.assert_allclose(inertia, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], atol=2e-9)


def test_every_inertia_is_one_that_a_body_can_have(model):
    inertia = np.sort(model.body_inertia[1:], axis=1)
    assert (inertia[:, 0] > 0.0).all()
    assert (inertia[:, 0] + inertia[:, 1] >= inertia[:, 2]).all()


@pytest.mark.parametrize("name", JOINTS)
def test_joints_keep_the_published_limits(model, name):
    low, high, torque, speed = JOINTS[name]
    np.testing.assert_allclose(model.joint(name).range, [low, high], atol=1e-6)
    np.testing.assert_allclose(model.actuator(name).ctrlrange, [low, high], atol=1e-6)
    np.testing.assert_allclose(model.actuator(name).forcerange, [-torque, torque], atol=1e-6)
    assert model.actuator(name).user[0] == pytest.approx(speed, abs=1e-5)


def test_motors_of_an_action_come_first_and_every_joint_has_a_motor(model):
    joints, motors = hinge_joint_names(model), motor_names(model)
    assert motors[: len(LEG_MOTORS)] == LEG_MOTORS
    assert (len(joints), len(motors)) == (24, 23)
    for joint, motor in zip(joints, motor_of_joint(model), strict=True):
        assert motors[motor] == ("LHipYawPitch" if joint == "RHipYawPitch" else joint)


def test_one_motor_turns_both_hip_yaw_pitch_joints(model):
    data = mujoco.MjData(model)
    model.opt.gravity[:] = 0.0
    data.qpos[2] = 1.0
    data.ctrl[model.actuator("LHipYawPitch").id] = -0.3
    data.xfrc_applied[model.body("LTibia").id] = (0.0, 0.0, 0.0, 0.0, 0.3, 0.0)
    mujoco.mj_step(model, data, 800)
    model.opt.gravity[2] = -9.81
    left, right = data.joint("LHipYawPitch").qpos[0], data.joint("RHipYawPitch").qpos[0]
    assert left == pytest.approx(right, abs=1e-3)
    assert 0.5 * (left + right) == pytest.approx(-0.3, abs=2e-3)


def test_cells_lie_at_the_corners_of_the_shoe_and_the_sole_below_the_ankle(model):
    corner = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)]) * (0.085, 0.049)
    expected = corner + np.array([[[0.02397, 0.00676]], [[0.02397, -0.00676]]])
    cells = cell_positions(model)
    np.testing.assert_allclose(cells[..., :2], expected, atol=1e-9)
    np.testing.assert_allclose(cells[..., 2], 0.0, atol=1e-9)
    for foot in FEET:
        np.testing.assert_allclose(model.site(f"{foot}_sole").pos, [0.0, 0.0, -0.04511], atol=1e-9)


def test_each_specification_is_fresh():
    load_nao_spec().body("torso").mass = 2.0
    assert load_nao_spec().body("torso").mass == pytest.approx(1.04956)


@pytest.mark.parametrize("yaw", [(0.0, 0.0), (0.4, 0.4), (3.1, 3.1), (-2.0, -2.0)])
def test_the_robot_is_placed_onto_its_footprints(model, yaw):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    heading = yaw[0]
    across = 0.05 * np.array([-np.sin(heading), np.cos(heading), 0.0])
    footprints = np.array([0.7, -0.3, 0.0]) + np.array([across, -across])
    place_on_ground(model, data, footprints, np.array(yaw))
    soles = np.array([data.site(f"{foot}_sole").xpos for foot in FEET])
    np.testing.assert_allclose(soles, footprints, atol=1e-6)
    ahead = data.site("left_sole").xmat.reshape(3, 3)[:, 0]
    np.testing.assert_allclose(ahead, [np.cos(heading), np.sin(heading), 0.0], atol=1e-6)
    lowest = min(data.site(f"{foot}_cell_{cell}").xpos[2] for foot in FEET for cell in CELLS)
    assert lowest == pytest.approx(0.0, abs=1e-12)
