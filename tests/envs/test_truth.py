"""The truth agrees with MuJoCo's contact forces and with Newton and Euler."""

from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from surefoot.envs.instrumentation.drawing import draw_nao
from surefoot.envs.instrumentation.truth import FeetTruth
from surefoot.envs.nao.env import SUBSTEPS, NaoEnv
from surefoot.envs.nao.stand import NaoStandEnv
from surefoot.envs.nao.truth import truth_layout
from surefoot.envs.nao.walk import NaoWalkEnv
from surefoot.envs.robots.nao import FEET, load_nao_spec

GRAVITY = 9.81
PLATE_MASS = 0.05


def contact_wrenches(env: NaoEnv) -> np.ndarray:
    """Add up MuJoCo's contacts under each sole: wrenches at and in the sole frames, shape (2, 6)."""
    model, data, truth = env.model, env.data, env.truth
    floor = model.geom("floor").id
    wrench = np.zeros((2, 6))
    local = np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        for foot, name in enumerate(FEET):
            plate = model.geom(f"{name}_plate").id
            if set(contact.geom) != {floor, plate}:
                continue
            mujoco.mj_contactForce(model, data, i, local)
            axes = contact.frame.reshape(3, 3)
            # MuJoCo's contact force acts on the second geom.
            sign = 1.0 if contact.geom[1] == plate else -1.0
            force = sign * axes.T @ local[:3]
            torque = np.cross(contact.pos - truth.position_sole[-1, foot], force)
            torque += sign * axes.T @ local[3:]
            R = truth.R_world_sole[-1, foot]
            wrench[foot] += np.concatenate([R.T @ force, R.T @ torque])
    return wrench


def cop_of_cells(env: NaoEnv) -> np.ndarray:
    """Centres of pressure of the cells in the sole frames, shape (S, 2, 2)."""
    force = env.truth.force_cell.reshape(-1, 2, 4)
    moment = np.einsum("sfc,fci->sfi", force, env.position_cell_sole[..., :2])
    return moment / force.sum(axis=-1)[..., None]


def cop_of_wrench(wrench: np.ndarray) -> np.ndarray:
    load = np.where(wrench[..., 2:3] > 5.0, wrench[..., 2:3], np.nan)
    return np.stack([-wrench[..., 4], wrench[..., 3]], axis=-1) / load


class Moment(NamedTuple):
    """What is known after a step: truth, the contacts' wrenches, the cells' CoP, and whether it is pushed."""

    truth: FeetTruth
    contact: np.ndarray
    cop_cells: np.ndarray
    pushed: bool


@pytest.fixture(scope="module", params=["still", "swaying", "pushed"])
def episode(request) -> list[Moment]:
    """The steps 81 to 280 of a stand."""
    options = {
        "still": {},
        "swaying": {"sway": (0.02, 0.035), "sway_period": 2.0},
        "pushed": {"push_impulse": (0.3, 0.6), "push_interval": 0.5},
    }[request.param]
    env = NaoStandEnv(**options)
    env.reset(seed=3)
    moments = []
    for step in range(280):
        env.step(np.zeros(11))
        if step >= 80:
            pushed = bool(env.data.xfrc_applied.any())
            moments.append(Moment(env.truth, contact_wrenches(env), cop_of_cells(env)[-1], pushed))
    return moments


def test_sole_wrenches_are_the_sum_of_the_contact_forces(episode):
    for moment in episode:
        np.testing.assert_allclose(moment.truth.wrench_sole[-1], moment.contact, atol=1e-9)


def test_cells_agree_with_the_contact_forces_while_in_contact(episode):
    """Within 0.5 % and 0.5 mm wherever a foot bears weight."""
    seen = 0
    for truth, contact, cop_cells, _ in episode:
        bearing = contact[:, 2] > 5.0
        cells = truth.force_cell[-1].reshape(2, 4).sum(axis=-1)
        np.testing.assert_allclose(cells[bearing], contact[bearing, 2], rtol=0.005)
        np.testing.assert_allclose(cop_cells[bearing], cop_of_wrench(contact)[bearing], atol=0.0005)
        seen += int(bearing.sum())
    assert seen > 375


