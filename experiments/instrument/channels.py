"""One channel of a recording: its readings, its clock, its noise, and its flaws with their beginning."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import linregress
from scipy.stats import t as student

from surefoot.calibration.in_situ.findings import Finding
from surefoot.experiments.force_torque.checks import RAILS
from surefoot.experiments.instrument.noise import (
    FEWEST,
    Allan,
    Noise,
    Stretch,
    allan,
    conversions,
    noise_of,
    rests,
    step_of,
)
from surefoot.experiments.instrument.recording import Recording
from surefoot.experiments.logs.format import MAX_GAP

STILL = 2.0  # s for which a channel may repeat one value while others move
RAILED, LOST = (
    0.01,
    0.5,
)  # shares of readings at a converter's end, and of missing ones, that are worth a word
ALARM = 1e-6  # probability of calling a sound channel's slope a drift


@dataclass(frozen=True)
class Wrong:
    """A finding, since when it holds, and the measurement that would settle it."""

    finding: Finding
    since: str = "all along"
    settle: str = ""


@dataclass(frozen=True, eq=False)
class ChannelFacts:
    """The facts of a channel, in counts and seconds."""

    name: str
    missing: float  # share of rows
    low: float
    high: float
    step: float  # smallest difference of two readings
    repeats: float  # share of rows that repeat the one before
    curve: Allan
    noise: Noise
    slope: float  # of its unloaded readings over time, a second; NaN if not known
    slope_std: float
    rests: tuple[Stretch, ...]


def facts_of(recording: Recording) -> list[ChannelFacts]:
    """Facts of each channel."""
    return [_facts(recording, i) for i in range(len(recording.names))]


def _facts(recording: Recording, i: int) -> ChannelFacts:
    raw = recording.raw[:, i]
    there = raw[np.isfinite(raw)]
    timed = recording.has_times
    still = rests(recording.time, raw, recording.unloaded[:, i]) if timed else []
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
    """Return the slope of the means of stretches over time, a second, and its standard deviation."""
    if len(still) < 3:
        return np.nan, np.nan
    times, means = (np.array([part[k].mean() for part in still]) for k in (0, 1))
    line = linregress(times, means)
    return float(line.slope), float(line.stderr)


def find_wrong(recording: Recording, facts: list[ChannelFacts]) -> Iterator[Wrong]:
    """Yield the flaws of the clock and of single channels."""
    if recording.kind == "weighings":
        return  # their own judge looks at single readings
    if recording.has_times:
        yield from _check_clock(recording)
    constant = _stuck(recording)
    for i, one in enumerate(facts):
        raw = recording.raw[:, i]
        there = np.isfinite(raw)
        if not there.any():
            yield Wrong(
                Finding(
                    "no reading", f"Column '{one.name}' holds no reading.", "Check its cable and its name."
                ),
                settle="Pull its plug and put it in again while logging: a reading must come and go.",
            )
            continue
        if one.missing > LOST:
            yield Wrong(
                Finding(
                    "missing", f"{100 * one.missing:.0f} % of the readings of '{one.name}' are missing.",
                    "If its converter is slower than the rows, write rows at its rate.", one.missing, LOST,
                    refuses=False,
                ),
                _when(recording, int(np.argmin(there))),
            )  # fmt: skip
        if (railed := np.isin(raw, RAILS) & there).mean() > RAILED:
            yield Wrong(
                Finding(
                    "rails", f"{railed.sum()} readings of column '{one.name}' are a converter's last code "
                    f"({raw[railed][0]:.0f}).", "Lower the gain, or look for a broken wire.",
                    float(railed.mean()), RAILED,
                ),
                _when(recording, int(np.argmax(railed))),
                "Lift the foot: a wire that is broken stays at the end.",
            )  # fmt: skip
        if constant[i] >= 0:
            yield Wrong(
                Finding(
                    "constant", f"'{one.name}' is {raw[there][-1]:.10g} in all readings from then on, while "
                    "others move.", "Check its cable and its converter.",
                ),
                _when(recording, int(constant[i])),
                "Press on this cell alone.",
            )  # fmt: skip
        if abs(one.slope) > one.slope_std * float(student.ppf(1.0 - ALARM / 2.0, max(len(one.rests) - 2, 1))):
            size = "" if recording.scale is None else f" ({60 * one.slope * recording.scale[i]:+.2g} N)"
            yield Wrong(
                Finding(
                    "drift", f"Unloaded, column '{one.name}' drifts by {60 * one.slope:+.3g} counts a "
                    f"minute{size}.", "A method that follows offsets undoes it.", refuses=False,
                ),
                settle="Let the feet hang for a minute after a quarter of an hour of power.",
            )  # fmt: skip


def _check_clock(recording: Recording) -> Iterator[Wrong]:
    steps = np.diff(recording.time)
    forward = steps[steps > 0]
    if (steps <= 0).any() and recording.kind != "six-axis sensor":
        row = int(np.argmax(steps <= 0)) + 1
        yield Wrong(
            Finding(
                "clock", f"Times do not increase at row {row}.", "Sort the rows, and drop repeated times."
            ),
            _when(recording, row),
        )
    if not len(forward):
        return
    gaps = steps > max(MAX_GAP, 4.0 * float(np.median(forward)))
    if gaps.any() and recording.kind != "six-axis sensor":
        yield Wrong(
            Finding(
                "gaps", f"The clock leaps {gaps.sum()} times, by {steps.max():.3g} s at most.",
                "Calibrate parts one by one, or with --split-gaps.", refuses=False,
            ),
            _when(recording, int(np.argmax(gaps)) + 1),
        )  # fmt: skip


def _stuck(recording: Recording) -> NDArray[np.intp]:
    """Return from which row on a channel never changes again while others do, -1 for none, shape (K,)."""
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


def _when(recording: Recording, row: int) -> str:
    if row == 0:
        return "all along"
    return f"{recording.time[row]:.6g} s" if recording.has_times else f"row {row}"
