"""The measurement-space fit of a six-axis sensor in its limb."""

import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from _in_situ import ADDED_MASS, NOISE, SENSORS, make_set, moving_sets, noisy_sets, paper_sets, swept_gravity
from _in_situ_stacked import wrench_of_gravity
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from threadpoolctl import threadpool_info, threadpool_limits

from surefoot.calibration.in_situ import InSituOptions, InSituSet, KnownLimb, calibrate_in_situ
from surefoot.calibration.results import CalibrationRefused, FitResult


def errors(fit, sensor, offset):
    matrix, mass, com, _ = SENSORS[sensor]
    return np.concatenate(
        [
            (fit.matrix - matrix).ravel(),
            fit.offset - offset,
            [fit.limb.mass - mass],
            fit.limb.mass_com - mass * com,
        ]
    )


def test_is_exact_without_noise(sensor):
    sets, offset = paper_sets(sensor, np.random.default_rng(0))
    matrix, mass, com, _ = SENSORS[sensor]
    fit = calibrate_in_situ(sets)
    assert fit.result is FitResult.DETERMINED
    assert (fit.stats.rank, fit.stats.unknowns) == (40, 40)
    assert np.abs(fit.matrix - matrix).max() < 1e-9 * np.abs(matrix).max()
    np.testing.assert_allclose(fit.offsets, np.tile(offset, (4, 1)), rtol=1e-9)
    assert fit.limb.mass == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(fit.limb.com, com, rtol=1e-8)
    np.testing.assert_allclose(fit.matrix @ fit.response, np.eye(6), atol=1e-9)
    wrench = fit.wrench(sets[0].raw)
    expected = sets[0].gravity @ wrench_of_gravity(mass, com).T
    np.testing.assert_allclose(wrench, expected, atol=1e-7)


@pytest.mark.slow
def test_errors_agree_with_the_covariance(sensor):
    squares = []
    for seed in range(40):
        sets, offset = noisy_sets(sensor, np.random.default_rng([1, seed]))
        # There are no loops to be seen here (below), and looking for them takes most of the time.
        # These limbs feel nothing of their turning: without times nobody can expect it.
        still = [replace(one, time=None) for one in sets]
        fit = calibrate_in_situ(still, options=InSituOptions(hysteresis=False))
        size = np.sqrt(np.diag(fit.covariance))
        error = errors(fit, sensor, offset) / size
        squares.append(error @ np.linalg.solve(fit.covariance / np.outer(size, size), error))
    low, high = chi2.ppf([0.005, 0.995], 40 * 46) / 40
    assert low < np.mean(squares) < high


def test_deviations_are_those_of_their_parts():
    sets, _ = noisy_sets("leg", np.random.default_rng(2))
    fit = calibrate_in_situ(sets)
    deviations = np.sqrt(np.diag(fit.covariance))
    np.testing.assert_array_equal(fit.matrix_std.ravel(), deviations[:36])
    np.testing.assert_array_equal(fit.offset_std, deviations[36:42])
    assert fit.limb_mass_std == deviations[42]


def test_does_not_shrink_the_scale_as_regressing_on_readings_does():
    # At 1 % noise the paper's own III-C gives about 1.2 kg here.
    sets, _ = paper_sets("leg", np.random.default_rng(3), n=2000, noise=0.01)
    assert calibrate_in_situ(sets).limb.mass == pytest.approx(SENSORS["leg"][1], rel=0.02)


def test_order_of_samples_and_sets_does_not_matter():
    sets, _ = noisy_sets("foot", np.random.default_rng(4))
    sets = [replace(one, time=None) for one in sets]
    shuffled = []
    for one in sets:
        order = np.random.default_rng(5).permutation(len(one.raw))
        shuffled.append(replace(one, raw=one.raw[order], gravity=one.gravity[order]))
    options = InSituOptions(robust=False)
    fit = calibrate_in_situ(sets, options=options)
    other = calibrate_in_situ(shuffled[1:] + shuffled[:1], options=options)
    # Of the noise alone the rows say in their order how slow it is.
    np.testing.assert_allclose((other.matrix - fit.matrix) / fit.matrix_std, 0.0, atol=0.05)
    np.testing.assert_allclose((other.offsets[-1] - fit.offsets[0]) / fit.offset_std, 0.0, atol=0.05)


