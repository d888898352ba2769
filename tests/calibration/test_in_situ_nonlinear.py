"""A polynomial on top of the linear map: what it is worth, where it counts, and when it stays away."""

from dataclasses import replace

import numpy as np
import pytest
from _in_situ import SENSORS, moving_sets, noisy_sets, random_gravity
from _in_situ_stacked import wrench_of_gravity

from surefoot.calibration.in_situ import (
    InSituFit,
    InSituOptions,
    InSituTracker,
    KnownLimb,
    NonlinearMap,
    calibrate_in_situ,
)
from surefoot.calibration.in_situ.held_out import with_nonlinear
from surefoot.calibration.in_situ.nonlinear import FADED, Products
from surefoot.calibration.results import CalibrationRefused, FitResult

AUTO = InSituOptions(nonlinear="auto")
MATRIX, MASS, COM, PLACES = SENSORS["leg"]
LIMB = KnownLimb(MASS, 0.01, COM, 0.002)
FULL_SCALE = np.repeat([60.0, 12.0], 3)


def bend(wrench, rng):
    """What a sensor adds to a wrench: cubic terms of 4 % and products of two axes."""
    cubic, cross = rng.choice([-0.04, 0.04], 6), rng.uniform(-0.01, 0.01, (6, 6, 6))
    u = wrench / FULL_SCALE
    off = 2.6 * cubic * (u - u**3) + np.einsum("abc,nb,nc->na", cross, u, u)
    return FULL_SCALE * off


def bent_sets(seed, count=4, **of_sets):
    """Sets of a leg's sensor that is not linear, and what it reads of wrenches without noise."""
    sets, offset = noisy_sets("leg", np.random.default_rng([60, seed]), n=1200, count=count, **of_sets)
    response, found = np.linalg.inv(MATRIX), []
    for one in sets:
        wrench = (
            one.gravity @ (wrench_of_gravity(MASS, COM) + wrench_of_gravity(one.added_mass, one.added_com)).T
        )
        off = bend(wrench, np.random.default_rng([61, seed]))
        found.append(replace(one, raw=one.raw + off @ response.T))
    return found, lambda w: (w + bend(w, np.random.default_rng([61, seed]))) @ response.T + offset


def error(fit: InSituFit, read, wrench) -> tuple[float, float]:
    """Force errors about their mean in N, rms: of the fit, and of its linear map alone."""
    raw = read(wrench)
    off = [(one.wrench(raw) - wrench)[:, :3] for one in (fit, replace(fit, nonlinear=None))]
    return tuple(float(np.sqrt(np.mean((e - e.mean(axis=0)) ** 2))) for e in off)


@pytest.mark.slow
def test_other_masses_are_read_better_and_the_fit_says_by_how_much():
    rng = np.random.default_rng(62)
    better, claimed = [], []
    for seed in range(4):
        sets, read = bent_sets(seed)
        fit = calibrate_in_situ(sets, limb=LIMB, options=AUTO)
        assert fit.result is FitResult.DETERMINED
        added = wrench_of_gravity(MASS, COM) + wrench_of_gravity(0.5, np.mean(PLACES[1:], axis=0))
        posture = sets[0].gravity[rng.integers(0, 1200, 300)]
        bent, linear = error(fit, read, posture @ added.T)
        better.append(bent / linear)
        before, after = np.linalg.norm(fit.nonlinear.held_out_rms[:, :3], axis=1)
        claimed.append(after / before)
        assert (fit.nonlinear.held_out_worst > fit.nonlinear.held_out_rms).all()
        assert any("a polynomial corrects" in warning for warning in fit.warnings)
        assert not any("weigh the limb" in warning for warning in fit.warnings)
    assert np.max(better) < 1.0
    assert np.mean(better) < 0.6
    assert np.mean(claimed) < 0.8


@pytest.mark.parametrize("seed", range(3))
def test_a_linear_sensor_stays_linear(seed):
    sets, _ = noisy_sets("leg", np.random.default_rng([63, seed]), n=1200)
    fit, plain = calibrate_in_situ(sets, options=AUTO), calibrate_in_situ(sets)
    assert fit.nonlinear is None
    np.testing.assert_array_equal(fit.matrix, plain.matrix)
    assert fit.warnings[-1].startswith("No polynomial predicted what took no part")


def test_without_it_such_a_sensor_is_refused():
    sets, _ = bent_sets(0)
    with pytest.raises(CalibrationRefused, match="the limb bends as it turns, or the sensor is not linear"):
        calibrate_in_situ(sets, limb=LIMB)


def test_without_the_limbs_weight_the_scale_is_in_doubt_and_said_to_be():
    sets, _ = bent_sets(5)
    fit = calibrate_in_situ(sets, options=AUTO)
    assert fit.warnings[-1].startswith("Added masses do not show the scale of a sensor that is not linear")
    assert abs(fit.limb.mass - MASS) < 3.0 * fit.limb_mass_std


@pytest.fixture(scope="module")
def bent() -> tuple[InSituFit, list]:
    sets, _ = bent_sets(6)
    return calibrate_in_situ(sets, limb=LIMB, options=InSituOptions(nonlinear=3)), sets


def at(found: NonlinearMap, z):
    return found.products.of_components(z) @ found.coefficients.T


