"""Configurations: checked, named, and back from JSON."""

import ast
import inspect
import json
import textwrap
from dataclasses import asdict
from itertools import pairwise
from operator import call

import numpy as np
import pytest
from _refusals import refusals

from surefoot.sensors import PRESETS, Imu, LoadCells, Mechanics, Wire, preset
from surefoot.sensors.configuration import from_mapping
from surefoot.sensors.presets import resolve

TAU = {"creep_time_constants": [3.0]}


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, named in PRESETS.items() for name in named]
)
def test_every_preset_survives_json(kind, name: str) -> None:
    config = preset(name, kind)
    assert resolve(json.loads(json.dumps(asdict(config))), kind) == config
    assert resolve(name, kind) is config
    assert resolve(config, kind) is config


@pytest.mark.parametrize("kind", [*PRESETS, Mechanics, Wire])
def test_every_field_tells_its_physics(kind) -> None:
    """A docstring follows each field in the source."""
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0].body
    for field, text in pairwise(body):
        if isinstance(field, ast.AnnAssign):
            assert isinstance(text, ast.Expr), field.target.id
            assert isinstance(text.value, ast.Constant)
            assert len(text.value.value) > 10


test_unknown_names_are_refused_with_what_there_is = refusals(
    call,
    (lambda: preset("hx712"), r"no LoadCells preset 'hx712'; there are \['hx711-bar-cells', .*'perfect'\]"),
    (lambda: resolve("hx711-load-cells", Imu), "no Imu preset 'hx711-load-cells'"),
    (
        lambda: from_mapping(LoadCells, {"drfit": 1.0}),
        r"LoadCells has no field \['drfit'\]; it has \['channels', 'capacity'",
    ),
    (
        lambda: resolve({"wire": {"dealy": 0.02}}, LoadCells),
        r"Wire has no field \['dealy'\]; it has \['spike_rate'",
    ),
)


def test_a_mapping_may_name_some_fields_only() -> None:
    assert resolve({"rate": [80.0, 80.0]}, LoadCells) == LoadCells(rate=(80.0, 80.0))


def test_a_mapping_may_hold_mappings() -> None:
    config = resolve({"wire": {"delay": 0.02}, "mechanics": {"creep_shares": [0.1]} | TAU}, LoadCells)
    assert config.wire == Wire(delay=0.02)
    assert config.mechanics == Mechanics(creep_shares=(0.1,), creep_time_constants=(3.0,))


test_anything_else_is_refused = refusals(
    lambda config: resolve(config, LoadCells),
    (3, "name of a preset, a mapping or a configuration"),
    (Imu(), "got Imu"),
    error=TypeError,
)


test_impossible_values_are_refused_with_field_and_value = refusals(
    call,
    (lambda: LoadCells(input_noise=-1.0), "LoadCells.input_noise must be finite and not negative, got -1.0"),
    (lambda: LoadCells(scale_drift=float("nan")), "LoadCells.scale_drift must be .*, got nan"),
    (lambda: LoadCells(capacity=0.0), "LoadCells.capacity must be finite and positive, got 0.0"),
    (lambda: LoadCells(channels=0), "LoadCells.channels must be a whole number from 1 on, got 0"),
    (lambda: LoadCells(adc_bits=40), "LoadCells.adc_bits must lie in 0 to 32, got 40"),
    (lambda: LoadCells(coding="gray"), "LoadCells.coding must be .*, got 'gray'"),
    (lambda: LoadCells(polarity=(1, 2)), r"LoadCells.polarity must hold \+1 or -1 .*, got \(1, 2\)"),
    (lambda: LoadCells(rate=(94.0, 78.0)), r"LoadCells.rate must be None or .*, got \(94.0, 78.0\)"),
    (lambda: LoadCells(wire={}), r"LoadCells.wire must be a Wire, got \{\}"),
    (
        lambda: LoadCells(channels=6, polarity=(1,), mechanics=Mechanics(mounting_warp_std=1.0)),
        "LoadCells.channels must be whole feet of 4 cells where impacts .*, got 6",
    ),
    (
        lambda: LoadCells(adc_bits=0, wire=Wire(wrong_words=0.1)),
        "LoadCells.adc_bits must be above 0 where words can be wrong, got 0",
    ),
    (lambda: Mechanics(nonlinearity=0.1), "Mechanics.nonlinearity must be below 1/12, got 0.1"),
    (lambda: Mechanics(creep_shares=(0.1,)), "must hold a positive time for each of the 1 creep_shares"),
    (lambda: Mechanics(overload_share=1.5), "Mechanics.overload_share must be at most 1, got 1.5"),
    (lambda: Imu(averaged=1), "Imu.averaged must be True or False, got 1"),
)


def test_configurations_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        LoadCells().capacity = 3.0
    assert not np.isscalar(LoadCells().nominal_scale)
