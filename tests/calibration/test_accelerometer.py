"""An accelerometer's own calibration by the size of gravity."""

import numpy as np
import pytest
from _in_situ import FOOT_MATRIX, make_set, random_gravity, swept_gravity
from _recordings import DATA, needs
from _refusals import refusals
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from surefoot.calibration.imu import calibrate_accelerometer
from surefoot.calibration.imu.accelerometer import _algebraic_start
from surefoot.calibration.in_situ import estimate_offset
from surefoot.calibration.results import CalibrationRefused, FitResult

G = 9.80665
BIAS = np.array([0.3, -0.5, 0.76])
MATRICES = {
    "bias": np.eye(3),
    "bias-scale": np.diag([1.03, 0.98, 1.01]),
    "full": np.array([[1.03, 0.02, -0.01], [0.0, 0.98, 0.015], [0.0, 0.0, 1.01]]),
}
UNKNOWNS = {"bias": 3, "bias-scale": 6, "full": 9}


def readings(model, rng, n, noise=0.0, bias=BIAS):
    """Specific force at rest as a faulty accelerometer reads it, f = K^-1 (true) + b."""
    true = random_gravity(rng, n, G)
    return np.linalg.solve(MATRICES[model], true.T).T + bias + noise * rng.standard_normal((n, 3)), true


@pytest.fixture(params=sorted(MATRICES))
def model(request):
    return request.param


def theta_of(fit, model):
    K = fit.matrix
    entries = [*np.diag(K), K[0, 1], K[0, 2], K[1, 2]]
    return np.concatenate([fit.bias, entries[: UNKNOWNS[model] - 3]])


def test_exact_without_noise(model):
    force, true = readings(model, np.random.default_rng(0), 40)
    before = force.copy()
    fit = calibrate_accelerometer(force, model=model)
    np.testing.assert_allclose(fit.bias, BIAS, atol=1e-9)
    np.testing.assert_allclose(fit.matrix, MATRICES[model], atol=1e-9)
    np.testing.assert_allclose(fit.correct(force), true, atol=1e-8)
    np.testing.assert_allclose(fit.correct(force[3]), true[3], atol=1e-8)
    np.testing.assert_array_equal(force, before)
    assert fit.result is FitResult.DETERMINED
    assert (fit.stats.samples, fit.stats.gated, fit.stats.rank) == (40, 0, UNKNOWNS[model])


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    seed=st.integers(0, 10_000),
    size=st.floats(-3.0, 4.0),
    bias=st.floats(-4.0, -0.6),
    model=st.sampled_from(sorted(MATRICES)),
)
def test_exact_in_any_unit_and_for_any_bias(seed, size, bias, model):
    rng = np.random.default_rng(seed)
    unit, where = 10.0**size, 10.0**bias * rng.standard_normal(3)
    skewed = np.linalg.solve(MATRICES[model], random_gravity(rng, 60, 1.0).T).T
    fit = calibrate_accelerometer(unit * (skewed + where), gravity=unit, model=model)
    np.testing.assert_allclose(fit.bias / unit, where, atol=1e-9)
    np.testing.assert_allclose(fit.matrix, MATRICES[model], atol=1e-9)


def test_neither_the_order_nor_a_rotation_matters():
    force, _ = readings("bias", np.random.default_rng(1), 60, noise=0.02)
    R = Rotation.from_rotvec([0.3, 1.2, -0.4]).as_matrix()
    fit = calibrate_accelerometer(force)
    np.testing.assert_allclose(calibrate_accelerometer(force[::-1]).bias, fit.bias, atol=1e-9)
    np.testing.assert_allclose(calibrate_accelerometer(force @ R.T).bias, R @ fit.bias, atol=1e-7)


def test_perfect_readings_are_left_alone(model):
    rng = np.random.default_rng(2)
    true = random_gravity(rng, 30, G)
    np.testing.assert_allclose(calibrate_accelerometer(true, model=model).correct(true), true, atol=1e-9)


