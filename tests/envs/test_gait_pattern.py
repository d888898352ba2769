"""Whole patterns: what holds at every tick of every walk."""

import mujoco
import numpy as np
import pytest
from _refusals import refusals

from surefoot.envs.gait.dynamics import joint_torques, motor_targets, multibody_zmp
from surefoot.envs.gait.footsteps import GaitTiming
from surefoot.envs.gait.kinematics import WholeBodyKinematics
from surefoot.envs.gait.pattern import plan_route, plan_walk
from surefoot.envs.gait.route import Leg

WALKS = {
    "slow": (0.02, 0.0),
    "medium": (0.04, 0.0),
    "fast": (0.1, 0.0),
    "backwards": (-0.04, 0.0),
    "on the spot": (0.0, 0.0),
    "arc": (0.04, -0.1),
    "turn in place": (0.0, 0.2),
    "route": None,
}
ROUTE = (Leg(2.4, 0.04, 0.1), Leg(2.8, 0.1, 0.0), Leg(0.5, 0.0, 0.0), Leg(2.8, -0.03, -0.2))
SHOE = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)]) * (0.085, 0.049)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(walk, id=name, marks=pytest.mark.slow if name in ("slow", "backwards", "arc") else ())
        for name, walk in WALKS.items()
    ],
)
def pattern(request):
    if request.param is None:
        return plan_route(ROUTE)
    speed, turn_rate = request.param
    return plan_walk(speed, turn_rate, 6.0)


def soles_of(model, qpos):
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    sites = [data.site(f"{foot}_sole") for foot in ("left", "right")]
    position = np.array([site.xpos for site in sites])
    rotation = np.array([site.xmat.reshape(3, 3) for site in sites])
    return position, rotation, data.subtree_com[1].copy()


def test_the_cop_reference_stays_well_inside_the_support(pattern):
    """It lies 3 cm or more within the convex hull of the standing shoes' corners, from all sides."""
    middle = np.array([(0.02397, 0.00676), (0.02397, -0.00676)])
    c, s = np.cos(pattern.yaw_sole), np.sin(pattern.yaw_sole)
    turn = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)
    corners = pattern.position_sole[:, :, None, :2] + (middle[:, None] + SHOE) @ turn
    angle = np.linspace(0, 2 * np.pi, 36, endpoint=False)
    direction = np.stack([np.cos(angle), np.sin(angle)])
    reach = np.where(pattern.stance[..., None, None], corners @ direction, -np.inf).max(axis=(1, 2))
    assert (reach >= pattern.cop @ direction + 0.03).all()


def test_motion_is_continuous(pattern):
    dt = 1 / 80
    assert np.abs(np.diff(pattern.com, axis=0)).max() < 0.4 * dt
    assert np.abs(np.diff(pattern.com_velocity, axis=0)).max() < 4.0 * dt
    assert np.abs(np.diff(pattern.cop, axis=0)).max() < 0.8 * dt
    assert np.diff(pattern.com, axis=0) / dt == pytest.approx(
        (pattern.com_velocity[1:] + pattern.com_velocity[:-1]) / 2, abs=2e-3
    )
    assert np.diff(pattern.com_velocity, axis=0) / dt == pytest.approx(
        (pattern.com_acceleration[1:] + pattern.com_acceleration[:-1]) / 2, abs=1e-6
    )


def test_feet_lift_only_in_the_air_and_never_slide(pattern):
    height = pattern.position_sole[..., 2]
    assert (height >= 0).all()
    assert (height[~pattern.stance] > 0).all()
    assert (height[pattern.stance] == 0).all()
    assert pattern.stance.any(axis=1).all()
    both = pattern.stance[1:] & pattern.stance[:-1]
    assert (np.diff(pattern.position_sole, axis=0)[both] == 0).all()
    assert (np.diff(pattern.yaw_sole, axis=0)[both] == 0).all()


def test_feet_land_without_velocity(pattern):
    landing = pattern.stance[1:] & ~pattern.stance[:-1]
    assert landing.any()
    velocity = np.diff(pattern.position_sole, axis=0)[landing] * 80
    assert np.abs(velocity).max() < 5e-3


def test_the_posture_puts_everything_where_it_is_planned(pattern, model):
    assert pattern.kinematic_error < 0.5e-3
    for k in range(0, pattern.ticks, 23):
        position, rotation, com = soles_of(model, pattern.qpos[k])
        assert position == pytest.approx(pattern.position_sole[k], abs=2e-5)
        assert com == pytest.approx(pattern.com[k], abs=2e-5)
        assert rotation[:, 2, 2] == pytest.approx(1.0, abs=1e-8)
        yaw = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
        assert np.unwrap(np.stack([pattern.yaw_sole[k], yaw]), axis=0)[1] == pytest.approx(
            pattern.yaw_sole[k], abs=1e-4
        )


def test_joints_keep_their_limits_and_speeds(pattern, model):
    low, high = model.jnt_range[1:].T
    assert (pattern.qpos[:, 7:] >= low).all()
    assert (pattern.qpos[:, 7:] <= high).all()
    speed = np.abs(np.diff(pattern.joint_target, axis=0)) * 80
    assert (speed <= model.actuator_user[:, 0]).all()


def test_one_motor_turns_both_hips(pattern, model):
    left, right = (model.joint(f"{side}HipYawPitch").qposadr[0] for side in "LR")
    assert pattern.qpos[:, left] == pytest.approx(pattern.qpos[:, right], abs=1e-6)
    assert pattern.joint_target[:, 0] == pytest.approx(pattern.qpos[:, left], abs=0.04)


