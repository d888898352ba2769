"""Telemetry that comes late, with jitter and in order."""

import numpy as np
import pytest

from surefoot.sensors import Link
from surefoot.sensors.transport.link import latency, receive, send

PERIOD = 0.01


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


def test_each_robot_has_its_own_delays() -> None:
    rng = np.random.default_rng(3)
    stage = latency(0.02, 0.004)
    state = stage.init((500, 1), rng)
    for number in range(50):
        held, state = stage.apply(np.full((500, 1), float(number)), state, rng, PERIOD)
    assert len(np.unique(held)) > 1
    assert (49 - held).mean() == pytest.approx(2.5, abs=0.1)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"delay": -0.02}, "Link.delay must be finite and not negative, got -0.02"),
        ({"jitter": -1.0}, "Link.jitter must be finite and not negative, got -1.0"),
        ({"rate": 0.0}, "Link.rate must be finite and positive, got 0.0"),
        ({"rate": None}, "Link.delay must be 0 for a link without a rate, got 0.02"),
    ],
)
def test_impossible_links_are_refused(fields, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Link(**fields)


def test_a_link_needs_room_for_what_is_under_way() -> None:
    with pytest.raises(ValueError, match="'depth' must be at least 1, got 0"):
        latency(0.02, depth=0)


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
