"""A robot that stands still shows nothing of its scales."""

import numpy as np
import pytest
from _synthetic import DT, LAYOUT, MASS, NOMINAL

from surefoot.calibration import OnlineSetup
from surefoot.calibration.moment.blocks import Block
from surefoot.calibration.moment.columns import Columns, Spread, first_mean, first_variance
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.modes import FIRST_CHANCE
from surefoot.calibration.moment.state import Belief
from surefoot.calibration.moment.still import Still
from surefoot.calibration.moment.tare import Tare

T = 8 * DT
SETUP = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL, lag=0, dt=DT)
LOAD = np.array([0.1, 0.15, 0.12, 0.13, 0.1, 0.15, 0.12, 0.13])


def read(force):
    """A block of a robot whose channels read a constant."""
    empty = np.zeros((8, 0))
    return Block(np.tile(force, (8, 1)), np.ones((8, 8)), *(empty,) * 7, np.full(8, DT))


def follow(readings, config=None, rate=1.0, lost=None, hangs=()):
    """Follow blocks of readings; return the first belief, the last, the published map and the tares."""
    config = config or Moment()
    columns, spread = Columns.of(LAYOUT), Spread.of(SETUP, config)
    tare = Tare(SETUP, config, columns, spread)
    still = Still.of(columns, spread, tare.variance)
    mean, rng = first_mean(columns), np.random.default_rng(3)
    mean[columns.scale] *= 1.0 + 0.2 * rng.normal(size=8)
    covariance = np.diag(first_variance(columns, spread, config))
    first = belief = Belief(np.tile(mean, (3, 1)), np.tile(covariance, (3, 1, 1)), FIRST_CHANCE)
    published = mean[columns.map].copy()
    state, at = still.init(), np.arange(columns.drift.start, columns.drift.stop)
    tares = tare.init()._replace(rate=rate)
    for k, reading in enumerate(readings):
        covariance = belief.covariance.copy()
        covariance[:, at, at] += rate**2 * spread.walk[1] * T * published[columns.scale] ** 2
        belief, state, tares = still.take(
            read(reading), T * (k + 1), belief._replace(covariance=covariance), published, state, tares,
            np.zeros(8) if lost is None else lost,
        )  # fmt: skip
        if k in hangs:
            belief, published, tares, _ = tare.take(
                read(reading)._replace(swing=np.ones((9, 2))),
                T * (k + 1),
                belief,
                published,
                tares,
                np.zeros(8),
            )
    return columns, first, belief, published, tares


def drift(blocks, rate=1.0, seed=0):
    std = rate * Moment().offset_drift * np.sqrt(T / 60.0)
    return LOAD + np.cumsum(std * np.random.default_rng(seed).normal(size=(blocks, 8)), axis=0)


def force_of(belief, columns, reading, mode=0):
    """Mean and covariance of a r + b + u."""
    H, at = np.zeros((8, columns.size)), np.arange(8)
    H[at, at], H[at, 8 + at], H[at, 16 + at] = reading, 1.0, 1.0
    return H @ belief.mean[mode], H @ belief.covariance[mode] @ H.T


@pytest.mark.parametrize("rate", [0.3, 1.0, 3.0])
def test_drift_of_half_a_minute_is_no_error_of_scales(rate):
    """A force becomes less sure by what has drifted alone."""
    readings = drift(300, rate)
    columns, first, belief, published, tares = follow(readings, rate=rate)
    total = readings[-1] - readings[0]
    assert np.linalg.norm(total - tares.moved) < 0.4 * np.linalg.norm(total)
    for j in range(3):
        np.testing.assert_array_equal(belief.mean[j, columns.scale], first.mean[j, columns.scale])
        before, stated = force_of(first, columns, readings[0], j)
        after, covariance = force_of(belief, columns, readings[0] + tares.moved, j)
        np.testing.assert_allclose(after - before, published[columns.scale] * tares.moved, atol=1e-12)
        drifted = rate**2 * Moment().offset_drift ** 2 / 60.0 * 300 * T * published[columns.scale] ** 2
        np.testing.assert_allclose(covariance - stated, np.diag(drifted), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("hangs", [(0, 299), range(300)], ids=["before and after", "all the time"])
def test_a_tare_of_zeros_that_were_followed_says_nothing_of_scales(hangs):
    columns, first, belief, published, tares = follow(drift(300) - LOAD, hangs=hangs)
    _, _, tared, *_ = follow(drift(1) - LOAD, hangs=(0,))
    std, stated = (np.sqrt(np.diagonal(one.covariance[0]))[columns.scale] for one in (belief, tared))
    np.testing.assert_allclose(std, stated, rtol=0.01)
    np.testing.assert_allclose(
        belief.mean[0, columns.scale], first.mean[0, columns.scale], atol=0.02 * std.max()
    )
    np.testing.assert_array_equal(tares.moved, 0.0)
    reading = drift(300)[-1] - LOAD
    a, b, u = (published[part] for part in (columns.scale, columns.offset, columns.drift))
    np.testing.assert_allclose(a * reading + b + u, 0.0, atol=1e-12)


@pytest.mark.parametrize("change", ["step", "sway", "lean"])
def test_a_load_that_moves_tells_scales(change):
    time = T * np.arange(300)
    load = {"step": 0.05 * (time > 15.0), "sway": 0.03 * np.sin(time), "lean": 0.004 * time}[change]
    feet = np.repeat([1.0, -1.0], 4)
    *_, tares = follow(drift(300) + load[:, None] * feet)
    seen = (tares.moved - (drift(300)[-1] - drift(300)[0])) @ feet / 8.0
    assert abs(seen) < 0.25 * np.abs(load).max()


def test_covariances_stay_those_of_something():
    for seed in range(5):
        _, _, belief, *_ = follow(drift(400, seed=seed))
        for covariance in belief.covariance:
            np.testing.assert_allclose(covariance, covariance.T, atol=1e-18)
            assert np.linalg.eigvalsh(covariance).min() > -1e-15


def test_a_channel_that_is_out_is_not_followed_and_does_not_count():
    lost, readings = np.zeros(8), drift(200)
    lost[2], readings[:, 2] = 1.0, np.random.default_rng(1).normal(size=200)
    *_, tares = follow(readings, lost=lost)
    assert tares.moved[2] == 0.0
    assert np.all(tares.moved[lost < 0.5] != 0.0)


def test_sensors_that_do_not_drift_show_noise_and_nothing_else():
    readings = LOAD + 1e-4 * np.random.default_rng(0).normal(size=(100, 8))
    *_, tares = follow(readings, Moment(offset_drift=0.0))
    np.testing.assert_array_equal(tares.moved, 0.0)