@pytest.mark.parametrize("factory", [pytest.param(False, marks=pytest.mark.slow), True])
def test_units_and_mixture_of_the_channels_change_nothing(factory):
    """Counts, a driver's newtons and any other mixture of them: one answer to a hundredth of its sigma."""
    rng = np.random.default_rng(70)
    sets, _ = noisy_sets("leg", rng, n=600)
    matrix = SENSORS["leg"][0]
    response = np.linalg.inv(matrix)
    walks = [np.cumsum(0.02 * NOISE * rng.standard_normal((600, 6)), axis=0) for _ in sets]
    sets = [replace(one, raw=one.raw + walk @ response.T) for one, walk in zip(sets, walks, strict=True)]
    counts = calibrate_in_situ(sets, factory_matrix=1.1 * matrix if factory else None)
    for mixture in (matrix, rng.standard_normal((6, 6)))[factory:]:
        mixed = [replace(one, raw=one.raw @ mixture.T) for one in sets]
        made = 1.1 * matrix @ np.linalg.inv(mixture)
        fit = calibrate_in_situ(mixed, factory_matrix=made if factory else None)
        np.testing.assert_allclose((fit.matrix @ mixture - counts.matrix) / counts.matrix_std, 0.0, atol=0.01)
        assert fit.limb.mass == pytest.approx(counts.limb.mass, abs=0.01 * counts.limb_mass_std)
        assert fit.limb_mass_std == pytest.approx(counts.limb_mass_std, rel=0.01)


