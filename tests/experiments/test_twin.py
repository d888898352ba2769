"""`surefoot twin`: presets read off recordings of simulated instruments, whose numbers are known."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from _logs import run
from _recordings import DATA, needs
from _streams import stream
from numpy.typing import NDArray

import surefoot  # noqa: F401  (registers the environments)
from surefoot.arrays import Floats
from surefoot.calibration.results import CalibrationRefused
from surefoot.experiments.instrument.likeness import compare
from surefoot.experiments.instrument.noise import conversions
from surefoot.experiments.instrument.recording import Recording, read_recording
from surefoot.experiments.instrument.response import creep_of, loop_of
from surefoot.experiments.instrument.twin import Twin, identify
from surefoot.experiments.logs.format import Log, write_log
from surefoot.experiments.logs.table import LogError
from surefoot.sensors import LoadCells
from surefoot.sensors.devices.load_cells import LoadCellState, load_cells
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE
from surefoot.sensors.stages.creep import creep
from surefoot.sensors.stages.hysteresis import hysteresis
from surefoot.sensors.stages.mechanics import SMALLEST_LOOP, Mechanics
from surefoot.sensors.transport.wire import Wire
from surefoot.wrappers import FootSensors

Program = tuple[tuple[float, float], ...]

HOST = 200.0  # rows a second
UP_AND_DOWN = tuple((newtons, 4.0) for newtons in (10.0, 25.0, 50.0, 75.0, 90.0, 75.0, 50.0, 25.0, 10.0))
LONG = ((0.0, 20.0), *UP_AND_DOWN, (0.0, 10.0), (90.0, 30.0), (0.0, 20.0))
LONG += tuple((newtons, 4.0) for newtons in (40.0, 0.0, 60.0, 20.0, 80.0, 0.0))
SHORT = ((0.0, 6.0), (30.0, 3.0), (60.0, 3.0), (90.0, 6.0), (60.0, 3.0), (30.0, 3.0), (0.0, 5.0), (80.0, 3.0))
"""Loads in N, and for how many seconds each is on."""


def record(cells: LoadCells, seed: int, program: Program) -> tuple[Recording, LoadCellState]:
    """Return the readings of cells under loads, and their state at power-up."""
    rng, K = np.random.default_rng(seed), cells.channels
    load = np.concatenate([np.full(round(HOST * seconds), float(newtons)) for newtons, seconds in program])
    device = load_cells(cells)
    first = state = device.init((K,), rng)
    raw = np.empty((len(load), K))
    for row, now in enumerate(load):
        raw[row], state = device.apply(np.full((1, K), now), state, rng, 1.0 / HOST)
    names, time = tuple(f"raw_{i}_count" for i in range(K)), np.arange(len(load)) / HOST
    loads = np.repeat(load[:, None], K, axis=1)
    return Recording("rig.csv", "channels", names, time, raw, loads == 0.0, loads), first


def hits(twin: Twin, cells: LoadCells, first: LoadCellState) -> dict[str, list[bool]]:
    """Return whether each parameter's interval holds the truth, in newtons of the twin's own size."""
    size = cells.counts_per_newton / twin.preset.counts_per_newton
    truth = {
        "noise of a conversion": [cells.noise_counts / twin.preset.counts_per_newton],
        "random walk of the offset": [cells.offset_drift * size],
        "random walk of the scale": [cells.scale_drift * size],
        "conversion rate": 1.0 / first.period if cells.rate else [],
        "slope": cells.slope * (1.0 + first.error[0]),
        "hysteresis": [cells.mechanics.hysteresis],
        "creep": cells.mechanics.creep_shares,
        "nonlinearity": first.mechanics.nonlinearity.quadratic,
        "mean age of readings": [cells.wire.delay],
    }
    if cells.rate:
        truth["mean age of readings"] = [cells.wire.delay + 0.5 * (1 + cells.settling) * first.period.mean()]
    found: dict[str, list[bool]] = {}
    for one in twin.parameters:
        name = one.name.partition(",")[0]
        channel = 0 if one.of == "all channels" else int(one.of.split("_")[1])
        if len(truth.get(name, ())):
            found.setdefault(name, []).append(bool(one.value.low <= truth[name][channel] <= one.value.high))
    return found


def instrument(rng: np.random.Generator, channels: int) -> LoadCells:
    """Draw an instrument, magnitudes log-uniformly and each on its own."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    creeps, slowest = rng.random() < 0.6, rng.uniform(70.0, 90.0)
    return LoadCells(
        channels=channels,
        polarity=(-1, 1),
        input_noise=between(30e-9, 1e-6),
        offset_drift=between(0.01, 1.0) * PER_SQRT_MINUTE,
        scale_drift=between(3e-4, 2e-2) * PER_SQRT_MINUTE,
        rate=None if rng.random() < 0.25 else (slowest, 1.15 * slowest),
        settling=int(rng.choice([1, 4])),
        mechanics=Mechanics(
            nonlinearity=between(2e-4, 5e-3),
            hysteresis=between(2e-4, 5e-3),
            creep_shares=(between(5e-4, 1e-2),) if creeps else (),
            creep_time_constants=(between(2.0, 20.0),) if creeps else (),
        ),
        wire=Wire(delay=float(rng.choice([0.0, 0.02]))),
    )


