"""The maker's matrix as a prior, scored with contact loads that no fit has seen; and an IMU's own errors."""

import re
from dataclasses import replace

import numpy as np
import pytest
from _in_situ import SENSORS, make_set, moving_sets, noisy_sets, swept_gravity
from scipy.spatial.transform import Rotation

from surefoot.calibration.in_situ import InSituOptions, InSituSet, KnownLimb, calibrate_in_situ
from surefoot.calibration.in_situ.data import change_motion, read_later
from surefoot.calibration.in_situ.imu import fit_sphere, level
from surefoot.calibration.results import CalibrationRefused, Finding, FitResult, decide

FULL_SCALE = np.array([130.0, 130.0, 400.0, 10.0, 10.0, 10.0])
COUNTED = np.ones(6)
TOOL = (1.2, np.array([0.01, 0.02, 0.06]))
LOADS = ((0.0, np.zeros(3)), (1.0, np.array([0.12, 0.0, 0.08])), (1.0, np.array([-0.05, 0.1, 0.1])))


def driver_sets(rng, loads, off, noise=2.0**-12, unit=COUNTED):
    """A driver's newtons, each entry off by a share of full scale, in units of its own; the true response."""
    response = np.diag(unit) @ (
        np.eye(6) + off * rng.standard_normal((6, 6)) * np.divide.outer(FULL_SCALE, FULL_SCALE)
    )
    time = 0.1 * np.arange(400)
    sets = []
    for mass, place in LOADS[:loads]:
        phase = rng.uniform(0.0, 6.0, 2)
        angles = np.array([1.2, 1.4]) * np.sin(2.0 * np.pi * time[:, None] / np.array([37.0, 23.0]) + phase)
        gravity = Rotation.from_euler("xy", angles).inv().apply([0.0, 0.0, -9.80665])
        one = make_set(np.linalg.inv(response), unit * 0.02 * FULL_SCALE, TOOL, (mass, place), gravity)
        read = one.raw + noise * unit * FULL_SCALE * rng.standard_normal((400, 6))
        sets.append(replace(one, raw=read, time=time, name=f"load {len(sets)}"))
    return sets, response


def contact_error(matrix, response):
    """Errors of pushes of half of full scale at random, as a share of it, rms."""
    pushes = 0.5 * FULL_SCALE * np.random.default_rng(1).uniform(-1.0, 1.0, (200, 6))
    return float(np.sqrt(np.mean(((pushes @ (matrix @ response - np.eye(6)).T) / FULL_SCALE) ** 2)))


@pytest.mark.parametrize(
    ("loads", "off"), [*(pytest.param(1, off, marks=pytest.mark.slow) for off in (0.0, 0.03)), (2, 0.03)]
)
def test_a_matrix_is_never_worse_than_the_makers(loads, off):
    held = []
    for seed in range(3):
        sets, response = driver_sets(np.random.default_rng([80, seed]), loads, off)
        fit = calibrate_in_situ(sets, factory_matrix=np.eye(6))
        ours, makers = contact_error(fit.matrix, response), contact_error(np.eye(6), response)
        assert ours < makers + 0.001
        held.append(np.abs(fit.matrix - np.linalg.inv(response)) < 1.96 * fit.matrix_std)
        if off and loads == 2:
            assert ours < 0.7 * makers
    # Entries of a matrix hang together: of three seeds 0.82 to 1 are held, of twenty 0.91 to 1.
    assert np.mean(held) > 0.8


def test_torques_in_another_unit_are_the_same_sensor():
    """Newton centimetres: shares of full scale know no units."""
    fits = []
    for unit in (np.ones(6), np.repeat([1.0, 100.0], 3)):
        sets, _ = driver_sets(np.random.default_rng(81), 1, 0.03, unit=unit)
        fit = calibrate_in_situ(sets, factory_matrix=np.diag(1.0 / unit))
        fits.append((fit.matrix * unit, fit.limb.mass))
    np.testing.assert_allclose(fits[1][0], fits[0][0], atol=1e-5)
    assert fits[1][1] == pytest.approx(fits[0][1], rel=1e-5)