def test_a_turned_sensor_frame_turns_the_matrix():
    sets, _ = noisy_sets("leg", np.random.default_rng(6))
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    turned = [replace(one, gravity=one.gravity @ turn.T, added_com=turn @ one.added_com) for one in sets]
    fit, other = calibrate_in_situ(sets), calibrate_in_situ(turned)
    both = np.kron(np.eye(2), turn)
    np.testing.assert_allclose(other.matrix, both @ fit.matrix, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(other.limb.com, turn @ fit.limb.com, rtol=1e-6)


def test_eight_channels():
    rng = np.random.default_rng(7)
    sets, offset = noisy_sets("leg", rng, noise=0.0)
    response = rng.standard_normal((8, 6)) * np.repeat([40.0, 2000.0], 3)
    matrix = SENSORS["leg"][0]
    wide = [
        replace(one, raw=(one.raw - offset) @ matrix.T @ response.T + 1000.0 + rng.standard_normal((600, 8)))
        for one in sets
    ]
    fit = calibrate_in_situ(wide)
    assert fit.matrix.shape == (6, 8)
    np.testing.assert_allclose(fit.matrix @ fit.response, np.eye(6), atol=1e-9)
    np.testing.assert_allclose(fit.matrix @ response, np.eye(6), atol=0.05)
    assert fit.covariance.shape == (60, 60)


def turned_sets(rng):
    """Readings of a turned accelerometer, with one mass off the plane of the others; and the turn."""
    sets, offset = noisy_sets("leg", rng)
    matrix, mass, com, _ = SENSORS["leg"]
    added = (0.511, np.array([0.2, -0.1, 0.5]))
    off = make_set(matrix, offset, (mass, com), added, swept_gravity(600))
    off = replace(off, raw=off.raw + (NOISE * rng.standard_normal((600, 6))) @ np.linalg.inv(matrix).T)
    turn = Rotation.from_rotvec([0.9, -0.4, 1.2]).as_matrix()
    return [replace(one, gravity=one.gravity @ turn) for one in (*sets, off)], turn


def test_finds_the_rotation_of_the_accelerometer():
    sets, turn = turned_sets(np.random.default_rng(8))
    fit = calibrate_in_situ(sets, options=InSituOptions(estimate_rotation=True))
    np.testing.assert_allclose(fit.rotation, turn, atol=2e-3)
    np.testing.assert_allclose(fit.limb.mass, SENSORS["leg"][1], rtol=0.03)
    np.testing.assert_allclose(fit.matrix @ np.linalg.inv(SENSORS["leg"][0]), np.eye(6), atol=0.02)


@pytest.mark.slow
def test_masses_in_one_plane_leave_the_rotation_open():
    sets, turn = turned_sets(np.random.default_rng(8))
    options = InSituOptions(estimate_rotation=True)
    with pytest.raises(CalibrationRefused, match="do not tell a sensor from its mirror image"):
        calibrate_in_situ(sets[:4], options=options)
    options = replace(options, factory_std=(0.1,) * 6)
    fit = calibrate_in_situ(sets[:4], factory_matrix=SENSORS["leg"][0] * 1.05, options=options)
    np.testing.assert_allclose(fit.rotation, turn, atol=5e-3)


def test_finds_the_temperature_coefficient():
    sets, offset = noisy_sets("leg", np.random.default_rng(9))
    coefficient = np.array([5.0, -3.0, 2.0, 1.0, -4.0, 6.0])
    warmed = []
    for j, one in enumerate(sets):
        kelvin = 25.0 + 10.0 * np.sin(np.linspace(0.0, 3.0 + j, 600))
        warmed.append(replace(one, raw=one.raw + np.outer(kelvin, coefficient), temperature=kelvin))
    fit = calibrate_in_situ(warmed, options=InSituOptions(drift=False))
    np.testing.assert_allclose(fit.temperature_coefficient, coefficient, atol=0.6)
    # Offsets are those of the mean temperature.
    reference = np.mean([one.temperature for one in warmed])
    assert fit.temperature_reference == pytest.approx(reference)
    there = offset + reference * coefficient
    np.testing.assert_allclose(fit.offsets, np.tile(there, (4, 1)), atol=8.0)
    hot = fit.wrench(fit.offset + 20.0 * coefficient, temperature=reference + 20.0)
    np.testing.assert_allclose(hot, 0.0, atol=0.5)


def warmed_sets(rng, gain, swing=15.0, n=1500):
    """Sets of a leg that warms and cools by 15 K, whose offsets and gains (1/K) go with it."""
    sets, offset = noisy_sets("leg", rng, n=n)
    matrix, coefficient, warmed = SENSORS["leg"][0], np.array([2.0, -1.0, 0.5, 0.4, -1.5, 2.0]), []
    for j, one in enumerate(sets):
        warmer = 0.5 * swing * np.sin(np.linspace(0.0, 2.2 + 0.7 * j, n) + j)
        more = ((one.raw - offset) @ matrix.T * gain * warmer[:, None]) @ np.linalg.inv(matrix).T
        raw = one.raw + more + np.outer(warmer, coefficient)
        warmed.append(replace(one, raw=raw, temperature=25.0 + warmer + 0.05 * rng.standard_normal(n)))
    return warmed, offset


GAIN = 1e-3 * np.array([0.8, 0.6, -0.5, 0.7, 0.9, -0.6])


def test_a_gain_that_goes_with_the_temperature_is_found():
    warmed, _ = warmed_sets(np.random.default_rng([29, 0]), GAIN)
    fit = calibrate_in_situ(warmed)
    np.testing.assert_allclose(fit.temperature_gain, GAIN, atol=1.5e-4)
    assert fit.warnings == ()
    mass = SENSORS["leg"][1]
    assert abs(fit.limb.mass - mass) < 4.0 * fit.limb_mass_std
    # Readings of one load, cold and hot, are one wrench.
    cold, hot = fit.temperature_reference - 7.0, fit.temperature_reference + 7.0
    load = np.array([10.0, -20.0, 30.0, 1.0, -2.0, 0.5])
    for kelvin in (cold, hot):
        warmer = kelvin - fit.temperature_reference
        raw = fit.response @ (load * (1.0 + warmer * fit.temperature_gain)) + fit.offset
        raw = raw + warmer * fit.temperature_coefficient
        np.testing.assert_allclose(fit.wrench(raw, temperature=kelvin), load, rtol=1e-9)
        np.testing.assert_allclose(fit.at_reference(raw, kelvin), fit.response @ load + fit.offset, rtol=1e-9)
    assert np.linalg.norm(fit.matrix @ np.linalg.inv(SENSORS["leg"][0]) - np.eye(6)) < 0.05


def test_gains_of_single_channels_that_go_with_the_temperature_are_warned_of():
    rng = np.random.default_rng(32)
    warmed, offset = warmed_sets(rng, GAIN)
    each = 2e-4 * rng.standard_normal(6)
    warmed = [
        replace(one, raw=one.raw + (one.raw - offset) * each * (one.temperature - 25.0)[:, None])
        for one in warmed
    ]
    told = "The gains of single channels follow the temperature, each its own way"
    assert any(warning.startswith(told) for warning in calibrate_in_situ(warmed).warnings)


def test_a_gain_that_stays_is_none():
    warmed, _ = warmed_sets(np.random.default_rng(30), np.zeros(6))
    fit = calibrate_in_situ(warmed)
    assert fit.temperature_gain is None
    assert fit.warnings == ()
    assert fit.temperature_coefficient is not None


def test_a_temperature_that_goes_with_gravity_is_left_out():
    sets, _ = noisy_sets("leg", np.random.default_rng(31))
    sets = [replace(one, temperature=25.0 + one.gravity[:, 0]) for one in sets]
    fit = calibrate_in_situ(sets)
    assert fit.temperature_coefficient is None
    assert any("went with gravity" in warning for warning in fit.warnings)


def warmed(ramps, drift):
    """Sets of the leg whose temperature follows a path in K each while the offset drifts, and both rates."""
    rng = np.random.default_rng(81)
    sets, _ = noisy_sets("leg", rng, n=1500)
    per_kelvin, rate = 2.0 * rng.standard_normal(6), drift * rng.standard_normal(6)
    path = np.linspace(-7.5, 7.5, 1500)
    found = []
    for one, warmth in zip(sets, ramps(path), strict=True):
        raw = one.raw + np.outer(warmth, per_kelvin) + np.outer(path, rate)
        found.append(replace(one, raw=raw, temperature=25.0 + warmth))
    return found, per_kelvin, rate


def both_ways(path):
    return path, -path, path, -path


@pytest.mark.parametrize("cooling", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_temperature_that_goes_with_time_is_not_told_from_a_drift(cooling):
    """Where it only rises the coefficient takes the drift in, and that is said."""
    sets, per_kelvin, drift = warmed(both_ways if cooling else lambda path: [path] * 4, drift=2.0)
    fit = calibrate_in_situ(sets)
    assert any("The temperature went with time" in warning for warning in fit.warnings) != cooling
    taken = fit.temperature_coefficient - per_kelvin
    np.testing.assert_allclose(taken, 0.0 if cooling else drift, atol=0.3)
    assert abs(fit.limb.mass - SENSORS["leg"][1]) < 3.0 * fit.limb_mass_std


@pytest.mark.slow
def test_a_drift_that_hides_in_the_coefficients_of_single_sets_is_named_and_cured():
    sets, _, _ = warmed(both_ways, drift=10.0)
    with pytest.raises(CalibrationRefused, match="The offset drifted as the temperature changed") as refused:
        calibrate_in_situ(sets)
    assert "Let the sensor warm and cool within each set" in refused.value.cure
    swinging, _, _ = warmed(lambda path: [7.5 * np.sin(path + j) for j in range(4)], drift=10.0)
    for cured in (swinging, [replace(one, temperature=None) for one in sets]):
        fit = calibrate_in_situ(cured)
        assert abs(fit.limb.mass - SENSORS["leg"][1]) < 3.0 * fit.limb_mass_std


def test_the_temperature_of_a_leaning_fit_is_its_own():
    matrix, mass, com, _ = SENSORS["foot"]
    sets, _ = noisy_sets("foot", np.random.default_rng(23), n=1000, count=1)
    kelvin = 25.0 + 5.0 * np.sin(np.linspace(0.0, 9.0, 1000))
    warm = replace(sets[0], temperature=kelvin, raw=sets[0].raw + np.outer(kelvin, np.full(6, 4.0)))
    fit = calibrate_in_situ([warm], factory_matrix=matrix, limb=KnownLimb(mass, 0.005, com, 0.001))
    assert fit.temperature_reference == pytest.approx(kelvin.mean())
    np.testing.assert_allclose(fit.temperature_coefficient, 4.0, atol=0.8)


def test_spikes_and_gaps_are_left_out():
    rng = np.random.default_rng(10)
    sets, _ = noisy_sets("leg", rng)
    clean = calibrate_in_situ(sets)
    hurt = []
    for one in sets:
        raw = one.raw.copy()
        raw[rng.integers(0, 600, 10)] += 5000.0 * rng.standard_normal((10, 6))
        raw[100:110, 2] = np.nan
        hurt.append(replace(one, raw=raw))
    fit = calibrate_in_situ(hurt)
    assert fit.stats.dropped == 40
    assert fit.stats.gated >= 36
    assert any("disagree with all others were left out" in warning for warning in fit.warnings)
    assert np.abs(fit.limb.mass - clean.limb.mass) < 2.0 * clean.limb_mass_std


def test_a_drifting_offset_does_not_hurt():
    rng = np.random.default_rng(11)
    sets, offset = noisy_sets("foot", rng)
    ramp = np.linspace(-0.5, 0.5, 600)[:, None] * np.linalg.solve(
        SENSORS["foot"][0], [2.0, -1.0, 1.5, 0, 0, 0]
    )
    drifting = [replace(one, raw=one.raw + ramp) for one in sets]
    fit = calibrate_in_situ(drifting)
    steady = calibrate_in_situ(sets)
    apart = np.abs(fit.matrix - steady.matrix) / np.hypot(fit.matrix_std, steady.matrix_std)
    assert apart.max() < 3.0
    # The last set's offset is that at its end.
    np.testing.assert_allclose(fit.offset, offset + ramp[-1], atol=8.0 * fit.offset_std.max())


def test_a_moving_limb_shows_its_inertia_and_needs_no_rest():
    sets, inertia = moving_sets(np.random.default_rng(12), noise=0.0)
    fit = calibrate_in_situ(sets)
    np.testing.assert_allclose(fit.matrix, SENSORS["leg"][0], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(fit.limb.inertia, inertia, atol=1e-6)
    noisy, _ = moving_sets(np.random.default_rng(13), noise=1.0)
    fit = calibrate_in_situ(noisy)
    assert fit.limb.mass == pytest.approx(SENSORS["leg"][1], rel=0.005)
    assert abs(fit.limb.mass - SENSORS["leg"][1]) < 4.0 * fit.limb_mass_std


@pytest.mark.parametrize("own", [pytest.param(0.0, marks=pytest.mark.slow), 2.0])
def test_the_inertia_of_what_is_added_is_open_by_as_much_as_is_claimed(own):
    off = []
    for seed in range(2):
        sets, _ = moving_sets(np.random.default_rng([14, seed]), noise=0.1, own=own)
        fit = calibrate_in_situ(sets)
        off.append(errors(fit, "leg", 500.0) / np.sqrt(np.diag(fit.covariance)))
    # As a point it moved the limb's first moment by four deviations.
    assert np.sqrt(np.mean(np.square(off), axis=0)).max() < 2.0


def test_a_slow_sweep_that_is_taken_as_rest_is_off_by_as_much_as_is_claimed():
    """The leg's own inertia, which no residual shows; with its motion it is as sure as noise lets it be."""
    rng = np.random.default_rng(71)
    matrix, mass, com, places = SENSORS["leg"]
    time = np.arange(1800) / 10.0
    angles = np.radians([45.0, 35.0]) * np.sin(2.0 * np.pi * np.array([0.04, 0.03]) * time[:, None])
    inertia = mass * (com @ com * np.eye(3) - np.outer(com, com))
    still, moving = [], []
    for added, place in zip(ADDED_MASS, places, strict=True):
        turn = Rotation.from_euler("xy", angles + rng.uniform(-0.1, 0.1, 2))
        gravity = turn.inv().apply([0.0, 0.0, 9.81])
        omega = (turn[:-1].inv() * turn[1:]).as_rotvec() / 0.1
        omega = np.concatenate([omega, omega[-1:]])
        alpha = np.gradient(omega, time, axis=0)
        moment = mass * com + added * place
        total = inertia + added * (place @ place * np.eye(3) - np.outer(place, place))
        force = (mass + added) * gravity - np.cross(alpha, moment) - np.cross(omega, np.cross(omega, moment))
        torque = np.cross(moment, gravity) - alpha @ total - np.cross(omega, omega @ total)
        wrench = np.concatenate([force, torque], axis=1) + 0.01 * NOISE * rng.standard_normal((1800, 6))
        still.append(InSituSet(wrench @ np.linalg.inv(matrix).T, gravity, added, place, time=time))
        moving.append(replace(still[-1], angular_velocity=omega, angular_acceleration=alpha))
    fit, sure = calibrate_in_situ(still), calibrate_in_situ(moving)
    off = [(one.matrix - matrix) / one.matrix_std for one in (fit, sure)]
    assert 0.2 < np.sqrt(np.mean(off[0] ** 2)) < 2.0
    assert abs(fit.limb.mass - mass) < 2.0 * fit.limb_mass_std
    assert sure.limb_mass_std < 0.5 * fit.limb_mass_std


def test_leans_on_the_factory_matrix_where_one_set_shows_nothing():
    matrix, mass, com, _ = SENSORS["foot"]
    rng = np.random.default_rng(14)
    aged = matrix * (1.0 + 0.15 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]))[:, None]
    sets, offset = noisy_sets("foot", rng, n=3000, count=1)
    limb = KnownLimb(mass, 0.01 * mass, com, 0.002)
    fit = calibrate_in_situ(sets, factory_matrix=aged, limb=limb)
    assert fit.result is FitResult.PARTLY_DETERMINED
    assert any("leans on the factory matrix" in warning for warning in fit.warnings)
    fresh, _ = noisy_sets("foot", np.random.default_rng(15), noise=0.0, count=1)
    expected = fresh[0].gravity @ wrench_of_gravity(mass, com).T
    ours = np.std(fit.wrench(fresh[0].raw) - expected, axis=0)
    theirs = np.std((fresh[0].raw - offset) @ aged.T - expected, axis=0)
    assert (ours[:3] < 0.5 * theirs[:3]).all()


@pytest.mark.slow
def test_a_good_factory_matrix_helps_and_a_bad_one_does_not_hurt():
    matrix = SENSORS["foot"][0]
    near = np.diag([1.01, 0.99, 1.01, 0.99, 1.01, 0.99]) @ matrix
    far = np.diag([1.3, 0.8, 1.2, 0.7, 1.3, 0.8]) @ matrix
    sums = np.zeros(3)
    options = InSituOptions(hysteresis=False)
    for seed in range(3):
        sets, _ = noisy_sets("foot", np.random.default_rng([16, seed]), n=300, noise=4.0)
        for i, factory in enumerate((None, near, far)):
            fit = calibrate_in_situ(sets, factory_matrix=factory, options=options)
            sums[i] += np.linalg.norm((fit.matrix - matrix) / matrix.std(axis=1, keepdims=True))
    assert sums[1] < 0.7 * sums[0]
    assert sums[2] < 1.2 * sums[0]


def test_what_the_data_know_is_not_drawn_to_an_aged_factory_matrix():
    matrix = SENSORS["leg"][0]
    rng = np.random.default_rng(26)
    aged = matrix * (1.0 + 0.2 * rng.standard_normal(matrix.shape))
    # One axis that agrees by chance changes nothing.
    aged[0] = 1.02 * matrix[0]
    sets, _ = noisy_sets("leg", rng, n=1000)
    alone, beside = calibrate_in_situ(sets), calibrate_in_situ(sets, factory_matrix=aged)
    assert beside.result is FitResult.DETERMINED
    assert not beside.warnings
    assert beside.limb.mass == pytest.approx(alone.limb.mass, abs=0.1 * alone.limb_mass_std)
    assert beside.limb_mass_std == pytest.approx(alone.limb_mass_std, rel=0.02)


@pytest.mark.parametrize("walk", [pytest.param(0.0, marks=pytest.mark.slow), 0.3])
def test_a_known_limb_counts_for_as_much_as_it_is_sure(walk):
    rng = np.random.default_rng(27)
    sets, _ = noisy_sets("leg", rng, n=1000)
    # What hangs together in time makes readings less sure, and not what was known before.
    steps = [walk * np.cumsum(rng.standard_normal((1000, 6)), axis=0) for _ in sets]
    sets = [replace(one, raw=one.raw + step) for one, step in zip(sets, steps, strict=True)]
    alone = calibrate_in_situ(sets).limb_mass_std
    known = calibrate_in_situ(sets, limb=KnownLimb(SENSORS["leg"][1], alone)).limb_mass_std
    assert known == pytest.approx(alone / np.sqrt(2.0), rel=0.05)


def lagging(wrench, share, scale, first=None):
    """A Prandtl-Ishlinskii element of its own make: plays at thresholds of ratio 3, from a first load on."""
    slack = scale * 3.0 ** -np.arange(1.0, 7.0)
    play, read = (wrench[0] if first is None else first)[:, None] * np.ones(6), np.empty_like(wrench)
    for i, load in enumerate(wrench):
        play = np.clip(play, load[:, None] - slack, load[:, None] + slack)
        read[i] = load + share * np.log2(3.0) * (play - load[:, None]).sum(axis=1)
    return read


def lagging_sets(read_load, noise, gravity=None, seed=17):
    """Sets of the paper, slowly swept, of a leg that reads loads as it will."""
    matrix, mass, com, places = SENSORS["leg"]
    rng, gravity = np.random.default_rng(seed), swept_gravity(1500) if gravity is None else gravity
    sets = []
    for added, place in zip(ADDED_MASS, places, strict=True):
        wrench = gravity @ (wrench_of_gravity(mass, com) + wrench_of_gravity(added, place)).T
        load = read_load(wrench) + noise * NOISE * rng.standard_normal(wrench.shape)
        raw, time = load @ np.linalg.inv(matrix).T, np.arange(len(gravity)) / 10.0
        sets.append(InSituSet(raw, gravity, added, place, time=time))
    return sets


def in_loops(wrench):
    return lagging(wrench, 0.015, np.array([50.0, 50.0, 50.0, 10.0, 10.0, 2.0]))


def test_hysteresis_is_fitted_and_does_not_bias_the_limb():
    mass, sets = SENSORS["leg"][1], lagging_sets(in_loops, noise=0.1)
    fit, plain = calibrate_in_situ(sets), calibrate_in_situ(sets, options=InSituOptions(hysteresis=False))
    assert fit.hysteresis is not None
    assert plain.hysteresis is None
    np.testing.assert_allclose(fit.hysteresis[:2], 0.015, rtol=0.4)
    assert abs(fit.limb.mass / mass - 1.0) < 0.5 * abs(plain.limb.mass / mass - 1.0)
    assert fit.stats.residual_rms < 0.5 * plain.stats.residual_rms
    assert fit.delay == 0.0


def creeping(wrench, share, times, dt=0.1):
    """Loads and what they crept, by exponentials that each add a share in the end; in use for long before."""
    read, at = wrench.copy(), np.tile(wrench.mean(axis=0), (len(times), 1))
    decay = np.exp(-dt / np.array(times))[:, None]
    for i, load in enumerate(wrench):
        at = load + decay * (at - load)
        read[i] += share * at.sum(axis=0)
    return read


def with_backlash(wrench, share=0.03):
    half = 0.5 * share * np.array([30.0, 38.0, 12.0, 8.0, 7.0, 1.7])
    read, at = np.empty_like(wrench), np.zeros(6)
    for i, load in enumerate(wrench):
        read[i] = at = np.clip(at, load - half, load + half)
    return read


def raster(n=1500):
    """Gravity while a hip turns to both sides once and sweeps from front to back meanwhile."""
    share = np.linspace(0.0, 1.0, n)
    a, b = (
        np.radians(35.0) * np.sin(2.0 * np.pi * 15.0 * share),
        np.radians(45.0) * np.sin(2.0 * np.pi * share),
    )
    return 9.81 * np.stack([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)], axis=-1)


