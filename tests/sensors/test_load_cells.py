"""Load cells: fused and stage by stage, their counts, and what a robot may know of them."""

from dataclasses import replace

import numpy as np
import pytest
from _chain import load_cell_chain
from _streams import DT, follow, stream

from surefoot.sensors import LoadCells, Mechanics, Wire, chain, load_cells, preset, sized
from surefoot.sensors.devices.load_cells import static_counts, true_map
from surefoot.sensors.presets import (
    BAR_CELLS_ON_HX711,
    HX711_LOAD_CELLS,
    NAO_FSR,
    PERFECT_LOAD_CELLS,
    REFERENCE_WEIGHT,
)
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE
from surefoot.sensors.stages.clock import sample_and_hold

PLAIN = replace(
    HX711_LOAD_CELLS,
    initial_scale_std=0.0,
    initial_offset_std=0.0,
    scale_drift=0.0,
    offset_drift=0.0,
    rate=None,
)
CODES = replace(PLAIN, polarity=(1,), input_noise=0.0)
WARMING = replace(
    HX711_LOAD_CELLS,
    scale_tempco=1e-3,
    offset_tempco=0.03,
    temperature_ramp=20.0 / 600.0,
    temperature_rise=14.0,
)


def read(config: LoadCells, loads: np.ndarray) -> np.ndarray:
    """Read loads of shape (N, K), constant over each step, and return what the host finds in N."""
    return config.nominal_scale * stream(load_cells(config), loads[:, None]) + config.nominal_offset


def spring(**fields) -> LoadCells:
    return replace(PERFECT_LOAD_CELLS, capacity=100.0, mechanics=Mechanics(**fields))


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
        replace(BAR_CELLS_ON_HX711, shear_std=0.1),
        replace(HX711_LOAD_CELLS, shear_std=0.1, rate=None),
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
        block = loads.normal(6.0, 4.0, (10, config.loads))
        counts, state = fused.apply(block, state, rng, DT)
        if config.rate is None:
            block = block.mean(axis=0) if config.averaged else block[-1]
        expected, other_state = chained.apply(block, other_state, other, DT)
        np.testing.assert_allclose(counts, expected, rtol=1e-12, atol=1e-9)


def test_counts_are_whole_and_scale_24_bits() -> None:
    blocks = np.repeat(np.linspace(-800.0, 800.0, 1000), 8) * np.ones((3, 10, 1))
    counts = stream(load_cells(replace(HX711_LOAD_CELLS, channels=8000)), blocks, seed=2)[-1]
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
    state = load_cells(replace(HX711_LOAD_CELLS, channels=40_000)).init((40_000,), rng)
    assert state.error[0].std() == pytest.approx(0.12, rel=0.02)
    assert state.error[1].std() == pytest.approx(1.5, rel=0.02)


def test_cells_drift_by_2_percent_and_1_newton_in_a_minute() -> None:
    config = replace(HX711_LOAD_CELLS, channels=16_000, initial_scale_std=0.0, initial_offset_std=0.0)
    _, state = follow(load_cells(config), np.zeros((60, 1, 16_000)), seed=6, dt=1.0)
    assert state.error[0].std() == pytest.approx(0.02, rel=0.03)
    assert state.error[1].std() == pytest.approx(1.0, rel=0.03)
    assert config.offset_drift == pytest.approx(PER_SQRT_MINUTE)


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
def test_ten_minutes_of_warming_move_offset_and_scale_by_their_coefficients(rise, expected, steps):
    rng = np.random.default_rng(10)
    config = replace(WARMING, channels=24_000, scale_drift=0.0, offset_drift=0.0, temperature_rise=rise)
    cells = load_cells(config)
    start = state = cells.init((24_000,), rng)
    block = np.zeros((1, 24_000))
    for _ in range(steps):
        _, state = cells.apply(block, state, rng, 600.0 / steps)
    np.testing.assert_allclose(state.thermal[2], expected, rtol=1e-9)
    np.testing.assert_allclose(state.error - start.error, start.thermal[:2] * expected, atol=1e-9)
    assert (state.error - start.error)[0].std() == pytest.approx(1e-3 * expected, rel=0.03)
    assert (state.error - start.error)[1].std() == pytest.approx(0.03 * expected, rel=0.03)
    # Cells warm up alike, but each follows with a coefficient of its own.
    assert np.corrcoef(start.thermal[1].reshape(2, -1))[0, 1] == pytest.approx(0.0, abs=0.06)