def test_what_the_readings_do_not_show_stays_the_makers():
    sets, _ = driver_sets(np.random.default_rng(82), 1, 0.03)
    fit = calibrate_in_situ(sets, factory_matrix=np.eye(6))
    assert fit.result is FitResult.PARTLY_DETERMINED
    assert fit.maker.known.shape == (6, 6)
    assert ((fit.maker.known >= 0.0) & (fit.maker.known <= 1.0)).all()
    # A tool that hangs near the axis loads no torque about it: who knows that gain is the maker.
    assert (fit.maker.known[:, 3:] < 0.5).any()
    assert 0.005 < fit.maker.share < 0.1
    assert "36 entries by the readings (one load)" in fit.scope


def test_how_far_the_maker_may_be_off_can_be_stated():
    sets, _ = driver_sets(np.random.default_rng(83), 2, 0.01)
    tight, loose = (
        calibrate_in_situ(sets, factory_matrix=np.eye(6), options=InSituOptions(factory_std=(std,) * 6))
        for std in (1e-7, 0.05)
    )
    np.testing.assert_allclose(tight.matrix, np.eye(6), atol=1e-4)
    assert np.abs(loose.matrix - np.eye(6)).max() > 0.01
    assert loose.maker.share == pytest.approx(0.05)


def test_a_kept_matrix_is_gravity_compensation():
    errors = []
    for seed in range(2):
        sets, _ = driver_sets(np.random.default_rng([84, seed]), 1, 0.01)
        fit = calibrate_in_situ(sets, factory_matrix=np.eye(6), matrix="keep")
        np.testing.assert_array_equal(fit.matrix, np.eye(6))
        assert fit.scope == "bias, mass and centre of mass; matrix kept (one load)"
        errors.append((fit.limb.mass - TOOL[0]) / fit.limb_mass_std)
        offset = 0.02 * FULL_SCALE
        spread = np.sqrt(np.diag(fit.covariance)[fit.columns.offset])
        assert (np.abs(fit.offset - offset) < 5.0 * spread).all()
    assert np.sqrt(np.mean(np.square(errors))) < 2.0


def test_a_free_matrix_leans_on_nothing():
    sets, _ = noisy_sets("leg", np.random.default_rng(85))
    aged = 1.05 * SENSORS["leg"][0]
    free = calibrate_in_situ(sets, factory_matrix=aged, matrix="free")
    np.testing.assert_allclose(free.matrix, calibrate_in_situ(sets).matrix, rtol=1e-5, atol=1e-9)
    with pytest.raises(CalibrationRefused, match="three are needed to determine a matrix"):
        calibrate_in_situ(sets[:2], factory_matrix=aged, matrix="free")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"matrix": "drop"}, "'matrix' must be 'keep', 'update' or 'free', got 'drop'."),
        ({"matrix": "keep"}, "'matrix' is 'keep', and there is none to keep: give 'factory_matrix'."),
    ],
)
def test_what_becomes_of_the_matrix_has_three_words(given, said):
    with pytest.raises(ValueError, match=re.escape(said)):
        calibrate_in_situ(noisy_sets("leg", np.random.default_rng(86), n=50)[0], **given)
    with pytest.raises(ValueError, match="'full_scale' must hold six positive values"):
        InSituOptions(full_scale=(1.0, 2.0))


@pytest.mark.parametrize("axis", [0, *(pytest.param(axis, marks=pytest.mark.slow) for axis in (1, 2))])
def test_a_mirrored_axis_is_named(axis):
    sets, _ = driver_sets(np.random.default_rng(87), 1, 0.0)
    mirror = np.where(np.isin(np.arange(6), (axis, axis + 3)), -1.0, 1.0)
    said = f"The likeliest cause: axis {'xyz'[axis]} of the sensor has the other sign, force and torque"
    with pytest.raises(CalibrationRefused, match=said):
        calibrate_in_situ([replace(one, raw=one.raw * mirror) for one in sets], factory_matrix=np.eye(6))