@pytest.mark.parametrize(
    ("read_load", "gravity", "share"),
    [
        # Neither time constant is one of the law's.
        (lambda wrench: creeping(wrench, 0.005, (10.0, 100.0)), None, 0.0015),
        (with_backlash, raster(), 0.03),
    ],
)
def test_a_sensor_that_lags_is_as_sure_as_it_is_right(read_load, gravity, share):
    fit = calibrate_in_situ(lagging_sets(read_load, noise=0.3, gravity=gravity, seed=42))
    np.testing.assert_allclose(fit.hysteresis[:5], share, rtol=0.35)
    assert fit.limb.mass == pytest.approx(SENSORS["leg"][1], rel=0.003)
    off = errors(fit, "leg", 0.0)
    scale = np.sqrt(np.diag(fit.covariance))
    nees = off / scale @ np.linalg.solve(fit.covariance / np.outer(scale, scale), off / scale)
    assert nees / len(off) < 3.0


def test_a_late_imu_is_told_from_hysteresis():
    # It cancels part of a loop, and what is left is wrong by as much.
    fit = calibrate_in_situ([read_late(one, 0.06) for one in lagging_sets(in_loops, noise=0.3)])
    assert fit.delay == pytest.approx(0.06, abs=0.01)
    assert fit.hysteresis is not None
    assert fit.limb.mass == pytest.approx(SENSORS["leg"][1], rel=0.005)
    assert any("The IMU is late by" in warning for warning in fit.warnings)


