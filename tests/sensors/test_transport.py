"""The way to the host: spikes, wrong words, repeats, gaps and late packets."""

from operator import call

import numpy as np
import pytest
from _refusals import refusals
from _streams import DT, follow, stream

from surefoot.sensors import ForceTorque, Link, Wire, force_torque
from surefoot.sensors.transport.errors import GapState, burst_gaps, spikes, stale_repeats, wrong_words
from surefoot.sensors.transport.link import latency, receive, send
from surefoot.sensors.transport.wire import ALONE, wire

PERIOD = 0.01

# Gaps, repeats, words and spikes


def many(share, length, steps, links, dt):
    """Which readings of so many links are lost, each on its own."""
    start = GapState((np.random.default_rng(4).random(links) < share).astype(float))
    return np.isnan(follow(burst_gaps(share, length), np.zeros((steps, links)), dt=dt, state=start)[0])


@pytest.mark.parametrize("dt", [0.01, 0.05])
def test_gaps_have_their_share_their_length_and_their_memory(dt):
    share, length = 0.2, 0.1
    gone = many(share, length, 1500, 400, dt)
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
    gone = many(0.3, 0.5, 3000, 300, 0.005)
    ends = (gone[:-1] & ~gone[1:]).sum()
    # Some 7,700 gaps, each exponential: good to 1.2 %.
    assert gone[:-1].sum() * 0.005 / ends == pytest.approx(0.5, rel=0.05)


def test_a_packet_holds_every_channel():
    together = np.isnan(stream(burst_gaps(0.4, 0.02), np.zeros((4000, 3))))
    assert (together == together[:, :1]).all()
    assert together[:, 0].mean() == pytest.approx(0.4, abs=0.05)


def test_repeats_have_their_share_and_geometric_runs():
    loads = np.random.default_rng(5).normal(size=(40_000, 2))
    read = stream(stale_repeats(0.6), loads)
    same = read[1:] == read[:-1]
    np.testing.assert_array_equal(read[0], loads[0])
    np.testing.assert_array_equal(read[1:][~same], loads[1:][~same])
    assert same.mean() == pytest.approx(0.6, abs=0.012)
    # Without a memory, two in a row are the square.
    assert (same[1:] & same[:-1]).mean() == pytest.approx(0.36, abs=0.015)
    assert same.all(axis=1).mean() == same.mean(), "all channels together"


def test_a_lost_reading_is_not_repeated():
    loads = np.array([np.nan, 1.0, np.nan, 2.0])[:, None]
    read = stream(stale_repeats(1.0 - 1e-12), loads)[:, 0]
    np.testing.assert_array_equal(read, [np.nan, 1.0, 1.0, 1.0])


@pytest.mark.parametrize("coding", ["offset-binary", "two's complement"])
def test_one_bit_of_a_wrong_word_is_off_and_each_as_often(coding):
    bits, signed = 12, coding != "offset-binary"
    rng = np.random.default_rng(6)
    words = rng.integers(-2048 if signed else 0, 2048 if signed else 4096, 120_000)
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


def test_each_bit_of_the_longest_words_turns_over_and_lost_ones_stay_lost():
    rng = np.random.default_rng(1)
    words = rng.integers(0, 2**32, 20000)
    read, _ = wrong_words(1.0, 32).apply(words.astype(float), (), rng, DT)
    assert set((words ^ read.astype(np.int64)).tolist()) == {2**bit for bit in range(32)}
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


def test_each_channel_has_spikes_of_its_size():
    read = stream(spikes(50.0, [1.0, 100.0]), np.zeros((20_000, 2)), seed=9, dt=0.002)
    hit = read != 0.0
    np.testing.assert_allclose([read[hit[:, k], k].std() for k in (0, 1)], [1.0, 100.0], rtol=0.06)


# Late packets


def deliver(link: Link, packets: int, seed: int = 0) -> tuple[list, np.ndarray]:
    rng = np.random.default_rng(seed)
    under_way, arrived = (), []
    for number in range(packets):
        under_way = send(np.array([float(number)]), number, number * PERIOD, under_way, link, rng)
        come, under_way = receive(under_way, number * PERIOD)
        arrived += come
    come, under_way = receive(under_way, packets * PERIOD + 1.0)
    assert under_way == ()
    return arrived + list(come), np.array([packet.arrival for packet in arrived + list(come)])


def test_packets_come_20_ms_late_by_4_ms_and_in_order() -> None:
    packets, arrival = deliver(Link(), 5000)
    assert [packet.number for packet in packets] == list(range(5000))
    assert (np.diff(arrival) >= 0.0).all()
    delay = arrival - PERIOD * np.arange(5000)
    assert delay.mean() == pytest.approx(0.020, abs=3e-4)
    assert delay.std() == pytest.approx(0.004, rel=0.06)


def test_a_packet_never_overtakes() -> None:
    _, arrival = deliver(Link(jitter=0.02), 2000)
    assert (np.diff(arrival) >= 0.0).all()
    assert (arrival >= PERIOD * np.arange(2000)).all()


def test_a_packet_is_there_when_it_has_arrived_and_not_before() -> None:
    rng = np.random.default_rng(1)
    under_way = send(np.zeros(1), 0, 1.0, (), Link(jitter=0.0), rng)
    assert receive(under_way, 1.0199) == ((), under_way)
    come, left = receive(under_way, 1.0201)
    assert (len(come), left) == (1, ())
    assert come[0].arrival == pytest.approx(1.020)


