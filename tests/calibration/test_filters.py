import numpy as np
import pytest
from scipy import signal

from surefoot.calibration import zero_phase
from surefoot.calibration.front_end.filters import low_pass

DT = 1.0 / 80.0


def run(values, cutoff=10.0):
    init, apply = low_pass(cutoff, DT)
    state, rows = init(values[0]), []
    for row in values:
        filtered, state = apply(row, state)
        rows.append(filtered)
    return np.stack(rows)


def test_the_stream_is_scipys_filter():
    values = np.random.default_rng(0).normal(size=(200, 3)) + 5.0
    b, a = signal.butter(2, 10.0, fs=80.0)
    start = signal.lfilter_zi(b, a)[:, None] * values[0]
    expected, _ = signal.lfilter(b, a, values, axis=0, zi=start)
    np.testing.assert_allclose(run(values), expected, atol=1e-12)


def test_a_constant_passes_unchanged_from_the_first_sample_on():
    np.testing.assert_allclose(run(np.full((50, 2), 7.0)), 7.0, atol=1e-12)


@pytest.mark.parametrize(("frequency", "power"), [(1.0, 1.0), (10.0, 0.5), (35.0, 0.0)])
def test_half_of_the_power_passes_at_the_cutoff(frequency, power):
    time = np.arange(4000) * DT
    values = np.sin(2 * np.pi * frequency * time)[:, None]
    passed = np.var(run(values)[400:]) / np.var(values[400:])
    assert passed == pytest.approx(power, abs=0.01)


def test_zero_phase_does_not_delay_and_the_stream_does():
    time = np.arange(800) * DT
    wave = np.sin(2 * np.pi * 2.0 * time)[:, None]
    causal, both_ways = run(wave), zero_phase(wave, 10.0, DT)
    middle = slice(200, 600)
    lags = np.arange(-8, 9)

    def best(filtered):
        match = [np.dot(np.roll(filtered[:, 0], -lag)[middle], wave[middle, 0]) for lag in lags]
        return lags[int(np.argmax(match))]

    assert best(both_ways) == 0
    assert best(causal) == 2  # sqrt(2) / (2 pi 10 Hz) = 23 ms


def test_zero_phase_bridges_gaps_and_leaves_them_missing():
    wave = np.sin(np.arange(300) * 0.05)[:, None] * np.ones(2)
    holed = wave.copy()
    holed[100:103, 0], holed[200, 1] = np.nan, np.inf
    filtered = zero_phase(holed, 10.0, DT)
    missing = ~np.isfinite(holed)
    assert np.isnan(filtered[missing]).all()
    np.testing.assert_allclose(filtered[~missing], zero_phase(wave, 10.0, DT)[~missing], atol=2e-3)


def test_a_channel_that_is_never_read_stays_missing():
    values = np.full((40, 2), np.nan)
    values[:, 0] = 1.0
    filtered = zero_phase(values, 10.0, DT)
    assert np.isnan(filtered[:, 1]).all()
    np.testing.assert_allclose(filtered[:, 0], 1.0)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 40.0, np.nan])
def test_a_cutoff_that_the_rate_cannot_carry_is_refused(cutoff):
    with pytest.raises(ValueError, match="'cutoff' must lie between 0 and half of the sample rate, 40 Hz"):
        low_pass(cutoff, DT)
    with pytest.raises(ValueError, match="'cutoff'"):
        zero_phase(np.zeros((30, 1)), cutoff, DT)


def test_a_time_step_that_is_none_is_refused():
    with pytest.raises(ValueError, match="'dt' must be a positive time"):
        low_pass(10.0, 0.0)