def test_the_whole_body_asks_for_the_referenced_cop(pattern, model):
    error = multibody_zmp(model, pattern.qpos, 1 / 80) - pattern.cop
    assert np.sqrt((error**2).mean(axis=0)).max() < 2.5e-3


def test_the_torso_stays_upright(pattern):
    _, x, y, _ = pattern.qpos[:, 3:7].T
    assert 1 - 2 * (x**2 + y**2) == pytest.approx(1.0, abs=1e-8)


def test_stride_phase_tells_the_feet_apart(pattern):
    assert ((pattern.phase >= 0) & (pattern.phase < 1)).all()
    swinging = ~pattern.stance
    assert (pattern.phase[swinging[:, 0]] < 0.5).all()
    assert (pattern.phase[swinging[:, 1]] >= 0.5).all()


def test_a_walk_goes_as_far_as_its_footsteps():
    pattern = plan_walk(0.1, 0.0, 6.0)
    walked = pattern.com[-1, 0] - pattern.com[0, 0]
    assert walked == pytest.approx(pattern.footsteps[-1].position[0], abs=1e-3)


def test_the_same_arguments_are_planned_once():
    assert plan_walk(0.04, 0.0, 6.0) is plan_walk(0.04, 0.0, 6.0)


def test_a_pattern_cannot_be_changed_by_its_users():
    command = plan_walk(0.04, 0.0, 6.0).command(100)
    with pytest.raises(ValueError, match="read-only"):
        command.joint_target[0] = 1.0


def test_outside_its_time_a_pattern_stands():
    pattern = plan_walk(0.04, 0.0, 6.0)
    assert pattern.command(-5).com == pytest.approx(pattern.com[0])
    assert pattern.command(10**6).com == pytest.approx(pattern.com[-1])
    assert pattern.command(10**6).stance.all()


test_impossible_plans_are_refused = refusals(
    lambda arguments: plan_walk(**arguments),
    ({"duration": -1.0}, "'duration' must be a positive number of seconds, got -1.0"),
    ({"duration": float("nan")}, "'duration' must be a positive number"),
    ({"duration": 2.0}, r"no room for two steps.*walk for at least 3\.9"),
    ({"speed": 0.5}, "walk at most"),
    ({"speed": float("nan")}, "'speed' must be finite"),
)


def test_the_least_duration_named_is_enough():
    timing = GaitTiming(step_time=0.5, stand_time=0.7)
    with pytest.raises(ValueError, match=r"at least (\d+\.\d+) s") as refusal:
        plan_walk(0.0, 0.0, 1.0, timing=timing)
    least = float(str(refusal.value).split("at least ")[1].split(" s")[0])
    assert len(plan_walk(0.0, 0.0, least, timing=timing).footsteps) == 2


def test_a_posture_out_of_reach_is_named(model):
    soles = np.array([[0.3, 0.05, 0.0], [-0.3, -0.05, 0.0]])
    with pytest.raises(ValueError, match="The legs cannot place the soles"):
        WholeBodyKinematics(model).solve(np.array([0.0, 0.0, 0.26]), soles, np.zeros(2))


def test_a_still_body_has_its_zmp_below_its_centre_of_mass(model):
    stand = plan_walk(0.04, 0.0, 6.0)
    qpos = np.tile(stand.qpos[0], (5, 1))
    assert multibody_zmp(model, qpos, 1 / 80) == pytest.approx(np.tile(stand.com[0, :2], (5, 1)), abs=1e-5)


def test_torques_balance_the_floating_torso_and_carry_the_weight(pattern, model):
    """An independent check: the torques, and the feet's wrenches, must satisfy the equations of motion."""
    share = np.where(pattern.stance.all(axis=1)[:, None], 0.5, pattern.stance)
    feet = pattern.position_sole[..., :2]
    torque = joint_torques(model, pattern.qpos, feet, share, 1 / 80)
    assert np.abs(torque[:, :6]).max() < 1e-9
    # Standing still on bent knees, each knee carries its half of what is above it.
    knees = [model.joint(f"{side}KneePitch").dofadr[0] for side in "LR"]
    assert (np.abs(torque[0, knees]) > 0.3).all()
    assert np.abs(torque[:, 6:]).max() < 3.3


def test_motors_lead_by_load_and_lag(model):
    qpos, qvel = np.tile(model.key("stand").qpos, (1, 1)), np.zeros((1, model.nv))
    torque = np.zeros((1, model.nv))
    still = motor_targets(model, qpos, qvel, torque)
    assert still[0] == pytest.approx(model.key("stand").ctrl, abs=1e-12)
    knee = model.joint("LKneePitch").dofadr[0]
    torque[0, knee], qvel[0, knee] = 1.5, -0.6
    lead = (motor_targets(model, qpos, qvel, torque) - still)[0]
    assert lead[3] == pytest.approx((1.5 - 10 * 0.6) / 300)
    assert np.abs(np.delete(lead, 3)).max() == 0
    # One motor carries the loads of both hip-yaw-pitch joints.
    torque[:], qvel[:] = 0.0, 0.0
    for side in "LR":
        torque[0, model.joint(f"{side}HipYawPitch").dofadr[0]] = 0.3
    assert (motor_targets(model, qpos, qvel, torque) - still)[0, 0] == pytest.approx(0.6 / 300)
