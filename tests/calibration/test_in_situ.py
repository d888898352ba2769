"""The measurement-space fit of a six-axis sensor in its limb."""

import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from _in_situ import NOISE, SENSORS, errors, make_set, moving_sets, noisy_sets, paper_sets, swept_gravity
from _in_situ_stacked import wrench_of_gravity
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from threadpoolctl import threadpool_info, threadpool_limits

from surefoot.calibration.in_situ import InSituOptions, KnownLimb, calibrate_in_situ
from surefoot.calibration.results import CalibrationRefused, FitResult


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
    np.testing.assert_allclose(fit.imu.rotation, turn, atol=2e-3)
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
    np.testing.assert_allclose(fit.imu.rotation, turn, atol=5e-3)


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


def test_leans_on_the_factory_matrix_where_one_set_shows_nothing():
    matrix, mass, com, _ = SENSORS["foot"]
    rng = np.random.default_rng(14)
    aged = matrix * (1.0 + 0.15 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]))[:, None]
    sets, offset = noisy_sets("foot", rng, n=3000, count=1)
    limb = KnownLimb(mass, 0.01 * mass, com, 0.002)
    fit = calibrate_in_situ(sets, factory_matrix=aged, limb=limb)
    assert fit.result is FitResult.PARTLY_DETERMINED
    assert any("leans on the factory's matrix" in warning for warning in fit.warnings)
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
