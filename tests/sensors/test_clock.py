"""Chips with clocks of their own."""

import numpy as np
import pytest

from surefoot.sensors import chain, quantize, white_noise
from surefoot.sensors.stages.clock import sample_and_hold

DT = 1 / 80
SUBSTEPS = 10


def ramp(step: int, channels: int) -> np.ndarray:
    """Time itself as the signal: a reading then says when it was converted."""
    times = step * DT + np.arange(1, SUBSTEPS + 1) * DT / SUBSTEPS
    return np.repeat(times[:, None], channels, axis=1)


def converted(rate: tuple[float, float], steps: int, channels: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    clock = sample_and_hold(chain(), rate)
    state = clock.init((channels,), rng)
    rows = []
    for step in range(steps):
        held, state = clock.apply(ramp(step, channels), state, rng, DT)
        rows.append(held)
    return np.array(rows)


def test_conversions_come_at_an_even_pace_within_the_rates() -> None:
    times = converted((78.0, 94.0), 400, 50)
    for channel in times.T:
        moments = np.unique(channel[np.isfinite(channel)].round(9))
        periods = np.diff(moments)
        # A chip that is faster than the host has some conversions overwritten unread.
        whole = periods / periods.min()
        np.testing.assert_allclose(whole, whole.round(), atol=1e-6)
        assert 1 / 94 - 1e-6 <= periods.min() <= 1 / 78 + 1e-6


def test_every_reading_is_the_latest_conversion() -> None:
    times = converted((78.0, 94.0), 200, 200)
    now = (np.arange(200) + 1)[:, None] * DT
    age = (now - times)[2:]
    assert (age >= -1e-12).all()
    assert age.max() < 1 / 78 + 1e-9
    assert age.mean() == pytest.approx(0.5 / 86, rel=0.05)


def test_chips_are_not_synchronised() -> None:
    times = converted((80.0, 80.0), 3, 2000)[-1]
    phase = (3 * DT - times) * 80.0
    counts, _ = np.histogram(phase, bins=5, range=(0.0, 1.0))
    assert counts.min() > 0.8 * 400


def test_a_chip_without_a_new_conversion_repeats_its_last_to_the_bit() -> None:
    rng = np.random.default_rng(1)
    clock = sample_and_hold(white_noise(1.0), (40.0, 40.0))
    state = clock.init((500,), rng)
    rows = []
    for step in range(40):
        held, state = clock.apply(ramp(step, 500), state, rng, DT)
        rows.append(held)
    fresh = np.diff(np.array(rows)[4:], axis=0) != 0.0
    assert fresh.mean() == pytest.approx(0.5, abs=0.02)
    # At half the host's rate every other reading is new.
    assert (fresh[:-1] != fresh[1:]).all()


def test_before_its_first_conversion_a_chip_has_no_reading() -> None:
    first = converted((10.0, 10.0), 12, 300)
    assert np.isnan(first[0]).mean() == pytest.approx(1 - DT * 10, abs=0.06)
    assert np.isfinite(first[-1]).all()


def test_between_substeps_the_signal_is_interpolated_from_the_end_of_the_block_before() -> None:
    """A straight line is read without error wherever a conversion falls, also before the first row."""
    rng = np.random.default_rng(2)
    clock = sample_and_hold(chain(), (78.0, 94.0))
    state = clock.init((300,), rng)
    for step in range(20):
        number = np.floor((DT - state.due) / state.period)
        expected = step * DT + state.due + number * state.period
        held, state = clock.apply(ramp(step, 300), state, rng, DT)
        if step:
            np.testing.assert_allclose(held[number >= 0], expected[number >= 0], atol=1e-12)


def test_conversions_happen_after_the_instrument_not_before_the_hold() -> None:
    rng = np.random.default_rng(3)
    clock = sample_and_hold(quantize(0.01), (78.0, 94.0))
    state = clock.init((8,), rng)
    for step in range(10):
        held, state = clock.apply(ramp(step, 8), state, rng, DT)
    np.testing.assert_allclose(held, np.round(held / 0.01) * 0.01, atol=1e-12)


@pytest.mark.parametrize("rate", [(0.0, 80.0), (90.0, 80.0), (80.0, float("inf")), (80.0,)])
def test_impossible_rates_are_refused(rate) -> None:
    with pytest.raises(ValueError, match="'rate' must be"):
        sample_and_hold(chain(), rate)