def read_late(one, late):
    """A set without its first second, whose gravity is that of before."""
    time = one.time[10:]
    before = np.stack([np.interp(time - late, one.time, column) for column in one.gravity.T], axis=1)
    return replace(one, raw=one.raw[10:], gravity=before, time=time)


@pytest.mark.parametrize("share", [0.005, pytest.param(0.02, marks=pytest.mark.slow)])
def test_an_axis_that_swings_little_about_a_large_load_is_unsure_of_its_offset(share):
    """A foot's vertical force: how it came there from zero, where the offset is, no small swing shows."""
    matrix, rng = SENSORS["foot"][0], np.random.default_rng(41)
    response, scale = np.linalg.inv(matrix), np.array([30.0, 30.0, 30.0, 3.0, 3.0, 3.0])
    sets, offset = paper_sets("foot", rng, n=600)
    read = []
    for one in sets:
        load = lagging((one.raw - offset) @ matrix.T, share, scale[:, None], np.zeros(6))
        load += 0.2 * NOISE * rng.standard_normal(load.shape)
        read.append(replace(one, raw=load @ response.T + offset, time=np.arange(600) / 10.0))
    fit = calibrate_in_situ(read)
    spread = matrix @ fit.covariance[fit.columns.offset, fit.columns.offset] @ matrix.T
    off = np.abs(matrix @ (fit.offset - offset)) / np.sqrt(np.diag(spread))
    assert (off < 2.5).all()
    assert off[2] > 0.4


