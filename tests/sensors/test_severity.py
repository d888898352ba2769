"""How bad an instrument is: errors are marked, none is forgotten, and they scale."""

import re
from dataclasses import fields, is_dataclass, replace
from math import inf

import numpy as np
import pytest
from _refusals import refusals

from surefoot.sensors import (
    PRESETS,
    ForceTorque,
    Imu,
    Link,
    LoadCells,
    Mechanics,
    StrainGauges,
    Wire,
    force_torque,
    load_cells,
    preset,
    scaled,
)
from surefoot.sensors.severity import errors_of
from surefoot.sensors.transport.wire import check_wire

BAD = preset("hx711-bar-cells")
DEVICES = {kind: list(named.values()) for kind, named in PRESETS.items()} | {
    Mechanics: [BAD.mechanics, preset("nao-fsr").mechanics, Mechanics()],
    Wire: [BAD.wire, preset("nao-fsr").wire, Wire()],
}
kinds = pytest.mark.parametrize("kind", list(DEVICES), ids=lambda kind: kind.__name__)


def is_an_error(value) -> bool:
    return value.acts if isinstance(value, (Mechanics, Wire)) else bool(np.any(value))


def identity_of(kind) -> set[str]:
    return {field.name for field in fields(kind)} - set(errors_of(kind))


@kinds
def test_no_field_with_the_name_of_an_error_is_forgotten(kind):
    assert errors_of(kind)
    word = re.compile(r"(_|^)(std|noise|drift|tempco|walk|shares?|loss|delay|jitter|nonlinearity)(_|$)")
    assert not [name for name in identity_of(kind) if word.search(name)]


@kinds
def test_no_severity_leaves_no_error(kind):
    for config in DEVICES[kind]:
        harmless = scaled(config, 0.0)
        for name in errors_of(kind):
            assert not is_an_error(getattr(harmless, name)), name
        assert all(getattr(harmless, name) == getattr(config, name) for name in identity_of(kind))


@kinds
def test_severity_one_is_the_configuration_and_others_are_in_proportion(kind):
    for config in DEVICES[kind]:
        assert scaled(config, 1.0) == config
        for severity in (0.3, 1.2):
            worse = scaled(config, severity)
            for name in errors_of(kind):
                if is_dataclass(getattr(config, name)):
                    assert getattr(worse, name) == scaled(getattr(config, name), severity)
                    continue
                expected = severity * np.array(getattr(config, name))
                np.testing.assert_allclose(getattr(worse, name), expected, rtol=1e-14)
            room = {"under_way"} if severity > 1.0 else set()
            assert all(getattr(worse, name) == getattr(config, name) for name in identity_of(kind) - room)


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, named in PRESETS.items() for name in named], ids=str
)
def test_every_preset_can_be_five_times_as_bad_and_reads(kind, name):
    config, last = preset(name, kind), None
    for severity in (1.5, 2.0, 5.0):
        worse = scaled(config, severity)
        assert worse != last or name == "perfect"
        last = worse
    if kind in (LoadCells, ForceTorque):
        device = (load_cells if kind is LoadCells else force_torque)(worse)
        load = np.full((2, config.channels) if kind is LoadCells else config.channels, 10.0)
        rng, finite = np.random.default_rng(0), 0
        state = device.init((config.channels,), rng)
        for _ in range(40):
            read, state = device.apply(load, state, rng, 1 / 80)
            finite += np.isfinite(read).all()
        assert finite > 10


def test_errors_that_end_somewhere_stop_there_and_others_go_on():
    worse = scaled(preset("nao-fsr"), 3.0)
    assert (worse.wire.stale_repeats, worse.mechanics.hysteresis, worse.initial_scale_std) == (
        0.95,
        0.12,
        3.0 * 0.3,
    )
    for kind in (Mechanics, Wire, StrainGauges):
        limits = {name: most for name, most in errors_of(kind).items() if most < inf}
        assert len(limits) >= 3
        hopeless = scaled(replace(kind(), **dict.fromkeys(limits, 1e-3)), 1e6)
        assert {name: getattr(hopeless, name) for name in limits} == limits
    beyond = Wire(stale_repeats=0.99)
    assert scaled(beyond, 2.0) == beyond
    both = scaled(ForceTorque(), 3.0)
    assert both.initial_scale_std + 5.0 * both.cross_talk_std == pytest.approx(0.25, rel=1e-9)
    assert both.initial_scale_std / both.cross_talk_std == pytest.approx(8.0)
    assert both.noise_force == pytest.approx(0.36)


def test_what_comes_later_finds_room_on_the_wire():
    late = preset("hx711-bar-cells")
    with pytest.raises(ValueError, match=r"under way than Wire.under_way = 4; give at least 10"):
        check_wire(replace(late, wire=replace(late.wire, delay=0.1)), 1 / 80)
    check_wire(scaled(late, 5.0), 1 / 80)
    assert scaled(Wire(), 5.0).under_way == Wire().under_way


@pytest.mark.parametrize("severity", [0.0, 0.5, 2.0, 5.0])
def test_a_severity_of_another_type_makes_the_same_device(severity):
    for name in PRESETS[LoadCells]:
        config = preset(name)
        assert repr(scaled(config, np.float64(severity))) == repr(scaled(config, severity))


def test_cells_of_twice_the_severity_are_twice_as_far_off():
    config = LoadCells(channels=32_000, rate=None, adc_bits=0, polarity=(1,), input_noise=0.0)
    rng = np.random.default_rng(0)
    spread = []
    for severity in (0.0, 1.0, 2.0):
        cells = load_cells(scaled(config, severity))
        read, _ = cells.apply(np.full((1, 32_000), 10.0), cells.init((32_000,), rng), rng, 60.0)
        spread.append((read - 10.0).std())
    # 10 N with a gain error of 12 % + 2 % and a zero of 1.5 N + 1 N, a minute after power-up.
    one = np.hypot(10.0 * np.hypot(0.12, 0.02), np.hypot(1.5, 1.0))
    np.testing.assert_allclose(spread, [0.0, one, 2.0 * one], rtol=0.02, atol=1e-12)


test_what_no_severity_can_be_is_refused = refusals(
    scaled,
    (Imu(), -0.5, r"'severity' must be finite and not negative, got -0\.5"),
    (Link(), float("nan"), "'severity' must be finite"),
    (
        LoadCells(initial_offset_std=1e3),
        1e308,
        r"severity of 1e\+308 is more .* LoadCells\.initial_offset_std must be",
    ),
)
test_what_marks_no_error_has_no_severity = refusals(
    scaled, ({}, 1.0, r"dict has no severity: it marks no field as an error"), error=TypeError
)
