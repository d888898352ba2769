"""Links of the error chain against their own specifications: bends, jumps, delays, shares, spreads."""

from typing import Any

import numpy as np
import pytest
import torch

from surefoot.sensors import LoadCells, chain, load_cells, preset
from surefoot.sensors.stages.mounting import mounting
from surefoot.sensors.stages.moving_average import moving_average
from surefoot.sensors.stages.nonlinearity import nonlinearity
from surefoot.sensors.stages.overload import overload
from surefoot.sensors.transport.errors import burst_gaps, spikes, stale_repeats, wrong_words

DT = 0.0125


def stream(stage: Any, loads: np.ndarray, seed: int = 0, dt: float = DT) -> np.ndarray:
    """Pass readings through a stage, one after the other along the first axis."""
    rng = np.random.default_rng(seed)
    state, read = stage.init(loads.shape[1:], rng), []
    for load in loads:
        reading, state = stage.apply(load, state, rng, dt)
        read.append(reading)
    return np.stack(read)


# Nonlinearity


def test_each_term_departs_from_the_line_by_its_share_where_it_says():
    load = np.linspace(0.0, 200.0, 20001)
    for terms, peak in (((0.004, 0.0), 0.5), ((0.0, -0.004), 3.0**-0.5)):
        off = nonlinearity(*terms, 200.0).apply(load, (), np.random.default_rng(0), DT)[0] - load
        worst = np.argmax(np.abs(off))
        assert off[worst] == pytest.approx(sum(terms) * 200.0, rel=1e-6)
        assert load[worst] == pytest.approx(peak * 200.0, abs=0.02)


def test_the_terminals_read_true_and_pulling_as_documented():
    ends = np.array([0.0, 50.0, -50.0, 80.0])
    rng = np.random.default_rng(0)
    read, _ = nonlinearity(0.01, 0.02, 50.0).apply(ends, (), rng, DT)
    np.testing.assert_allclose(read - ends, [0.0, 0.0, -8.0 * 0.01 * 50.0, 0.0], atol=1e-12)
    beyond, _ = nonlinearity(0.01, 0.02, 50.0).apply(np.array([-70.0]), (), rng, DT)
    np.testing.assert_allclose(beyond, -74.0)


def test_channels_bend_each_their_own_way():
    stage = nonlinearity([0.01, -0.02], 0.0, [100.0, 10.0])
    read, _ = stage.apply(np.array([50.0, 5.0]), (), np.random.default_rng(0), DT)
    np.testing.assert_allclose(read, [51.0, 4.8])


@pytest.mark.parametrize("terms", [(0.082, 0.0), (-0.082, 0.0), (0.0, 0.19), (0.0, -0.19), (0.04, -0.1)])
def test_what_is_allowed_grows_with_the_load(terms):
    load = np.linspace(-1.3, 1.3, 2001)
    read, _ = nonlinearity(*terms, 1.0).apply(load, (), np.random.default_rng(0), DT)
    assert (np.diff(read) > 0.0).all()


# Mounting


def impacts(count: int) -> np.ndarray:
    """Loads of two feet: the left is put down over three readings and lifted at once, the right rests."""
    cycle = np.zeros((7, 8))
    cycle[:, :4] = np.array([0.0, 0.0, 5.0, 10.0, 15.0, 15.0, 15.0])[:, None]
    return np.tile(cycle, (count, 1))


def test_an_impact_moves_a_foot_along_its_modes_with_their_spreads():
    loads = impacts(3000)
    zero = stream(mounting(8.0, 0.7, 0.2), loads) - loads
    np.testing.assert_array_equal(zero[:, 4:], 0.0)
    jumps = np.diff(zero[:, :4], axis=0)
    when = np.flatnonzero(np.abs(jumps).max(axis=1) > 1e-9)
    # Once each cycle at touch-down, at its first reading, and once at lift-off.
    np.testing.assert_array_equal(np.sort(when % 7), np.repeat([1, 6], [3000, 2999]))
    modes = jumps[when] @ np.array([[1, 1, 1, 1], [1, -1, -1, 1], [1, -1, 1, -1], [1, 1, -1, -1]]).T / 4.0
    np.testing.assert_allclose(modes[:, 2:], 0.0, atol=1e-10)
    # A standard deviation of 6,000 draws is good to 0.9 %, a correlation to 0.013.
    np.testing.assert_allclose(modes[:, :2].std(axis=0), [0.2, 0.7], rtol=0.04)
    assert abs(np.corrcoef(modes[:, :2].T)[0, 1]) < 0.05