@pytest.mark.parametrize("jitter", [0.0, 0.004])
def test_the_stage_and_the_packets_are_one_model(jitter: float) -> None:
    """The newest packet that has arrived is what the stage holds, draw for draw."""
    stage, link = latency(0.02, jitter), Link(delay=0.02, jitter=jitter)
    rng, other = np.random.default_rng(2), np.random.default_rng(2)
    state, under_way, newest = stage.init((1,), rng), (), np.nan
    for number in range(300):
        held, state = stage.apply(np.array([float(number)]), state, rng, PERIOD)
        under_way = send(np.array([float(number)]), number, number * PERIOD, under_way, link, other)
        come, under_way = receive(under_way, number * PERIOD)
        newest = come[-1].values[0] if come else newest
        assert held[0] == newest or (np.isnan(held[0]) and np.isnan(newest))
    assert newest > 290


def test_what_is_held_is_as_old_as_the_delay_and_half_a_period() -> None:
    number = np.arange(2000.0)[:, None]
    age = (number - stream(latency(0.02, 0.004), number, seed=3, dt=PERIOD))[20:]
    assert len(np.unique(age)) > 1
    assert age.mean() == pytest.approx(2.5, abs=0.1)


def test_the_last_that_came_is_held_while_everything_is_under_way() -> None:
    """A jitter above the queue's length holds the readings of a whole queue up."""
    rng, stage = np.random.default_rng(4), latency(0.02, 0.02, depth=3)
    state, newest = stage.init((1,), rng), np.nan
    waited = 0
    for number in range(1, 400):
        held, state = stage.apply(np.array([float(number)]), state, rng, PERIOD)
        if (state.due > 0.0).all():
            np.testing.assert_array_equal(held, newest)
            waited += 1
        assert np.isnan(newest) or held[0] >= newest
        newest = held[0]
    assert waited > 20


# All of them on one wire


@pytest.mark.parametrize(
    ("fields", "stage"),
    [
        ({"spike_rate": 20.0, "spike_size": 0.5}, spikes(20.0, 50.0, code_range=(-128.0, 127.0))),
        ({"wrong_words": 0.2}, wrong_words(0.2, 8, "two's complement")),
        ({"stale_repeats": 0.4}, stale_repeats(0.4)),
        ({"packet_loss": 0.3}, burst_gaps(0.3, ALONE)),
        ({"gap_share": 0.3, "gap_length": 0.05}, burst_gaps(0.3, 0.05)),
        ({"delay": 0.02, "jitter": 0.004, "under_way": 4}, latency(0.02, 0.004, 4)),
    ],
    ids=lambda part: next(iter(part)) if isinstance(part, dict) else "",
)
def test_each_field_of_a_wire_is_one_stage_with_its_numbers(fields, stage):
    codes = np.rint(np.random.default_rng(7).normal(0.0, 40.0, (80, 8))).clip(-128.0, 127.0)
    read = stream(wire(Wire(**fields), -100.0, (-128.0, 127.0), 8), codes)
    np.testing.assert_array_equal(read, stream(stage, codes))
    assert (read != codes).any()
    np.testing.assert_array_equal(read, np.rint(read))
    assert (np.nanmin(read), np.nanmax(read)) >= (-128.0, -128.0)
    assert np.nanmax(read) <= 127.0


def test_single_packets_are_lost_each_on_its_own():
    lost = np.isnan(stream(wire(Wire(packet_loss=0.1), 1.0, (-1.0, 1.0), 0), np.ones((40_000, 1)), dt=0.005))
    assert lost.mean() == pytest.approx(0.1, rel=0.04)
    assert (lost[1:] & lost[:-1]).mean() == pytest.approx(0.01, rel=0.15)


def test_a_wire_too_short_for_its_delay_says_how_long_it_must_be():
    stage = wire(Wire(delay=0.02), 1.0, (-1.0, 1.0), 0)
    with pytest.raises(ValueError, match=r"more are under way than Wire.under_way = 8; give at least 22"):
        stage.apply(np.zeros(8), stage.init((8,), np.random.default_rng(0)), np.random.default_rng(0), 0.001)
    with pytest.raises(ValueError, match=r"Wire.wrong_words must be 0 for an instrument without a conv"):
        wire(Wire(wrong_words=0.1), 1.0, (-1.0, 1.0), 0)


def test_a_force_torque_sensor_is_read_over_the_same_wire():
    config = ForceTorque(wire=Wire(packet_loss=0.2, wrong_words=0.1, delay=0.015))
    assert config.word_bits == 16
    codes = stream(force_torque(config), np.ones((5000, 12)), seed=7, dt=0.01)
    assert np.isnan(codes[0]).all(), "nothing has arrived yet"
    codes = codes[5:]
    lost = np.isnan(codes)
    assert (lost == lost[:, :1]).all()
    assert lost.mean() == pytest.approx(0.2, rel=0.08)
    np.testing.assert_array_equal(codes[~lost], np.rint(codes[~lost]))
    assert np.abs(codes[~lost]).max() <= 2**15


# Bad input


test_impossible_errors_are_refused = refusals(
    call,
    (lambda: burst_gaps(1.0, 1.0), r"'share' must lie in \[0, 1\), got 1.0"),
    (lambda: wrong_words(0.1, 33), "'bits' must be a whole number from 1 to 32, got 33"),
    (lambda: wrong_words(0.1, 8, "gray"), "'coding' must be one of .* got 'gray'"),
    (lambda: Link(rate=None), "Link.delay must be 0 for a link without a rate, got 0.02"),
    (lambda: latency(0.02, depth=0), "'depth' must be at least 1, got 0"),
)
