"""Configurations: checked, named, and back from JSON."""

import ast
import inspect
import json
import textwrap
from dataclasses import asdict
from itertools import pairwise

import numpy as np
import pytest

from surefoot.sensors import PRESETS, Encoders, Imu, Link, LoadCells, from_mapping, preset, resolve


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, named in PRESETS.items() for name in named]
)
def test_every_preset_survives_json(kind, name: str) -> None:
    config = preset(name, kind)
    assert resolve(json.loads(json.dumps(asdict(config))), kind) == config
    assert resolve(name, kind) is config
    assert resolve(config, kind) is config


@pytest.mark.parametrize("kind", PRESETS)
def test_every_field_tells_its_physics(kind) -> None:
    """A docstring follows each field in the source."""
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0].body
    for field, text in pairwise(body):
        if isinstance(field, ast.AnnAssign):
            assert isinstance(text, ast.Expr), field.target.id
            assert isinstance(text.value, ast.Constant)
            assert len(text.value.value) > 10


def test_unknown_presets_list_what_there_is() -> None:
    with pytest.raises(
        ValueError, match=r"no LoadCells preset 'hx712'; there are \['hx711-load-cells', 'perfect'\]"
    ):
        preset("hx712")
    with pytest.raises(ValueError, match="no Imu preset 'hx711-load-cells'"):
        resolve("hx711-load-cells", Imu)


def test_unknown_keys_are_named() -> None:
    with pytest.raises(
        ValueError, match=r"LoadCells has no field \['drfit'\]; it has \['channels', 'capacity'"
    ):
        from_mapping(LoadCells, {"drfit": 1.0})


def test_a_mapping_may_name_some_fields_only() -> None:
    assert resolve({"rate": [80.0, 80.0]}, LoadCells) == LoadCells(rate=(80.0, 80.0))


def test_anything_else_is_refused() -> None:
    with pytest.raises(TypeError, match="name of a preset, a mapping or a LoadCells, got int"):
        resolve(3, LoadCells)
    with pytest.raises(TypeError, match="got Imu"):
        resolve(Imu(), LoadCells)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (
            lambda: LoadCells(input_noise=-1.0),
            "LoadCells.input_noise must be finite and not negative, got -1.0",
        ),
        (lambda: LoadCells(gain_drift=float("nan")), "LoadCells.gain_drift must be .*, got nan"),
        (
            lambda: LoadCells(temperature_ramp=-0.1),
            "LoadCells.temperature_ramp must be finite and not negative, got -0.1",
        ),
        (lambda: LoadCells(initial_zero_std="1"), "LoadCells.initial_zero_std must be .*, got '1'"),
        (lambda: LoadCells(capacity=0.0), "LoadCells.capacity must be finite and positive, got 0.0"),
        (lambda: LoadCells(channels=0), "LoadCells.channels must be a positive whole number, got 0"),
        (lambda: LoadCells(adc_bits=40), "LoadCells.adc_bits must lie in 0 to 32, got 40"),
        (lambda: LoadCells(coding="gray"), "LoadCells.coding must be .*, got 'gray'"),
        (lambda: LoadCells(polarity=(1, 2)), r"LoadCells.polarity must hold \+1 or -1 .*, got \(1, 2\)"),
        (lambda: LoadCells(polarity=(1, -1, 1)), r"LoadCells.polarity must .* repeats along them, got"),
        (lambda: LoadCells(rate=(94.0, 78.0)), r"LoadCells.rate must be None or .*, got \(94.0, 78.0\)"),
        (
            lambda: Imu(gyroscope_noise=-1e-4),
            "Imu.gyroscope_noise must be finite and not negative, got -0.0001",
        ),
        (lambda: Imu(averaged=1), "Imu.averaged must be True or False, got 1"),
        (lambda: Encoders(bits=-1), "Encoders.bits must lie in 0 to 32, got -1"),
        (lambda: Encoders(noise_std=-1.0), "Encoders.noise_std must be finite and not negative, got -1.0"),
        (lambda: Link(jitter=float("inf")), "Link.jitter must be finite and not negative, got inf"),
    ],
)
def test_impossible_values_are_refused_with_field_and_value(make, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        make()


def test_configurations_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        LoadCells().capacity = 3.0
    assert not np.isscalar(LoadCells().nominal_scale)
