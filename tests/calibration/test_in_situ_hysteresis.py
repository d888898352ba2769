"""In-situ fits of sensors that lag behind their load."""

from dataclasses import replace

import numpy as np
import pytest
from _in_situ import ADDED_MASS, NOISE, SENSORS, errors, noisy_sets, paper_sets, swept_gravity
from _in_situ_stacked import wrench_of_gravity

from surefoot.calibration.in_situ import InSituOptions, InSituSet, calibrate_in_situ


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
    np.testing.assert_allclose(fit.hysteresis.share[:2], 0.015, rtol=0.4)
    assert abs(fit.limb.mass / mass - 1.0) < 0.5 * abs(plain.limb.mass / mass - 1.0)
    assert fit.stats.residual_rms < 0.5 * plain.stats.residual_rms
    assert fit.imu.delay == 0.0


def test_the_matrix_holds_at_the_ends_of_cycles_of_its_amplitude():
    """A limb swings its axes by 2 to 36 N; contact loads come from any direction."""
    fit, matrix = calibrate_in_situ(lagging_sets(in_loops, noise=0.1)), SENSORS["leg"][0]
    cycle = np.sin(np.linspace(0.0, 4.0 * np.pi, 400))[:, None]
    for axis, amplitude in enumerate(fit.hysteresis.amplitude):
        read = in_loops(cycle * amplitude * np.eye(6)[axis]) @ np.linalg.inv(matrix).T @ fit.matrix.T
        assert np.ptp(read[:, axis]) / 2.0 == pytest.approx(amplitude, rel=0.012)
    # Its gains in the air, where axes swing by less or more, are up to 3 % off that.
    assert np.max(np.abs(fit.hysteresis.swing_gain - 1.0)) > 0.01
    np.testing.assert_allclose(fit.matrix_in_air @ fit.response_in_air, np.eye(6), atol=1e-9)


def creeping(wrench, share=0.005, times=(10.0, 100.0), dt=0.1):
    """Loads and what they crept, by exponentials that each add a share in the end; in use for long before."""
    read, at = wrench.copy(), np.tile(wrench.mean(axis=0), (len(times), 1))
    decay = np.exp(-dt / np.array(times))[:, None]
    for i, load in enumerate(wrench):
        at = load + decay * (at - load)
        read[i] += share * at.sum(axis=0)
    return read


def with_backlash(wrench, share=0.01):
    half = 0.5 * share * np.array([30.0, 38.0, 12.0, 8.0, 7.0, 1.7])
    read, at = np.empty_like(wrench), np.zeros(6)
    for i, load in enumerate(wrench):
        read[i] = at = np.clip(at, load - half, load + half)
    return read


def in_channels(wrench):
    matrix = SENSORS["leg"][0]
    return lagging(wrench @ np.linalg.inv(matrix).T, 0.015, np.full(6, 20000.0)) @ matrix.T


RASTER = swept_gravity(1500, turns=(15.0, 1.0), begin=0.0)
"""A hip turns to both sides once and sweeps from front to back meanwhile."""


@pytest.mark.parametrize(
    ("read_load", "most"), [(creeping, 0.01), (with_backlash, 0.01), (in_channels, 0.08)]
)
@pytest.mark.parametrize("gravity", [None, pytest.param(RASTER, marks=pytest.mark.slow)])
def test_a_sensor_that_lags_by_another_law_is_weighed_as_well_as_claimed(read_load, most, gravity):
    """The fit has one law, loops of loads in proportion to the swing."""
    fit = calibrate_in_situ(lagging_sets(read_load, noise=0.3, gravity=gravity, seed=42), refuse=False)
    assert not any("The likeliest cause" in str(one) for one in (*fit.refusals, *fit.warnings))
    if not fit.refusals:
        assert fit.limb.mass == pytest.approx(SENSORS["leg"][1], rel=most)
        assert abs(fit.limb.mass - SENSORS["leg"][1]) < 3.5 * fit.limb_mass_std


@pytest.mark.parametrize("first", [None, np.zeros(6)])
def test_loops_begin_where_the_sets_show_it(first):
    def read_load(wrench):
        return lagging(wrench, 0.015, np.array([50.0, 50.0, 50.0, 10.0, 10.0, 2.0]), first)

    fit = calibrate_in_situ(lagging_sets(read_load, noise=0.1))
    # 22 counts by the other one.
    assert fit.stats.residual_rms < 20.0


def test_a_late_imu_is_told_from_hysteresis():
    # It cancels part of a loop, and what is left is wrong by as much.
    fit = calibrate_in_situ([read_late(one, 0.06) for one in lagging_sets(in_loops, noise=0.3)])
    assert fit.imu.delay == pytest.approx(0.06, abs=0.01)
    assert fit.hysteresis is not None
    assert fit.limb.mass == pytest.approx(SENSORS["leg"][1], rel=0.005)
    assert any("The IMU is late by" in warning for warning in fit.warnings)


def read_late(one, late):
    """A set without its first second, whose gravity is that of before."""
    time = one.time[10:]
    before = np.stack([np.interp(time - late, one.time, column) for column in one.gravity.T], axis=1)
    return replace(one, raw=one.raw[10:], gravity=before, time=time)


@pytest.mark.parametrize("share", [0.005, pytest.param(0.02, marks=pytest.mark.slow)])
def test_the_offset_of_an_axis_that_swings_little_about_a_large_load(share):
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
    off = np.abs(matrix @ (fit.offset - offset))
    assert (off < 2.5 * np.sqrt(np.diag(spread))).all()
    assert off[2] < 0.5 * share * 9.81 * SENSORS["foot"][1]


@pytest.mark.parametrize(("seed", "samples"), [([1, 0], 600)])
def test_no_hysteresis_is_seen_where_there_is_none(sensor, seed, samples):
    sets, _ = noisy_sets(sensor, np.random.default_rng(seed), n=samples)
    fit, plain = calibrate_in_situ(sets), calibrate_in_situ(sets, options=InSituOptions(hysteresis=False))
    assert fit.hysteresis is None
    # A delay is less sure beside loops that might be there.
    np.testing.assert_allclose(np.diag(fit.covariance), np.diag(plain.covariance), rtol=0.01)


def test_hysteresis_that_no_order_shows_is_allowed_for():
    sets, rng = lagging_sets(in_loops, noise=0.1), np.random.default_rng(18)
    orders = [rng.permutation(len(one.raw)) for one in sets]
    mixed = [
        replace(one, raw=one.raw[order], gravity=one.gravity[order], time=None)
        for one, order in zip(sets, orders, strict=True)
    ]
    fit, sure = calibrate_in_situ(mixed), calibrate_in_situ(mixed, options=InSituOptions(hysteresis=False))
    worst, too_sure = (
        np.max(np.abs(errors(one, "leg", one.offset)[-4:]) / np.sqrt(np.diag(one.covariance)[-4:]))
        for one in (fit, sure)
    )
    assert worst < 2.0
    assert too_sure > 4.0
    assert fit.limb_mass_std < 0.05 * fit.limb.mass
    assert fit.hysteresis is None
    assert any("noise or hysteresis" in words for words in fit.warnings)


def test_few_samples_show_no_hysteresis():
    rng = np.random.default_rng(21)
    for _ in range(2):
        sets, _ = noisy_sets("leg", rng, n=12)
        fit = calibrate_in_situ(sets, accept="few samples")
        assert fit.hysteresis is None