CELLS = LoadCells(
    channels=2,
    polarity=(-1, 1),
    input_noise=400e-9,
    offset_drift=0.05 * PER_SQRT_MINUTE,
    scale_drift=1e-3 * PER_SQRT_MINUTE,
    rate=(78.0, 94.0),
    mechanics=Mechanics(nonlinearity=2e-3, hysteresis=4e-3),
    wire=Wire(delay=0.02),
)


@pytest.fixture(scope="module")
def rig() -> tuple[Recording, LoadCellState]:
    return record(CELLS, 3, SHORT)


@pytest.fixture(scope="module")
def twin(rig: tuple[Recording, LoadCellState]) -> Twin:
    return identify(rig[0], CELLS.capacity)


def test_the_instrument_is_found(rig: tuple[Recording, LoadCellState], twin: Twin) -> None:
    held = [one for parts in hits(twin, CELLS, rig[1]).values() for one in parts]
    assert len(held) >= 10
    assert np.mean(held) >= 0.8
    assert twin.preset.mechanics.hysteresis == pytest.approx(4e-3, rel=0.2)
    assert twin.preset.input_noise == pytest.approx(400e-9, rel=0.1)
    assert twin.preset.wire.delay == pytest.approx(0.02, abs=0.003)
    assert (twin.preset.coding, twin.preset.adc_bits) == ("offset-binary", 24)
    assert twin.alike, twin.likeness


@pytest.mark.parametrize("change", [{"input_noise": 800e-9}, {"offset_drift": 1.0}, {"rate": (60.0, 65.0)}])
def test_another_instrument_is_told_apart(twin: Twin, change: dict[str, float]) -> None:
    size = np.full(2, 1.0 / twin.preset.counts_per_newton)
    tests = compare(twin.recording, replace(twin.preset, **change), np.full(2, np.nan), size)
    assert min(p for _, p in tests) < 1e-3


def test_loops_and_creep_are_those_of_the_stages() -> None:
    time = np.arange(400) / 100.0
    load = np.repeat(np.repeat([0.0, 40.0, 90.0, 10.0, 60.0], 80)[:, None], 2, axis=1)
    for element, found in (
        (hysteresis(0.003, 98.1, smallest=SMALLEST_LOOP), 0.003 * loop_of(load, 98.1)),
        (creep((0.003,), (0.5,)), 0.003 * creep_of(time, load, 0.5)),
    ):
        np.testing.assert_allclose(stream(element, load, dt=0.01) - load, found, atol=1e-12)


