"""The preset of load cells that behave as a recording does, with intervals, and whether they do."""

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

ROUND = 1e-6  # by which a step may miss a count
FINEST = 2.0**24  # steps in the range of readings that no converter has
FOLLOWS = 0.5  # correlation with its load that no cell is below that carries it: noise is a percent of it
OVERLOAD = 1.5  # times its rated load that a cell bears by its data sheet
CUT = 0.01  # share of readings at zero, and none beyond, from which something has cut them off
LATE = 1.05  # rows by which a conversion may be seen late, jitter of the rows included
ITERATIONS = 20  # of counting a chip's conversions
UNLIKE = 0.01  # probability below which a test tells twin and log apart, over all tests


@dataclass(frozen=True)
class Parameter:
    """One number of an instrument, with its interval."""

    name: str
    unit: str
    value: Interval
    of: str = "all channels"


@dataclass(frozen=True, eq=False)
class Twin:
    """An instrument as a recording shows it."""

    recording: Recording
    preset: LoadCells
    parameters: tuple[Parameter, ...]
    likeness: tuple[tuple[str, float], ...]  # what was compared, and the probability of so large a difference
    notes: tuple[str, ...]

    @property
    def tables(self) -> tuple[Table, ...]:
        """The instrument, and how much its twin is like it."""
        return (parameter_table(self), likeness_table(self))

    @property
    def alike(self) -> bool:
        """Whether no test tells twin and log apart."""
        return all(p * len(self.likeness) > UNLIKE for _, p in self.likeness)


def identify(recording: Recording, capacity: float | None = None) -> Twin:
    """Find the load cells that a recording is of; their capacity in N is the largest load unless it is given.

    A recording has rest, and for the answer to loads known ones (``load_kg`` or ``load_N`` in each row).
    CalibrationRefused if there are no times, no scale in newtons, or no rest; LogError if times do not
    increase, or the recording's own command cannot read it.
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
        # Noise and drift once more, without what the cells remember of their loads.
        size = np.full(len(scale), 1.0 / float(np.mean(np.abs(response.scale))))
        forgot = recording.raw - response.memory(recording.time, recording.load, rated)
        at_rest = fit_at_rest(constant_stretches(recording, size, forgot)) or at_rest
        response = respond(recording.time, recording.raw, recording.load, rated, at_rest, rate)
    else:
        highest = np.abs(recording.raw - np.nanmedian(recording.raw, axis=0)) * scale
        rated = capacity or max(LoadCells().capacity, float(np.nanmax(highest)))
    if not recording.has_loads:
        # What an unknown load does at rest is in the noise, and the drift is all its own.
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
    """Refuse a recording that is not one of load cells over time that bear its heaviest load in N."""
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
    """Leave out unloaded readings of channels that something has cut off at zero, and say so."""
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
    """Return N per count, without a sign: by known loads, else the nominal one."""
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
    """Return the conversions a second of a chip that is slower than the rows; ``None`` for others."""
    rows = seen.rows
    if not seen.slower or len(rows) < FEWEST:
        return None
    time, row = recording.time[rows], float(np.median(np.diff(recording.time)))
    period, number_of = float(np.diff(time).mean()), np.zeros(0)
    # Each conversion is seen up to a row late; a gap has no more of them than it must have.
    for _ in range(ITERATIONS):
        steps = np.maximum(np.ceil((np.diff(time) - LATE * row) / period), 1.0)
        number_of, before = np.concatenate([[0.0], np.cumsum(steps)]), period
        period, _ = np.polyfit(number_of, time, 1)
        if abs(period - before) < 1e-12 * before:
            break
    # Lateness beats with the rows and does not average out: the line is as sure as its two ends.
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
    """Return the cells, and notes on open questions."""
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
    """Return one step in readings, the bits, 0 for none, whether they are offset-binary, and notes."""
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
    """Return the median of each channel's unloaded counts; NaN where no row is known to be unloaded."""
    seen = np.isfinite(counts) & recording.unloaded
    return np.array(
        [np.median(one[at]) if at.any() else np.nan for one, at in zip(counts.T, seen.T, strict=True)]
    )


def _mechanics(response: Response | None) -> Mechanics:
    """Return the errors of the spring elements that are surely there."""
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
    """Write the cells as JSON, which :class:`~surefoot.wrappers.FootSensors` takes as a mapping."""
    given, default = asdict(twin.preset), LoadCells()
    shown = {
        one.name: given[one.name]
        for one in fields(twin.preset)
        if getattr(twin.preset, one.name) != getattr(default, one.name)
    }
    write_text(path, json.dumps(shown, indent=1) + "\n")
    return path


def parameter_table(twin: Twin) -> Table:
    """Return the parameters with their intervals."""
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
    """Return whether the twin behaves as the log."""
    limit = UNLIKE / max(len(twin.likeness), 1)
    rows = tuple((name, number(p), Verdict.of(p > limit)) for name, p in twin.likeness)
    note = "Two-sample tests of Kolmogorov and Smirnov: the log, and a run of the preset under its loads."
    return Table("likeness", "Twin against log", ("compared", "probability", "alike"), rows, note)
