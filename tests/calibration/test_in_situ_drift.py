"""Offsets that walk: what a drift could feign, and what it leaves."""

from dataclasses import replace

import numpy as np
import pytest
from _in_situ import NOISE, SENSORS, noisy_sets, random_gravity, swept_gravity
from _in_situ_stacked import wrench_of_gravity
from scipy.stats import chi2

from surefoot.calibration.in_situ import InSituOptions, InSituSet, KnownLimb, calibrate_in_situ
from surefoot.calibration.in_situ.solver.colour import Colour, Part, Spectrum, likeliest_colour
from surefoot.calibration.in_situ.solver.compress import compress
from surefoot.calibration.results import CalibrationRefused, FitResult


def walk(rng, rows, size):
    """A random walk of six channels that spans a size."""
    path = np.cumsum(rng.standard_normal((rows, 6)), axis=0)
    return size * path / np.ptp(path, axis=0)


def colour_of(noise):
    constant = np.full((len(noise), 1), len(noise) ** -0.5)
    residual = noise - constant @ (constant.T @ noise)
    return likeliest_colour([Spectrum.of(residual, constant, 1.0)], 0.1)[0]


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_has_no_colour(seed):
    assert colour_of(np.random.default_rng([30, seed]).standard_normal((500, 6))) == Colour()


def test_a_random_walk_is_seen_and_its_rows_become_white():
    rng = np.random.default_rng(31)
    noise = rng.standard_normal((800, 6)) + 0.2 * np.cumsum(rng.standard_normal((800, 6)), axis=0)
    colour = colour_of(noise)
    assert colour.drift.exponent == 2.0
    # A walk of step q over white noise of s: q^2 / (2 pi f)^2 = s^2 at the corner.
    assert colour.drift.corner == pytest.approx(0.2 / (2.0 * np.pi), rel=0.3)
    white = colour.weigh(noise, 1.0)[:, 0]
    assert abs(np.corrcoef(white[:-1], white[1:])[0, 1]) < 0.1
    assert colour_of(colour.weigh(noise, 1.0)) == Colour()


def test_a_drift_is_followed_to_its_end_as_surely_as_is_claimed():
    rng = np.random.default_rng(32)
    colour = Colour(Part(0.2 / (2.0 * np.pi)))
    weights, variances = colour.slow(400, 1.0, (0.5, 1.0))
    errors = []
    for _ in range(300):
        drift = 0.2 * np.cumsum(rng.standard_normal(400))
        read = drift + rng.standard_normal(400)
        mean = read.mean()
        errors.append([mean - drift[200], mean - drift[-1]] + weights @ read)
    claimed = np.sqrt(variances)
    np.testing.assert_allclose(np.std(errors, axis=0), claimed, rtol=0.15)


def test_an_offset_that_walks_is_as_sure_as_a_filter_is():
    rng, step, gravity = np.random.default_rng(39), 0.1, swept_gravity(1000)
    noise = step * np.cumsum(rng.standard_normal((1000, 6)), axis=0) + rng.standard_normal((1000, 6))
    raw = gravity @ rng.normal(0.0, 10.0, (3, 6)) + noise
    (part,) = compress([InSituSet(raw, gravity, time=np.arange(1000.0))], InSituOptions(), False, False)
    # A Kalman filter's variance settles at the step times a sample's deviation, a smoother's at half of that.
    assert part.end.variance == pytest.approx(step, rel=0.3)
    assert part.middle.variance == pytest.approx(step / 2.0, rel=0.3)


def rasters(sensor, rng, drift, rows=1500):
    """The paper's first four sets, the second joint moved once a set; the offset walks by so many N (std)."""
    matrix, mass, com, places = SENSORS[sensor]
    gravity = swept_gravity(rows, turns=(13.0, 0.5), begin=-0.5 * np.pi)
    sets = []
    for added, place in zip((0.0, 0.703, 0.703, 0.703), places, strict=True):
        wrench = gravity @ (wrench_of_gravity(mass, com) + wrench_of_gravity(added, place)).T
        path = np.cumsum(rng.standard_normal((rows, 6)), axis=0) / np.sqrt(rows)
        wrench = wrench + drift * path * NOISE / NOISE[0] + NOISE * rng.standard_normal((rows, 6))
        sets.append(
            InSituSet(wrench @ np.linalg.inv(matrix).T, gravity, added, place, time=0.2 * np.arange(rows))
        )
    return sets


@pytest.mark.parametrize(
    ("sensor", "drift"), [pytest.param("leg", 0.3, marks=pytest.mark.slow), ("foot", 0.1)]
)
def test_a_raster_is_answered_within_its_uncertainty(sensor, drift):
    errors = []
    mass = SENSORS[sensor][1]
    for seed in range(2):
        sets = rasters(sensor, np.random.default_rng([33, seed]), drift)
        fit = calibrate_in_situ(sets)
        errors.append((fit.limb.mass - mass) / fit.limb_mass_std)
        assert fit.limb.mass == pytest.approx(mass, rel=0.02)
        assert fit.limb_mass_std < 0.01 * mass
        assert " ".join(fit.warnings).count("turned no faster than the sensor's offset drifts") == 1
    assert np.sum(np.square(errors)) < chi2.ppf(0.995, len(errors))


