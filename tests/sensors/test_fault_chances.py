"""Faults by chance: how often, where and when, and what is refused."""

import numpy as np
import pytest
from _refusals import refusals

from surefoot.sensors.faults.chances import draw_faults, parse_chances
from surefoot.sensors.randomness import Stream

ROBOTS, CHANNELS = 4000, 8


def drawn(chances, seed=0, robots=ROBOTS):
    rng = Stream.of(0, seed)
    return [draw_faults(parse_chances(chances), CHANNELS, rng) for _ in range(robots)]


def test_each_channel_has_its_probability():
    faults = [fault for robot in drawn({"dies": 0.02}) for fault in robot]
    hits = np.bincount([fault.channel for fault in faults], minlength=CHANNELS)
    # Four standard deviations of a binomial share.
    np.testing.assert_allclose(hits / ROBOTS, 0.02, atol=4.0 * np.sqrt(0.02 * 0.98 / ROBOTS))
    assert {(fault.kind, fault.start, fault.stop) for fault in faults} == {("dead", 0.0, None)}


def test_what_stands_first_comes_first_and_a_channel_has_one_fault():
    for robot in drawn({"sticks": 0.5, "flips": 1.0}, robots=50):
        assert sorted(fault.channel for fault in robot) == list(range(CHANNELS))
    assert {fault.kind for fault in robot} == {"stuck", "flipped"}


def test_moments_are_alike_likely():
    starts = [fault.start for robot in drawn({"within 20 s dies": 0.2}, robots=500) for fault in robot]
    assert 0.0 <= min(starts) < 1.0
    assert 19.0 < max(starts) < 20.0
    assert np.mean(starts) == pytest.approx(10.0, abs=4.0 * 20.0 / np.sqrt(12 * len(starts)))


def test_times_and_sizes_are_those_of_the_words():
    (fault,) = drawn({"from t=3 s to t=5 s drops 30 % in gaps of 0.2 s": 1.0}, robots=1)[0][:1]
    assert (fault.start, fault.stop, fault.probability, fault.burst) == (3.0, 5.0, 0.3, 0.2)


def test_a_channel_is_exchanged_with_any_other():
    partners = {(f.channel, f.other) for robot in drawn({"swaps": 0.3}, robots=400) for f in robot}
    assert partners == {(i, j) for i in range(CHANNELS) for j in range(CHANNELS) if i != j}


def test_chance_draws_as_much_whatever_happens():
    one, other = Stream.of(0, 3), Stream.of(0, 3)
    draw_faults(parse_chances({"dies": 0.0}), CHANNELS, one)
    draw_faults(parse_chances({"sticks": 1.0}), CHANNELS, other)
    assert one.random((1,)) == other.random((1,))


test_what_is_no_chance_is_refused = refusals(
    parse_chances,
    ({"dies": 1.5}, r"^The value of 'dies' must be the probability .* from 0 to 1; got 1\.5\.$"),
    ({3: 0.1}, r"^A fault by chance is named by words such as 'dies', got 3\.$"),
    (
        {"explodes": 0.1},
        r"^A fault by chance reads 'dies', 'at t=5 s sticks' or .*got 'explodes'\. A cell dies",
    ),
    ({"at t=3 s cell left/2 dies": 0.1}, r"without a cell; got 'at t=3 s cell left/2 dies'"),
)