def test_an_absurd_answer_is_refused_however_well_it_fits():
    """N mm that are taken for N m: a limb whose centre of mass is 60 m away."""
    sets, _ = driver_sets(np.random.default_rng(88), 1, 0.0, unit=np.repeat([1.0, 1e3], 3))
    with pytest.raises(CalibrationRefused, match=r"centre of mass comes out [0-9.]+ m away from the sensor"):
        calibrate_in_situ(sets, factory_matrix=np.eye(6))


def swinging_sets(rng, late):
    """Swings of a leg, with an IMU that is late by so many s."""
    sets, _ = moving_sets(rng, noise=1.0)
    return [change_motion(one, lambda values, one=one: read_later(values, one, -late)) for one in sets]


@pytest.mark.parametrize("late", [pytest.param(0.005, marks=pytest.mark.slow), 0.03])
def test_a_late_imu_is_shifted_and_answered(late):
    fit = calibrate_in_situ(swinging_sets(np.random.default_rng(89), late))
    assert fit.imu.delay == pytest.approx(late, abs=1e-3)
    assert any("The IMU is late by" in warning for warning in fit.warnings)
    assert abs(fit.limb.mass - SENSORS["leg"][1]) < 4.0 * fit.limb_mass_std


def test_clocks_that_agree_are_left_alone():
    sets = tuple(swinging_sets(np.random.default_rng(90), 0.0))
    assert calibrate_in_situ(sets).imu.delay == 0.0


@pytest.mark.parametrize("moving", [False, True])
def test_a_bias_is_found_with_and_without_a_gyroscope(moving):
    bias = np.array([0.1, -0.3, 0.2])
    rng = np.random.default_rng(91)
    sets = moving_sets(rng, noise=1.0)[0] if moving else noisy_sets("leg", rng)[0]
    biased = [
        replace(one, gravity=one.gravity + bias + 0.02 * rng.standard_normal(one.gravity.shape))
        for one in sets
    ]
    sphere = fit_sphere(biased)
    off = sphere.bias - bias
    assert off @ np.linalg.solve(sphere.covariance, off) < 20.0
    assert np.abs(off).max() < 0.05
    levelled = level(biased, sphere)
    noise = np.std(np.linalg.norm(levelled[0].gravity, axis=1))
    assert noise < 0.005


@pytest.mark.parametrize("axes", [(1.0, 1.04, 1.0), (1.0, 1.0, 0.96)])
def test_axes_of_the_accelerometer_that_differ_are_told_from_a_bias(axes):
    rng = np.random.default_rng(93)
    sets = [
        replace(one, gravity=axes * (one.gravity + 0.005 * rng.standard_normal(one.gravity.shape)))
        for one in noisy_sets("leg", rng)[0]
    ]
    sphere = fit_sphere(sets)
    np.testing.assert_allclose(sphere.scales * axes, 1.0, atol=0.006)
    assert np.abs(sphere.bias).max() < 0.1  # not the 1.1 of a fit without axes
    (found,) = sphere.findings
    assert "its scale is off by (" in found.reason
    assert "bias" not in found.reason


def test_an_acceleration_that_the_gyroscope_does_not_show_is_no_noise():
    rng = np.random.default_rng(92)
    still = moving_sets(rng, noise=1.0)[0]
    felt = []
    for one in still:
        pushed = 1.0 + 0.03 * np.sin(np.linspace(0.0, 12.0 * np.pi, len(one.gravity)))
        gravity = pushed[:, None] * one.gravity
        noisy = gravity + 0.05 * rng.standard_normal(gravity.shape)
        felt.append((gravity, replace(one, gravity=noisy)))
    levelled = level([one for _, one in felt], fit_sphere([one for _, one in felt]))
    for (gravity, noisy), one in zip(felt, levelled, strict=True):
        off = [
            np.std(np.linalg.norm(g, axis=1) - np.linalg.norm(gravity, axis=1))
            for g in (noisy.gravity, one.gravity)
        ]
        assert off[1] < 0.5 * off[0]


