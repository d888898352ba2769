"""Faults in words."""

import numpy as np
import pytest

from surefoot.sensors import Fault, LoadCells, apply_faults, parse_fault
from surefoot.sensors.faults.words import CELLS, cell_names


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
    assert len(CELLS) == 4


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("left/2 dies", "A fault reads 'at t=12 s cell left/2 dies' or .*, got 'left/2 dies'"),
        ("at t=-1 s cell left/2 dies", "A fault reads"),
        ("at t=1 s cell middle/2 dies", r"no cell 'middle/2'; there are \['left/front-left', .*right/4"),
        ("at t=1 s cell left/5 dies", "no cell 'left/5'; there are"),
        ("at t=1 s cell left dies", "no cell 'left'; there are"),
        ("at t=1 s cell left/1 swaps with left/9", "no cell 'left/9'"),
        ("at t=1 s cell left/1 explodes", "A cell dies, sticks, .*, got 'explodes' in 'at t=1 s"),
        ("at t=1 s cell left/1 swaps with left/1", "Fault.other must name another channel"),
        ("from t=3 s to t=2 s cell left/1 dies", "Fault.stop must come after the start at 3.0 s"),
        ("at t=1 s cell left/1 drops 300 %", "Fault.probability must lie above 0 and at most at 1"),
    ],
)
def test_what_cannot_be_read_is_told_with_what_can(text, error):
    with pytest.raises(ValueError, match=error):
        parse_fault(text)


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
