"""How bad an instrument is: every field is an error or not, none is forgotten, and errors scale."""

from dataclasses import fields

import numpy as np
import pytest

from surefoot.sensors import (
    PRESETS,
    ForceTorque,
    Imu,
    Link,
    LoadCells,
    Mechanics,
    StrainGauges,
    Wire,
    load_cells,
    preset,
    scaled,
)
from surefoot.sensors.severity import ERRORS, IDENTITY

BAD = preset("hx711-bar-cells")
DEVICES = {kind: list(named.values()) for kind, named in PRESETS.items()} | {
    Mechanics: [BAD.mechanics, preset("nao-fsr").mechanics, Mechanics()],
    Wire: [BAD.wire, preset("nao-fsr").wire, Wire()],
}
PERFECT = {kind: named["perfect"] for kind, named in PRESETS.items()} | {Mechanics: Mechanics(), Wire: Wire()}
kinds = pytest.mark.parametrize("kind", list(DEVICES), ids=lambda kind: kind.__name__)


def is_an_error(value) -> bool:
    return value.acts if isinstance(value, (Mechanics, Wire)) else bool(np.any(value))


@kinds
def test_every_field_is_either_an_error_or_what_the_instrument_is(kind):
    names = [field.name for field in fields(kind)]
    assert sorted(ERRORS[kind] + IDENTITY[kind]) == sorted(names)


@kinds
def test_no_severity_leaves_the_errors_of_the_perfect_device(kind):
    perfect = PERFECT[kind]
    for config in DEVICES[kind]:
        harmless = scaled(config, 0.0)
        for name in ERRORS[kind]:
            assert not is_an_error(getattr(perfect, name)), f"{name} is an error that a perfect device has"
            assert not is_an_error(getattr(harmless, name)), name
        assert all(getattr(harmless, name) == getattr(config, name) for name in IDENTITY[kind])


@kinds
def test_severity_one_is_the_configuration_and_others_are_in_proportion(kind):
    for config in DEVICES[kind]:
        assert scaled(config, 1.0) == config
        for severity in (0.3, 1.3):
            worse = scaled(config, severity)
            for name in ERRORS[kind]:
                if type(getattr(config, name)) in ERRORS:
                    assert getattr(worse, name) == scaled(getattr(config, name), severity)
                    continue
                expected = severity * np.array(getattr(config, name))
                np.testing.assert_allclose(getattr(worse, name), expected, rtol=1e-14)
            assert all(getattr(worse, name) == getattr(config, name) for name in IDENTITY[kind])


def test_cells_of_twice_the_severity_are_twice_as_far_off():
    config = LoadCells(rate=None, adc_bits=0, polarity=(1,), input_noise=0.0)
    rng = np.random.default_rng(0)
    spread = []
    for severity in (0.0, 1.0, 2.0):
        cells = load_cells(scaled(config, severity))
        load = np.full((4000, 1, 8), 10.0)
        read, _ = cells.apply(load, cells.init((4000, 8), rng), rng, 60.0)
        spread.append((read - 10.0).std())
    # 10 N with a gain error of 12 % + 2 % and a zero of 1.5 N + 1 N, a minute after power-up.
    one = np.hypot(10.0 * np.hypot(0.12, 0.02), np.hypot(1.5, 1.0))
    np.testing.assert_allclose(spread, [0.0, one, 2.0 * one], rtol=0.02, atol=1e-12)


def test_what_no_severity_can_be_is_refused():
    with pytest.raises(ValueError, match=r"'severity' must be finite and not negative, got -0\.5"):
        scaled(Imu(), -0.5)
    with pytest.raises(ValueError, match="'severity' must be finite"):
        scaled(Link(), float("nan"))
    with pytest.raises(TypeError, match=r"dict has no severity; \['LoadCells', 'Mechanics'"):
        scaled({}, 1.0)
    with pytest.raises(ValueError, match=r"severity of 4\.0 is more .* StrainGauges\.gain_error_std must be"):
        scaled(StrainGauges(), 4.0)
    with pytest.raises(ValueError, match=r"severity of 3\.0 is more .* ForceTorque"):
        scaled(ForceTorque(), 3.0)
