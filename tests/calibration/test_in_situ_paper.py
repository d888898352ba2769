"""The in-situ paper as printed: Lemma 1, the offset, Lemma 2 and the matrix."""

import tracemalloc

import numpy as np
import pytest
from _in_situ import (
    ADDED_MASS,
    FOOT_MATRIX,
    SENSORS,
    make_set,
    offsets_of,
    paper_sets,
    random_gravity,
    with_arrays,
)
from _in_situ_stacked import estimate_matrix_stacked, estimate_offset_stacked
from _recordings import DATA, needs
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from surefoot.calibration.in_situ import estimate_matrix, estimate_offset

# Exactness, and the paper written out


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.01])
def test_factors_give_what_the_stacked_systems_give(sensor, noise):
    sets, _ = paper_sets(sensor, np.random.default_rng(1), noise=noise)
    found = offsets_of(sets)
    stacked = [estimate_offset_stacked(one.raw, one.gravity) for one in sets]
    np.testing.assert_allclose(found, stacked, rtol=1e-8)
    fit = estimate_matrix(sets, found, noise_margin=0.0)
    matrix, mass, moment, rank = estimate_matrix_stacked(sets, found)
    assert rank == 40
    np.testing.assert_allclose(fit.matrix, matrix, rtol=1e-8, atol=1e-8 * np.abs(matrix).min(axis=1).max())
    np.testing.assert_allclose(fit.limb.mass, mass, rtol=1e-8)
    np.testing.assert_allclose(fit.limb.mass_com, moment, rtol=1e-8)


def test_three_sets_of_the_paper_suffice(sensor):
    sets, offset = paper_sets(sensor, None)
    fit = estimate_matrix(sets[:3], offset)
    np.testing.assert_allclose(fit.limb.mass, SENSORS[sensor][1], rtol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    seed=st.integers(0, 10_000),
    counts=st.floats(-3.0, 6.0),
    mass=st.floats(-1.0, 1.5),
    zero=st.floats(-2.0, 2.0),
    samples=st.sampled_from([12, 40]),
)
def test_exact_whatever_the_units_and_the_weight(seed, counts, mass, zero, samples):
    rng = np.random.default_rng(seed)
    # A well-conditioned response with another magnitude in each channel; places of the size of the limb.
    scale = 10.0 ** (counts + rng.uniform(-1.0, 1.0, 6))
    left, right = Rotation.random(2, random_state=seed).as_matrix()
    mix = np.block([[left, 0.3 * np.eye(3)], [-0.3 * np.eye(3), right]])
    matrix = np.linalg.inv(scale[:, None] * mix)
    limb = (10.0**mass, rng.uniform(-0.1, 0.1, 3))
    offset = 10.0**zero * scale * 10.0**mass * 9.81 * rng.uniform(-1.0, 1.0, 6)
    added = [(0.0, np.zeros(3))]
    added += [
        (10.0**mass * share, axis * 0.3) for share, axis in zip([0.4, 0.5, 0.7], np.eye(3), strict=True)
    ]
    sets = [make_set(matrix, offset, limb, one, random_gravity(rng, samples)) for one in added]
    found = offsets_of(sets)
    size = scale * 10.0**mass * 9.81
    np.testing.assert_allclose(found / size, np.broadcast_to(offset / size, found.shape), atol=1e-9)
    fit = estimate_matrix(sets, found)
    np.testing.assert_allclose(fit.matrix * scale, matrix * scale, atol=1e-7)
    np.testing.assert_allclose(fit.limb.mass, limb[0], rtol=1e-7)


# What must not matter


def test_turning_the_sensor_frame_turns_the_result(sensor):
    sets, _ = paper_sets(sensor, np.random.default_rng(3), noise=0.003)
    R = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()
    turned = [with_arrays(one, one.raw, one.gravity @ R.T, R @ one.added_com) for one in sets]
    plain = offsets_of(sets)
    np.testing.assert_allclose(offsets_of(turned), plain, rtol=1e-9)
    fit, other = estimate_matrix(sets, plain), estimate_matrix(turned, plain)
    both = np.kron(np.eye(2), R)
    np.testing.assert_allclose(other.matrix, both @ fit.matrix, atol=1e-9 * np.abs(fit.matrix).max())
    np.testing.assert_allclose(other.limb.mass, fit.limb.mass, rtol=1e-9)
    np.testing.assert_allclose(other.limb.mass_com, R @ fit.limb.mass_com, rtol=1e-7)


def test_an_unknown_rotation_and_scale_of_the_accelerometer_leave_the_offset():
    sets, _ = paper_sets("foot", np.random.default_rng(4), noise=0.01)
    R = Rotation.from_rotvec([1.0, 0.2, -0.5]).as_matrix()
    plain = estimate_offset(sets[1].raw, sets[1].gravity).offset
    np.testing.assert_allclose(estimate_offset(sets[1].raw, -0.1 * sets[1].gravity @ R).offset, plain)


def test_a_bias_of_the_accelerometer_goes_into_the_offset():
    sets, offset = paper_sets("foot", None)
    bias = np.array([0.1, -0.2, 0.05])
    fit = estimate_offset(sets[0].raw, sets[0].gravity + bias)
    of_bias = SENSORS["foot"][1] * bias  # as a force
    np.testing.assert_allclose(FOOT_MATRIX[:3] @ (offset - fit.offset), of_bias, rtol=1e-6)