def test_the_warp_shows_in_neither_load_nor_moments():
    loads = impacts(5)
    zero = (stream(mounting(8.0, 0.7), loads) - loads)[-1, :4]
    corners = np.array([[0.07, 0.03], [0.07, -0.03], [-0.05, 0.03], [-0.05, -0.03]])
    assert np.abs(zero).min() > 0.1
    np.testing.assert_allclose(zero.sum(), 0.0, atol=1e-12)
    np.testing.assert_allclose(zero @ corners, 0.0, atol=1e-12)


def test_nothing_jumps_below_the_threshold():
    loads = impacts(20)
    np.testing.assert_array_equal(stream(mounting(61.0, 5.0, 5.0), loads), loads)


def test_a_gap_is_no_impact_and_hides_none():
    rest, stand = impacts(1)[1:3]
    loads = np.stack([rest, np.nan * rest, rest, np.nan * rest, stand])
    read = stream(mounting(8.0, 0.7), loads)
    np.testing.assert_array_equal(read[:4], loads[:4])
    assert (read[4, :4] != stand[:4]).all()


# Overload


def test_an_overload_leaves_its_share_for_good_and_only_once():
    loads = np.array([0.0, 140.0, 0.0, 170.0, 0.0, 160.0, 0.0, np.nan, 190.0, 0.0, -155.0, 0.0])[:, None]
    zero = (stream(overload(0.1, 150.0), loads) - loads)[:, 0]
    expected = [0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 2.0, np.nan, 4.0, 4.0, 3.5, 3.5]
    np.testing.assert_allclose(zero, expected, atol=1e-12)


def test_each_cell_has_its_own_limit():
    loads = np.array([[100.0, 100.0], [0.0, 0.0]])
    np.testing.assert_allclose(stream(overload(0.5, [90.0, 120.0]), loads)[1], [5.0, 0.0])


# Moving average


@pytest.mark.parametrize(("count", "order"), [(4, 1), (5, 2), (8, 3)])
def test_a_sine_comes_out_as_the_formula_says_and_late_by_the_group_delay(count, order):
    time = np.arange(2000) * DT
    delay = order * (count - 1) * DT / 2.0
    for frequency in (0.3, 2.0, 5.5):
        omega = 2.0 * np.pi * frequency
        read = stream(moving_average(count, order), np.sin(omega * time)[:, None])[200:, 0]
        basis = np.stack([np.sin(omega * time[200:]), np.cos(omega * time[200:])], axis=1)
        (in_phase, quadrature), *_ = np.linalg.lstsq(basis, read, rcond=None)
        half = omega * DT / 2.0
        expected = (np.sin(count * half) / (count * np.sin(half))) ** order * np.exp(-1j * omega * delay)
        assert in_phase + 1j * quadrature == pytest.approx(expected, abs=1e-9)


def test_a_step_settles_after_its_readings_and_ramps_are_late_by_the_delay():
    step = np.repeat([0.0, 1.0], [3, 12])[:, None]
    read = stream(moving_average(4, 2), step)[:, 0]
    assert (read[:3] == 0.0).all()
    assert (np.diff(read[2:10]) > 0.0).all()
    np.testing.assert_allclose(read[3 + 2 * 3 :], 1.0, rtol=1e-12)
    ramp = np.arange(50.0)[:, None]
    np.testing.assert_allclose(stream(moving_average(4, 2), ramp)[10:], ramp[10:] - 3.0)


def test_blocks_are_filtered_substep_by_substep():
    loads = np.random.default_rng(1).normal(size=(60, 3))
    whole = stream(moving_average(4, 2), loads)
    rng = np.random.default_rng(0)
    stage = moving_average(4, 2, blocks=True)
    state, parts = stage.init((3,), rng), []
    for block in np.split(loads, [1, 11, 14, 40]):
        read, state = stage.apply(block, state, rng, DT)
        parts.append(read)
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=1e-12, atol=1e-14)


def test_a_converter_behind_the_filter_is_late_by_both():
    """A ramp of 1 N a second, read by perfect converters at the end of each block of 10 substeps."""
    stage = chain(moving_average(21, blocks=True), load_cells(preset("perfect")))
    rng = np.random.default_rng(0)
    state, substep = stage.init((8,), rng), DT / 10
    for k in range(20):
        block = (k * 10 + np.arange(1, 11)) * substep
        read, state = stage.apply(np.repeat(block[:, None], 8, axis=1), state, rng, DT)
    np.testing.assert_allclose(read, block[-1] - 10.0 * substep, rtol=1e-12)


def test_a_lost_reading_does_not_spoil_the_next():
    loads = np.array([1.0, 1.0, np.nan, 1.0, 1.0])[:, None]
    np.testing.assert_allclose(stream(moving_average(3), loads), loads)


