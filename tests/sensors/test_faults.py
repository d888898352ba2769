"""Faults: what the host reads, when, and what stays untouched."""

from dataclasses import replace
from operator import call

import numpy as np
import pytest
from _refusals import refusals
from _streams import DT, stream

from surefoot.sensors import Fault, ForceTorque, LoadCells, apply_faults, channel_faults, parse_fault
from surefoot.sensors.faults.words import CELLS as CELL_NAMES
from surefoot.sensors.faults.words import cell_names
from surefoot.sensors.presets import HX711_LOAD_CELLS

CELLS = HX711_LOAD_CELLS
K = CELLS.slope
ZERO = CELLS.zero_code


def log(seconds=4.0, seed=0):
    """Counts (N, 8) of loads about 6 N, and their times."""
    time = DT * (1.0 + np.arange(round(seconds / DT)))
    load = 6.0 + np.random.default_rng(seed).normal(0.0, 2.0, (len(time), 8))
    return np.rint(ZERO + K * load), time


def faulty(*faults, counts=None, time=None, seed=0, config=CELLS):
    if counts is None:
        counts, time = log()
    return apply_faults(counts, time, faults, config, np.random.default_rng(seed))


def load_of(counts, channel):
    return (counts[:, channel] - ZERO) / K[channel]


@pytest.mark.parametrize(
    "fault",
    [
        Fault("dead", 2, 1.0, 2.0),
        Fault("stuck", 2, 1.0, 2.0),
        Fault("saturated", 2, 1.0, 2.0),
        Fault("saturated", 2, 1.0, 2.0, level=4.0),
        Fault("spiking", 2, 1.0, 2.0, rate=10.0),
        Fault("dropped", 2, 1.0, 2.0, probability=0.5),
        Fault("dropped", 2, 1.0, 2.0, probability=0.5, burst=0.1),
        Fault("flipped", 2, 1.0, 2.0),
        Fault("swapped", 2, 1.0, 2.0, other=5),
    ],
    ids=lambda fault: f"{fault.kind} {fault.level or fault.burst or ''}",
)
def test_a_fault_touches_its_channel_and_its_time_alone(fault):
    counts, time = log()
    kept = counts.copy()
    read = faulty(fault, counts=counts, time=time)
    np.testing.assert_array_equal(counts, kept)
    active = (time >= 1.0 - 1e-9) & (time < 2.0 - 1e-9)
    assert active.sum() == 80
    touched = [2, 5] if fault.kind == "swapped" else [2]
    others = [k for k in range(8) if k not in touched]
    np.testing.assert_array_equal(read[:, others], counts[:, others])
    np.testing.assert_array_equal(read[~active], counts[~active])
    for channel in touched:
        assert (read[active, channel] != counts[active, channel]).any()
    finite = np.isfinite(read)
    np.testing.assert_array_equal(read[finite], np.round(read[finite]))
    assert read[finite].min() >= 0.0
    assert read[finite].max() <= 2.0**24 - 1.0


def test_what_each_fault_reads():
    counts, time = log()
    on = time >= 1.0 - 1e-9
    read = faulty(
        Fault("dead", 0, 1.0),
        Fault("stuck", 1, 1.0),
        Fault("saturated", 2, 1.0),
        Fault("saturated", 3, 1.0),
        Fault("saturated", 4, 1.0, level=5.0),
        Fault("flipped", 5, 1.0),
        Fault("swapped", 6, 1.0, other=7),
    )
    assert (read[on, 0] == ZERO).all()
    assert (read[on, 1] == counts[~on][-1, 1]).all()
    # Cells 0, 2, ... are wired the other way round: a load that presses drives them to the lower rail.
    assert K[2] < 0 < K[3]
    assert (read[on, 2] == 0.0).all()
    assert (read[on, 3] == 2.0**24 - 1.0).all()
    np.testing.assert_allclose(load_of(read, 4)[on], np.minimum(load_of(counts, 4)[on], 5.0), atol=1e-4)
    np.testing.assert_allclose(load_of(read, 5)[on], -load_of(counts, 5)[on], atol=1e-9)
    np.testing.assert_array_equal(read[on, 6:], counts[on, :5:-1])