def test_what_turning_adds_to_gravity_is_no_noise():
    rng, arm = np.random.default_rng(92), np.array([0.05, 0.02, 0.5])
    time = 0.05 * np.arange(4000)
    angle = 0.6 * np.sin(0.35 * time), 0.8 * np.sin(0.22 * time + 1.0)
    turn = Rotation.from_euler("xy", np.stack(angle, axis=1))
    rate = np.gradient(turn.apply(np.eye(3)[2]), time, axis=0)
    assert np.abs(rate).max() < 0.5  # a slow sweep
    path = turn.apply(arm)
    moved = np.gradient(np.gradient(path, time, axis=0), time, axis=0)
    felt = turn.inv().apply([0.0, 0.0, -9.80665] - moved)[20:-20]
    noisy = InSituSet(
        np.zeros((len(felt), 6)), felt + 0.05 * rng.standard_normal(felt.shape), time=time[20:-20]
    )
    sphere = fit_sphere([noisy])
    (levelled,) = level([noisy], sphere)
    along = felt / np.linalg.norm(felt, axis=1, keepdims=True)
    # Noise along gravity goes, and the acceleration of 0.1 m/s^2 stays.
    left = np.sum((levelled.gravity + sphere.bias - felt) * along, axis=1)
    assert np.std(left) < 0.01
    assert np.std(np.linalg.norm(felt, axis=1)) > 0.015


def test_a_scale_that_is_off_is_taken_off_and_said():
    sets, _ = noisy_sets("leg", np.random.default_rng(92))
    fit = calibrate_in_situ([replace(one, gravity=1.03 * one.gravity) for one in sets])
    assert fit.imu.scale == pytest.approx(1.0 / 1.03, rel=2e-3)
    assert "its scale is off by +3.0 %" in fit.warnings[0]
    assert fit.limb.mass == pytest.approx(SENSORS["leg"][1], rel=0.01)


def test_findings_are_decided_in_one_place():
    note, no = Finding("a", "It drifts.", refuses=False), Finding("b", "It bends.", "Hold it.", 0.2, 0.1)
    refused = decide([note, no, no], "")
    assert [str(one) for one in refused.refused] == ["It bends. Hold it."]
    assert (refused.passed, refused.warnings) == ((), ("It drifts.",))
    passed = decide([note, no], "I know")
    assert (len(passed.refused), len(passed.passed)) == (0, 1)


def test_white_noise_of_still_poses_is_no_contradiction():
    """One row a pose, without times: nothing but the covariance knows of the noise."""
    rng = np.random.default_rng(93)
    sets = []
    for added, place in zip(
        (0.0, 0.7, 0.9, 1.1), [*SENSORS["leg"][3][:3], SENSORS["leg"][3][3]], strict=True
    ):
        gravity = rng.standard_normal((30, 3))
        gravity *= 9.80665 / np.linalg.norm(gravity, axis=1, keepdims=True)
        sets.append(
            make_set(
                SENSORS["leg"][0],
                500.0,
                (1.5, np.array([0.0, 0.01, 0.1])),
                (added, place),
                gravity,
                noise=0.02,
                rng=rng,
            )
        )
    fit = calibrate_in_situ(sets)
    assert abs(fit.limb.mass - 1.5) < 3.0 * fit.limb_mass_std


def test_one_pose_after_the_other_leaves_a_known_limb_as_it_was():
    gravity = swept_gravity(40)
    one = make_set(
        SENSORS["foot"][0], 100.0, (0.6, np.array([0.03, 0.004, 0.04])), (0.0, np.zeros(3)), gravity
    )
    rng = np.random.default_rng(94)
    read = InSituSet(one.raw + rng.standard_normal(one.raw.shape), gravity)
    fit = calibrate_in_situ([read], factory_matrix=SENSORS["foot"][0], limb=KnownLimb(0.6, 0.001))
    assert fit.limb.mass == pytest.approx(0.6, abs=0.003)
    np.testing.assert_allclose(fit.matrix, SENSORS["foot"][0], atol=0.02 * np.abs(SENSORS["foot"][0]).max())


def test_a_motion_without_times_is_answered():
    sets = [replace(one, time=None) for one in moving_sets(np.random.default_rng(95), noise=1.0)[0]]
    fit = calibrate_in_situ(sets)
    assert abs(fit.limb.mass - SENSORS["leg"][1]) < 4.0 * fit.limb_mass_std