# Gaps, repeats, words and spikes


@pytest.mark.parametrize("dt", [0.01, 0.05])
def test_gaps_have_their_share_their_length_and_their_memory(dt):
    share, length = 0.2, 0.1
    lost = np.isnan(stream(burst_gaps(share, length), np.zeros((1500, 400, 3)), dt=dt))
    assert (lost == lost[..., :1]).all(), "a packet holds every channel"
    gone = lost[..., 0]
    rate = 1.0 / (length * (1.0 - share))
    # As many independent looks as correlation times: the share is good to about 1 %.
    assert gone.mean() == pytest.approx(share, rel=0.05)
    assert gone[0].mean() == pytest.approx(share, abs=0.08), "stationary from the start"
    ends = (gone[:-1] & ~gone[1:]).sum()
    leave = (1.0 - share) * -np.expm1(-rate * dt)
    assert gone[:-1].sum() / ends == pytest.approx(1.0 / leave, rel=0.04)
    for lag in (round(0.05 / dt), round(0.1 / dt)):
        both = (gone[:-lag] & gone[lag:]).mean()
        correlation = (both - share**2) / (share * (1.0 - share))
        assert correlation == pytest.approx(np.exp(-rate * lag * dt), abs=0.03)


def test_gaps_of_long_links_last_their_mean_length():
    gone = np.isnan(stream(burst_gaps(0.3, 0.5), np.zeros((3000, 300, 1)), dt=0.005))[..., 0]
    ends = (gone[:-1] & ~gone[1:]).sum()
    # Some 7,700 gaps, each exponential: good to 1.2 %.
    assert gone[:-1].sum() * 0.005 / ends == pytest.approx(0.5, rel=0.05)


def test_channels_with_links_of_their_own_are_lost_on_their_own():
    gone = np.isnan(stream(burst_gaps(0.4, 0.02, each=True), np.zeros((4000, 2))))
    assert abs(np.corrcoef(gone.T)[0, 1]) < 0.08
    np.testing.assert_allclose(gone.mean(axis=0), 0.4, atol=0.05)


@pytest.mark.parametrize("each", [False, True])
def test_repeats_have_their_share_and_geometric_runs(each):
    loads = np.random.default_rng(5).normal(size=(40000, 2))
    read = stream(stale_repeats(0.6, each=each), loads)
    same = read[1:] == read[:-1]
    np.testing.assert_array_equal(read[0], loads[0])
    np.testing.assert_array_equal(read[1:][~same], loads[1:][~same])
    np.testing.assert_allclose(same.mean(axis=0), 0.6, atol=0.012)
    # Without a memory, two in a row are the square.
    np.testing.assert_allclose((same[1:] & same[:-1]).mean(axis=0), 0.36, atol=0.015)
    together = (same[:, 0] & same[:, 1]).mean()
    assert together == pytest.approx(0.36 if each else 0.6, abs=0.015)


def test_a_lost_reading_is_not_repeated():
    loads = np.array([np.nan, 1.0, np.nan, 2.0])[:, None]
    read = stream(stale_repeats(1.0 - 1e-12), loads)[:, 0]
    np.testing.assert_array_equal(read, [np.nan, 1.0, 1.0, 1.0])


@pytest.mark.parametrize("coding", ["offset-binary", "two's complement"])
def test_one_bit_of_a_wrong_word_is_off_and_each_as_often(coding):
    bits, signed = 12, coding != "offset-binary"
    rng = np.random.default_rng(6)
    words = rng.integers(-2048 if signed else 0, 2048 if signed else 4096, (300, 400))
    read, _ = wrong_words(0.1, bits, coding).apply(words.astype(float), (), rng, DT)
    assert (read == np.rint(read)).all()
    assert read.min() >= words.min()
    assert read.max() <= words.max()
    # The integers' own bits are the independent formula.
    turned = (words ^ read.astype(np.int64)) & (2**bits - 1)
    wrong = turned != 0
    assert wrong.mean() == pytest.approx(0.1, rel=0.04)
    which = np.log2(turned[wrong])
    assert (which == np.rint(which)).all(), "one bit alone"
    # 1,000 of each are good to 3 %.
    np.testing.assert_allclose(np.bincount(which.astype(int), minlength=bits) / which.size, 1 / 12, rtol=0.15)


