"""How far the printed method is off: what its covariances claim, and what it gets wrong."""

import numpy as np
import pytest
from _in_situ import ADDED_MASS, SENSORS, make_set, offsets_of, paper_sets, swept_gravity, with_arrays

from surefoot.calibration.in_situ import estimate_matrix, estimate_offset

# Uncertainty


def test_covariance_of_the_offset_agrees_with_its_errors():
    rng, runs, n = np.random.default_rng(8), 600, 150
    matrix, mass, com, _ = SENSORS["foot"]
    offset = np.full(6, 500.0)
    clean = make_set(matrix, offset, (mass, com), (0.0, np.zeros(3)), swept_gravity(n))
    deviation = np.array([3.0, 1.0, 2.0, 4.0, 1.5, 2.5])
    nees = []
    for _ in range(runs):
        fit = estimate_offset(clean.raw + deviation * rng.standard_normal((n, 6)), clean.gravity)
        error = fit.offset - offset
        nees.append(error @ np.linalg.solve(fit.covariance, error))
    # The covariance has n - 4 degrees of freedom: the mean of Hotelling's T^2.
    free = n - 4
    expected = 6.0 * free / (free - 7.0)
    assert np.mean(nees) == pytest.approx(expected, abs=4.0 * np.sqrt(12.0 / runs) * 1.1)


def test_covariance_of_the_matrix_agrees_with_its_errors_while_noise_is_tiny():
    rng, runs = np.random.default_rng(9), 300
    matrix, mass, com, _ = SENSORS["foot"]
    sets, offset = paper_sets("foot", None, n=40)
    truth = np.concatenate([matrix.ravel(), [mass], mass * com])
    deviation = np.array([1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])  # N and N m, white
    nees = []
    for _ in range(runs):
        noisy = [
            with_arrays(
                one,
                one.raw + np.linalg.solve(matrix, (deviation * rng.standard_normal(one.raw.shape)).T).T,
                one.gravity,
            )
            for one in sets
        ]
        fit = estimate_matrix(noisy, offset)
        error = np.concatenate([fit.matrix.ravel(), [fit.limb.mass], fit.limb.mass_com]) - truth
        size = np.sqrt(np.diag(fit.covariance))
        nees.append(error / size @ np.linalg.solve(fit.covariance / np.outer(size, size), error / size))
    assert np.mean(nees) == pytest.approx(40.0, rel=0.05)


def test_four_samples_leave_no_scatter():
    gravity = 9.81 * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
    fit = estimate_offset(gravity @ np.arange(18.0).reshape(3, 6) ** 2 + 10.0, gravity)
    np.testing.assert_allclose(fit.offset, 10.0)
    assert np.isnan(fit.covariance).all()


# What the method gets wrong


def test_noise_in_the_readings_shrinks_the_limb_and_more_samples_do_not_help():
    masses = []
    for samples in (1000, 8000):
        sets, _ = paper_sets("leg", np.random.default_rng(10), n=samples, noise=0.01)
        masses.append(estimate_matrix(sets, offsets_of(sets)).limb.mass)
    assert max(masses) < 0.4 * 4.9
    assert masses[1] == pytest.approx(masses[0], rel=0.2)
    foot, _ = paper_sets("foot", np.random.default_rng(10), n=8000, noise=0.01)
    assert 0.85 * 0.6 < estimate_matrix(foot, offsets_of(foot)).limb.mass < 0.97 * 0.6


def test_neither_spheres_nor_added_masses_show_the_shrinking():
    sets, _ = paper_sets("leg", np.random.default_rng(11), n=8000, noise=0.003)
    found = offsets_of(sets)
    fit = estimate_matrix(sets, found)
    assert fit.limb.mass < 0.85 * 4.9
    for one, offset, added in zip(sets, found, ADDED_MASS, strict=True):
        force = fit.wrench(one.raw, offset)[:, :3]
        of_gravity = np.linalg.lstsq(one.gravity, force, rcond=None)[0]
        axes = np.linalg.svd(of_gravity, compute_uv=False)
        assert axes[0] / axes[2] < 1.04
        assert np.trace(of_gravity) / 3.0 - fit.limb.mass == pytest.approx(added, abs=0.1)
