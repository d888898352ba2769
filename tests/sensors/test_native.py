"""Devices in C against the Python that specifies them: the same counts and states, sample by sample."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from _native import SANITIZED, compile_program, run_program
from _streams import leaves
from hypothesis import given, settings
from hypothesis import strategies as st

from surefoot.native import FOLDER, Library, compiler
from surefoot.sensors import Fault, ForceTorque, LoadCells, Mechanics, StrainGauges, Wire, load_cells, preset
from surefoot.sensors.devices.native_device import NativeDevice, native_device
from surefoot.sensors.devices.native_kinds import CELLS, FAULTS, FORCE_TORQUE, STRAIN_GAUGES, Broken
from surefoot.sensors.faults.channels import KINDS as FAULT_KINDS
from surefoot.sensors.presets import PRESETS
from surefoot.sensors.randomness import Stream

SAMPLES, SUBSTEPS, DT = 2000, 5, 1 / 80
CLOSE = 1e-9

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")

ELEMENT = Mechanics(
    nonlinearity=0.01,
    hysteresis=0.02,
    creep_shares=(0.1, -0.02),
    creep_time_constants=(0.05, 2.0),
    mounting_warp_std=1.0,
    mounting_common_std=0.3,
    impact_threshold=15.0,
    overload_share=0.1,
    safe_overload=0.6,
)
WIRE = Wire(
    spike_rate=3.0,
    wrong_words=0.05,
    stale_repeats=0.2,
    packet_loss=0.05,
    gap_share=0.05,
    gap_length=0.05,
    delay=0.02,
    jitter=0.004,
)
WARM = {"scale_tempco": 5e-5, "offset_tempco": 0.03, "temperature_ramp": 0.5, "temperature_rise": 14.0}
DRIFTING = {"scale_drift": 0.01, "offset_drift_force": 1.0, "offset_drift_torque": 0.02}
HEATED = {"temperature_ramp": 0.5, "temperature_rise": 14.0, "scale_tempco": 0.01}
REDUNDANT = tuple(map(tuple, np.linalg.pinv(np.random.default_rng(3).normal(0.0, 40.0, (8, 6))).tolist()))
KINDS = {LoadCells: CELLS, ForceTorque: FORCE_TORQUE, StrainGauges: STRAIN_GAUGES, Broken: FAULTS}
ALL_FAULTS = (
    Fault("dead", 0, 1.0, 6.0),
    Fault("stuck", 1, 0.5, 7.0),
    Fault("saturated", 2, 2.0),
    Fault("saturated", 3, 2.0, level=4.0),
    Fault("spiking", 4, 0.0, 20.0, rate=20.0, size=5.0),
    Fault("dropped", 5, 3.0, probability=0.4),
    Fault("dropped", 6, 3.0, 15.0, probability=0.3, burst=0.2),
    Fault("swapped", 7, 4.0, 12.0, other=4),
    Fault("flipped", 0, 8.0),
    Fault("stuck", 5, 9.0, 18.0),
    Fault("dropped", 1, 22.0),
)
TABLE: dict[str, Any] = {
    **{name: preset(name, LoadCells) for name in PRESETS[LoadCells]},
    "whole": LoadCells(mechanics=ELEMENT, wire=WIRE, settling=4, capacity=40.0, **WARM),
    "whole, no clock": LoadCells(mechanics=ELEMENT, wire=WIRE, rate=None, capacity=40.0, **WARM),
    "whole, no converter": LoadCells(
        mechanics=ELEMENT, wire=Wire(spike_rate=3.0, delay=0.02), settling=4, capacity=40.0, adc_bits=0
    ),
    "fast chips": LoadCells(rate=(300.0, 330.0), settling=6, adc_bits=0),
    "slow chips": LoadCells(
        rate=(9.0, 11.0), settling=3, adc_bits=0, temperature_ramp=0.01, offset_tempco=0.01
    ),
    "scales drift": LoadCells(offset_drift=0.0, adc_bits=0),
    "offsets drift": LoadCells(scale_drift=0.0, input_noise=0.0, adc_bits=0),
    "nothing drifts": LoadCells(scale_drift=0.0, offset_drift=0.0, input_noise=0.0, adc_bits=0),
    "impacts": LoadCells(mechanics=Mechanics(mounting_common_std=2.0, impact_threshold=3.0), adc_bits=0),
    "shear": LoadCells(mechanics=ELEMENT, settling=4, capacity=40.0, shear_std=0.1),
    "shear, averaged": LoadCells(rate=None, averaged=True, shear_std=0.1, adc_bits=0),
    "words": LoadCells(wire=Wire(wrong_words=0.3), coding="two's complement", adc_bits=16),
    "four cells": LoadCells(channels=4, mechanics=ELEMENT, adc_bits=0),
    "sixteen cells": LoadCells(channels=16, mechanics=ELEMENT, adc_bits=0),
    **{name: preset(name, ForceTorque) for name in PRESETS[ForceTorque]},
    "six axes, whole": ForceTorque(wire=WIRE, cross_talk_std=0.03, **DRIFTING),
    "six axes, no converter": ForceTorque(
        sensors=1,
        resolution_force=0.0,
        resolution_torque=0.0,
        wire=Wire(spike_rate=3.0, delay=0.02),
        **DRIFTING,
    ),
    **{name: preset(name, StrainGauges) for name in PRESETS[StrainGauges]},
    "gauges, whole": StrainGauges(nonlinearity=0.02, cross_nonlinearity=0.01, adc_bits=0, **HEATED),
    "gauges that lag": StrainGauges(matrix=REDUNDANT, hysteresis=0.03, adc_bits=0),
    "gauges, nothing acts": StrainGauges(
        hysteresis=0.0,
        creep_shares=(),
        creep_time_constants=(),
        noise_force=0.0,
        noise_torque=0.0,
        offset_drift_force=0.0,
        offset_drift_torque=0.0,
    ),
}
TABLE |= {
    "faults": Broken(ALL_FAULTS, LoadCells(polarity=(1, -1))),
    "faults, six axes": Broken(ALL_FAULTS, ForceTorque()),
    "faults, no converter": Broken((*ALL_FAULTS[:2], *ALL_FAULTS[3:]), LoadCells(adc_bits=0, polarity=(1,))),
}
WHOLE = ("whole", "six axes, whole", "gauges, whole", "faults")
QUICK = ("hx711-load-cells", "slow chips", "shear", "words", "four cells", *WHOLE)


def loads(channels: int, rng: np.random.Generator, bad: bool = True) -> np.ndarray[Any, Any]:
    """Two thousand blocks of feet that are set down and lifted, some of a simulation that blew up."""
    time = np.arange(SAMPLES * SUBSTEPS) * DT / SUBSTEPS
    phase = rng.uniform(0.0, 2.0 * np.pi, channels)
    load = 12.0 * np.maximum(np.sin(7.0 * time[:, None] + phase), 0.0) + rng.normal(
        0.0, 0.3, (len(time), channels)
    )
    blocks = load.reshape(SAMPLES, SUBSTEPS, channels)
    blocks[SAMPLES // 4] += 60.0
    if bad:
        hit = rng.random(blocks.shape) < 1e-3
        blocks[hit] = rng.choice([np.nan, np.inf, -np.inf], int(hit.sum()))
    return blocks


def of_library(library: Library | None, config: Any) -> NativeDevice | None:
    return native_device(library, KINDS[type(config)], config)


def same(expected: Any, found: Any) -> None:
    assert type(found) is type(expected)
    for one, other in zip(leaves(expected), leaves(found), strict=True):
        assert one.shape == other.shape
        np.testing.assert_allclose(other, one, rtol=CLOSE, atol=CLOSE)


def play(library: Library, config: Any, seed: int, exchange: int, substeps: int = SUBSTEPS) -> None:
    """Read two thousand blocks, or instants, in both ways; change places after some."""
    kind, rng = KINDS[type(config)], np.random.default_rng([17, seed])
    device, native, wire = kind.build(config), of_library(library, config), getattr(config, "wire", None)
    assert native is not None
    one, other = Stream.of(seed, 1), Stream.of(seed, 1)
    expected = device.init((config.channels,), one)
    state = native.pack(device.init((config.channels,), other))
    same(expected, state.python())
    blocks = loads(kind.count_loads(config), rng)[:, :substeps].copy()
    rows: list[tuple[Any, Any]] = []
    with np.errstate(invalid="ignore"):
        for k, load in enumerate(blocks if kind.blocks else blocks[:, 0]):
            if k == exchange:
                expected, state = state.python(), native.pack(expected)
                one, other = other, one
            # The wire holds so many readings and no more.
            dt = DT if k % 100 or (wire and wire.late) else 0.1 * rng.random() + 1e-4
            wanted, expected = device.apply(load, expected, one, dt)
            rows.append((wanted, native.step(state, load, other, dt)))
    wanted, found = np.array(rows).transpose(1, 0, 2)
    # What lies just between two codes may be rounded to either, and is not to be held against the rest.
    with np.errstate(invalid="ignore"):
        near = (abs(found - wanted) == 1.0) & (np.rint(wanted) == wanted)
    assert near.sum() <= 2
    np.testing.assert_allclose(np.where(near, wanted, found), wanted, rtol=CLOSE, atol=CLOSE)
    assert one.record == other.record
    if not near.any():
        same(expected, state.python())


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in TABLE]
)
def test_counts_and_states_are_the_same(library: Library, name: str) -> None:
    play(library, TABLE[name], 1, 700)


def random_fault(kind: str, channels: int, rng: np.random.Generator) -> Fault:
    start, level, rate, size, probability, burst = rng.uniform(0.1, (12.0, 9.0, 30.0, 9.0, 1.0, 0.5))
    channel, away = int(rng.integers(channels)), 1 + int(rng.integers(channels - 1))
    return Fault(
        kind,
        channel,
        start,
        start + 6.0 if rng.random() < 0.5 else None,
        level=level,
        rate=rate,
        size=size,
        probability=probability,
        burst=rng.choice([0.0, burst]),
        other=(channel + away) % channels if kind == "swapped" else None,
    )


@pytest.mark.slow
@settings(max_examples=8, deadline=None, derandomize=True)
@given(data=st.data(), seed=st.integers(0, 1000), exchange=st.integers(0, SAMPLES - 1))
def test_random_devices_are_the_same(library: Library, data: Any, seed: int, exchange: int) -> None:
    def some(value: Any) -> Any:
        return data.draw(st.sampled_from([type(value)(0), value]))

    shares = data.draw(st.sampled_from([(), (0.1,), (0.05, 0.0, -0.02)]))
    times = (0.1, 1.0, 30.0)[: len(shares)]
    wire = Wire(
        spike_rate=some(2.0), stale_repeats=some(0.3), packet_loss=some(0.1), gap_share=some(0.1),
        delay=some(0.03), jitter=some(0.01), under_way=data.draw(st.integers(4, 16)),
    )  # fmt: skip
    element = Mechanics(
        nonlinearity=some(0.02), hysteresis=some(0.05), creep_shares=shares, creep_time_constants=times,
        mounting_warp_std=some(1.5), mounting_common_std=some(0.5), overload_share=some(0.2),
        safe_overload=0.5,
    )  # fmt: skip
    rate = data.draw(st.sampled_from([None, (78.0, 94.0), (20.0, 200.0)]))
    cells = LoadCells(
        channels=data.draw(st.sampled_from([4, 8, 12])), mechanics=element, wire=wire, rate=rate,
        settling=1 if rate is None else data.draw(st.integers(1, 8)), adc_bits=some(24), capacity=40.0,
        scale_drift=some(0.01), offset_drift=some(0.1), **data.draw(st.sampled_from([{}, WARM])),
    )  # fmt: skip
    codes = data.draw(st.sampled_from([0.0, 1.0]))
    sensors = ForceTorque(
        sensors=data.draw(st.integers(1, 2)), wire=wire, resolution_force=0.06 * codes, noise_force=some(0.1),
        resolution_torque=0.001 * codes, full_scale_force=30.0, full_scale_torque=15.0,
        scale_drift=some(0.01), offset_drift_force=some(1.0), offset_drift_torque=some(0.02),
    )  # fmt: skip
    gauges = StrainGauges(
        matrix=data.draw(st.sampled_from([REDUNDANT, StrainGauges().matrix])), adc_bits=some(16),
        hysteresis=some(0.03),
        nonlinearity=some(0.02), cross_nonlinearity=some(0.01), creep_shares=shares,
        creep_time_constants=times, offset_drift_force=some(1.0), noise_torque=some(0.01),
        **data.draw(st.sampled_from([{}, HEATED])),
    )  # fmt: skip
    substeps = data.draw(st.sampled_from([1, 2, SUBSTEPS]))
    kinds = data.draw(st.lists(st.sampled_from(FAULT_KINDS), min_size=1, max_size=16))
    chances = np.random.default_rng(seed)
    faults = tuple(random_fault(kind, cells.channels, chances) for kind in kinds)
    for config in (cells, sensors, gauges, Broken(faults, cells)):
        play(library, config, seed, exchange, substeps)


def test_a_state_shares_nothing_with_the_pythons(library: Library) -> None:
    config, stream = TABLE["whole"], Stream.of(3)
    native = of_library(library, config)
    assert native is not None
    state = native.pack(load_cells(config).init((8,), stream))
    kept = state.python()
    native.step(state, np.full((SUBSTEPS, 8), 3.0), stream, DT)
    assert (kept.error != state.python().error).all()


def test_what_the_library_is_not_made_for_is_left_to_python(library: Library) -> None:
    assert of_library(None, LoadCells()) is None
    for config in (
        LoadCells(rate=None, settling=2),
        LoadCells(channels=36),
        LoadCells(settling=9),
        LoadCells(wire=Wire(delay=0.01, under_way=17)),
        LoadCells(mechanics=Mechanics(creep_shares=(0.1,) * 5, creep_time_constants=(1.0,) * 5)),
        ForceTorque(sensors=9),
        ForceTorque(wire=Wire(delay=0.01, under_way=17)),
        StrainGauges(matrix=tuple(map(tuple, np.tile(REDUNDANT, 2).tolist()))),
        StrainGauges(creep_shares=(0.1,) * 5, creep_time_constants=(1.0,) * 5),
        Broken((Fault("dead", 0),) * 17, LoadCells()),
    ):
        assert of_library(library, config) is None


def test_a_wire_that_cannot_hold_its_words_is_refused_in_the_same_words(library: Library) -> None:
    config, said = LoadCells(wire=Wire(delay=0.02, under_way=2)), []
    native = of_library(library, config)
    assert native is not None
    device, stream, block = load_cells(config), Stream.of(1), np.zeros((1, 8))
    state = device.init((8,), stream)
    for step in (
        lambda: device.apply(block, state, stream, 0.005),
        lambda: native.step(native.pack(state), block, stream, 0.005),
    ):
        with pytest.raises(ValueError, match="under way") as caught:
            step()
        said.append(str(caught.value))
    assert said[0] == said[1]


def test_the_headers_compile_alone_without_a_warning(tmp_path: Path) -> None:
    for header in sorted(FOLDER.glob("surefoot_*.h")):
        (tmp_path / "alone.c").write_text(f'#include "{header.name}"\nint main(void) {{ return 0; }}\n')
        for flags in ([], ["-DSF_SINGLE"]):
            compile_program(tmp_path / "alone.c", tmp_path / "alone", "-O1", *flags)


@pytest.mark.slow
@pytest.mark.parametrize("name", WHOLE)
def test_garbage_stays_within_the_arrays(library: Library, tmp_path: Path, name: str) -> None:
    config = TABLE[name]
    native = of_library(library, config)
    assert native is not None
    kind = KINDS[type(config)]
    state = native.pack(kind.build(config).init((config.channels,), Stream.of(1)))
    (tmp_path / "config").write_bytes(native.constants.tobytes())
    (tmp_path / "state").write_bytes(state.now.tobytes())
    source = Path(__file__).parent / "fuzz_devices.c"
    compile_program(source, tmp_path / "fuzz", f"-D{kind.name.upper()}", *SANITIZED)
    run_program(tmp_path / "fuzz", tmp_path / "config", tmp_path / "state", "200000")
