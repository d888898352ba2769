"""Load cells: fused and stage by stage, their counts, and what a robot may know of them."""

from dataclasses import replace

import numpy as np
import pytest

from surefoot.sensors import LoadCells, load_cells
from surefoot.sensors.devices.load_cells import load_cell_chain, static_counts, true_map
from surefoot.sensors.presets import BAR_CELLS_ON_HX711, HX711_LOAD_CELLS, NAO_FSR, PERFECT_LOAD_CELLS
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE

DT = 1 / 80
PLAIN = replace(
    HX711_LOAD_CELLS,
    initial_scale_std=0.0,
    initial_offset_std=0.0,
    scale_drift=0.0,
    offset_drift=0.0,
    rate=None,
)
WARMING = replace(
    HX711_LOAD_CELLS,
    scale_tempco=1e-3,
    offset_tempco=0.03,
    temperature_ramp=20.0 / 600.0,
    temperature_rise=14.0,
)


@pytest.mark.parametrize(
    "config",
    [
        HX711_LOAD_CELLS,
        PERFECT_LOAD_CELLS,
        PLAIN,
        replace(HX711_LOAD_CELLS, rate=None),
        replace(HX711_LOAD_CELLS, adc_bits=0),
        replace(HX711_LOAD_CELLS, scale_drift=0.0),
        replace(HX711_LOAD_CELLS, offset_drift=0.0, input_noise=0.0),
        replace(HX711_LOAD_CELLS, coding="two's complement", polarity=(1,)),
        WARMING,
        replace(WARMING, temperature_rise=0.0, rate=None),
        replace(WARMING, scale_drift=0.0, offset_drift=0.0),
        replace(HX711_LOAD_CELLS, settling=4),
        replace(HX711_LOAD_CELLS, settling=3, rate=None),
        replace(HX711_LOAD_CELLS, settling=3, rate=(300.0, 900.0)),
        replace(HX711_LOAD_CELLS, mechanics=BAR_CELLS_ON_HX711.mechanics),
        replace(HX711_LOAD_CELLS, wire=BAR_CELLS_ON_HX711.wire),
        BAR_CELLS_ON_HX711,
        replace(BAR_CELLS_ON_HX711, rate=(20.0, 30.0)),
        replace(BAR_CELLS_ON_HX711, rate=None),
        NAO_FSR,
    ],
)
def test_fused_cells_equal_the_chain_of_their_stages(config: LoadCells) -> None:
    fused, chained = load_cells(config), load_cell_chain(config)
    rng, other = np.random.default_rng(0), np.random.default_rng(0)
    state, other_state = fused.init((8,), rng), chained.init((8,), other)
    loads = np.random.default_rng(1)
    for _ in range(100):
        block = loads.normal(6.0, 4.0, (10, 8))
        counts, state = fused.apply(block, state, rng, DT)
        expected, other_state = chained.apply(block if config.rate else block[-1], other_state, other, DT)
        np.testing.assert_allclose(counts, expected, rtol=1e-12, atol=1e-9)


def test_counts_are_whole_and_span_24_bits() -> None:
    rng = np.random.default_rng(2)
    cells = load_cells(HX711_LOAD_CELLS)
    state = cells.init((1000, 8), rng)
    block = np.linspace(-800.0, 800.0, 1000)[:, None, None] * np.ones((10, 8))
    for _ in range(3):
        counts, state = cells.apply(block, state, rng, DT)
    np.testing.assert_array_equal(counts, np.round(counts))
    assert counts.min() == 0.0
    assert counts.max() == 2.0**24 - 1.0


def test_the_nominal_map_is_the_data_sheets() -> None:
    """1 mV/V at 98.1 N into +-0.5/128 of the supply: 10 kg are 2^24 * 0.128 counts."""
    assert HX711_LOAD_CELLS.counts_per_newton * 98.1 == pytest.approx(2**24 * 0.128)
    assert HX711_LOAD_CELLS.zero_code == 2**23
    assert HX711_LOAD_CELLS.noise_counts == pytest.approx(38.0, rel=0.03)
    rng = np.random.default_rng(3)
    load = np.array([0.0, 1.0, 5.0, 20.0, 40.0, 60.0, 80.0, 98.1])
    cells = load_cells(PLAIN)
    counts = static_counts(PLAIN, cells.init((8,), rng), np.tile(load, (400, 1)), rng)
    read = PLAIN.nominal_scale * counts + PLAIN.nominal_offset
    np.testing.assert_allclose(read.mean(axis=0), load, atol=1e-3)
    np.testing.assert_allclose(read.std(axis=0), 1.8e-3, rtol=0.15)


def test_bridges_may_be_wired_either_way_round() -> None:
    rng = np.random.default_rng(4)
    state = load_cells(PLAIN).init((8,), rng)
    rise = static_counts(PLAIN, state, np.full(8, 2.0), rng) - static_counts(PLAIN, state, np.zeros(8), rng)
    np.testing.assert_array_equal(np.sign(rise), [-1, 1, -1, 1, -1, 1, -1, 1])
    np.testing.assert_array_equal(np.sign(PLAIN.nominal_scale), np.sign(rise))


def test_errors_at_power_up_have_their_spread() -> None:
    rng = np.random.default_rng(5)
    state = load_cells(HX711_LOAD_CELLS).init((5000, 8), rng)
    assert state.error[0].std() == pytest.approx(0.12, rel=0.02)
    assert state.error[1].std() == pytest.approx(1.5, rel=0.02)