def test_a_saturated_cell_clips_on_the_side_that_presses_whichever_way_it_is_wired():
    read = faulty(Fault("saturated", 0, level=5.0), Fault("saturated", 1, level=5.0))
    for channel in (0, 1):
        load = load_of(read, channel)
        assert load.max() == pytest.approx(5.0, abs=1e-4)
        assert load.min() < 2.0


def many(kind, seconds, **parameters):
    """What is read of no load with a fault in each of the eight channels: counts (N, 8)."""
    faults = [Fault(kind, channel, **parameters) for channel in range(8)]
    return stream(channel_faults(faults, CELLS), np.full((round(seconds / DT), 8), ZERO))


def test_spikes_come_at_their_rate_with_their_size_to_either_side():
    off = (many("spiking", 25.0, rate=2.0, size=15.0) - ZERO) / K
    hit = off != 0.0
    # Of a Poisson process at 2/s in 12.5 ms: 400 +- 20 in 200 s.
    assert 330 < hit.sum() < 470
    np.testing.assert_allclose(np.abs(off[hit]), 15.0, atol=1e-4)
    assert 0.4 < (off[hit] > 0.0).mean() < 0.6


@pytest.mark.parametrize("burst", [0.0, 0.25])
def test_samples_are_lost_by_their_share_in_gaps_of_their_length(burst):
    lost = np.isnan(many("dropped", 125.0, probability=0.3, burst=burst))
    assert lost.mean() == pytest.approx(0.3, abs=0.05)
    ends = (lost[:-1] & ~lost[1:]).sum()
    # Readings lost each on its own leave gaps of 1/(1 - 0.3) readings.
    assert lost[:-1].sum() * DT / ends == pytest.approx(burst if burst else DT / 0.7, rel=0.2)


def test_a_channel_may_be_lost_for_good():
    assert np.isnan(faulty(Fault("dropped", 3, 1.0))[79:, 3]).all()


def test_a_sample_that_never_came_does_not_come_back_by_a_fault():
    counts, time = log()
    counts[100] = np.nan
    read = faulty(Fault("dead", 0), Fault("saturated", 1), Fault("flipped", 2), counts=counts, time=time)
    assert np.isnan(read[100]).all()
    stuck = faulty(Fault("stuck", 0, time[100]), counts=counts, time=time)
    assert (stuck[100:, 0] == counts[99, 0]).all()


def test_faults_act_in_their_order():
    counts, _ = log()
    first = faulty(Fault("dead", 0), Fault("swapped", 0, other=1))
    assert (first[:, 1] == ZERO).all()
    second = faulty(Fault("swapped", 0, other=1), Fault("dead", 0))
    np.testing.assert_array_equal(second[:, 1], counts[:, 0])
    assert (second[:, 0] == ZERO).all()


def test_a_log_reads_what_a_stream_reads():
    faults = (
        Fault("spiking", 0, rate=10.0),
        Fault("dropped", 1, 0.5, 3.0, probability=0.4, burst=0.1),
        Fault("stuck", 2, 1.0, 2.0),
    )
    counts, _ = log()
    read = stream(channel_faults(faults, CELLS), counts, seed=4)
    np.testing.assert_array_equal(read, faulty(*faults, seed=4))


def test_the_clock_of_a_log_is_the_faults_clock():
    counts, time = log()
    read = faulty(Fault("dead", 0, 1001.0), counts=counts, time=time + 1000.0)
    assert (np.flatnonzero(read[:, 0] == ZERO) == np.arange(79, 320)).all()


def test_other_faults_do_not_change_what_chance_does_to_a_channel():
    alone = faulty(Fault("spiking", 1, rate=10.0), seed=5)
    beside = faulty(Fault("dead", 4, 1.0), Fault("spiking", 1, rate=10.0), seed=5)
    np.testing.assert_array_equal(alone[:, 1], beside[:, 1])


def test_six_axis_sensors_break_alike():
    config = ForceTorque()
    counts = np.tile(np.rint(np.arange(12.0) * 40.0), (4, 1))
    time = np.arange(1.0, 5.0)
    faults = (Fault("saturated", 2), Fault("saturated", 11), Fault("flipped", 3))
    read = apply_faults(counts, time, faults, config, np.random.default_rng(0))
    assert (read[:, 2] == np.floor(1500.0 / 0.06)).all()
    assert (read[:, 11] == np.floor(35.0 / 0.0011)).all()
    assert (read[:, 3] == -counts[:, 3]).all()