@pytest.mark.parametrize("unknowns", [6, 9])
def test_a_quadric_that_is_no_ellipsoid_starts_from_a_sphere(unknowns):
    rng = np.random.default_rng(12)
    angle, height = rng.uniform(0.0, 6.3, 50), rng.uniform(-1.0, 1.0, 50)
    waist = np.sqrt(1.0 + height**2)
    hyperboloid = np.stack([waist * np.cos(angle), waist * np.sin(angle), height], axis=-1)
    start = _algebraic_start(hyperboloid, unknowns)
    np.testing.assert_array_equal(start[3:], [1.0, 1.0, 1.0, 0.0, 0.0, 0.0][: unknowns - 3])
    centred = hyperboloid - start[:3]
    spread = np.std(np.sum(centred**2, axis=1))  # the best sphere has the least spread of squares
    for axis in np.eye(3):
        assert spread < np.std(np.sum((centred + 0.1 * axis) ** 2, axis=1))


@pytest.mark.slow
def test_covariance_agrees_with_the_errors(model):
    rng, runs, n = np.random.default_rng(4), 200, 120
    entries = MATRICES[model]
    truth = [*BIAS, *np.diag(entries), entries[0, 1], entries[0, 2], entries[1, 2]][: UNKNOWNS[model]]
    nees = []
    for _ in range(runs):
        force, _ = readings(model, rng, n, noise=0.02)
        fit = calibrate_accelerometer(force, model=model)
        error = theta_of(fit, model) - truth
        nees.append(error @ np.linalg.solve(fit.covariance, error))
    p = UNKNOWNS[model]
    free = n - p
    # Hotelling; noise of equal size in all channels is nearly, not quite, equal along K's directions.
    expected = p * free / (free - 2.0)
    assert np.mean(nees) == pytest.approx(expected, abs=4.0 * np.sqrt(2.0 * p / runs) * 1.1)


def test_a_hip_that_swings_separates_scale_from_bias_badly_but_honestly():
    # Distances that a smaller K makes smaller would pull this bias by four deviations.
    rng, runs, truth = np.random.default_rng(11), 20, np.concatenate([BIAS, np.ones(3)])
    nees, deviation, gravity = [], [], swept_gravity(3000)
    for _ in range(runs):
        force = gravity + BIAS + 0.005 * rng.standard_normal((3000, 3))
        fit = calibrate_accelerometer(force, gravity=9.81, model="bias-scale")
        error = theta_of(fit, "bias-scale") - truth
        nees.append(error @ np.linalg.solve(fit.covariance, error))
        deviation.append(np.sqrt(fit.covariance[2, 2]))
    assert np.mean(nees) == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / runs))
    plain = calibrate_accelerometer(force, gravity=9.81)
    assert np.mean(deviation) > 50.0 * np.sqrt(plain.covariance[2, 2])


def test_samples_that_moved_are_left_out(model):
    rng = np.random.default_rng(5)
    force, _ = readings(model, rng, 200, noise=0.01)
    still = calibrate_accelerometer(force, model=model)
    moved = force.copy()
    moved[:20] *= 1.0 + rng.uniform(0.05, 0.5, (20, 1))
    fit = calibrate_accelerometer(moved, model=model)
    assert fit.stats.gated == 20
    assert fit.stats.samples == 180
    deviation = np.sqrt(np.diag(still.covariance))
    assert (np.abs(theta_of(fit, model) - theta_of(still, model)) < 3.0 * deviation).all()


def test_samples_that_are_not_finite_are_left_out():
    force, _ = readings("full", np.random.default_rng(6), 50)
    force[[3, 9], [0, 2]] = np.nan, np.inf
    fit = calibrate_accelerometer(force, model="full")
    np.testing.assert_allclose(fit.bias, BIAS, atol=1e-9)
    assert (fit.stats.samples, fit.stats.dropped) == (48, 2)


def test_the_offset_of_a_force_sensor_is_freed_of_the_bias():
    rng, offset = np.random.default_rng(7), np.full(6, 800.0)
    gravity = random_gravity(rng, 60, G)
    one = make_set(FOOT_MATRIX, offset, (0.6, np.zeros(3)), (0.0, np.zeros(3)), gravity)
    force = -gravity + BIAS  # at rest, the specific force points up
    raw_error = FOOT_MATRIX[:3] @ (estimate_offset(one.raw, -force).offset - offset)
    np.testing.assert_allclose(raw_error, 0.6 * BIAS, rtol=1e-6)
    corrected = -calibrate_accelerometer(force).correct(force)
    np.testing.assert_allclose(estimate_offset(one.raw, corrected).offset, offset, rtol=1e-9)