def test_beyond_the_calibrated_readings_it_fades_to_the_linear_map(bent):
    fit, sets = bent
    found, rng = fit.nonlinear, np.random.default_rng(64)
    direction = rng.standard_normal((4000, 6))
    border = np.linalg.solve(found.products.ellipsoid, direction.T).T
    border /= np.linalg.norm(border @ found.products.ellipsoid.T, axis=1, keepdims=True)
    inside = np.abs(at(found, border * rng.uniform(0.0, 1.0, (4000, 1)) ** (1.0 / 6.0)))
    on = np.abs(at(found, border))
    most = np.maximum(inside.max(axis=0), on.max(axis=0))
    for beyond in (1.01, 1.1, 1.2):
        assert (np.abs(at(found, beyond * border)) <= on * (1.0 + 1e-12)).all()
        assert (np.abs(at(found, beyond * border)) <= most).all()
    for edge in (1.0, FADED):
        step = at(found, (edge + 1e-9) * border) - at(found, (edge - 1e-9) * border)
        assert np.abs(step).max() < 1e-6 * most.max()
    np.testing.assert_array_equal(at(found, FADED * border * rng.uniform(1.0, 1e6, (4000, 1))), 0.0)
    # Readings themselves: all that were calibrated lie within, and far beyond the map is linear.
    above = np.concatenate([one.raw - o for one, o in zip(sets, fit.offsets, strict=True)])
    distance = np.linalg.norm(found.products.components(above) @ found.products.ellipsoid.T, axis=1)
    assert np.quantile(distance, 0.99) < 1.0
    far = fit.offset + 100.0 * (above - above.mean(axis=0))
    np.testing.assert_array_equal(fit.wrench(far), (far - fit.offset) @ fit.matrix.T)


def test_it_leaves_the_best_affine_map_as_it_is(bent):
    fit, sets = bent
    above = np.concatenate([one.raw - o for one, o in zip(sets, fit.offsets, strict=True)])
    added = fit.nonlinear.wrench(above)
    affine = np.linalg.lstsq(np.column_stack([np.ones(len(above)), above]), added, rcond=None)[0]
    left = np.column_stack([np.ones(len(above)), above]) @ affine
    assert np.std(left, axis=0).max() < 0.05 * np.std(added, axis=0).max()


def test_a_constant_product_and_one_axis_alone():
    z = np.random.default_rng(65).standard_normal((500, 6)) * [1.0, 1.0, 1.0, 1.0, 1.0, 0.0]
    products = Products.of(z, np.eye(6), 2)
    found = products.of_components(products.components(z))
    assert found.shape == (500, 21)
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_array_equal(found[:, [5, 10, 14, 17, 19, 20]], 0.0)
    np.testing.assert_allclose(products.of_components(np.zeros(6)), -products.affine[0], atol=1e-15)


@pytest.mark.slow
def test_a_moving_limb_and_eight_channels():
    sets, _ = moving_sets(np.random.default_rng(66), 1.0)
    assert calibrate_in_situ(sets, options=AUTO).nonlinear is None
    sets, _ = bent_sets(7)
    mixed = np.random.default_rng(67).standard_normal((8, 6)) * 0.3
    wide = [replace(one, raw=one.raw @ mixed.T) for one in sets]
    fit, narrow = (calibrate_in_situ(of, limb=LIMB, options=AUTO) for of in (wide, sets))
    np.testing.assert_allclose(fit.wrench(wide[0].raw), narrow.wrench(sets[0].raw), atol=0.3)
    assert fit.nonlinear.degrees == narrow.nonlinear.degrees


@pytest.mark.parametrize("given", [1, 4, "yes", True])
def test_other_degrees_are_refused(given):
    with pytest.raises(ValueError, match=r"'nonlinear' must be None, 'auto' or one of \(2, 3\), got"):
        InSituOptions(nonlinear=given)


def test_where_wider_tolerances_do_not_help_the_linear_fit_says_why():
    def answer(sets, options):
        raise CalibrationRefused("It bends." if options == InSituOptions() else "An axis is unseen.", "")

    with pytest.raises(CalibrationRefused, match="It bends"):
        with_nonlinear((), AUTO, answer, weighed=False)


@pytest.mark.slow
def test_a_limb_that_bends_is_no_sensor_that_is_not_linear():
    sets, _ = noisy_sets("leg", np.random.default_rng(68), n=1200)
    response = np.linalg.inv(MATRIX)
    soft = []
    for one, give in zip(sets, (0.0, 0.0, 0.03, 0.03), strict=True):
        g = one.gravity
        # A joint that gives way in two sets: the same wrench has another reading than in the others.
        extra = np.zeros((len(g), 6))
        extra[:, 3:] = give * MASS * 0.2 * g * g[:, [1, 2, 0]]
        soft.append(replace(one, raw=one.raw + extra @ response.T))
    with pytest.raises(CalibrationRefused):
        calibrate_in_situ(soft, options=AUTO)


def test_the_tracker_follows_a_linear_map(bent):
    fit, _ = bent
    with pytest.raises(ValueError, match=r"track dataclasses.replace\(fit, nonlinear=None\)"):
        InSituTracker(fit)
    InSituTracker(replace(fit, nonlinear=None)).update(
        fit.offset, random_gravity(np.random.default_rng(69), 1)[0], 0.01
    )
