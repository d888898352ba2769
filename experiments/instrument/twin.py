"""Identify a preset of simulated load cells from a recording, and test how well it reproduces the log."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import linregress

from surefoot.arrays import Floats
from surefoot.calibration.results import CalibrationRefused
from surefoot.experiments.instrument.likeness import compare, constant_stretches
from surefoot.experiments.instrument.noise import FEWEST, Conversions, conversions, step_of
from surefoot.experiments.instrument.recording import Recording
from surefoot.experiments.instrument.response import Response, respond
from surefoot.experiments.instrument.rest import SURE, AtRest, Interval, fit_at_rest, normal_interval
from surefoot.experiments.logs.checks import clock_of
from surefoot.experiments.logs.table import LogError
from surefoot.experiments.study.tables import Table, Verdict, number, span
from surefoot.files import write_text
from surefoot.sensors import LoadCells
from surefoot.sensors.stages.mechanics import Mechanics
from surefoot.sensors.transport.wire import Wire

ROUND = 1e-6  # tolerance when comparing the step of the readings with one count
FINEST = 2.0**24  # steps in the range of readings above which they must have been filtered or scaled
FOLLOWS = 0.5  # minimum correlation of a loaded cell with its load (the usual noise of 1 % gives nearly 1)
OVERLOAD = 1.5  # maximum load of a cell relative to its rated load, from data sheets
CUT = 0.01  # share of readings at exactly zero above which a one-sided channel counts as clipped
LATE = 1.05  # maximum delay in rows between a conversion and its first row, including jitter of the rows
ITERATIONS = 20  # maximum iterations when counting the conversions of a chip
UNLIKE = 0.01  # significance level for a difference between twin and log, over all tests together


@dataclass(frozen=True)
class Parameter:
    """One identified parameter of an instrument, with its confidence interval."""

    name: str
    unit: str
    value: Interval
    of: str = "all channels"


@dataclass(frozen=True, eq=False)
class Twin:
    """An instrument identified from a recording, with tests of its likeness."""

    recording: Recording
    preset: LoadCells
    parameters: tuple[Parameter, ...]
    likeness: tuple[tuple[str, float], ...]  # compared quantities and their p-values
    notes: tuple[str, ...]

    @property
    def tables(self) -> tuple[Table, ...]:
        """Tables of the parameters and of the likeness tests."""
        return (parameter_table(self), likeness_table(self))

    @property
    def alike(self) -> bool:
        """Whether no test finds a significant difference between twin and log."""
        return all(p * len(self.likeness) > UNLIKE for _, p in self.likeness)


def identify(recording: Recording, capacity: float | None = None) -> Twin:
    """Identify the load cells of a recording.

    The recording must contain rest. Scale, hysteresis, creep and delay also need known loads, as columns
    ``load_kg`` or ``load_N``.

    Args:
        recording: The recording.
        capacity: Rated load of one cell in N. By default the largest known load, or an estimate if
            the load is constant.

    Raises:
        CalibrationRefused: If times, a scale in newtons or rest are missing.
        LogError: If times do not increase, or the command for this kind of log cannot read the recording.
    """
    heaviest = 0.0 if recording.load is None else float(np.nanmax(np.abs(recording.load)))
    _check(recording, capacity, heaviest)
    recording = replace(recording, time=clock_of(recording.time, recording.file, joined=True).time)
    recording, cut = _leave_out_cut(recording)
    scale = _scale(recording)
    rates = [_rate(recording, conversions(raw)) for raw in recording.raw.T]
    known = [one for one in rates if one is not None]
    size = np.full(len(scale), float(np.mean(scale)))
    at_rest = fit_at_rest(constant_stretches(recording, size))
    if at_rest is None:
        raise CalibrationRefused(
            f"{recording.file}: no channel rests under one load for {FEWEST} conversions.",
            "Record half a minute of rest, and loads that stay on for some seconds.",
        )
    row = float(np.median(np.diff(recording.time)))
    rate = float(np.mean([one.value for one in known])) if known else 1.0 / row
    response: Response | None = None
    if recording.load is not None and np.ptp(recording.load) > 0.0:
        rated = capacity or heaviest
        response = respond(recording.time, recording.raw, recording.load, rated, at_rest, rate)
        # Estimate noise and drift again, after subtracting hysteresis and creep.
        size = np.full(len(scale), 1.0 / float(np.mean(np.abs(response.scale))))
        forgot = recording.raw - response.memory(recording.time, recording.load, rated)
        at_rest = fit_at_rest(constant_stretches(recording, size, forgot)) or at_rest
        response = respond(recording.time, recording.raw, recording.load, rated, at_rest, rate)
    else:
        highest = np.abs(recording.raw - np.nanmedian(recording.raw, axis=0)) * scale
        rated = capacity or max(LoadCells().capacity, float(np.nanmax(highest)))
    if not recording.has_loads:
        # Changes of an unknown load also appear as noise and drift, so only the upper limits are valid.
        noise = at_rest.noise._replace(low=0.0)
        at_rest = AtRest(noise, Interval(0.0, 0.0, at_rest.offset.high), None, at_rest.settling)
    signed = scale if recording.scale is None else recording.scale
    slope = 1.0 / signed if response is None else response.scale
    preset, notes = _preset(recording, rated, slope, known, at_rest, response)
    parameters = tuple(_parameters(recording, preset, rates, at_rest, response))
    periods = np.array([np.nan if one is None else 1.0 / one.value for one in rates])
    tests = compare(recording, preset, periods, size)
    return Twin(recording, preset, parameters, tests, cut + notes)


def _check(recording: Recording, capacity: float | None, heaviest: float) -> None:
    """Refuse a recording without times, of a six-axis sensor, or with a load in N far above the capacity."""
    if not recording.has_times:
        raise CalibrationRefused(f"{recording.file}: rows have no times.", "Give time_s, or [rates].")
    if recording.kind == "six-axis sensor":
        raise CalibrationRefused(
            f"{recording.file}: is of a six-axis sensor, and twins are made of load cells.",
            "'surefoot check' shows its noise and drift, 'surefoot calibrate ft' its matrix and offset.",
        )
    if recording.refusal:
        raise LogError(recording.refusal)
    if capacity and capacity * OVERLOAD < heaviest:
        raise LogError(
            f"{recording.file}: has loads of {heaviest:.4g} N, and no cell of {capacity:g} N bears them; "
            "give the rated load of one cell in N."
        )


def _leave_out_cut(recording: Recording) -> tuple[Recording, tuple[str, ...]]:
    """Leave out unloaded readings of channels that are clipped at zero, and return notes about them."""
    raw, unloaded, notes = recording.raw.copy(), recording.unloaded.copy(), []
    for i, (name, one) in enumerate(zip(recording.names, recording.raw.T, strict=True)):
        there = one[np.isfinite(one)]
        share = float((there == 0.0).mean()) if len(there) else 0.0
        if share > CUT and (there.min() == 0.0 or there.max() == 0.0):
            raw[unloaded[:, i] | (one == 0.0), i] = np.nan
            unloaded[:, i] = False
            notes.append(
                f"{100 * share:.0f} % of the readings of '{name}' are 0 and none lies beyond: something has "
                "cut them off, so that its unloaded readings show neither noise nor drift."
            )
    return replace(recording, raw=raw, unloaded=unloaded), tuple(notes)


def _scale(recording: Recording) -> Floats:
    """Return the absolute scale in N per count, from known loads if present, else the nominal one."""
    load = recording.load
    if load is not None and np.ptp(load) > 0.0:
        found = []
        for name, raw, on in zip(recording.names, recording.raw.T, load.T, strict=True):
            there = np.isfinite(raw)
            line = linregress(on[there], raw[there])
            if abs(line.rvalue) < FOLLOWS:
                raise CalibrationRefused(
                    f"{recording.file}: column '{name}' does not follow its load.",
                    "Check its wiring and that the load rests on it, or leave the column out.",
                )
            found.append(1.0 / abs(line.slope))
        return np.array(found)
    if recording.scale is None:
        raise CalibrationRefused(
            f"{recording.file}: nothing says what a count is in newtons.",
            "Give the load of each row as load_kg or load_N, or a walk with its description.",
        )
    return np.abs(recording.scale)


def _rate(recording: Recording, seen: Conversions) -> Interval | None:
    """Return the conversions per second of a chip that is slower than the rows, otherwise ``None``."""
    rows = seen.rows
    if not seen.slower or len(rows) < FEWEST:
        return None
    time, row = recording.time[rows], float(np.median(np.diff(recording.time)))
    period, number_of = float(np.diff(time).mean()), np.zeros(0)
    # A conversion appears in the log up to one row late. Count the fewest conversions that explain each gap.
    for _ in range(ITERATIONS):
        steps = np.maximum(np.ceil((np.diff(time) - LATE * row) / period), 1.0)
        number_of, before = np.concatenate([[0.0], np.cumsum(steps)]), period
        period, _ = np.polyfit(number_of, time, 1)
        if abs(period - before) < 1e-12 * before:
            break
    # The delay beats with the row rate and does not average out, so only the two ends limit the error.
    spread = row / np.sqrt(6.0) / float(time[-1] - time[0])
    return normal_interval(1.0 / period, spread / period)


def _preset(
    recording: Recording,
    capacity: float,
    slope: Floats,
    rates: list[Interval],
    at_rest: AtRest,
    response: Response | None,
) -> tuple[LoadCells, tuple[str, ...]]:
    """Return the preset, and notes about parameters that the recording does not determine."""
    default, row = LoadCells(), float(np.median(np.diff(recording.time)))
    unit, bits, binary, notes = _find_converter(recording, slope)
    counts, slope = recording.raw / unit, slope / unit
    gain = default.rated_output * default.adc_gain * 2.0**bits
    signs = tuple(int(one) for one in np.sign(slope))
    size = float(np.mean(np.abs(slope)))
    rate = (min(one.value for one in rates), max(one.value for one in rates)) if rates else None
    if rate is None:
        notes.append("No clock of a chip shows in the rows: chips are as fast as they are, or faster.")
    own = 0.5 * (1 + at_rest.settling) / float(np.mean(rate)) if rate else 0.0
    delay = max(0.0, response.delay.value - own) if response and response.delay else 0.0
    if response is not None:
        zero = response.offset / unit
    else:
        zero = _zero_of(counts, recording)
        notes.append(
            "No known load: scale, hysteresis, creep and delay are not seen."
            if recording.has_loads
            else "No row is known to be unloaded: noise is at most that of the quietest parts, and scale, "
            "offset, drift, hysteresis, creep and delay are not seen."
        )
    offset = ((zero - (2.0 ** (bits - 1) if binary else 0.0)) / slope)[np.isfinite(zero)]
    cells = LoadCells(
        capacity=capacity,
        rated_output=default.rated_output * size * capacity / gain,
        adc_bits=bits,
        coding="offset-binary" if binary else "two's complement",
        polarity=signs if len(signs) == default.channels else (1 if sum(signs) >= 0 else -1,),
        input_noise=at_rest.noise.value * size * default.excitation * default.rated_output / gain,
        rate=rate,
        settling=at_rest.settling,
        initial_scale_std=float(np.std(np.abs(slope)) / size),
        initial_offset_std=float(np.sqrt(np.mean(offset**2))) if len(offset) else default.initial_offset_std,
        scale_drift=at_rest.scale.value if at_rest.scale else 0.0,
        offset_drift=at_rest.offset.value,
        mechanics=_mechanics(response),
        wire=Wire(delay=delay, under_way=max(Wire().under_way, int(np.ceil(delay / row)) + 2)),
    )
    return cells, tuple(notes)


def _find_converter(recording: Recording, slope: Floats) -> tuple[float, int, bool, list[str]]:
    """Return the step of the readings, the bits, whether they are offset-binary, and notes.

    The number of bits is 0 if the readings do not come directly from a converter.
    """
    step = float(np.nanmedian([step_of(raw) for raw in recording.raw.T]))
    unit, most = step if np.isfinite(step) else 1.0, LoadCells().adc_bits
    if unit * FINEST <= float(np.max(np.nanmax(recording.raw, axis=0) - np.nanmin(recording.raw, axis=0))):
        note = (
            f"Readings step by {step:.2g}, finer than any converter: they were filtered or scaled since. The "
            "preset reads newtons, and its noise is that after the filter."
        )
        return float(np.mean(np.abs(slope))), 0, False, [note]
    uneven = f"Readings step by {unit:.4g}: a count of the preset is one such step."
    counts = recording.raw / unit
    high, binary = float(np.nanmax(np.abs(counts))), bool(np.nanmedian(counts) > 2.0 ** (most - 2))
    bits = most if high > 2.0**15 else max(int(np.ceil(np.log2(high + 1.0))) + 1, 8)
    return unit, bits, binary, [uneven] * (abs(unit - 1.0) > ROUND)


def _zero_of(counts: Floats, recording: Recording) -> Floats:
    """Return the median unloaded count of each channel, or NaN without rows that are known to be unloaded."""
    seen = np.isfinite(counts) & recording.unloaded
    return np.array(
        [np.median(one[at]) if at.any() else np.nan for one, at in zip(counts.T, seen.T, strict=True)]
    )


def _mechanics(response: Response | None) -> Mechanics:
    """Return the significant errors of the spring elements."""
    if response is None:
        return Mechanics()
    bends = [abs(one.value) for one in response.nonlinearity if one.low > 0.0 or one.high < 0.0]
    given: dict[str, Any] = {"nonlinearity": max(bends, default=0.0)}
    if response.hysteresis.low > 0.0:
        given["hysteresis"] = response.hysteresis.value
    if response.creep is not None:
        given |= {"creep_shares": (response.creep.value,), "creep_time_constants": (response.creep_time,)}
    return Mechanics(**given)


def _parameters(
    recording: Recording,
    cells: LoadCells,
    rates: list[Interval | None],
    at_rest: AtRest,
    response: Response | None,
) -> Iterator[Parameter]:
    if cells.adc_bits:
        yield Parameter("step of a reading", "N", Interval(*3 * (1.0 / cells.counts_per_newton,)))
    yield Parameter("noise of a conversion", "N", at_rest.noise)
    yield Parameter("random walk of the offset", "N/√s", at_rest.offset)
    if at_rest.scale is not None:
        yield Parameter("random walk of the scale", "1/√s", at_rest.scale)
    for name, rate in zip(recording.names, rates, strict=True):
        if rate is not None:
            yield Parameter("conversion rate", "1/s", rate, name)
    if response is None:
        return
    for name, value, std in zip(recording.names, response.scale, response.scale_std, strict=True):
        yield Parameter("slope", "1/N", normal_interval(float(value), float(std)), name)
    yield Parameter("hysteresis", "1", response.hysteresis)
    if response.creep is not None:
        yield Parameter(f"creep, in the end, of {response.creep_time:.3g} s", "1", response.creep)
    for name, bend in zip(recording.names, response.nonlinearity, strict=True):
        yield Parameter("nonlinearity", "1", bend, name)
    if response.delay is not None:
        yield Parameter("mean age of readings", "s", response.delay)


def write_preset(path: Path, twin: Twin) -> Path:
    """Write fields with other than default values as JSON for :class:`~surefoot.wrappers.FootSensors`."""
    given, default = asdict(twin.preset), LoadCells()
    shown = {
        one.name: given[one.name]
        for one in fields(twin.preset)
        if getattr(twin.preset, one.name) != getattr(default, one.name)
    }
    write_text(path, json.dumps(shown, indent=1) + "\n")
    return path


def parameter_table(twin: Twin) -> Table:
    """Return the table of parameters with their confidence intervals."""
    rows = tuple(
        (
            one.name,
            one.of.removeprefix("raw_").removesuffix("_count"),
            number(one.value.value, 4),
            span(one.value.low, one.value.high, ".4g"),
            one.unit,
        )
        for one in twin.parameters
    )
    columns = ("what", "of", "value", f"{100 * SURE:.0f} % interval", "unit")
    return Table("parameters", "The instrument", columns, rows)


def likeness_table(twin: Twin) -> Table:
    """Return the table of tests that compare the twin with the log."""
    limit = UNLIKE / max(len(twin.likeness), 1)
    rows = tuple((name, number(p), Verdict.of(p > limit)) for name, p in twin.likeness)
    note = "Two-sample tests of Kolmogorov and Smirnov: the log, and a run of the preset under its loads."
    return Table("likeness", "Twin against log", ("compared", "probability", "alike"), rows, note)