def test_channels_that_lag_are_no_loads_that_lag():
    matrix = SENSORS["leg"][0]

    def read_load(wrench):
        return lagging(wrench @ np.linalg.inv(matrix).T, 0.015, np.full(6, 20000.0)) @ matrix.T

    fit = calibrate_in_situ(lagging_sets(read_load, noise=0.1))
    assert fit.hysteresis is None
    assert (fit.channel_hysteresis > 0.005).all()
    assert fit.limb.mass == pytest.approx(SENSORS["leg"][1], rel=0.015)
    assert fit.stats.residual_rms < 10.0  # where the loops are 300 counts wide


@pytest.mark.parametrize(("seed", "samples"), [([1, 0], 600)])
def test_no_hysteresis_is_seen_where_there_is_none(sensor, seed, samples):
    sets, _ = noisy_sets(sensor, np.random.default_rng(seed), n=samples)
    fit, plain = calibrate_in_situ(sets), calibrate_in_situ(sets, options=InSituOptions(hysteresis=False))
    assert fit.hysteresis is None
    assert fit.channel_hysteresis is None
    # A delay is less sure beside loops that might be there.
    np.testing.assert_allclose(np.diag(fit.covariance), np.diag(plain.covariance), rtol=0.01)


def test_arguments_are_left_alone():
    sets, _ = noisy_sets("foot", np.random.default_rng(19), n=200)
    before = [one.raw.copy() for one in sets]
    first, second = calibrate_in_situ(sets), calibrate_in_situ(sets)
    for one, raw in zip(sets, before, strict=True):
        np.testing.assert_array_equal(one.raw, raw)
    np.testing.assert_array_equal(first.matrix, second.matrix)