def test_the_command_writes_a_preset_that_feet_take(
    rig: tuple[Recording, LoadCellState], tmp_path: Path, undrawn: None
) -> None:
    recording = rig[0]
    table = pd.DataFrame(dict(zip(recording.names, recording.raw.T, strict=True)))
    table.insert(0, "load_N", recording.load[:, 0])
    table.insert(0, "time_s", recording.time)
    table.to_csv(tmp_path / "rig.csv", index=False)
    result = run("twin", tmp_path / "rig.csv", "--capacity", "98.1", "--json")
    assert json.loads(result.stdout)["alike"]
    given = json.loads((tmp_path / "rig.twin.json").read_text())
    env = FootSensors(gym.make("surefoot/NaoStand-v0"), given)
    env.reset(seed=1)
    env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    assert np.isfinite(env.raw).all()
    env.close()


def test_what_is_missing_is_said(rig: tuple[Recording, LoadCellState], tmp_path: Path) -> None:
    with pytest.raises(
        CalibrationRefused, match=r"nothing says what a count is in newtons\. Give the load of"
    ):
        identify(replace(rig[0], load=None))
    pd.DataFrame({"raw_a_count": [1.0, 2.0]}).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(CalibrationRefused, match=r"a\.csv: rows have no times\. Give time_s, or \[rates\]\."):
        identify(read_recording(tmp_path / "a.csv"))
    with pytest.raises(
        CalibrationRefused, match=r"is of a six-axis sensor, and twins are made of load cells\."
    ):
        identify(replace(rig[0], kind="six-axis sensor"))
    with pytest.raises(LogError, match=r"rig\.csv: column 'time_s' goes back at row 7 .* sort the rows by"):
        identify(replace(rig[0], time=np.where(np.arange(len(rig[0].time)) == 7, 0.01, rig[0].time)))
    with pytest.raises(LogError, match=r"rig\.csv: missing column"):
        identify(replace(rig[0], refusal="rig.csv: missing column raw_b_count."))


def test_repeats_of_a_clock_and_of_coarse_steps_are_told_apart() -> None:
    rng = np.random.default_rng(5)
    quiet = np.rint(rng.normal(0.3, 2.0, 6000))  # steps of half its noise: 14 % of the rows repeat by chance
    found = conversions(quiet)
    assert (found.slower, len(found.rows)) == (False, 6000)
    for rate in (10.0, 78.0, 150.0):
        number_of = np.floor(rate * np.arange(0.0, 30.0, 1.0 / HOST) + 0.3).astype(int)
        found = conversions(np.rint(rng.normal(0.0, 40.0, number_of[-1] + 1))[number_of])
        assert found.slower
        assert len(found.rows) == pytest.approx(30.0 * rate, rel=0.02)
    assert not conversions(np.full(500, 7.0)).slower


def test_a_walk_shows_its_cells_by_feet_in_the_air(walks: dict[str, Log], tmp_path: Path) -> None:
    """The reference is late: rows in which a foot already stands again must not count as unloaded."""
    log = walks["bad-start"]
    assert log.truth is not None
    recording = read_recording(write_log(log, tmp_path / "walk.parquet"))
    assert np.abs(log.truth.force[recording.unloaded]).max() < 0.05
    twin = identify(recording)
    drift = {one.name: one.value for one in twin.parameters}["random walk of the offset"]
    assert drift.value == pytest.approx(HX711_LOAD_CELLS.offset_drift, rel=0.15)
    assert twin.alike, twin.likeness


