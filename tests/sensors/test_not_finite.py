"""Loads of a simulation that blew up: NaN for as long as they last, and no trace afterwards."""

from dataclasses import replace

import numpy as np
import pytest
from _streams import DT, leaves

from surefoot.sensors import (
    PRESETS,
    LoadCells,
    Mechanics,
    StrainGauges,
    Wire,
    load_cells,
    preset,
    strain_gauges,
)
from surefoot.sensors.stages.creep import creep
from surefoot.sensors.stages.hysteresis import hysteresis
from surefoot.sensors.stages.mechanics import mechanics
from surefoot.sensors.stages.mounting import mounting
from surefoot.sensors.stages.moving_average import moving_average
from surefoot.sensors.stages.overload import overload

BAD = [float("nan"), float("inf"), -float("inf")]
values = pytest.mark.parametrize("value", BAD)
REMEMBERING = {
    "hx711-bar-cells": preset("hx711-bar-cells"),
    "nao-fsr": preset("nao-fsr"),
    "a clock and its filter": LoadCells(settling=4),
    "a filter alone": LoadCells(settling=4, rate=None),
}


@values
@pytest.mark.parametrize("name", REMEMBERING)
def test_cells_that_remember_loads_forget_one_that_is_not_finite(name, value):
    config = replace(REMEMBERING[name], wire=Wire())
    cells, rng = load_cells(config), np.random.default_rng(1)
    state = cells.init((8,), rng)
    block = np.full((2, 8), 10.0)
    blown = block.copy()
    blown[:, 2] = value
    rows = []
    for k in range(40):
        counts, state = cells.apply(blown if k == 20 else block, state, rng, DT)
        rows.append(counts)
        remembered = [state.window, state.mechanics] if k > 5 else []
        assert all(np.isfinite(leaf).all() for leaf in leaves(tuple(remembered)))
    lost = np.isnan(np.stack(rows)[10:])
    assert lost.any()
    assert not lost[:, [0, 1, 3, 4, 5, 6, 7]].any(), "the other cells never saw it"
    # One conversion is lost; a chip may hold it for one look more.
    assert lost[:, 2].sum() <= 2


@values
def test_a_lost_load_leaves_cells_where_the_load_before_had_left_them(value):
    """Hysteresis and overloads count extremes: nothing happens to them while the load is not there."""
    element = mechanics(Mechanics(hysteresis=0.1, overload_share=0.5, nonlinearity=0.01), 10.0)
    rng = np.random.default_rng(0)
    state, other = (element.init((4,), np.random.default_rng(3)) for _ in range(2))
    for load in (3.0, 25.0, value, 2.0, value, 8.0):
        read, state = element.apply(np.full(4, load), state, rng, DT)
        if np.isfinite(load):
            expected, other = element.apply(np.full(4, load), other, rng, DT)
            np.testing.assert_array_equal(read, expected)
        else:
            assert np.isnan(read).all()


@values
@pytest.mark.parametrize(
    "stage",
    [
        hysteresis(0.05, 10.0),
        creep((0.1, 0.05), (0.05, 2.0)),
        overload(0.1, 6.0),
        mounting(1.0, 2.0, 0.5),
        moving_average(4),
    ],
    ids=["hysteresis", "creep", "overload", "mounting", "moving average"],
)
def test_no_stage_keeps_what_is_not_finite(stage, value):
    rng = np.random.default_rng(0)
    state = stage.init((4,), rng)
    for load in (5.0, 5.0, 5.0, 5.0, 5.0, value, 5.0, 5.5):
        read, state = stage.apply(np.full(4, load), state, rng, DT)
        assert np.isfinite(read).all() == np.isfinite(load)
        assert load == value or all(np.isfinite(leaf).all() for leaf in leaves(state))


@pytest.mark.parametrize("name", PRESETS[StrainGauges])
def test_strain_gauges_recover(name):
    config = preset(name, StrainGauges)
    sensor, rng = strain_gauges(config), np.random.default_rng(0)
    state = sensor.init((config.channels,), rng)
    for k in range(6):
        wrench = np.full(6, np.nan if k == 3 else 1.0)
        counts, state = sensor.apply(wrench, state, rng, DT)
        assert np.isnan(counts).all() == (k == 3)
    assert all(np.isfinite(leaf).all() for leaf in leaves(state))