def test_the_true_map_undoes_the_errors_of_the_moment():
    rng = np.random.default_rng(11)
    config = replace(WARMING, input_noise=0.0)
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


def test_wrong_channels_are_refused() -> None:
    rng = np.random.default_rng(9)
    for shape, given in (((4,), r"\(4,\)"), ((3, 8), r"\(3, 8\)")):
        with pytest.raises(
            ValueError, match=rf"^A reading must hold the 8 channels, got shape {given}; give \(8,\)"
        ):
            load_cells(HX711_LOAD_CELLS).init(shape, rng)
    state = load_cells(HX711_LOAD_CELLS).init((8,), rng)
    with pytest.raises(ValueError, match=r"^Loads must have the shape \(S, 8\), got \(3, 10, 8\)\.$"):
        load_cells(HX711_LOAD_CELLS).apply(np.zeros((3, 10, 8)), state, rng, DT)
    with pytest.raises(ValueError, match=r"'load' must hold 8 cells on its last axis, got shape \(3, 4\)"):
        static_counts(HX711_LOAD_CELLS, state, np.zeros((3, 4)), rng)


# Spring elements and filters


def test_the_true_map_knows_what_impacts_and_overloads_did_to_the_offsets():
    config = spring(mounting_warp_std=2.0, mounting_common_std=0.5, impact_threshold=20.0, overload_share=0.1)
    rng, cells = np.random.default_rng(3), load_cells(config)
    state, loads = cells.init((8,), rng), np.full((1, 8), 5.0)
    for _ in range(6):
        _, state = cells.apply(loads, state, rng, DT)
        _, state = cells.apply(loads + 20.0, state, rng, DT)
    _, state = cells.apply(loads + 245.0, state, rng, DT)
    _, state = cells.apply(loads + 245.0, state, rng, DT)
    scale, offset = true_map(config, state)
    assert np.abs(offset).min() > 1.0
    weights = np.array([[0.0] * 8, [30.0] * 8])
    np.testing.assert_allclose(scale * static_counts(config, state, weights, rng) + offset, weights)
    stayed, _ = cells.apply(loads + 245.0, state, rng, DT)
    np.testing.assert_allclose(scale * stayed + offset, 250.0)


def test_a_converter_that_averages_four_settles_in_four_and_is_late_by_one_and_a_half():
    config = replace(CODES, rate=(80.0, 80.0), settling=4)
    ramp = np.arange(1.0, 200.0)[:, None] * DT * np.ones(8)
    rng, cells = np.random.default_rng(4), load_cells(config)
    state = cells.init((8,), rng)
    due = state.due
    for load in ramp:
        counts, state = cells.apply(load[None], state, rng, DT)
    late = ramp[-1] - (config.nominal_scale * counts + config.nominal_offset)
    # The last conversion ended due - period before now: the mean of the two steps that it is part of, and 1.5
    # periods of DT before that one.
    np.testing.assert_allclose(late, (DT - due) % DT + 1.5 * DT, atol=3e-5)
    step = np.repeat([0.0, 8.0], 10)[:, None] * np.ones(8)
    steady = replace(config, rate=None)
    np.testing.assert_allclose(read(steady, step)[9:15, 0], [0.0, 2.0, 4.0, 6.0, 8.0, 8.0], atol=3e-5)


