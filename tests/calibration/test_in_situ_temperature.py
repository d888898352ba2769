"""In-situ fits of sensors whose temperature changes."""

from dataclasses import replace

import numpy as np
import pytest
from _in_situ import SENSORS, noisy_sets

from surefoot.calibration.in_situ import InSituOptions, KnownLimb, calibrate_in_situ


def test_finds_the_temperature_coefficient():
    sets, offset = noisy_sets("leg", np.random.default_rng(9))
    coefficient = np.array([5.0, -3.0, 2.0, 1.0, -4.0, 6.0])
    warmed = []
    for j, one in enumerate(sets):
        kelvin = 25.0 + 10.0 * np.sin(np.linspace(0.0, 3.0 + j, 600))
        warmed.append(replace(one, raw=one.raw + np.outer(kelvin, coefficient), temperature=kelvin))
    fit = calibrate_in_situ(warmed, options=InSituOptions(drift=False))
    np.testing.assert_allclose(fit.temperature.coefficient, coefficient, atol=0.6)
    # Offsets are those of the mean temperature.
    reference = np.mean([one.temperature for one in warmed])
    assert fit.temperature.reference == pytest.approx(reference)
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
    np.testing.assert_allclose(fit.temperature.gain, GAIN, atol=1.5e-4)
    assert fit.warnings == ()
    mass = SENSORS["leg"][1]
    assert abs(fit.limb.mass - mass) < 4.0 * fit.limb_mass_std
    # Readings of one load, cold and hot, are one wrench.
    cold, hot = fit.temperature.reference - 7.0, fit.temperature.reference + 7.0
    load = np.array([10.0, -20.0, 30.0, 1.0, -2.0, 0.5])
    for kelvin in (cold, hot):
        warmer = kelvin - fit.temperature.reference
        raw = fit.response @ (load * (1.0 + warmer * fit.temperature.gain)) + fit.offset
        raw = raw + warmer * fit.temperature.coefficient
        np.testing.assert_allclose(fit.wrench(raw, temperature=kelvin), load, rtol=1e-9)
        np.testing.assert_allclose(fit.at_reference(raw, kelvin), fit.response @ load + fit.offset, rtol=1e-9)
    assert np.linalg.norm(fit.matrix @ np.linalg.inv(SENSORS["leg"][0]) - np.eye(6)) < 0.05


def test_a_gain_that_stays_is_none():
    warmed, _ = warmed_sets(np.random.default_rng(30), np.zeros(6))
    fit = calibrate_in_situ(warmed)
    assert fit.temperature.gain is None
    assert fit.warnings == ()
    assert fit.temperature is not None


def test_a_temperature_that_goes_with_gravity_is_left_out():
    sets, _ = noisy_sets("leg", np.random.default_rng(31))
    sets = [replace(one, temperature=25.0 + one.gravity[:, 0]) for one in sets]
    fit = calibrate_in_situ(sets)
    assert fit.temperature is None
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
    taken = fit.temperature.coefficient - per_kelvin
    np.testing.assert_allclose(taken, 0.0 if cooling else drift, atol=0.3)
    assert abs(fit.limb.mass - SENSORS["leg"][1]) < 3.0 * fit.limb_mass_std


def test_the_temperature_of_a_leaning_fit_is_its_own():
    matrix, mass, com, _ = SENSORS["foot"]
    sets, _ = noisy_sets("foot", np.random.default_rng(23), n=1000, count=1)
    kelvin = 25.0 + 5.0 * np.sin(np.linspace(0.0, 9.0, 1000))
    warm = replace(sets[0], temperature=kelvin, raw=sets[0].raw + np.outer(kelvin, np.full(6, 4.0)))
    fit = calibrate_in_situ([warm], factory_matrix=matrix, limb=KnownLimb(mass, 0.005, com, 0.001))
    assert fit.temperature.reference == pytest.approx(kelvin.mean())
    np.testing.assert_allclose(fit.temperature.coefficient, 4.0, atol=0.8)