def test_cells_agree_with_the_contact_forces_while_walking():
    """Within 0.5 % and 0.5 mm under a foot that carries; landing and lifting plates add their own inertia."""
    env = NaoWalkEnv(speed=0.1, duration=6.0)
    env.reset(seed=0)
    weight = env.model.body_subtreemass[0] * GRAVITY
    light = 0
    for step in range(480):
        env.step(np.zeros(11))
        if step < 80:
            continue
        contact = contact_wrenches(env)
        cells = env.truth.force_cell[-1].reshape(2, 4).sum(axis=-1)
        carrying, touching = contact[:, 2] > 20.0, contact[:, 2] > 5.0
        np.testing.assert_allclose(cells[carrying], contact[carrying, 2], rtol=0.005)
        np.testing.assert_allclose(
            cop_of_cells(env)[-1][carrying], cop_of_wrench(contact)[carrying], atol=0.0005
        )
        np.testing.assert_allclose(cells[touching], contact[touching, 2], atol=0.005 * weight)
        light += int((touching & ~carrying).sum())
    assert light > 10


def test_a_standing_robot_weighs_what_it_weighs():
    env = NaoStandEnv(joint_noise=0.0, velocity_noise=0.0)
    env.reset(seed=0)
    for _ in range(160):
        env.step(np.zeros(11))
    weight = env.model.body_subtreemass[0] * GRAVITY
    assert env.truth.vgrf().sum() == pytest.approx(weight, rel=1e-3)
    assert env.truth.force_cell[-1].sum() == pytest.approx(weight, rel=1e-3)
    assert (env.truth.force_cell[-1] > 0.0).all()
    np.testing.assert_allclose(env.truth.cop_world(), env.truth.com[-1, :2], atol=0.0005)


def test_what_cells_read_beyond_the_ground_is_the_inertia_of_their_plate():
    """At any time, in the air too: cells = ground + m (g_z - a_z) + m g, along the sole's z."""
    env = NaoStandEnv(push_impulse=(1.0, 1.5), push_interval=0.3)
    rng = np.random.default_rng(0)
    env.reset(seed=1)
    acceleration = np.zeros(6)
    in_air = 0
    for _ in range(200):
        _, _, terminated, _, _ = env.step(rng.uniform(-1.0, 1.0, 11))
        for foot, name in enumerate(FEET):
            plate = env.model.body(f"{name}_plate").id
            kind = mujoco.mjtObj.mjOBJ_BODY
            mujoco.mj_objectAcceleration(env.model, env.data, kind, plate, acceleration, 0)
            # MuJoCo's accelerations hold gravity: a - g.
            proper = env.truth.R_world_sole[-1, foot][:, 2] @ acceleration[3:]
            ground = env.truth.wrench_sole[-1, foot, 2]
            cells = env.truth.force_cell[-1, 4 * foot : 4 * foot + 4].sum()
            assert cells == pytest.approx(ground - PLATE_MASS * proper + PLATE_MASS * GRAVITY, abs=1e-6)
            in_air += ground == 0.0
        if terminated:
            env.reset()
    assert in_air > 10


def test_hanging_feet_read_zero_and_ankle_sensors_carry_them():
    model = load_nao_spec().compile()
    # An immovable torso, of whose inertia the solver must not make its unit of accuracy.
    model.dof_armature[:6] = 1e9
    model.opt.tolerance = 0.0
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[2] = 1.0
    mujoco.mj_step(model, data, 4000)
    truth = FeetTruth(data.sensordata.copy()[None], truth_layout(model, np.ones(8)))
    # The ankles sag by a milliradian, and so the plates' weight by a few millinewtons.
    np.testing.assert_allclose(truth.force_cell, 0.0, atol=0.01)
    np.testing.assert_allclose(truth.force_cell.reshape(2, 4).sum(axis=-1), 0.0, atol=1e-3)
    np.testing.assert_array_equal(truth.wrench_sole, 0.0)
    np.testing.assert_allclose(truth.wrench_ankle[0, :, 2], -0.17184 * GRAVITY, rtol=1e-3)
    assert np.isnan(truth.cop_world()).all()


