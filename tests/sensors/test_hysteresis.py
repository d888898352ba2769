"""Hysteresis: as wide as specified at every amplitude, blind to speed, and forgetful of small loops."""

import _streams
import numpy as np
import pytest
from _refusals import refusals

from surefoot.sensors.stages.hysteresis import hysteresis

FULL = 80.0


def follow(element, loads, state=None):
    """Read loads one after the other, (n,) or (n, K); returns readings of the same shape and the state."""
    loads = np.asarray(loads, dtype=np.float64)
    read, state = _streams.follow(element, loads.reshape(len(loads), -1), state=state)
    return read.reshape(loads.shape), state


def cycles(amplitudes, means, count=2):
    """Swing between the ends and stop at mid-load on the way: (4 count, K)."""
    return np.concatenate([[means + amplitudes, means, means - amplitudes, means]] * count)


@pytest.mark.parametrize("share", [0.001, 0.01, 0.015])
@pytest.mark.parametrize("true_at", [0.03, 1.0])
def test_the_width_is_the_share_at_every_amplitude_about_every_mean(share, true_at):
    rng = np.random.default_rng(1)
    amplitudes = FULL * 10.0 ** rng.uniform(-4.0, 0.0, 500)
    means = rng.uniform(-FULL, FULL, 500)
    read, _ = follow(hysteresis(share, FULL, true_at=true_at), cycles(amplitudes, means))
    # The second cycle: the first one is still coming from where no load had been.
    falling, rising = read[5], read[7]
    np.testing.assert_allclose((falling - rising) / (2.0 * amplitudes), share, rtol=1e-6)


def test_loops_vanish_beneath_the_smallest_amplitude_and_stay_as_they_are_beyond_the_full_scale():
    element = hysteresis(0.01, FULL, smallest=0.125)
    read, _ = follow(element, cycles(FULL * np.array([0.0625, 0.03, 2.0, 5.0]), np.zeros(4)))
    width = read[5] - read[7]
    np.testing.assert_allclose(width, [0.0, 0.0, 0.02 * FULL, 0.02 * FULL], atol=1e-12)


@pytest.mark.parametrize("true_at", [0.25, 1.0])
def test_the_ends_of_the_chosen_cycle_read_true_and_the_slope_grows_by_the_share_an_octave(true_at):
    octaves = np.array([0.0, -1.0, -2.0, -5.0])
    amplitudes = FULL * true_at * 2.0**octaves
    read, _ = follow(hysteresis(0.01, FULL, true_at=true_at), cycles(amplitudes, np.zeros(4)))
    np.testing.assert_allclose((read[4] - read[6]) / (2.0 * amplitudes), 1.0 + 0.01 * octaves, rtol=1e-12)


def test_it_does_not_know_how_fast_the_load_came():
    """The same turning points, through any number of samples between them: the same readings there."""
    turns = np.random.default_rng(2).uniform(-FULL, FULL, 60)
    element = hysteresis(0.01, FULL)
    jumps, _ = follow(element, turns)
    slowly = np.interp(np.arange(59 * 37 + 1) / 37.0, np.arange(60), turns)
    crawled, _ = follow(element, slowly)
    np.testing.assert_allclose(crawled[::37], jumps, atol=1e-11)
    rng = np.random.default_rng(0)
    state = element.init((1,), rng)
    for load, step, expected in zip(turns, (1e-3, 1.0, 1e5, 0.0) * 15, jumps, strict=True):
        reading, state = element.apply(np.array([load]), state, rng, step)
        assert reading[0] == expected


def test_a_larger_swing_wipes_out_what_smaller_ones_left():
    rng = np.random.default_rng(3)
    element = hysteresis(0.01, FULL)
    wild = rng.uniform(-0.8 * FULL, 0.8 * FULL, (200, 50))
    after = np.concatenate([wild, np.full((1, 50), FULL), np.full((1, 50), -FULL), wild[:5]])
    read, state = follow(element, after)
    plain, untouched = follow(element, after[200:])
    np.testing.assert_allclose(read[200:], plain, atol=1e-12)
    np.testing.assert_allclose(state.plays, untouched.plays, atol=1e-12)


def test_minor_loops_close_on_the_major_one_and_leave_no_trace():
    element = hysteresis(0.01, FULL)
    start = [FULL, -FULL, 0.3 * FULL]
    read, without = follow(element, start)
    inner, with_loop = follow(element, [*start, 0.1 * FULL, 0.3 * FULL])
    assert inner[-1] == pytest.approx(read[-1], abs=1e-12)
    # Inside, the minor loop is a loop.
    opened, _ = follow(element, [*start, 0.2 * FULL, 0.1 * FULL, 0.2 * FULL])
    assert opened[-3] - opened[-1] == pytest.approx(0.01 * 0.2 * FULL)
    np.testing.assert_allclose(
        follow(element, [0.5 * FULL, FULL], with_loop)[0], follow(element, [0.5 * FULL, FULL], without)[0]
    )
    major, _ = follow(element, [FULL, -FULL, FULL, -FULL])
    np.testing.assert_array_equal(major[:2], major[2:])


def test_readings_grow_with_the_load():
    read, _ = follow(hysteresis(0.05, FULL), np.linspace(-FULL, FULL, 2001))
    assert (np.diff(read[1:]) > 0.0).all()


def test_each_channel_has_its_full_scale():
    loads = np.random.default_rng(4).uniform(-1.0, 1.0, (40, 3)) * np.array([1500.0, 35.0, 1.0])
    element = hysteresis(0.02, [1500.0, 35.0, 1.0], true_at=[1.0, 0.1, 1.0])
    expected, _ = follow(element, loads)
    alone, _ = follow(hysteresis(0.02, 35.0, true_at=0.1), loads[:, 1])
    np.testing.assert_allclose(expected[:, 1], alone, atol=1e-12)


test_impossible_elements_are_refused = refusals(
    lambda arguments: hysteresis(**arguments),
    ({"share": 0.1, "full_scale": 1.0, "smallest": 0.0}, r"'smallest' must lie in \(0, 1\], .* got 0.0"),
    ({"share": 0.1, "full_scale": 1.0}, "'share' must be below 0.0[67].*, or readings would fall"),
)