class TestUnknownLoads:
    """A plate and a board say in which unit they read, and nobody says what stands on them."""

    def recording(self, raw: Floats, unloaded: NDArray[np.bool_]) -> Recording:
        names, time = tuple(f"raw_{i}_count" for i in range(raw.shape[1])), np.arange(len(raw)) / HOST
        return Recording("plate.csv", "feet alone", names, time, raw, unloaded, scale=np.ones(raw.shape[1]))

    def readings(self, noise: float, step: float) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the newtons of a plate on which somebody stands from the 15th to the 25th second."""
        rng, time = np.random.default_rng(2), np.arange(0.0, 40.0, 1.0 / HOST)
        on = (time > 15.0) & (time < 25.0)
        raw = 200.0 * on[:, None] + rng.normal(0.0, noise, (len(time), 2))
        return (np.rint(raw / step) * step if step else raw), np.repeat(~on[:, None], 2, axis=1)

    def test_coarse_readings_show_their_noise_and_no_clock(self) -> None:
        twin = identify(self.recording(*self.readings(0.4, 0.162)))
        named = {one.name: one.value for one in twin.parameters}
        assert "conversion rate" not in named
        assert named["noise of a conversion"].low < 0.4 < named["noise of a conversion"].high
        assert named["step of a reading"].value == pytest.approx(0.162)
        assert twin.preset.capacity > 200.0
        assert twin.preset.code_range[1] > 200.0 / 0.162
        assert twin.alike, twin.likeness

    def test_filtered_readings_have_no_converter(self) -> None:
        twin = identify(self.recording(*self.readings(0.4, 0.0)))
        assert twin.preset.adc_bits == 0
        assert twin.preset.noise_counts == pytest.approx(0.4, rel=0.03)
        assert (
            "finer than any converter: they were filtered or scaled since. The preset reads" in twin.notes[0]
        )

    def test_readings_that_are_cut_off_show_no_drift(self) -> None:
        raw, unloaded = self.readings(0.4, 0.1)
        twin = identify(self.recording(np.maximum(raw, 0.0), unloaded))
        assert re.match(
            r"\d\d % of the readings of 'raw_0_count' are 0 and none lies beyond: something has cut",
            twin.notes[0],
        )
        assert twin.notes[-1].startswith(
            "No row is known to be unloaded: noise is at most that of the quietest"
        )
        noise, drift = (one.value for one in twin.parameters[1:3])
        assert noise.low == 0.0
        assert noise.high > 0.4
        assert (drift.value, drift.low) == (0.0, 0.0)
        assert twin.preset.offset_drift == 0.0


@pytest.mark.slow
def test_intervals_of_twenty_instruments_hold_nine_in_ten() -> None:
    kinds: dict[str, list[bool]] = {}
    for seed in range(20):
        cells = instrument(np.random.default_rng(1000 + seed), 8)
        recording, first = record(cells, seed, LONG)
        for name, parts in hits(identify(recording, cells.capacity), cells, first).items():
            kinds.setdefault(name, []).extend(parts)
    held = [one for parts in kinds.values() for one in parts]
    print(sum(held), len(held), {name: (sum(parts), len(parts)) for name, parts in kinds.items()})
    assert len(held) > 400
    assert np.mean(held) >= 0.88


@pytest.mark.slow
@needs("foot")
def test_real_instruments_have_twins_or_the_reason_why_not(
    benchmark_script: Callable[[str], ModuleType],
) -> None:
    script, folder = benchmark_script("real_recordings"), DATA
    for name, alike in (("force plate 1", True), ("force plate 2", True), ("balance board", False)):
        twin = script.find_twin(folder, name)
        seen = {one.name: one.value for one in twin.parameters}
        assert "conversion rate" not in seen
        assert twin.alike == alike
        # 10 kN in 16 bits, and ten grams of a board's cell.
        assert seen["step of a reading"].value == pytest.approx(0.162 if alike else 0.099, rel=0.01)
        assert seen["random walk of the offset"].low < 0.2
    for name, message in (
        ("force plate with a rocked pole", "no channel rests under one load"),
        ("iCub's feet, swaying", "no channel rests under one load"),
        ("iCub's six-axis sensor", "is of a six-axis sensor, and twins are made of load cells"),
    ):
        with pytest.raises(CalibrationRefused, match=message):
            script.find_twin(folder, name)