def test_what_hangs_below_a_sensor_is_the_published_foot_and_the_plate():
    ankle, cells = draw_nao().below_ankle, draw_nao().below_cells
    side = np.array([1.0, -1.0])
    np.testing.assert_allclose(ankle.mass, 0.17184, atol=1e-9)
    np.testing.assert_allclose(ankle.position_sensor_sole, [[0.0, 0.0, 0.04511]] * 2, atol=1e-9)
    np.testing.assert_allclose(ankle.R_sole_sensor, np.tile(np.eye(3), (2, 1, 1)), atol=1e-12)
    # The vendor's centre of mass is about the ankle, 45.11 mm above the sole.
    expected = np.stack([[0.02542] * 2, 0.0033 * side, [0.04511 - 0.03239] * 2], axis=1)
    np.testing.assert_allclose(ankle.com_sole, expected, atol=1e-7)
    np.testing.assert_allclose(cells.mass, PLATE_MASS)
    np.testing.assert_allclose(cells.position_sensor_sole, 0.0, atol=1e-12)
    expected = np.stack([[0.02397] * 2, 0.00676 * side, [0.003] * 2], axis=1)
    np.testing.assert_allclose(cells.com_sole, expected, atol=1e-9)


def test_ankle_wrenches_are_the_grounds_and_the_feets_own_weight_and_inertia():
    """Newton and Euler for the foot about the ankle: ground, and m (g - a) and its moment of each body."""
    env = NaoWalkEnv(speed=0.1, duration=6.0, foot_roll=0.05)
    env.reset(seed=0)
    model, data = env.model, env.data
    below = draw_nao().below_ankle
    acceleration, velocity = np.zeros(6), np.zeros(6)
    largest = 0.0
    for step in range(320):
        env.step(np.zeros(11))
        if step < 80 or step % 3:
            continue
        truth = env.truth
        for foot, name in enumerate(FEET):
            R = truth.R_world_sole[-1, foot] @ below.R_sole_sensor[foot]
            ankle = (
                truth.position_sole[-1, foot]
                + truth.R_world_sole[-1, foot] @ below.position_sensor_sole[foot]
            )
            force = truth.R_world_sole[-1, foot] @ truth.wrench_sole[-1, foot, :3]
            torque = truth.R_world_sole[-1, foot] @ truth.wrench_sole[-1, foot, 3:]
            torque = torque + np.cross(truth.position_sole[-1, foot] - ankle, force)
            carried = force[2]
            for body in (model.body(f"{name[0]}_ankle").id, model.body(f"{name}_plate").id):
                kind = mujoco.mjtObj.mjOBJ_BODY
                # Of the body's centre of mass, in the world's axes; MuJoCo's acceleration is a - g.
                mujoco.mj_objectAcceleration(model, data, kind, body, acceleration, 0)
                mujoco.mj_objectVelocity(model, data, kind, body, velocity, 0)
                spin, turning, proper = velocity[:3], acceleration[:3], acceleration[3:]
                axes = data.ximat[body].reshape(3, 3)
                inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
                push = -model.body_mass[body] * proper
                force = force + push
                torque = torque + np.cross(data.xipos[body] - ankle, push)
                torque = torque - inertia @ turning - np.cross(spin, inertia @ spin)
            expected = np.concatenate([R.T @ force, R.T @ torque])
            np.testing.assert_allclose(truth.wrench_ankle[-1, foot], expected, atol=2e-3)
            largest = max(largest, carried)
    assert largest > 40.0


