"""Partial resets of sensors: the chosen robots take another state, the others keep theirs bit for bit."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from _streams import leaves

from surefoot.sensors import (
    Fault,
    ForceTorque,
    LoadCells,
    Mechanics,
    StrainGauges,
    Wire,
    chain,
    channel_faults,
    drift,
    force_torque,
    imu,
    load_cells,
    scale,
    strain_gauges,
    white_noise,
)
from surefoot.sensors.presets import NAO_IMU
from surefoot.sensors.select import batch_axes, select
from surefoot.sensors.stages.clock import sample_and_hold
from surefoot.sensors.stages.creep import creep
from surefoot.sensors.stages.hysteresis import hysteresis
from surefoot.sensors.stages.mounting import mounting
from surefoot.sensors.stages.moving_average import moving_average
from surefoot.sensors.stages.overload import overload
from surefoot.sensors.stages.temperature import thermal_drift
from surefoot.sensors.transport.errors import burst_gaps, stale_repeats
from surefoot.sensors.transport.link import latency

WARM = LoadCells(scale_tempco=1e-4, offset_tempco=0.01, temperature_ramp=0.02)
CELLS = LoadCells()
WORST = replace(
    WARM,
    settling=4,
    mechanics=Mechanics(
        nonlinearity=0.01,
        hysteresis=0.02,
        creep_shares=(0.1, 0.02),
        creep_time_constants=(0.05, 2.0),
        mounting_warp_std=0.5,
        overload_share=0.1,
        safe_overload=0.1,
    ),
    wire=Wire(stale_repeats=0.3, gap_share=0.3, packet_loss=0.1, delay=0.02, jitter=0.004, spike_rate=3.0),
)
FAULTS = [Fault("stuck", 1, start=0.02), Fault("dropped", 2, probability=0.5, burst=0.1)]

# What to build, its channels, and whether it takes blocks of substeps.
SENSORS = {
    "load cells": (lambda: load_cells(CELLS), 8, True),
    "every link of load cells": (lambda: load_cells(WORST), 8, True),
    "warm load cells": (lambda: load_cells(WARM), 8, True),
    "six-axis": (lambda: force_torque(ForceTorque(sensors=2)), 12, False),
    "strain gauges": (lambda: strain_gauges(StrainGauges()), 6, False),
    "imu": (lambda: imu(NAO_IMU), 6, False),
    "link": (lambda: latency(0.02, 0.004), 8, False),
    "faults": (lambda: channel_faults(FAULTS, CELLS), 8, False),
    "creep and hysteresis": (
        lambda: chain(creep((0.1, -0.02), (0.05, 2.0)), hysteresis(0.05, 10.0)),
        8,
        False,
    ),
    "mounting": (lambda: mounting(1.0, 2.0, 0.5), 8, False),
    "overload": (lambda: overload(0.1, 6.0), 8, False),
    "gaps and repeats": (lambda: chain(burst_gaps(0.3, 0.1), stale_repeats(0.5)), 8, False),
    "filter": (lambda: moving_average(4), 8, False),
    "temperature": (lambda: thermal_drift(0.1, 0.1, 0.1, ramp=1.0), 8, False),
    "clock": (lambda: sample_and_hold(chain(drift(1.0, 1.0), white_noise(0.1))), 8, True),
    "stateless": (lambda: scale(2.0), 8, False),
}


def run(corruption, channels, blocks, robots, rng, steps=5):
    state = corruption.init((robots, channels), rng)
    for _ in range(steps):
        shape = (robots, 3, channels) if blocks else (robots, channels)
        _, state = corruption.apply(10.0 * rng.normal(size=shape), state, rng, 1 / 80)
    return state


@pytest.mark.parametrize("robots", [2, 3])
@pytest.mark.parametrize("name", SENSORS)
def test_the_chosen_take_theirs_and_the_others_keep_theirs(name, robots):
    # As many robots as an axis has entries that is none of robots: the shape alone does not tell them apart.
    build, channels, blocks = SENSORS[name]
    corruption, rng = build(), np.random.default_rng(1)
    state, fresh = (run(corruption, channels, blocks, robots, rng) for _ in range(2))
    mask = np.arange(robots) % 2 == 0
    before = [np.copy(leaf) for leaf in leaves(state)]
    mixed = select(mask, fresh, state, axes := batch_axes(corruption, channels))
    for leaf, new, old, kept, axis in zip(
        leaves(mixed), leaves(fresh), leaves(state), before, leaves(axes), strict=True
    ):
        np.testing.assert_array_equal(old, kept)
        if axis is None:
            np.testing.assert_array_equal(old, new)  # shared is only what never differs
            continue
        assert old.shape[axis] == robots
        for robot in range(robots):
            source = new if mask[robot] else old
            np.testing.assert_array_equal(leaf.take(robot, axis), source.take(robot, axis))


@pytest.mark.parametrize("name", SENSORS)
def test_a_selected_robot_goes_on_as_it_would_alone(name):
    build, channels, blocks = SENSORS[name]
    corruption = build()
    state, fresh = (run(corruption, channels, blocks, 4, np.random.default_rng(s)) for s in (1, 2))
    mask = np.array([True, False, False, True])
    mixed = select(mask, fresh, state, batch_axes(corruption, channels))
    force = 10.0 * np.random.default_rng(5).normal(size=(4, 3, channels) if blocks else (4, channels))
    read, old, new = (
        corruption.apply(force, which, np.random.default_rng(9), 1 / 80)[0] for which in (mixed, state, fresh)
    )
    np.testing.assert_array_equal(read, np.where(mask[:, None], new, old))


@pytest.mark.parametrize("name", ["warm load cells", "every link of load cells", "six-axis", "faults"])
def test_torch_selects_as_numpy_does(name):
    build, channels, blocks = SENSORS[name]
    corruption, rng = build(), np.random.default_rng(3)
    state, fresh = (run(corruption, channels, blocks, 4, rng) for _ in range(2))
    mask = np.array([True, False, True, False])
    axes = batch_axes(corruption, channels)

    def to_torch(tree):
        if isinstance(tree, tuple):
            parts = [to_torch(part) for part in tree]
            return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
        return torch.asarray(tree, dtype=torch.float32)

    mixed = select(torch.asarray(mask), to_torch(fresh), to_torch(state), axes)
    for ours, theirs in zip(leaves(select(mask, fresh, state, axes)), leaves(mixed), strict=True):
        assert theirs.dtype is torch.float32
        np.testing.assert_array_equal(ours.astype(np.float32), theirs.numpy())


def test_robots_must_be_the_same():
    cells, rng = load_cells(CELLS), np.random.default_rng(0)
    axes = batch_axes(cells, 8)
    four, five = (cells.init((robots, 8), rng) for robots in (4, 5))
    with pytest.raises(ValueError, match=r"'mask' must have shape \(4,\)"):
        select(np.ones(5, bool), four, four, axes)
    with pytest.raises(ValueError, match="make both for the same robots"):
        select(np.ones(4, bool), five, four, axes)