@pytest.mark.parametrize("scale", [pytest.param(1.0, marks=pytest.mark.slow), 1.1])
def test_a_matrix_that_leans_reports_how_sure_its_rows_are(scale):
    matrix, mass, com, _ = SENSORS["foot"]
    limb = KnownLimb(mass, 0.005 * mass, com, 0.001)
    # Along what was seen: the limb's own wrench.
    seen = np.linalg.solve(matrix, wrench_of_gravity(mass, com))
    scores = []
    for seed in range(2):
        sets, _ = noisy_sets("foot", np.random.default_rng([20, seed]), n=1000, count=1)
        # The rows lean by a rule of their own, whatever the shares of the fit that finds the limb.
        options = InSituOptions(factory_std=(0.1,) * 6)
        fit = calibrate_in_situ(sets, factory_matrix=scale * matrix, limb=limb, options=options)
        error = (fit.matrix - matrix) @ seen
        rows = [fit.columns.row(axis) for axis in range(3)]
        spread = np.array([np.diag(seen.T @ fit.covariance[row, row] @ seen) for row in rows])
        scores.append(np.abs(error[:3]) / np.sqrt(spread + (0.005 * mass) ** 2))
    assert np.median(scores) < 3.0


def test_few_samples_show_no_hysteresis():
    rng = np.random.default_rng(21)
    for _ in range(2):
        sets, _ = noisy_sets("leg", rng, n=12)
        fit = calibrate_in_situ(sets, accept="few samples")
        assert fit.hysteresis is None


def test_one_thread_solves_and_the_others_come_back(monkeypatch):
    module = sys.modules[calibrate_in_situ.__module__]
    fit, seen = module.fit_of, []

    def watched(*given):
        seen.extend(one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas")
        return fit(*given)

    monkeypatch.setattr(module, "fit_of", watched)
    with threadpool_limits(limits=2, user_api="blas"):
        calibrate_in_situ(paper_sets("leg", np.random.default_rng(0), n=50, noise=0.001)[0])
        after = [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]
    assert set(seen) == {1}
    assert set(after) == {2}


@pytest.mark.slow
def test_many_samples_take_little_memory():
    """960,000 samples in 16 sets, which hold 69 MB."""
    sets = 4 * noisy_sets("leg", np.random.default_rng(28), n=60_000)[0]
    tracemalloc.start()
    calibrate_in_situ(sets)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100e6
