"""Feet in the air, and feet that roll: what the pattern plans and what the ground feels."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surefoot.envs.gait.pattern import plan_walk
from surefoot.envs.gait.swing import LIFT_HEIGHT, TOE_AND_HEEL, lift, minimum_jerk, pivot_of, roll_of_step
from surefoot.envs.nao.walk import NaoWalkEnv
from surefoot.envs.robots.nao import FEET, cell_positions

ANGLE = 0.08


@pytest.fixture(scope="module")
def pattern():
    return plan_walk(0.04, 0.0, 8.0, foot_roll=ANGLE)


@given(st.floats(-1.0, 2.0))
def test_the_foot_is_never_below_the_ground_nor_above_its_height(phase):
    assert 0.0 <= lift(phase) <= LIFT_HEIGHT + 1e-12


@given(st.floats(0.0, 1.0))
def test_the_way_is_symmetric(phase):
    assert minimum_jerk(phase) + minimum_jerk(1.0 - phase) == pytest.approx(1.0, abs=1e-12)
    assert lift(phase) == pytest.approx(lift(1.0 - phase), abs=1e-12)


def test_it_leaves_and_lands_without_velocity_or_acceleration():
    h = 1e-4
    for way in (minimum_jerk, lambda s: lift(s) / LIFT_HEIGHT):
        for end, inward in ((0.0, h), (1.0, -h)):
            gone = way(end + inward) - way(end)
            assert abs(gone / h) < 1e-6
            assert abs(way(end + 2 * inward) - 2 * way(end + inward) + way(end)) / h**2 < 0.1


def test_the_way_only_goes_forward():
    assert (np.diff(minimum_jerk(np.linspace(0, 1, 200))) > 0).all()


def test_half_way_is_the_top():
    assert lift(0.5) == pytest.approx(LIFT_HEIGHT)
    assert minimum_jerk(0.5) == pytest.approx(0.5)


def corners(pattern):
    """Front and rear edges of the planned soles in the world: x along the walk and z, shape (ticks, 2, 2)."""
    cos, sin = np.cos(pattern.pitch_sole), np.sin(pattern.pitch_sole)
    x = np.stack([pattern.position_sole[..., 0] + edge * cos for edge in TOE_AND_HEEL], axis=-1)
    z = np.stack([pattern.position_sole[..., 2] - edge * sin for edge in TOE_AND_HEEL], axis=-1)
    return x, z


def test_the_edges_are_those_of_the_cells_rectangle(model):
    expected = np.repeat(TOE_AND_HEEL, 2)
    np.testing.assert_allclose(cell_positions(model)[..., 0], [expected, expected], atol=1e-9)


def test_a_foot_leaves_its_toe_last_and_lands_on_its_heel(pattern):
    for foot in range(2):
        stance = pattern.stance[:, foot]
        leaves = np.flatnonzero(stance[:-1] & ~stance[1:])
        lands = np.flatnonzero(~stance[:-1] & stance[1:]) + 1
        assert len(leaves) >= 2
        np.testing.assert_allclose(pattern.pitch_sole[leaves, foot], ANGLE, atol=1e-12)
        np.testing.assert_allclose(pattern.pitch_sole[lands, foot], -ANGLE, atol=1e-12)


def test_the_edge_that_stays_down_neither_lifts_nor_slides(pattern):
    x, z = corners(pattern)
    # An edge is on the ground or, in the air, above it.
    np.testing.assert_allclose(z.min(axis=-1)[pattern.stance], 0.0, atol=1e-12)
    assert (z[~pattern.stance] > 0.0).all()
    for edge, rolling in enumerate((pattern.pitch_sole > 0, pattern.pitch_sole < 0)):
        still = pattern.stance & rolling
        assert still.any(axis=0).all()
        together = still[1:] & still[:-1]
        np.testing.assert_allclose(np.diff(x[..., edge], axis=0)[together], 0.0, atol=1e-12)


def test_a_foot_that_carries_alone_is_flat(pattern):
    alone = ~pattern.stance.all(axis=1)
    assert (pattern.pitch_sole[alone][pattern.stance[alone]] == 0.0).all()
    assert np.abs(np.diff(pattern.pitch_sole, axis=0)).max() < 0.02


def test_the_posture_has_the_planned_pitch(pattern, model):
    data = mujoco.MjData(model)
    assert pattern.kinematic_error < 0.5e-3
    for k in range(80, pattern.ticks, 7):
        data.qpos[:] = pattern.qpos[k]
        mujoco.mj_kinematics(model, data)
        for foot, name in enumerate(FEET):
            sole = data.site(f"{name}_sole")
            axes = sole.xmat.reshape(3, 3)
            np.testing.assert_allclose(sole.xpos, pattern.position_sole[k, foot], atol=2e-5)
            # Toe down: the sole's x-axis points below the horizon.
            assert np.arcsin(-axes[2, 0]) == pytest.approx(pattern.pitch_sole[k, foot], abs=1e-5)
            assert axes[2, 1] == pytest.approx(0.0, abs=1e-5)


def test_a_step_backwards_leaves_its_heel_last():
    backwards = plan_walk(-0.04, 0.0, 6.0, foot_roll=ANGLE)
    stance = backwards.stance[:, 0]
    leaves = np.flatnonzero(stance[:-1] & ~stance[1:])
    np.testing.assert_allclose(backwards.pitch_sole[leaves, 0], -ANGLE, atol=1e-12)


def test_a_roll_starts_and_ends_at_rest():
    roll = np.concatenate([np.zeros(2), *roll_of_step(0.1, 26, 38), np.zeros(2)])
    assert np.abs(np.diff(roll)).max() < 0.03
    assert roll[:2].tolist() == roll[-2:].tolist() == [0.0, 0.0]
    assert roll.max() == pytest.approx(0.1)
    assert roll.min() == pytest.approx(-0.1)


@pytest.mark.parametrize("pitch", [0.1, -0.1, 0.0])
def test_pivoting_keeps_the_edge_in_its_place(pitch):
    forward, up = pivot_of(pitch)
    edge = TOE_AND_HEEL[0] if pitch > 0 else TOE_AND_HEEL[1]
    assert forward + edge * np.cos(pitch) == pytest.approx(edge)
    assert up - edge * np.sin(pitch) == pytest.approx(0.0)


def test_the_ground_feels_the_heel_first_and_the_toe_last():
    """Where a foot that has just landed, and one that is about to leave, is pressed."""
    env = NaoWalkEnv(speed=0.04, duration=8.0, foot_roll=ANGLE, push_impulse=(0.0, 0.0))
    env.reset(seed=0)
    light = {"landing": [], "leaving": []}
    for tick in range(640):
        _, _, terminated, _, _ = env.step(np.zeros(11, dtype=np.float32))
        assert not terminated
        wrench, pitch = (
            env.truth.wrench_sole[-1],
            env.pattern.pitch_sole[min(tick + 1, env.pattern.ticks - 1)],
        )
        for foot in np.flatnonzero((wrench[:, 2] > 3.0) & (np.abs(pitch) > 0.2 * ANGLE)):
            light["leaving" if pitch[foot] > 0.0 else "landing"].append(-wrench[foot, 4] / wrench[foot, 2])
    for part, edge in zip(("leaving", "landing"), TOE_AND_HEEL, strict=True):
        assert len(light[part]) > 8
        np.testing.assert_allclose(np.median(light[part]), edge, atol=2e-3)


@pytest.mark.parametrize("roll", [-0.05, 0.5, float("nan"), "a little"])
def test_impossible_rolls_are_refused(roll):
    with pytest.raises(ValueError, match=r"'foot_roll' is a pitch between 0 .* and 0.2 rad, got"):
        NaoWalkEnv(foot_roll=roll)