def test_a_raster_that_a_drift_hides_is_refused_for_that():
    sets = rasters("foot", np.random.default_rng(38), drift=2.0)
    with pytest.raises(
        CalibrationRefused, match=r"Along \(.*1\.00, .*\) gravity turned no faster"
    ) as refused:
        calibrate_in_situ(sets)
    assert "come back to the first ones" in str(refused.value)
    fit = calibrate_in_situ(sets, accept="the drift is known")
    said = " ".join([*map(str, fit.refusals), *fit.warnings])
    assert said.count("gravity turned no faster") == 1


def static_poses(rng, masses):
    """A hundred postures a set, at rest, of a sensor in newtons whose zero walks by 2 N; and its limb."""
    response = np.eye(6) + 0.03 * rng.standard_normal((6, 6)) * np.repeat([1.0, 0.05], 3)[:, None]
    limb, places = (1.0, np.array([0.01, -0.02, 0.06])), ([0.0] * 3, [0.1, 0.0, 0.1], [-0.02, 0.12, 0.05])
    sets = []
    for added, place in list(zip((0.0, 0.5, 0.5), np.array(places), strict=True))[:masses]:
        gravity = random_gravity(rng, 100)
        wrench = gravity @ (wrench_of_gravity(*limb) + wrench_of_gravity(added, place)).T
        scale = np.repeat([1.0, 0.02], 3)
        noise = walk(rng, 100, 2.0) * scale * 0.5 + 0.02 * scale * rng.standard_normal((100, 6))
        sets.append(
            InSituSet((wrench + noise) @ response.T, gravity, added, place, time=10.0 * np.arange(100))
        )
    return sets, response, limb


@pytest.mark.parametrize(
    ("masses", "timed", "seeds"),
    [
        (1, True, 2),
        pytest.param(1, False, 20, marks=pytest.mark.slow),
        pytest.param(3, True, 20, marks=pytest.mark.slow),
    ],
)
def test_static_poses_of_a_sensor_whose_zero_walks(masses, timed, seeds):
    gains = []
    for seed in range(seeds):
        sets, response, limb = static_poses(np.random.default_rng([34, seed]), masses)
        sets = sets if timed else [replace(one, time=None) for one in sets]
        known = {"factory_matrix": np.eye(6), "limb": KnownLimb(limb[0], 0.002, limb[1], 5e-4)}
        fit = calibrate_in_situ(sets, **known if masses == 1 else {})
        # What the limb's weight reads along each axis, over what it is.
        gains.append(np.diag((fit.matrix @ response @ wrench_of_gravity(*limb))[:3]) / limb[0])
    np.testing.assert_allclose(gains, 1.0, atol=0.015)


def test_noise_that_has_no_colour_changes_nothing():
    sets, _ = noisy_sets("foot", np.random.default_rng(35))
    fit, still = calibrate_in_situ(sets), calibrate_in_situ(sets, options=InSituOptions(drift=False))
    np.testing.assert_array_equal(fit.matrix, still.matrix)
    np.testing.assert_array_equal(fit.covariance, still.covariance)


def test_the_data_alone_need_no_prior():
    sets, _ = noisy_sets("foot", np.random.default_rng(36))
    fit = calibrate_in_situ(sets)
    np.testing.assert_allclose(fit.data_share, 1.0, atol=1e-3)


def test_two_moving_sets_say_that_the_factory_matrix_knows_the_scale():
    # The faintest inertia makes the rank full, and says nothing of the scale.
    matrix, mass, _, _ = SENSORS["leg"]
    rng = np.random.default_rng(37)
    sets, _ = noisy_sets("leg", rng, n=1500)
    share, time = np.linspace(0.0, 1.0, 1500), sets[0].time
    angles = np.radians([45.0, 35.0, 0.0]) * np.sin(2.0 * np.pi * np.array([1.1, 5.0, 1.0]) * share[:, None])
    rate = np.gradient(angles, time, axis=0)
    turning = np.gradient(rate, time, axis=0)
    moving = [replace(one, angular_velocity=rate, angular_acceleration=turning) for one in sets[1:3]]
    # Nothing shows that all axes are off alike: how far they may be is what the maker knows.
    options = InSituOptions(factory_std=(0.1,) * 6)
    fit = calibrate_in_situ(moving, factory_matrix=0.9 * matrix, options=options)
    assert fit.result is FitResult.PARTLY_DETERMINED
    assert fit.data_share[fit.columns.limb][0] < 0.5
    assert abs(fit.limb.mass - mass) < 2.0 * fit.limb_mass_std
    assert any("leans on the factory's matrix" in warning for warning in fit.warnings)


@pytest.mark.slow
def test_a_leap_of_a_zero_that_looks_like_a_drift_is_named():
    sets = rasters("leg", np.random.default_rng(33), drift=0.1)
    raw = sets[0].raw.copy()
    raw[600:] += np.linalg.inv(SENSORS["leg"][0]) @ [9.0, 6.0, 10.5, 0.7, 1.0, 0.3]
    spoilt = [replace(sets[0], raw=raw, name="first"), *sets[1:]]
    said = r"drifts.*The likeliest cause: the zero of 'first' leaps at"
    with pytest.raises(CalibrationRefused, match=said) as refused:
        calibrate_in_situ(spoilt, options=InSituOptions(robust=False))
    assert refused.value.cure.startswith("Cut the set there into two")
    assert "come back to the first ones" in refused.value.cure
