"""Every link within the load cells' own chain against its own specification."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from surefoot.sensors import ForceTorque, LoadCells, Mechanics, Wire, force_torque, load_cells
from surefoot.sensors.corruption import chain
from surefoot.sensors.devices.load_cells import static_counts, true_map
from surefoot.sensors.presets import BAR_CELLS_ON_HX711, PERFECT_LOAD_CELLS
from surefoot.sensors.rare import change_at_random
from surefoot.sensors.stages.clock import sample_and_hold
from surefoot.sensors.transport.errors import spikes
from surefoot.sensors.transport.wire import wire

DT = 1 / 80
CODES = LoadCells(
    polarity=(1,),
    input_noise=0.0,
    rate=None,
    initial_scale_std=0.0,
    initial_offset_std=0.0,
    scale_drift=0.0,
    offset_drift=0.0,
)


def read(config: LoadCells, loads: np.ndarray, dt: float = DT, seed: int = 0) -> np.ndarray:
    """Read loads of shape (N, ..., K), constant over each step, and return what the host finds in N."""
    rng = np.random.default_rng(seed)
    cells = load_cells(config)
    state, rows = cells.init(loads.shape[1:], rng), []
    for load in loads:
        counts, state = cells.apply(load[..., None, :], state, rng, dt)
        rows.append(counts)
    return config.nominal_scale * np.stack(rows) + config.nominal_offset


def spring(**fields) -> LoadCells:
    return replace(PERFECT_LOAD_CELLS, capacity=100.0, mechanics=Mechanics(**fields))


# Mechanics


def test_cells_bend_each_their_own_way_within_the_data_sheet():
    loads = np.broadcast_to(np.array([0.0, 50.0, 100.0])[:, None, None], (3, 4000, 8))
    off = read(spring(nonlinearity=0.002), loads) - loads
    np.testing.assert_allclose(off[[0, 2]], 0.0, atol=1e-12)
    assert np.abs(off[1]).max() == pytest.approx(0.2, rel=0.01)
    # Uniform: the standard deviation is the range over the root of 12.
    assert off[1].std() == pytest.approx(0.4 / 12**0.5, rel=0.02)


def test_the_loop_is_as_wide_and_has_the_area_that_its_share_says():
    swing, share = 40.0, 0.01
    up = np.linspace(0.0, swing, 2001)
    cycle = np.concatenate([up, up[::-1]])
    loads = np.tile(cycle, 2)[:, None] * np.ones(8)
    read_back = read(spring(hysteresis=share), loads)[len(cycle) :, 0]
    rising, falling = read_back[:2001], read_back[2001:][::-1]
    middle = (falling - rising)[1000]
    assert middle == pytest.approx(share * swing, rel=1e-3)
    # The area between the branches of this operator, by its plays: sum of w 2 r (2 a - 2 r), a the amplitude.
    amplitude, half = swing / 2.0, 100.0 * 0.5 ** np.arange(1.0, 9.0)
    weights = share * np.where(half == half.min(), 2.0, 1.0)
    inside = half < amplitude
    area = np.sum((weights * 4.0 * half * (amplitude - half))[inside])
    assert np.trapezoid(falling - rising, up) == pytest.approx(area, rel=2e-3)


def test_a_constant_load_creeps_along_its_exponentials():
    config = spring(creep_shares=(0.02, 0.01), creep_time_constants=(2.0, 20.0))
    time = np.arange(1, 101) * 0.5
    crept = read(config, np.full((100, 8), 30.0), dt=0.5)[:, 0]
    expected = 30.0 * (1.0 + 0.02 * (1.0 - np.exp(-time / 2.0)) + 0.01 * (1.0 - np.exp(-time / 20.0)))
    np.testing.assert_allclose(crept, expected, rtol=1e-12)


def test_the_true_map_knows_what_impacts_and_overloads_did_to_the_zeros():
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


# The converter's filter


def test_a_converter_that_averages_four_settles_in_four_and_is_late_by_one_and_a_half():
    config = replace(CODES, rate=(80.0, 80.0), settling=4)
    ramp = np.arange(1.0, 200.0)[:, None] * DT * np.ones(8)
    rng, cells = np.random.default_rng(4), load_cells(config)
    state = cells.init((8,), rng)
    due = state.due
    for load in ramp:
        counts, state = cells.apply(load[None], state, rng, DT)
    late = ramp[-1] - (config.nominal_scale * counts + config.nominal_offset)
    # The last conversion lies due - period before now, and its mean 1.5 periods before that.
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
        block = (time - dt + dt * np.arange(1, 11) / 10)[:, None] * np.ones(200)
        mean, state = stage.apply(block, state, rng, dt)
    last = phase + np.floor((time - phase) * rate + 1e-9) / rate
    np.testing.assert_allclose(mean, last - 0.5 * (settling - 1) / rate, atol=1e-9)


def test_noise_is_that_of_one_conversion_with_and_without_a_filter():
    for settling in (1, 4):
        config = replace(CODES, input_noise=9e-8, rate=(80.0, 80.0), settling=settling)
        rows = read(config, np.full((50, 300, 8), 10.0))[10:]
        assert rows.std() == pytest.approx(config.noise_counts * config.nominal_scale[0], rel=0.02)


def test_a_chip_that_skips_a_look_does_not_lead_its_cell_astray():
    """Slow chips, most of whose looks find nothing new: no spring element sees a load that never was."""
    config = replace(spring(overload_share=1.0, safe_overload=0.2), rate=(9.0, 11.0))
    rng, cells = np.random.default_rng(6), load_cells(config)
    state = cells.init((500, 8), rng)
    for k in range(300):
        load = 10.0 + 9.0 * np.sin(2.0 * k * DT)
        _, state = cells.apply(np.full((500, 10, 8), load), state, rng, DT)
    assert state.mechanics.overload.excess.max() == 0.0


# The wire


def test_spikes_of_codes_are_whole_codes_at_their_rate_and_of_their_size():
    config = replace(CODES, wire=Wire(spike_rate=2.0, spike_size=0.05))
    off = read(config, np.full((200, 400, 8), 40.0)) - 40.0
    hit = np.abs(off) > 1e-4
    assert hit.mean() == pytest.approx(1.0 - np.exp(-2.0 * DT), rel=0.03)
    assert off[hit].std() == pytest.approx(0.05 * config.capacity, rel=0.02)
    counts = (off + 40.0 - config.nominal_offset) / config.nominal_scale
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    stage = wire(Wire(spike_rate=100.0, spike_size=9.0), 100.0, (-128.0, 127.0), 8)
    codes, _ = stage.apply(np.zeros((500, 8)), stage.init((500, 8), None), np.random.default_rng(0), DT)
    assert (codes.min(), codes.max()) == (-128.0, 127.0)


def test_readings_are_late_by_their_delay_and_jitter():
    """A ramp of 1 N/s read every 2 ms tells the age of each reading."""
    dt, config = 0.002, replace(CODES, wire=Wire(delay=0.02, jitter=0.0004, under_way=20))
    ramp = np.arange(1, 2000)[:, None, None] * dt * np.ones((1, 20, 8))
    age = (ramp - read(config, ramp, dt=dt))[50:, :, 0]
    # The host finds what arrived up to a look ago: half of one more in the mean, and its spread.
    assert age.mean() == pytest.approx(0.02 + 0.5 * dt, rel=0.02)
    # A jitter far below the time between packets: ages are looks, the delay rounded up.
    looks = np.rint(age / dt)
    np.testing.assert_allclose(age, looks * dt, atol=3e-5)
    assert (looks == 10).mean() == pytest.approx(0.5, abs=0.02)
    assert (looks == 11).mean() == pytest.approx(0.5, abs=0.02)


def test_losses_alone_and_in_bursts_have_their_shares_and_lengths():
    dt = 0.005
    config = replace(CODES, wire=Wire(packet_loss=0.1))
    lost = np.isnan(read(config, np.ones((2000, 40, 8)), dt=dt))[..., 0]
    assert lost.mean() == pytest.approx(0.1, rel=0.04)
    assert (lost[1:] & lost[:-1]).mean() == pytest.approx(0.01, rel=0.15)
    config = replace(CODES, wire=Wire(gap_share=0.2, gap_length=0.2))
    lost = np.isnan(read(config, np.ones((6000, 40, 8)), dt=dt))
    assert (lost == lost[..., :1]).all()
    ends = (lost[:-1, :, 0] & ~lost[1:, :, 0]).sum()
    # Some 1,200 gaps, each exponential: good to 3 %.
    assert lost[..., 0].sum() * dt / ends == pytest.approx(0.2, rel=0.1)
    assert lost.mean() == pytest.approx(0.2, rel=0.12)


def test_repeats_and_wrong_words_come_as_often_as_they_should():
    rising = np.arange(3000.0)[:, None, None] * 0.01 * np.ones((1, 10, 8))
    again = np.diff(read(replace(CODES, wire=Wire(stale_repeats=0.4)), rising), axis=0) == 0.0
    assert again.mean() == pytest.approx(0.4, rel=0.03)
    off = read(replace(CODES, wire=Wire(wrong_words=0.05)), rising) - rising
    wrong = np.abs(off) > CODES.nominal_scale[0]
    # Of 24 bits the lowest hides in the rounding.
    assert wrong.mean() == pytest.approx(0.05 * 23 / 24, rel=0.05)


def test_a_wire_too_short_for_its_delay_says_how_long_it_must_be():
    stage = wire(Wire(delay=0.02), 1.0, (-1.0, 1.0), 0)
    with pytest.raises(ValueError, match=r"more are under way than Wire.under_way = 8; give at least 22"):
        stage.apply(np.zeros(8), stage.init((8,), np.random.default_rng(0)), np.random.default_rng(0), 0.001)
    with pytest.raises(ValueError, match=r"Wire.wrong_words must be 0 for an instrument without a conv"):
        wire(Wire(wrong_words=0.1), 1.0, (-1.0, 1.0), 0)


def test_a_force_torque_sensor_is_read_over_the_same_wire():
    config = ForceTorque(wire=Wire(packet_loss=0.2, wrong_words=0.1, delay=0.015))
    assert config.word_bits == 16
    rng, sensor = np.random.default_rng(7), force_torque(config)
    state, rows = sensor.init((100, 12), rng), []
    for _ in range(100):
        codes, state = sensor.apply(np.ones((100, 12)), state, rng, 0.01)
        rows.append(codes)
    assert np.isnan(rows[0]).all(), "nothing has arrived yet"
    codes = np.stack(rows[5:])
    lost = np.isnan(codes)
    assert (lost == lost[..., :1]).all()
    assert lost.mean() == pytest.approx(0.2, rel=0.08)
    np.testing.assert_array_equal(codes[~lost], np.rint(codes[~lost]))
    assert np.abs(codes[~lost]).max() <= 2**15


# Rare events


@pytest.mark.parametrize("library", ["numpy", "torch"])
@pytest.mark.parametrize("probability", [0.0, 0.002, 0.05, 0.3, 1.0])
def test_rare_events_are_found_as_often_as_by_looking_at_all(library, probability):
    rng = np.random.default_rng(8) if library == "numpy" else torch.Generator().manual_seed(8)
    zeros = np.zeros((300, 8)) if library == "numpy" else torch.zeros((300, 8), dtype=torch.float64)
    hits = [np.asarray(change_at_random(zeros, probability, lambda few: few + 1.0, rng)) for _ in range(60)]
    found = np.stack(hits)
    assert set(np.unique(found)) <= {0.0, 1.0}
    spread = (probability * (1.0 - probability) / found.size) ** 0.5
    assert found.mean() == pytest.approx(probability, abs=4.0 * spread + 1e-12)
    # Each place alike, and one after the other on its own.
    each = found.reshape(60, -1)
    both = (each[:, 1:] * each[:, :-1]).mean()
    assert both == pytest.approx(probability**2, abs=5.0 * probability / each.size**0.5)
    thirds = found.reshape(60, 3, -1).mean(axis=(0, 2))
    np.testing.assert_allclose(thirds, probability, atol=4.0 * 3**0.5 * spread)


def test_spikes_of_a_batch_are_those_of_their_channels():
    stage = spikes(50.0, [1.0, 100.0])
    read_back, _ = stage.apply(np.zeros((20_000, 2)), (), np.random.default_rng(9), 0.002)
    hit = read_back != 0.0
    np.testing.assert_allclose([read_back[hit[:, k], k].std() for k in (0, 1)], [1.0, 100.0], rtol=0.06)


def test_the_whole_device_has_every_link():
    assert all(getattr(BAR_CELLS_ON_HX711.wire, name) for name in Wire.__dataclass_fields__)
    spring_fields = set(Mechanics.__dataclass_fields__) - {"mounting_common_std"}
    assert all(getattr(BAR_CELLS_ON_HX711.mechanics, name) for name in spring_fields)
    # Half of a conversion, three halves of the filter's, and the network.
    assert BAR_CELLS_ON_HX711.nominal_age == pytest.approx(2.0 / 86.0 + 0.02)