def test_newton_and_euler_hold_between_substeps(episode):
    """M (c'' + g) = sum of the forces and L' = sum of their moments about the centre of mass (Eqs. 6, 7)."""
    model = load_nao_spec().compile()
    for truth, _, _, pushed in episode[::8]:
        if pushed:
            continue
        force = np.einsum("sfij,sfj->sfi", truth.R_world_sole, truth.wrench_sole[..., :3])
        torque = np.einsum("sfij,sfj->sfi", truth.R_world_sole, truth.wrench_sole[..., 3:])
        arm = truth.position_sole - truth.com[:, None]
        moment = (torque + np.cross(arm, force)).sum(axis=1)
        dt = np.diff(truth.time)[:, None]
        acceleration = np.diff(truth.com_velocity, axis=0) / dt
        mass = model.body_subtreemass[0]
        np.testing.assert_allclose(
            mass * (acceleration - model.opt.gravity), force.sum(axis=1)[:-1], atol=0.02
        )
        np.testing.assert_allclose(np.diff(truth.angular_momentum, axis=0) / dt, moment[:-1], atol=0.02)


def test_rows_are_the_substeps_of_one_control_step():
    env = NaoStandEnv()
    env.reset(seed=0)
    np.testing.assert_array_equal(env.truth.rows, np.tile(env.truth.rows[0], (SUBSTEPS, 1)))
    env.step(np.zeros(11))
    np.testing.assert_allclose(env.truth.time, 0.00125 * np.arange(SUBSTEPS), atol=1e-12)
    first, kept = env.truth, env.truth.rows.copy()
    env.step(np.zeros(11))
    np.testing.assert_allclose(env.truth.time[0], 0.0125, atol=1e-12)
    np.testing.assert_array_equal(first.rows, kept)


def test_truth_reads_the_state_it_names():
    env = NaoStandEnv(sway=(0.02, 0.03), sway_period=1.0)
    env.reset(seed=0)
    for _ in range(100):
        env.step(np.zeros(11))
    mujoco.mj_forward(env.model, env.data)
    model, data = env.model, env.data
    truth = FeetTruth(data.sensordata.copy()[None], env.channels)
    np.testing.assert_allclose(truth.joint_position[0], data.qpos[7:], atol=1e-12)
    torso = model.body("torso").id
    np.testing.assert_allclose(truth.com[0], data.subtree_com[torso], atol=1e-12)
    np.testing.assert_allclose(truth.position_torso[0], data.xpos[torso], atol=1e-12)
    np.testing.assert_allclose(truth.R_world_torso[0], data.xmat[torso].reshape(3, 3), atol=1e-12)
    for foot, name in enumerate(FEET):
        sole = data.site(f"{name}_sole")
        np.testing.assert_allclose(truth.position_sole[0, foot], sole.xpos, atol=1e-12)
        np.testing.assert_allclose(truth.R_world_sole[0, foot], sole.xmat.reshape(3, 3), atol=1e-12)
    np.testing.assert_allclose(truth.accelerometer[0], data.sensor("accelerometer").data)
    np.testing.assert_allclose(truth.gyroscope[0], data.qvel[3:6], atol=1e-12)
    np.testing.assert_array_equal(truth.inertial, np.hstack([truth.accelerometer, truth.gyroscope]))
    assert np.linalg.norm(truth.accelerometer[0]) == pytest.approx(GRAVITY, abs=1.0)


def test_unequal_cells_share_unequally_but_add_up_alike():
    forces = []
    for stiffness in (None, [1.0] * 8):
        env = NaoStandEnv(cell_stiffness=stiffness)
        env.reset(seed=0)
        for _ in range(100):
            env.step(np.zeros(11))
        forces.append(env.truth.force_cell[-1].reshape(2, 4))
    np.testing.assert_allclose(forces[0].sum(axis=-1), forces[1].sum(axis=-1), atol=1e-9)
    warp = np.abs(np.array(forces) @ (1.0, -1.0, -1.0, 1.0))
    assert (warp[0] > 1.0).all()
    np.testing.assert_allclose(warp[1], 0.0, atol=1e-9)