def test_samples_that_are_not_finite_are_left_out_and_arguments_untouched():
    sets, _ = paper_sets("foot", np.random.default_rng(5), noise=0.003)
    raw, gravity = sets[1].raw.copy(), sets[1].gravity.copy()
    raw[7, 2], gravity[11, 0] = np.nan, np.inf
    kept = np.delete(np.arange(len(raw)), [7, 11])
    raw_before, gravity_before = raw.copy(), gravity.copy()
    fit, clean = estimate_offset(raw, gravity), estimate_offset(raw[kept], gravity[kept])
    np.testing.assert_array_equal(fit.offset, clean.offset)
    holed = [sets[0], with_arrays(sets[1], raw, gravity), *sets[2:]]
    whole = [sets[0], with_arrays(sets[1], raw[kept], gravity[kept]), *sets[2:]]
    found = offsets_of(whole)
    np.testing.assert_array_equal(estimate_matrix(holed, found).matrix, estimate_matrix(whole, found).matrix)
    np.testing.assert_array_equal(raw, raw_before)
    np.testing.assert_array_equal(gravity, gravity_before)


# Lemma 1


def test_a_limb_that_bends_leaves_the_three_space():
    sets, _ = paper_sets("foot", np.random.default_rng(7))
    one = sets[1]
    # Bending moves the centre of mass with the load: the wrench has terms of second order.
    bent = (
        one.raw
        + 0.02
        * np.linalg.solve(
            FOOT_MATRIX, np.vstack([np.zeros((3, len(one.gravity))), (one.gravity**2).T / 9.81])
        ).T
    )
    left = estimate_offset(bent, one.gravity).affine_residual
    assert left > 10.0 * estimate_offset(one.raw, one.gravity).affine_residual


def test_a_zero_that_drifts_leaves_the_three_space():
    rng = np.random.default_rng(8)
    one = paper_sets("foot", rng)[0][0]
    noisy = one.raw + 5.0 * rng.standard_normal(one.raw.shape)
    # 4 N and 0.2 N m over the set, in no direction that gravity's readings have.
    ramp = np.linspace(-2.0, 2.0, len(noisy))[:, None] * np.linalg.solve(
        FOOT_MATRIX, [1, -1, 1, 0.05, 0, 0.05]
    )
    left = estimate_offset(noisy + ramp, one.gravity).affine_residual
    assert left > 2.0 * estimate_offset(noisy, one.gravity).affine_residual


def test_semi_axes_follow_from_the_response(sensor):
    sets, _ = paper_sets(sensor, None)
    fit = estimate_offset(sets[0].raw, sets[0].gravity)
    np.testing.assert_allclose(fit.basis.T @ fit.basis, np.eye(3), atol=1e-12)
    points = fit.coordinates(sets[0].raw) - fit.coordinates(fit.offset)
    on_sphere = np.linalg.solve(fit.response, points.T)
    np.testing.assert_allclose(np.linalg.norm(on_sphere, axis=0), 9.81, rtol=1e-9)


# More channels, more samples


def test_more_channels_than_six_get_the_smallest_matrix():
    rng = np.random.default_rng(18)
    response = rng.standard_normal((8, 6)) * [50.0, 50.0, 50.0, 3000.0, 3000.0, 3000.0]
    matrix, offset = np.linalg.pinv(response), rng.uniform(-3000.0, 3000.0, 8)
    _, mass, com, places = SENSORS["foot"]
    sets = [
        make_set(matrix, offset, (mass, com), one, random_gravity(rng, 50))
        for one in zip(ADDED_MASS, places, strict=True)
    ]
    fit = estimate_matrix(sets, offsets_of(sets))
    np.testing.assert_allclose(fit.matrix, matrix, atol=1e-9 * np.abs(matrix).max())


def test_a_quarter_of_a_million_samples_need_no_stack():
    sets, offset = paper_sets("foot", np.random.default_rng(19), n=30_000, noise=0.003)
    tracemalloc.start()
    try:
        estimate_matrix(sets * 2, np.tile(offset, (8, 1)))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 20e6  # the stacked system has 460 MB


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
        force = (one.raw - offset) @ fit.matrix[:3].T
        of_gravity = np.linalg.lstsq(one.gravity, force, rcond=None)[0]
        axes = np.linalg.svd(of_gravity, compute_uv=False)
        assert axes[0] / axes[2] < 1.04
        assert np.trace(of_gravity) / 3.0 - fit.limb.mass == pytest.approx(added, abs=0.1)


# A real foot


@needs("ft")
def test_a_real_foot_that_swings_has_the_offset_that_is_known_of_it():
    log = np.load(DATA / "ft" / "icub_right_foot_swing.npz")
    fit = estimate_offset(log["raw"], log["gravity"])
    force = log["factory_matrix"][:3] @ fit.offset
    np.testing.assert_allclose(force, [291.7, -78.7, 38.8], atol=0.4)
    assert fit.affine_residual < 0.08  # of some 4 N: noise, and a limb that moves