test_impossible_faults_are_refused = refusals(
    call,
    (lambda: Fault("broken", 0), r"Fault.kind must be one of .*'dead'.*, got 'broken'"),
    (lambda: Fault("dead", -1), "Fault.channel must be a whole number from 0, got -1"),
    (lambda: Fault("dead", 0, 2.0, 1.0), "Fault.stop must come after the start at 2.0 s, got 1.0"),
    (lambda: Fault("saturated", 0, level=-3.0), "Fault.level must be finite and positive, got -3.0"),
    (lambda: Fault("dropped", 0, probability=0.0), "Fault.probability must lie above 0 and at most at 1"),
    (lambda: Fault("swapped", 3, other=3), "Fault.other must name another channel, got 3"),
    (lambda: Fault("dead", 0, other=1), "Fault.other must be None for a channel that is dead, got 1"),
    (lambda: faulty(Fault("dead", 8)), "Fault.channel must be one of the instrument's 8 channels"),
    (
        lambda: faulty(Fault("saturated", 0), config=replace(CELLS, adc_bits=0)),
        "Fault.level must be given for an instrument without a converter",
    ),
    (lambda: faulty(counts=np.zeros((3, 8)), time=np.zeros(2)), r"'time' \(N,\), got \(3, 8\) and \(2,\)"),
    (lambda: faulty(counts=np.zeros((2, 8)), time=np.zeros(2)), "'time' must be finite and increase"),
)


# Faults in words


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("at t=12 s cell left/2 dies", Fault("dead", 1, start=12.0)),
        ("at t=0 s cell right/rear-right sticks", Fault("stuck", 7)),
        ("from t=3 s to t=5.5 s cell left/front-left flips", Fault("flipped", 0, start=3.0, stop=5.5)),
        ("at t=1 s cell right/1 saturates", Fault("saturated", 4, start=1.0)),
        ("at t=1 s cell right/1 saturates beyond 20 N", Fault("saturated", 4, start=1.0, level=20.0)),
        ("at t=1 s cell right/2 spikes", Fault("spiking", 5, start=1.0)),
        ("at t=1 s cell right/2 spikes 2 /s by 15 N", Fault("spiking", 5, start=1.0, rate=2.0, size=15.0)),
        ("at t=1 s cell left/4 drops", Fault("dropped", 3, start=1.0)),
        (
            "at t=1 s cell left/4 drops 30 % in gaps of 0.2 s",
            Fault("dropped", 3, start=1.0, probability=0.3, burst=0.2),
        ),
        ("  at t=9 s  cell left/3 swaps with right/1 ", Fault("swapped", 2, start=9.0, other=4)),
    ],
)
def test_a_line_says_when_which_and_what(text, fault):
    assert parse_fault(text) == fault


def test_cells_go_by_number_or_name_in_the_order_of_the_channels():
    assert cell_names()[:2] == ["left/front-left", "left/front-right"]
    for channel, name in enumerate(cell_names()):
        assert parse_fault(f"at t=0 s cell {name} dies").channel == channel
    assert parse_fault("at t=0 s cell b/2 dies", feet=("a", "b"), cells=("heel", "toe")).channel == 3
    assert len(CELL_NAMES) == 4


test_what_cannot_be_read_is_refused_with_what_can = refusals(
    parse_fault,
    ("left/2 dies", "A fault reads 'at t=12 s cell left/2 dies' or .*, got 'left/2 dies'"),
    ("at t=1 s cell middle/2 dies", r"no cell 'middle/2'; there are \['left/front-left', .*right/4"),
    ("at t=1 s cell left/1 explodes", "A cell dies, sticks, .*, got 'explodes' in 'at t=1 s"),
    ("from t=3 s to t=2 s cell left/1 dies", "Fault.stop must come after the start at 3.0 s"),
)


def test_a_line_does_to_a_log_what_it_says():
    config = LoadCells(adc_bits=0, polarity=(1,))
    time = np.arange(1.0, 6.0)
    read = apply_faults(
        np.full((5, 8), 7.0),
        time,
        [parse_fault("from t=2 s to t=4 s cell left/2 dies")],
        config,
        np.random.default_rng(0),
    )
    np.testing.assert_array_equal(read[:, 1], [7.0, 0.0, 0.0, 7.0, 7.0])
    np.testing.assert_array_equal(np.delete(read, 1, axis=1), 7.0)