def test_cells_drift_by_2_percent_and_1_newton_in_a_minute() -> None:
    rng = np.random.default_rng(6)
    config = replace(HX711_LOAD_CELLS, initial_scale_std=0.0, initial_offset_std=0.0)
    cells = load_cells(config)
    state = cells.init((2000, 8), rng)
    block = np.zeros((2000, 1, 8))
    for _ in range(60):
        _, state = cells.apply(block, state, rng, 1.0)
    assert state.error[0].std() == pytest.approx(0.02, rel=0.03)
    assert state.error[1].std() == pytest.approx(1.0, rel=0.03)
    assert config.offset_drift == pytest.approx(PER_SQRT_MINUTE)


def test_the_true_map_undoes_the_errors_of_the_moment() -> None:
    rng = np.random.default_rng(7)
    config = replace(HX711_LOAD_CELLS, input_noise=0.0)
    cells = load_cells(config)
    state = cells.init((8,), rng)
    for _ in range(50):
        _, state = cells.apply(np.zeros((10, 8)), state, rng, DT)
    scale, offset = true_map(config, state)
    load = np.linspace(0.0, 40.0, 24).reshape(3, 8)
    read = scale * static_counts(config, state, load, rng) + offset
    # Half a count is 25 uN at most.
    np.testing.assert_allclose(read, load, atol=4e-5)


def test_static_readings_leave_the_state_alone_and_do_not_drift() -> None:
    rng = np.random.default_rng(8)
    state = load_cells(HX711_LOAD_CELLS).init((8,), rng)
    kept = [part.copy() for part in state[:6]]
    counts = static_counts(HX711_LOAD_CELLS, state, np.zeros((5000, 8)), rng)
    for part, before in zip(state[:6], kept, strict=True):
        np.testing.assert_array_equal(part, before)
    halves = counts.reshape(2, 2500, 8).mean(axis=1)
    np.testing.assert_allclose(halves[0], halves[1], atol=5.0)


@pytest.mark.parametrize(("rise", "expected"), [(0.0, 20.0), (14.0, 14.0 * (1.0 - np.exp(-20.0 / 14.0)))])
@pytest.mark.parametrize("steps", [10, 60])
def test_ten_minutes_of_warming_move_zero_and_span_by_their_coefficients(rise, expected, steps):
    rng = np.random.default_rng(10)
    config = replace(WARMING, scale_drift=0.0, offset_drift=0.0, temperature_rise=rise)
    cells = load_cells(config)
    start = state = cells.init((3000, 8), rng)
    block = np.zeros((3000, 1, 8))
    for _ in range(steps):
        _, state = cells.apply(block, state, rng, 600.0 / steps)
    np.testing.assert_allclose(state.thermal[2], expected, rtol=1e-9)
    np.testing.assert_allclose(state.error - start.error, start.thermal[:2] * expected, atol=1e-9)
    assert (state.error - start.error)[0].std() == pytest.approx(1e-3 * expected, rel=0.03)
    assert (state.error - start.error)[1].std() == pytest.approx(0.03 * expected, rel=0.03)
    # Cells of one robot warm up alike, but each follows with a coefficient of its own.
    assert np.corrcoef(start.thermal[1].T)[0, 1] == pytest.approx(0.0, abs=0.06)


def test_the_true_map_knows_the_temperature():
    rng = np.random.default_rng(11)
    config = replace(WARMING, input_noise=0.0, scale_drift=0.0, offset_drift=0.0)
    cells = load_cells(config)
    state = cells.init((8,), rng)
    cold = true_map(config, state)
    for _ in range(60):
        _, state = cells.apply(np.zeros((1, 8)), state, rng, 10.0)
    load = np.linspace(0.0, 40.0, 24).reshape(3, 8)
    counts = static_counts(config, state, load, rng)
    scale, offset = true_map(config, state)
    np.testing.assert_allclose(scale * counts + offset, load, atol=4e-5)
    assert np.abs(cold[0] * counts + cold[1] - load).max() > 0.1


@pytest.mark.parametrize("off", [{"temperature_ramp": 0.0}, {"scale_tempco": 0.0, "offset_tempco": 0.0}])
def test_cells_that_do_not_warm_up_read_bit_for_bit_what_they_read_before(off):
    config = replace(WARMING, **off)
    assert not config.warms
    read = []
    for each in (HX711_LOAD_CELLS, config):
        rng = np.random.default_rng(12)
        cells = load_cells(each)
        state = cells.init((8,), rng)
        counts = []
        for _ in range(50):
            one, state = cells.apply(np.full((10, 8), 5.0), state, rng, DT)
            counts.append(one)
        read.append(counts)
    np.testing.assert_array_equal(read[0], read[1])


def test_wrong_channels_are_refused() -> None:
    rng = np.random.default_rng(9)
    with pytest.raises(ValueError, match=r"must hold the 8 channels, got shape \(4,\)"):
        load_cells(HX711_LOAD_CELLS).init((4,), rng)
    state = load_cells(HX711_LOAD_CELLS).init((8,), rng)
    with pytest.raises(ValueError, match=r"'load' must hold 8 cells on its last axis, got shape \(3, 4\)"):
        static_counts(HX711_LOAD_CELLS, state, np.zeros((3, 4)), rng)
