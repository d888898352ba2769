"""Facts of the channels of a recording, and their flaws with the time at which they begin."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.special import stdtrit

from surefoot.calibration.results import Finding
from surefoot.experiments.force_torque.checks import RAILS
from surefoot.experiments.instrument.noise import (
    FEWEST,
    Allan,
    Noise,
    Stretch,
    allan,
    conversions,
    find_leaps,
    find_settled,
    noise_of,
    rests,
    step_of,
)
from surefoot.experiments.instrument.recording import Recording
from surefoot.experiments.logs.checks import SPLIT, TWO_SESSIONS
from surefoot.experiments.logs.clock import EPOCH, LOST_ROWS, SLOWEST, find_gaps, unit_of_times
from surefoot.experiments.study.tables import plural, sentence

_settle = tomllib.loads(files(__package__).joinpath("settle.toml").read_text(encoding="utf-8"))

STILL = 2.0  # time in s for which a channel may repeat one value while others change
RAILED, LOST = 0.01, 0.5  # shares of readings at the end of the converter, and missing, that are reported
ALARM = 1e-6  # probability of reporting a drift of a sound channel


@dataclass(frozen=True)
class Wrong:
    """A finding, the time from which it holds, and the measurement that would settle it."""

    finding: Finding
    since: str = "all along"
    settle: str = ""


@dataclass(frozen=True, eq=False)
class ChannelFacts:
    """Facts of a channel in counts and seconds."""

    name: str
    missing: float  # share of rows without a reading
    low: float
    high: float
    step: float  # smallest difference of two readings
    repeats: float  # share of rows that repeat the previous one
    curve: Allan
    noise: Noise
    slope: float  # slope of the unloaded readings in counts per second; NaN if unknown
    slope_std: float
    rests: tuple[Stretch, ...]


def facts_of(recording: Recording) -> list[ChannelFacts]:
    """Return the facts of each channel."""
    return [_facts(recording, i) for i in range(len(recording.names))]


def _facts(recording: Recording, i: int) -> ChannelFacts:
    raw = recording.raw[:, i]
    there = raw[np.isfinite(raw)]
    timed = recording.has_times
    still = rests(recording.time, raw, recording.unloaded[:, i]) if timed else []
    if recording.load is not None:
        still = find_settled(still)
    curve = allan(still)
    slope, slope_std = _slope(still) if recording.unloaded[:, i].any() else (np.nan, np.nan)
    return ChannelFacts(
        name=recording.names[i],
        missing=float(1.0 - np.isfinite(raw).mean()) if len(raw) else 1.0,
        low=float(there.min()) if len(there) else np.nan,
        high=float(there.max()) if len(there) else np.nan,
        step=step_of(raw),
        repeats=conversions(raw).repeats,
        curve=curve,
        noise=noise_of(curve),
        slope=slope,
        slope_std=slope_std,
        rests=tuple(still),
    )


def _slope(still: list[Stretch]) -> tuple[float, float]:
    """Return the slope of the means of stretches in counts per second, and its standard deviation."""
    if len(still) < 3:
        return np.nan, np.nan
    times, means = (np.array([part[k].mean() for part in still]) for k in (0, 1))
    line = scipy.stats.linregress(times, means)
    return float(line.slope), float(line.stderr)


def find_wrong(recording: Recording, facts: list[ChannelFacts]) -> Iterator[Wrong]:
    """Yield the flaws of the clock and of single channels."""
    if recording.kind == "weighings":
        return  # judge_weighings checks single readings
    if recording.kind != "six-axis sensor":
        told = "'time_s'" in recording.refusal
        yield from (one for one in _check_clock(recording) if one.finding.name == "gaps" or not told)
    yield from find_wrong_channels(recording, facts)


def find_wrong_channels(recording: Recording, facts: list[ChannelFacts]) -> Iterator[Wrong]:
    """Yield the flaws of single channels."""
    constant, read = _stuck(recording), np.isfinite(recording.raw)
    nothing = ""
    if len(read) < FEWEST:
        nothing = f"{len(read)} row{'s are' if len(read) != 1 else ' is'} too few for a check."
    elif not read.any():
        nothing = "No column contains a reading."
    elif all(np.ptp(raw[at]) == 0.0 for raw, at in zip(recording.raw.T, read.T, strict=True) if at.any()):
        nothing = "No channel changes."
    if nothing:
        cure = "Check the cables, and log some seconds of a changing load."
        finding = Finding("no reading", nothing, cure)
        yield Wrong(finding, settle=settling_motion(finding.name))
        return
    for i, one in enumerate(facts):
        raw = recording.raw[:, i]
        there = np.isfinite(raw)
        if not there.any():
            reason, cure = f"Column '{one.name}' contains no reading.", "Check its cable and its name."
            yield _wrong(recording, 0, Finding("no reading", reason, cure))
            continue
        if one.missing > LOST:
            reason = f"{100 * one.missing:.0f} % of the readings of '{one.name}' are missing."
            cure = "If its converter is slower than the rows, write rows at its rate."
            finding = Finding("missing", reason, cure, one.missing, LOST, refuses=False)
            yield _wrong(recording, int(np.argmin(there)), finding)
        if (railed := np.isin(raw, RAILS) & there).mean() > RAILED:
            last = f"column '{one.name}' are at the end of the converter's range ({raw[railed][0]:.0f})"
            reason, cure = (
                f"{railed.sum()} readings of {last}.",
                "Lower the gain, or check for a broken wire.",
            )
            finding = Finding("rails", reason, cure, float(railed.mean()), RAILED)
            yield _wrong(recording, int(np.argmax(railed)), finding)
        if constant[i] >= 0:
            value = f"{raw[there][-1]:.10g}"
            reason = f"'{one.name}' stays at {value} from then on, while others change."
            finding = Finding("constant", reason, "Check its cable and its converter.")
            yield _wrong(recording, int(constant[i]), finding)
        sure = stdtrit(max(len(one.rests) - 2, 1), 1.0 - ALARM / 2.0)
        if abs(one.slope) > one.slope_std * sure:
            size = "" if recording.scale is None else f" ({60 * one.slope * recording.scale[i]:+.2g} N)"
            reason = f"Unloaded, column '{one.name}' drifts by {60 * one.slope:+.3g} counts a minute{size}."
            finding = Finding("drift", reason, "Use a method that tracks offsets.", refuses=False)
            yield _wrong(recording, 0, finding, "drift-unloaded")


def _check_clock(recording: Recording) -> Iterator[Wrong]:
    time, steps, walks = recording.time, np.diff(recording.time), recording.kind != "channels"
    if not np.isfinite(time).all():
        row, lacking = int(np.argmin(np.isfinite(time))), np.isnan(time).all()
        reason = f"Column 'time_s' is {time[row]} at row {row}."
        if lacking:
            reason = "Rows have no times, so rate, noise and drift cannot be measured."
        toml = f"{Path(recording.file).stem}.toml"
        cure = f"Give time_s, or the rows per second under [rates] in {toml}; weighings need load_kg."
        yield _wrong(recording, row, Finding("clock", reason, cure, refuses=not lacking))
        return
    clock = recording.clock
    if clock is not None and clock.flaw and len(steps):
        reason = f"Column 'time_s' {clock.flaw}."
        yield _wrong(recording, clock.row, Finding("clock", reason, sentence(clock.cure)))
    elif clock is not None and clock.restart:
        reason, _, cure = f"Column 'time_s' {clock.restart}{TWO_SESSIONS}{SPLIT}".partition(". ")
        yield _wrong(recording, clock.row, Finding("clock", f"{reason}.", cure, refuses=walks))
    if not (steps > 0.0).any():
        return
    usual = float(np.median(steps))
    gaps = find_gaps(steps, LOST_ROWS) if walks and usual < SLOWEST else find_leaps(time)
    if clock is not None:
        gaps[[first - 1 for first in clock.sessions[1:]]] = False
    if gaps.any() and (steps >= 0.0).all():
        reason = f"The clock has {plural(int(gaps.sum()), 'gap')}, the longest of {steps[gaps].max():.3g} s."
        finding = Finding("gaps", reason, "Calibrate the parts singly, or use --split-gaps.", refuses=walks)
        yield _wrong(recording, int(np.argmax(gaps)) + 1, finding)
    if usual >= SLOWEST:
        reason = f"Rows are {usual:.4g} s apart, so times may be in another unit than seconds."
        cure = (
            f'Give the unit in {Path(recording.file).stem}.toml: [units] time_s = "{unit_of_times(usual)}".'
        )
        yield _wrong(recording, 0, Finding("rate", reason, cure, usual, SLOWEST, refuses=False))


def _wrong(recording: Recording, row: int, finding: Finding, kind: str = "") -> Wrong:
    if row == 0:
        since = "all along"
    else:
        since = say_time(recording.time[row]) if np.isfinite(recording.time[row]) else f"row {row}"
    return Wrong(finding, since, settling_motion(kind or finding.name))


def say_time(time: float) -> str:
    """Return a time in s as text, to 10 ms if it counts from 1970."""
    return f"{time:.6g} s" if abs(time) < EPOCH else f"{time:.2f} s"


def settling_motion(kind: str) -> str:
    """Return the shortest motion or reading that shows whether a mistake of this kind was made, or ""."""
    return str(_settle.get(kind.replace(" ", "-"), ""))


def _stuck(recording: Recording) -> NDArray[np.intp]:
    """Return the row after which each channel stays constant while others change, or -1, shape (K,)."""
    found = np.full(len(recording.names), -1)
    changed: list[int] = []
    for raw in recording.raw.T:
        rows = np.flatnonzero(np.isfinite(raw))
        moves = rows[1:][np.diff(raw[rows]) != 0.0]
        changed.append(int(moves[-1]) if len(moves) else 0)
    last = max(changed, default=0)
    for i, row in enumerate(changed):
        still = recording.time[last] - recording.time[row] if recording.has_times else 0.0
        lasting = recording.has_times and still > STILL
        if np.isfinite(recording.raw[:, i]).sum() > FEWEST and (lasting or row == 0 < last):
            found[i] = row
    return found
