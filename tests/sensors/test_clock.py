"""Chips with clocks of their own."""

import numpy as np
import pytest
from _streams import DT, stream

from surefoot.sensors import chain, quantize, white_noise
from surefoot.sensors.stages.clock import integrate, latest_conversion, sample_and_hold

SUBSTEPS = 10
WITHIN = (DT / SUBSTEPS) ** 2 * 94.0 / 4.0
"""By how much a mean over steps may differ from one over a straight line, in s."""


def ramps(steps: int, channels: int) -> np.ndarray:
    """Time itself as the signal, at the middle of each substep: a reading is the middle of its conversion."""
    times = np.arange(steps)[:, None] * DT + (np.arange(SUBSTEPS) + 0.5) * DT / SUBSTEPS
    return np.repeat(times[..., None], channels, axis=-1)


def converted(rate: tuple[float, float], steps: int, channels: int, seed: int = 0) -> np.ndarray:
    return stream(sample_and_hold(chain(), rate), ramps(steps, channels), seed)


def test_conversions_come_at_an_even_pace_within_the_rates() -> None:
    times = converted((78.0, 94.0), 400, 50)[3:]  # the first conversions began before the signal did
    for channel in times.T:
        moments = np.unique(channel[np.isfinite(channel)].round(9))
        periods = np.diff(moments)
        # A chip that is faster than the host has some conversions overwritten unread.
        period = np.median(periods[periods < 1.5 * periods.min()])
        np.testing.assert_allclose(periods, period * (periods / period).round(), atol=2 * WITHIN)
        assert 1 / 94 - WITHIN <= period <= 1 / 78 + WITHIN


def test_every_reading_is_the_latest_conversion() -> None:
    times = converted((78.0, 94.0), 200, 200)
    now = (np.arange(200) + 1)[:, None] * DT
    age = (now - times)[2:]
    # It ended up to a period ago, and its middle lies half a period before.
    assert (age >= 0.5 / 94 - WITHIN).all()
    assert age.max() < 1.5 / 78 + WITHIN
    assert age.mean() == pytest.approx(1.0 / 86, rel=0.05)


def test_chips_are_not_synchronised() -> None:
    times = converted((80.0, 80.0), 3, 2000)[-1]
    phase = (3 * DT - times) * 80.0 - 0.5
    counts, _ = np.histogram(phase, bins=5, range=(0.0, 1.0))
    assert counts.min() > 0.8 * 400


def test_a_chip_without_a_new_conversion_repeats_its_last_to_the_bit() -> None:
    rows = stream(sample_and_hold(white_noise(1.0), (40.0, 40.0)), ramps(40, 500), seed=1)
    fresh = np.diff(rows[4:], axis=0) != 0.0
    assert fresh.mean() == pytest.approx(0.5, abs=0.02)
    # At half the host's rate every other reading is new.
    assert (fresh[:-1] != fresh[1:]).all()


def test_before_its_first_conversion_a_chip_has_no_reading() -> None:
    first = converted((10.0, 10.0), 12, 300)
    assert np.isnan(first[0]).mean() == pytest.approx(1 - DT * 10, abs=0.06)
    assert np.isfinite(first[-1]).all()


@pytest.mark.parametrize("rate", [(78.0, 94.0), (190.0, 230.0), (9.0, 11.0)])
def test_a_conversion_is_the_mean_since_the_one_before(rate) -> None:
    """Of a signal that changes from substep to substep, held against sums over a fine grid."""
    rng, fine, steps, channels = np.random.default_rng(2), 200, 30, 40
    blocks = rng.normal(size=(steps, SUBSTEPS, channels))
    clock = sample_and_hold(chain(), rate)
    state = clock.init((channels,), rng)
    signal = np.repeat(blocks.reshape(-1, channels), fine, axis=0)
    grid = DT / SUBSTEPS / fine
    checked = 0
    for step in range(steps):
        number, at, _ = latest_conversion(state.period, state.due, DT)
        period = state.period
        held, state = clock.apply(blocks[step], state, rng, DT)
        for k in np.flatnonzero((number >= 0) & (step * DT + at >= period)):
            stop = (step * DT + at[k]) / grid
            start = stop - period[k] / grid
            assert held[k] == pytest.approx(signal[round(start) : round(stop), k].mean(), abs=0.03)
            checked += 1
    assert checked > 50


def test_the_integral_of_conversions_is_that_of_the_signal() -> None:
    """Nothing of the signal is lost between conversions, whatever the length of a block."""
    rng, period = np.random.default_rng(3), np.full(5, 0.013)
    due, charge = rng.uniform(0.0, 0.013, 5), np.zeros(5)
    total, counted = np.zeros(5), np.zeros(5)
    for _ in range(300):
        dt = rng.uniform(0.001, 0.0129)  # at most one conversion a block
        block = rng.normal(size=(rng.integers(1, 6), 5))
        number, at, due = latest_conversion(period, due, dt)
        mean, charge = integrate(block, charge, period, number, at, dt)
        total += block.mean(axis=0) * dt
        # The first one began before the signal did.
        counted += np.where(number >= 0.0, mean * period, 0.0)
    np.testing.assert_allclose(counted + charge, total, atol=1e-12)


def test_conversions_happen_after_the_instrument_not_before_the_hold() -> None:
    held = stream(sample_and_hold(quantize(0.01), (78.0, 94.0)), ramps(10, 8), seed=3)[-1]
    np.testing.assert_allclose(held, np.round(held / 0.01) * 0.01, atol=1e-12)


@pytest.mark.parametrize("rate", [(0.0, 80.0), (90.0, 80.0), (80.0, float("inf")), (80.0,)])
def test_impossible_rates_are_refused(rate) -> None:
    with pytest.raises(ValueError, match="'rate' must be"):
        sample_and_hold(chain(), rate)