# Refusals


test_what_does_not_determine_is_refused = refusals(
    lambda force, options: calibrate_accelerometer(force, **options),
    (
        np.full((2, 3), np.nan),
        {},
        "Only 0 samples for 3 unknowns (2 samples without a finite value left out)",
    ),
    (G * np.eye(3), {}, "Only 3 samples for 3 unknowns, and 4 are needed."),
    (
        random_gravity(np.random.default_rng(8), 9),
        {"model": "full"},
        "Only 9 samples for 9 unknowns, and 10 are needed.",
    ),
    (
        random_gravity(np.random.default_rng(8), 20, 1.0),
        {},
        "The readings are 1 in size where gravity is 9.80665: they seem to be in another unit.",
    ),
    (
        swept_gravity(100, side=0.0) + np.array([0.2, 0.1, 0.0]),
        {},
        "Gravity was seen turning in a plane only",
    ),
    (np.tile([0.0, 0.0, G], (9, 1)), {}, "Gravity was seen in one direction only"),
    error=CalibrationRefused,
    plain=True,
)


def test_sides_of_a_cube_show_no_skewness():
    sides = G * np.repeat(np.vstack([np.eye(3), -np.eye(3)]), 3, axis=0)
    assert calibrate_accelerometer(sides, model="bias-scale").stats.rank == 6
    with pytest.raises(CalibrationRefused) as refusal:
        calibrate_accelerometer(sides, model="full")
    assert str(refusal.value) == (
        "The orientations determine 6 of the 9 unknowns of the model 'full'. Rest the accelerometer on "
        "further sides, such as all six of a cube and some between them, or take a model with fewer unknowns."
    )


def test_a_log_of_motion_is_refused(model):
    rng = np.random.default_rng(9)
    force = random_gravity(rng, 300, G) + rng.uniform(-3.0, 3.0, (300, 3))
    with pytest.raises(
        CalibrationRefused, match=r"leave the ellipsoid by \d+ % of gravity, and 5 % are the most"
    ):
        calibrate_accelerometer(force, model=model)


def test_of_few_samples_none_counts_as_moved():
    rng = np.random.default_rng(10)
    sides = G * np.vstack([np.eye(3), -np.eye(3)])
    sides[5] *= 1.05
    assert calibrate_accelerometer(sides).stats.gated == 0
    more = np.vstack([sides, random_gravity(rng, 20, G)])
    assert calibrate_accelerometer(more).stats.gated == 1


test_bad_arguments = refusals(
    lambda force, options: calibrate_accelerometer(force, **options),
    (np.ones(3), {}, "'specific_force' must have shape (n, 3), got (3,)."),
    (
        np.ones((5, 3)),
        {"model": "scale"},
        "'model' must be one of 'bias', 'bias-scale', 'full', got 'scale'.",
    ),
    (np.ones((5, 3)), {"gravity": -9.81}, "'gravity' must be finite and positive, got -9.81."),
    plain=True,
)


# A real arm


@needs("ft")
def test_an_arm_with_its_own_accelerometer_finds_the_kinematic_offset(model):
    arm = np.load(DATA / "ft" / "kuka_ati_gamma_static.npz")
    kinematic = estimate_offset(arm["wrench"], arm["gravity"]).offset

    def force_error(specific_force):
        return np.linalg.norm((estimate_offset(arm["wrench"], -specific_force).offset - kinematic)[:3])

    assert force_error(arm["accel_g"]) > 0.65  # N, by a bias of 0.08 g
    fit = calibrate_accelerometer(arm["accel_g"], gravity=1.0, model=model)
    assert force_error(fit.correct(arm["accel_g"])) < 0.01
    assert fit.stats.residual_rms < 0.003  # g
    assert fit.bias[2] == pytest.approx(0.077, abs=0.001)