def test_wrong_words_of_float32_tensors_are_whole_and_lost_ones_stay_lost():
    words = torch.randint(0, 2**24, (20000,), generator=torch.Generator().manual_seed(1))
    read, _ = wrong_words(1.0).apply(words.to(torch.float32), (), torch.Generator().manual_seed(2), DT)
    turned = (words ^ read.to(torch.int64)).numpy()
    assert set(turned.tolist()) == {2**bit for bit in range(24)}
    gone, _ = wrong_words(1.0).apply(np.array([np.nan]), (), np.random.default_rng(0), DT)
    assert np.isnan(gone).all()


@pytest.mark.parametrize("dt", [0.005, 0.1])
def test_spikes_come_at_their_rate_with_their_spread(dt):
    read = stream(spikes(4.0, 30.0), np.full((500, 400), 7.0), dt=dt) - 7.0
    hit = read != 0.0
    # Some 4,000 and 66,000 spikes.
    assert hit.mean() == pytest.approx(1.0 - np.exp(-4.0 * dt), rel=0.06)
    assert read[hit].std() == pytest.approx(30.0, rel=0.05)
    assert abs(read[hit].mean()) < 2.0
    assert abs(np.corrcoef(hit[1:].ravel(), hit[:-1].ravel())[0, 1]) < 0.02


# Bad input


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: nonlinearity(float("nan"), 0.0, 1.0), "'quadratic' and 'cubic' must be finite"),
        (lambda: nonlinearity(0.0, 0.0, 0.0), "'full_scale' must be finite and positive, got 0.0"),
        (lambda: nonlinearity(0.26, 0.0, 1.0), "must leave readings that grow"),
        (lambda: nonlinearity(-0.09, 0.0, 1.0), "must leave readings that grow"),
        (lambda: nonlinearity(0.0, 0.2, 1.0), "must leave readings that grow"),
        (lambda: nonlinearity(0.0, [0.0, -0.4], 1.0), "must leave readings that grow"),
        (lambda: mounting(-1.0, 1.0), "'threshold' must be finite and not negative, got -1.0"),
        (lambda: mounting(1.0, 1.0, warp=(1, 0)), r"'warp' must hold \+1 or -1.*got \(1, 0\)"),
        (lambda: mounting(1.0, 1.0).init((6,), None), r"whole feet of 4 cells, got shape \(6,\)"),
        (lambda: overload(1.1, 1.0), "'share' must be at most 1, got 1.1"),
        (lambda: overload(0.1, [1.0, -1.0]), "'safe' must be finite and positive"),
        (lambda: moving_average(0), "'count' must be a positive whole number, got 0"),
        (lambda: moving_average(2, 1.5), "'order' must be a positive whole number, got 1.5"),
        (lambda: burst_gaps(1.0, 1.0), r"'share' must lie in \[0, 1\), got 1.0"),
        (lambda: burst_gaps(0.1, 0.0), "'mean_length' must be finite and positive, got 0.0"),
        (lambda: stale_repeats(1.0), r"'probability' must lie in \[0, 1\), got 1.0"),
        (lambda: wrong_words(-0.1), r"'probability' must lie in \[0, 1\], got -0.1"),
        (lambda: wrong_words(0.1, 33), "'bits' must be a whole number from 1 to 32, got 33"),
        (lambda: wrong_words(0.1, 8, "gray"), "'coding' must be one of .* got 'gray'"),
        (lambda: spikes(1.0, -2.0), "'size' must be finite and not negative, got -2.0"),
    ],
)
def test_impossible_links_are_refused(make, text):
    with pytest.raises(ValueError, match=text):
        make()


def test_links_stand_in_one_chain_with_an_instrument():
    """From the load to the host in the instrument's order, without one NaN that no gap explains."""
    config = LoadCells(rate=None, polarity=(1,))
    stage = chain(
        overload(0.01, 150.0),
        nonlinearity(5e-4, 0.0, config.capacity),
        mounting(20.0, 1.0),
        moving_average(5, blocks=False),
    )
    loads = np.abs(np.random.default_rng(2).normal(30.0, 20.0, (50, 8)))
    bridge = stream(stage, loads)
    host = chain(load_cells(config), wrong_words(0.01, config.adc_bits), burst_gaps(0.2, 0.1))
    rng = np.random.default_rng(3)
    state, read = host.init((8,), rng), []
    for load in bridge:
        counts, state = host.apply(load[None], state, rng, DT)
        read.append(counts)
    read = np.stack(read)
    assert np.isfinite(bridge).all()
    assert (np.isnan(read).all(axis=1) == np.isnan(read).any(axis=1)).all()
    assert 0.0 < np.isnan(read).mean() < 0.8
    kept = read[~np.isnan(read)]
    assert (kept == np.rint(kept)).all()
    assert kept.max() <= config.code_range[1]
