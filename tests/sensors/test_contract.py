"""The laws that every stage and every preset obeys: one table, one set of tests."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from _streams import DT, leaves

from surefoot.native import SENSORS
from surefoot.sensors import (
    PRESETS,
    Corruption,
    Encoders,
    Fault,
    ForceTorque,
    Imu,
    Link,
    LoadCells,
    Mechanics,
    StrainGauges,
    Wire,
    chain,
    channel_faults,
    drift,
    encoders,
    force_torque,
    imu,
    load_cells,
    offset,
    preset,
    quantize,
    saturate,
    scale,
    scale_drift,
    strain_gauges,
    white_noise,
)
from surefoot.sensors.corruption import stateless
from surefoot.sensors.randomness import Stream
from surefoot.sensors.stages.clock import sample_and_hold
from surefoot.sensors.stages.creep import creep
from surefoot.sensors.stages.hysteresis import hysteresis
from surefoot.sensors.stages.mechanics import mechanics
from surefoot.sensors.stages.mounting import mounting
from surefoot.sensors.stages.moving_average import moving_average
from surefoot.sensors.stages.nonlinearity import cross_nonlinearity, nonlinearity, random_nonlinearity
from surefoot.sensors.stages.overload import overload
from surefoot.sensors.stages.shear import shear
from surefoot.sensors.stages.temperature import thermal_drift
from surefoot.sensors.transport.errors import burst_gaps, spikes, stale_repeats, wrong_words
from surefoot.sensors.transport.link import latency
from surefoot.sensors.transport.wire import wire

SUBSTEPS = 10


def build(config: Any) -> Corruption[Any]:
    """Make the corruption of a preset; a link becomes the latency that it is."""
    match config:
        case LoadCells():
            return load_cells(config)
        case ForceTorque():
            return force_torque(config)
        case StrainGauges():
            return strain_gauges(config)
        case Imu():
            return imu(config)
        case Encoders():
            return encoders(config)
        case Link():
            return latency(config.delay, config.jitter)
    raise AssertionError(config)


def cells_with(**fields: Any) -> Callable[[], Corruption[Any]]:
    return lambda: load_cells(LoadCells(**fields))


WARM = {"scale_tempco": 5e-5, "offset_tempco": 0.03, "temperature_ramp": 0.5, "temperature_rise": 14.0}
WARM_GAUGES = {"temperature_ramp": 0.5, "temperature_rise": 14.0}
BENT = Mechanics(
    nonlinearity=0.01,
    hysteresis=0.02,
    creep_shares=(0.1, -0.02),
    creep_time_constants=(0.05, 2.0),
    mounting_warp_std=1.0,
    impact_threshold=2.0,
    overload_share=0.1,
    safe_overload=0.6,
)
BAD_WIRE = Wire(
    spike_rate=10.0,
    wrong_words=0.2,
    stale_repeats=0.3,
    packet_loss=0.1,
    gap_share=0.2,
    gap_length=0.05,
    delay=0.02,
    jitter=0.004,
)
WHOLE = {"mechanics": BENT, "wire": BAD_WIRE, "settling": 4, "capacity": 10.0}
FAULTS = (
    Fault("spiking", 0, rate=20.0),
    Fault("dropped", 1, probability=0.3, burst=0.05),
    Fault("dropped", 2, probability=0.5),
    Fault("stuck", 3, start=0.05, stop=0.1),
    Fault("saturated", 4, level=4.0),
    Fault("saturated", 5, start=0.06),
    Fault("swapped", 6, other=7),
    Fault("flipped", 6, start=0.03),
    Fault("dead", 7, stop=0.05),
)


def sideways(stage: Corruption[Any]) -> Corruption[Any]:
    """Feed a stage with vertical loads and with shear of a third and of minus a fifth of them."""
    return chain(stateless(lambda load, rng, dt: np.concatenate([load, load / 3, -load / 5], axis=-1)), stage)


# Name: (how to make it, channels, whether it reads blocks of substeps).
STAGES: dict[str, tuple[Callable[[], Corruption[Any]], int, bool]] = {
    "empty chain": (chain, 8, False),
    "scale": (lambda: scale([1.5] * 8), 8, False),
    "offset": (lambda: offset(0.3), 8, False),
    "drift": (lambda: drift(1.5, 0.1), 8, False),
    "scale drift": (lambda: scale_drift(0.1, 0.01), 8, False),
    "white noise": (lambda: white_noise(0.2), 8, False),
    "saturate": (lambda: saturate(-1.0, 1.0), 8, False),
    "quantize": (lambda: quantize(0.25), 8, False),
    "latency": (lambda: latency(0.02, 0.004), 8, False),
    "sample and hold": (lambda: sample_and_hold(white_noise(0.1), (60.0, 94.0)), 8, True),
    "chain": (lambda: chain(scale(2.0), drift(1.0, 0.1), quantize(0.01)), 8, False),
    "thermal drift": (lambda: thermal_drift(1.0, 0.1, 0.01, ramp=0.5, rise=14.0), 8, False),
    "thermal scale": (lambda: thermal_drift(0.1, 0.0, 1e-3, ramp=0.5, relative=True), 8, False),
    "hysteresis": (lambda: hysteresis(0.05, [10.0] * 8), 8, False),
    "creep": (lambda: creep((0.1, -0.02), (0.05, 2.0)), 8, False),
    "warming gauges that lag": (lambda: strain_gauges(StrainGauges(**WARM_GAUGES)), 6, False),
    "nonlinearity": (lambda: nonlinearity(0.01, [0.02] * 8, 10.0), 8, False),
    "mounting": (lambda: mounting(1.0, 2.0, 0.5), 8, False),
    "overload": (lambda: overload(0.1, 6.0), 8, False),
    "moving average": (lambda: moving_average(4), 8, False),
    "burst gaps": (lambda: burst_gaps(0.3, 0.05), 8, False),
    "stale repeats": (lambda: stale_repeats(0.5), 8, False),
    "wrong words": (lambda: chain(quantize(1.0), wrong_words(0.5)), 8, False),
    "spikes": (lambda: spikes(20.0, 5.0), 8, False),
    "faults": (lambda: channel_faults(FAULTS, LoadCells()), 8, False),
    "warming load cells": (cells_with(**WARM), 8, True),
    "drawn nonlinearity": (lambda: random_nonlinearity(0.05, 10.0), 8, False),
    "coupled nonlinearity": (lambda: cross_nonlinearity(0.04, 0.01, [10.0] * 8), 8, False),
    "bent gauges": (
        lambda: strain_gauges(StrainGauges(nonlinearity=0.04, cross_nonlinearity=0.01)),
        6,
        False,
    ),
    "mechanics": (lambda: mechanics(BENT, 10.0), 8, False),
    "wire": (lambda: chain(quantize(1.0), wire(BAD_WIRE, 20.0, (-128.0, 127.0), 8)), 8, False),
    "settling": (lambda: sample_and_hold(chain(), (60.0, 94.0), settling=4), 8, True),
    "whole load cells": (cells_with(**WHOLE, **WARM), 8, True),
    "whole load cells without a clock": (cells_with(**WHOLE, rate=None), 8, True),
    "force-torque on a wire": (lambda: force_torque(ForceTorque(wire=BAD_WIRE)), 12, False),
    "skewed IMU": (
        lambda: imu(Imu(accelerometer_scale_std=0.1, gyroscope_scale_std=0.2, misalignment_std=0.05)),
        6,
        False,
    ),
    "shear": (lambda: sideways(shear(0.1)), 8, False),
    "whole load cells that feel shear": (
        lambda: sideways(load_cells(LoadCells(shear_std=0.1, **WHOLE))),
        8,
        True,
    ),
    "load cells, drifting scales only": (cells_with(offset_drift=0.0), 8, True),
    "load cells, drifting offsets only": (cells_with(scale_drift=0.0, input_noise=0.0), 8, True),
}
for kind, named in PRESETS.items():
    for preset_name, preset_config in named.items():
        count = {Imu: 6, StrainGauges: 6, ForceTorque: 12}.get(kind, 8)
        STAGES[f"{kind.__name__} {preset_name}"] = (
            lambda preset_config=preset_config: build(preset_config),
            count,
            kind is LoadCells,
        )

NULL = {
    "scale": (lambda: scale(1.0), False),
    "offset": (lambda: offset(0.0), False),
    "drift": (drift, False),
    "scale drift": (scale_drift, False),
    "white noise": (lambda: white_noise(0.0), False),
    "quantize": (lambda: quantize(0.0), False),
    "latency": (lambda: latency(0.0), False),
    "empty chain": (chain, False),
    "ideal mechanics": (lambda: mechanics(Mechanics(), 10.0), False),
    "direct wire": (lambda: wire(Wire(), 1.0, (-1.0, 1.0), 0), False),
    "drawn nonlinearity": (lambda: random_nonlinearity(0.0, 10.0), False),
    "coupled nonlinearity": (lambda: cross_nonlinearity(0.0, 0.0, [10.0] * 8), False),
    "no faults": (lambda: channel_faults((), LoadCells(adc_bits=0)), False),
    "thermal drift": (lambda: thermal_drift(0.0, 0.0, 0.0, ramp=1.0), False),
    "hysteresis": (lambda: hysteresis(0.0, 1.0), False),
    "creep": (lambda: creep((), ()), False),
    "nonlinearity": (lambda: nonlinearity(0.0, 0.0, 10.0), False),
    "mounting": (lambda: mounting(1.0, 0.0), False),
    "overload": (lambda: overload(0.0, 5.0), False),
    "shear": (lambda: sideways(shear(0.0)), False),
    "moving average": (lambda: moving_average(1), False),
    "burst gaps": (lambda: burst_gaps(0.0, 0.1), False),
    "stale repeats": (lambda: stale_repeats(0.0), False),
    "wrong words": (lambda: wrong_words(0.0), False),
    "spikes": (lambda: spikes(0.0, 5.0), False),
    **{
        f"perfect {kind.__name__}": (lambda kind=kind: build(preset("perfect", kind)), kind)
        for kind in PRESETS
        # Perfect gauges still read counts: their own tests turn them back into wrenches.
        if kind is not StrainGauges
    },
}

stages = pytest.mark.parametrize("name", STAGES)


def readings(name: str) -> list[Any]:
    """Ten readings in the shape that a stage takes, around 5 N."""
    _, channels, blocks = STAGES[name]
    shape = (10, SUBSTEPS, channels) if blocks else (10, channels)
    return list(np.random.default_rng(1).normal(5.0, 2.0, shape))


def run(name: str, rng: Any) -> Any:
    make, channels, _ = STAGES[name]
    stage, outputs = make(), []
    state = stage.init((channels,), rng)
    for reading in readings(name):
        output, state = stage.apply(reading, state, rng, DT)
        outputs.append(output)
    return np.stack(outputs)


@stages
def test_a_step_follows_from_its_arguments_and_changes_none(name: str) -> None:
    make, channels, _ = STAGES[name]
    stage, inputs, seeded = make(), readings(name), np.random.default_rng
    state, same = (stage.init((channels,), seeded(0)) for _ in range(2))
    for one, other in zip(leaves(state), leaves(same), strict=True):
        np.testing.assert_array_equal(one, other)
    _, state = stage.apply(inputs[0], state, seeded(6), DT)
    kept = np.stack(inputs)
    first, _ = stage.apply(inputs[1], state, seeded(7), DT)
    first = first.copy()
    _, later = stage.apply(inputs[2], state, seeded(8), DT)
    stage.apply(inputs[3], later, seeded(9), DT)
    again, _ = stage.apply(inputs[1], state, seeded(7), DT)
    np.testing.assert_array_equal(np.stack(inputs), kept)
    np.testing.assert_array_equal(again, first)
    if name != "empty chain":
        assert not np.shares_memory(again, inputs[1]), "no view of the reading"


@stages
def test_shape_and_dtype_are_kept(name: str) -> None:
    read = run(name, np.random.default_rng(0))
    assert read.shape == (10, STAGES[name][1])
    assert read.dtype == np.float64


@stages
def test_a_stream_brings_the_same_with_the_library_and_without(name: str, monkeypatch: Any) -> None:
    one, other = Stream.of(4, 7), Stream.of(4, 7)
    read = run(name, one)
    monkeypatch.setattr(SENSORS, "installed", lambda: None)
    np.testing.assert_allclose(run(name, other), read, rtol=1e-12, atol=1e-12)
    assert one.record == other.record


@pytest.mark.parametrize(("make", "kind"), NULL.values(), ids=NULL)
def test_a_null_model_changes_nothing(make: Any, kind: Any) -> None:
    stage, rng = make(), np.random.default_rng(0)
    channels = {Imu: 6, ForceTorque: 12}.get(kind, 8)
    state = stage.init((channels,), rng)
    for seed in range(5):
        shape = (SUBSTEPS, channels) if kind is LoadCells else (channels,)
        reading = np.random.default_rng(seed).normal(0.0, 20.0, shape)
        output, state = stage.apply(reading, state, rng, DT)
        expected = reading.mean(axis=0) if kind is LoadCells else reading
        np.testing.assert_array_equal(output, expected)


def test_anything_else_is_no_generator() -> None:
    with pytest.raises(TypeError, match=r"got RandomState; pass numpy\.random\.default_rng"):
        drift(1.0).init((8,), np.random.RandomState(0))
