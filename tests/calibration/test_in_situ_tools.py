"""One tool on an arm, by its driver's newtons: mounting, frames, few poses, coarse counts, its weight."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from surefoot.calibration import GRAVITY, Limb
from surefoot.calibration.in_situ import InSituSet, calibrate_in_situ
from surefoot.calibration.results import CalibrationRefused, FitResult

TOOL = Limb(0.7, 0.7 * np.array([0.012, -0.008, 0.05]))
OTHER = Limb(1.3, 1.3 * np.array([0.0, 0.01, 0.08]))
BIAS = np.array([-2.0, 4.0, 9.0, 0.2, -0.1, 0.04])
NOISE = np.array([0.03, 0.03, 0.03, 0.001, 0.001, 0.001])
NEWTONS = np.eye(6)


def poses(count=60, seed=0):
    """Give gravity in poses at random, (n, 3)."""
    return Rotation.random(count, random_state=seed).apply([0.0, 0.0, -GRAVITY])


def read(gravity, seed=1, limb=TOOL):
    """Give what an exact sensor reads, (n, 6)."""
    noise = NOISE * np.random.default_rng(seed).standard_normal((len(gravity), 6))
    return limb.weight(gravity) + BIAS + noise


def fit(gravity, readings, **how):
    return calibrate_in_situ([InSituSet(readings, gravity, name="tool", **how)], factory_matrix=NEWTONS)


@pytest.mark.parametrize("degrees", [4.0, 37.0, 101.0])
def test_a_sensor_mounted_at_any_angle_is_named_with_the_rotation_that_undoes_it(degrees):
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.48, -0.6, 0.64]))
    gravity = poses()
    with pytest.raises(CalibrationRefused, match=rf"turned by {degrees:g}[.\d]* degrees about") as refused:
        fit(turn.apply(gravity), read(gravity))
    rows = re.search(r"R_sensor_accelerometer = \[(.*?\])\]", str(refused.value))
    R = np.array(re.findall(r"-?\d\.\d+", rows[1]), dtype=float).reshape(3, 3)
    found = fit(turn.apply(gravity) @ R.T, read(gravity))
    np.testing.assert_allclose(found.matrix[:3, :3], np.eye(3), atol=3e-3)
    assert found.limb.mass == pytest.approx(TOOL.mass, abs=0.005)


@pytest.mark.parametrize("count", [4, 5])
def test_a_few_poses_leave_the_makers_matrix_as_it_was(count):
    """They leave hardly a residual, which does not mean that there is no noise."""
    for seed in range(3):
        gravity = poses(count, seed)
        found = fit(gravity, read(gravity, seed))
        np.testing.assert_allclose(np.diag(found.matrix), 1.0, atol=0.02)
        assert found.limb.mass == pytest.approx(TOOL.mass, abs=0.02)


def test_a_centre_of_mass_that_no_pose_shows_is_as_unsure_as_limbs_are_long():
    gravity = np.tile([[0.0, 0.0, -GRAVITY], [0.0, 0.0, GRAVITY]], (10, 1))
    found = fit(gravity, read(gravity))
    x, y, z = np.sqrt(np.diag(found.covariance)[found.columns.limb][1:])
    assert max(x, y) < 0.01
    assert 0.1 < z < 1.0
    assert abs(found.limb.com[2]) < 1.0


def test_whole_counts_below_whose_size_the_noise_is_are_sound():
    rng = np.random.default_rng(3)
    for seed in range(4):
        gravity = poses(10, seed).repeat(60, axis=0)
        counts = np.round(20.0 * TOOL.weight(gravity) + 0.15 * rng.standard_normal((600, 6)))
        found = calibrate_in_situ([InSituSet(counts, gravity)], factory_matrix=NEWTONS / 20.0)
        assert found.limb.mass == pytest.approx(TOOL.mass, abs=0.02)


def test_poses_without_times_of_which_some_are_off_are_no_loose_cable():
    gravity = poses(40)
    readings = read(gravity)
    readings[[3, 11, 24, 30]] += 0.6
    found = fit(gravity, readings)
    assert any("4 samples that disagree" in warning for warning in found.warnings)
    assert found.limb.mass == pytest.approx(TOOL.mass, abs=0.01)


@pytest.mark.parametrize("frame", ["base", "compensated"])
def test_readings_that_do_not_follow_gravity_have_one_cause(frame):
    turn = Rotation.random(60, random_state=0)
    gravity = turn.inv().apply([0.0, 0.0, -GRAVITY])
    readings = read(gravity)
    if frame == "base":
        readings = np.hstack([turn.apply(readings[:, :3] - BIAS[:3]), turn.apply(readings[:, 3:] - BIAS[3:])])
    else:
        readings = TOOL.compensate(readings, gravity)
    with pytest.raises(CalibrationRefused, match=r"compensated already .* do not turn with") as no:
        fit(gravity, readings)
    assert "gauge" not in str(no.value)


def test_a_torque_about_an_axis_through_the_centre_of_mass_is_no_idle_channel():
    straight = Limb(0.7, np.array([0.0, 0.0, 0.04]))
    gravity = poses()
    assert fit(gravity, read(gravity, limb=straight)).result is not FitResult.REFUSED
    dead = read(gravity, limb=straight)
    dead[:, 2] = BIAS[2] + NOISE[2] * np.random.default_rng(5).standard_normal(60)
    with pytest.raises(CalibrationRefused, match="Channel 2 does not follow gravity"):
        fit(gravity, dead)


@pytest.mark.parametrize("timed", [True, False])
def test_a_tool_that_was_changed_in_the_middle_is_refused(timed):
    time = 0.1 * np.arange(600)
    angles = np.column_stack([1.2 * np.sin(time / 2.3), 1.4 * np.sin(time / 3.1 + 0.5)])
    gravity = Rotation.from_euler("xy", angles).inv().apply([0.0, 0.0, -GRAVITY]) if timed else poses(600)
    readings = np.concatenate([read(gravity[:300]), read(gravity[300:], 2, OTHER)])
    with pytest.raises(CalibrationRefused, match="of the readings' spread follows gravity in no") as refused:
        fit(gravity, readings, time=time if timed else None)
    assert ("what hangs in 'tool' changed at" in str(refused.value)) == timed


def test_a_tools_weight_is_taken_off_a_single_sample_and_off_many():
    gravity, push = poses(5), np.array([3.0, 0.0, -7.0, 0.1, 0.0, 0.2])
    wrench = TOOL.weight(gravity) + push
    np.testing.assert_allclose(TOOL.compensate(wrench, gravity), np.tile(push, (5, 1)), atol=1e-12)
    np.testing.assert_allclose(TOOL.compensate(wrench[2], gravity[2]), push, atol=1e-12)


def test_shapes_that_are_wrong_are_named() -> None:
    with pytest.raises(ValueError, match=r"^mass_com must have shape \(3,\), in kg m, got \(2,\)\.$"):
        Limb(1.0, np.zeros(2))
    with pytest.raises(ValueError, match=r"^'wrench' must have shape \(\.\.\., 6\), got \(5,\)\.$"):
        TOOL.compensate(np.zeros(5), np.array([0.0, 0.0, -9.81]))