@pytest.mark.parametrize("blocks", [1, 5, 25])
def test_the_mean_is_over_conversions_however_the_host_steps(blocks):
    """A ramp, on which the conversions between two looks lie on a straight line."""
    rate, settling, dt = 100.0, 4, 0.001 * blocks * 5
    stage = sample_and_hold(chain(), (rate, rate), settling=settling)
    rng = np.random.default_rng(5)
    state = stage.init((200,), rng)
    phase, time = state.due, 0.0
    for k in range(round(0.5 / dt)):
        time = dt * (k + 1)
        block = (time - dt + dt * (np.arange(10) + 0.5) / 10)[:, None] * np.ones(200)
        mean, state = stage.apply(block, state, rng, dt)
    last = phase + np.floor((time - phase) * rate + 1e-9) / rate
    # The steps of the ramp are not the conversions' own.
    np.testing.assert_allclose(mean, last - 0.5 * settling / rate, atol=rate * (dt / 10) ** 2)


def test_noise_is_that_of_one_conversion_with_and_without_a_filter():
    for settling in (1, 4):
        config = replace(CODES, channels=2400, input_noise=9e-8, rate=(80.0, 80.0), settling=settling)
        rows = read(config, np.full((50, 2400), 10.0))[10:]
        assert rows.std() == pytest.approx(config.noise_counts * config.nominal_scale[0], rel=0.02)


def test_a_chip_that_skips_a_look_does_not_lead_its_cell_astray():
    """Slow chips, most of whose looks find nothing new: no spring element sees a load that never was."""
    config = replace(spring(overload_share=1.0, safe_overload=0.2), channels=4000, rate=(9.0, 11.0))
    loads = 10.0 + 9.0 * np.sin(2.0 * np.arange(300) * DT)
    _, state = follow(load_cells(config), np.broadcast_to(loads[:, None, None], (300, 10, 4000)), seed=6)
    assert state.mechanics.overload.excess.max() == 0.0


def test_the_whole_device_has_every_link():
    assert all(getattr(BAR_CELLS_ON_HX711.wire, name) for name in Wire.__dataclass_fields__)
    spring_fields = set(Mechanics.__dataclass_fields__) - {"mounting_common_std"}
    assert all(getattr(BAR_CELLS_ON_HX711.mechanics, name) for name in spring_fields)
    # Half of a conversion that is waited for, half of the four that are averaged, and the network.
    assert BAR_CELLS_ON_HX711.nominal_age == pytest.approx(2.5 / 86.0 + 0.02)


# Cells for robots of other weights


def test_cells_of_the_reference_robot_stay_as_they_are():
    for name in ("hx711-load-cells", "hx711-bar-cells", "nao-fsr"):
        assert sized(preset(name), REFERENCE_WEIGHT) == preset(name)


@pytest.mark.parametrize("config", [HX711_LOAD_CELLS, NAO_FSR, preset("hx711-bar-cells")])
def test_larger_cells_read_larger_loads_alike(config):
    """In shares of the weight everything but the drawn spikes is the same, sample by sample."""
    config, factor = replace(config, wire=replace(config.wire, spike_rate=0.0, wrong_words=0.0)), 8.0
    load, shares = (1.0 + np.sin(0.4 * np.arange(60)))[:, None, None] * np.ones((4, 8)) / 8.0, []
    for weight in (REFERENCE_WEIGHT, factor * REFERENCE_WEIGHT):
        larger = sized(config, weight)
        counts = stream(load_cells(larger), weight * load, seed=4, dt=0.02)
        shares.append((larger.nominal_scale * counts + larger.nominal_offset) / weight)
    np.testing.assert_allclose(shares[1], shares[0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("weight", [0.0, -1.0, float("nan"), float("inf")])
def test_a_weight_that_is_none_is_refused(weight):
    with pytest.raises(ValueError, match=f"'weight' must be finite and positive, in N, got {weight}"):
        sized(HX711_LOAD_CELLS, weight)
