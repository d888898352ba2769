"""The clock of a log: the times of its rows in s, whatever its logger wrote.

Loggers write times of day, counters of 32 bits that overflow, seconds without fractions, and one time for a
whole packet of rows, and some append a second session to the file of the first. :func:`read_clock` makes
increasing times of all of these and reports what it did. Times since 1970 are kept as they are.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration.front_end.readings import LONGEST_GAP

MAX_GAP = 0.1  # longest time in s between two rows that a page's filters bridge
LOST_ROWS = 0.3
"""Longest time in s between two rows of one log: links lose rows for 0.1 s and more, and in one support of
0.3 s a foot is loaded or lifted. Calibrators start their filters again after shorter gaps, too."""

SLOWEST = 1.0  # median time in s between rows of feet at or above which the unit of time must be wrong
CLOCKS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # units of time besides seconds, in s

EPOCH = 1e8  # s, three years: a larger time is one since 1970

JOINED = 1.0  # s between two sessions of one file once they are joined: a gap for every command
COARSEST = 1.0  # s, the coarsest unit of loggers: a time repeated for longer is of a clock that stopped
OVERFLOWS = (2.0**32, *(2.0**32 * unit for unit in CLOCKS.values()), 2.0**16 * CLOCKS["ms"], 86400.0, 3600.0)
"""Times in s after which clocks begin again at zero: counters of 32 bits by their unit, counters of 16 bits
in milliseconds, times of day at midnight, and times of minutes and seconds alone at the full hour."""

NEAR = 16  # rows by which late packets may be out of order; sorting moves no row farther
FEWEST = 8  # median rows of a session below which the rows of a file are in no order at all


@dataclass(frozen=True)
class Clock:
    """The times of N rows, and what was found of them."""

    time: Floats  # in s, shape (N,); as the log has them if there is a flaw
    sessions: tuple[int, ...] = (0,)  # the first row of each session
    notices: tuple[str, ...] = ()  # what was done, each a predicate of the column's name
    flaw: str = ""  # why times cannot be used, a predicate as well
    cure: str = ""
    row: int = 0  # where the flaw or the second session begins

    @property
    def step(self) -> float:
        """Median time between two rows in s; NaN for a single row."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else np.nan

    @property
    def restart(self) -> str:
        """Where further sessions begin, a predicate of the column's name; empty for one session."""
        return self.notices[-1].partition(";")[0] if len(self.sessions) > 1 else ""


def read_clock(stamps: Floats, *, spread: bool = True, rows: NDArray[np.int64] | None = None) -> Clock:
    """Read the column of times of a log, in s, shape (N,).

    Overflows are undone. Rows that share a time are spread evenly up to the next one, unless ``spread`` is
    false. A session that begins before the end of the one before it is moved behind it by a gap of
    :data:`JOINED`, so that sessions stay apart. Disorder and a stopped clock are flaws. Messages number the
    rows by ``rows``, (N,), by default from 0 on.
    """
    number = np.arange(len(stamps)) if rows is None else rows
    if len(stamps) < 2:
        return Clock(stamps, flaw="has one row alone", cure="record some seconds.")
    if not np.isfinite(stamps).all():
        row = int(np.argmin(np.isfinite(stamps)))
        cure = "drop the row or interpolate the column."
        return Clock(stamps, flaw=f"is {stamps[row]} at row {number[row]}", cure=cure, row=row)
    time, notices = _undo_overflow(stamps, number)
    back = np.flatnonzero(np.diff(time) < 0.0) + 1
    if len(back) and (disorder := _disorder(time, back)):
        flaw = _describe("goes back", time, back, number)
        return Clock(stamps, flaw=flaw, cure=disorder, row=int(back[0]))
    sessions = (0, *back.tolist())
    parts = np.split(time, back)
    if spread:
        for first, part in zip(sessions, parts, strict=True):
            if (row := _find_stop(part)) >= 0:
                flaw = f"stands still at {part[row]:.13g} s from row {number[first + row]} on"
                cure = "write the time of each row, or leave the column out."
                return Clock(stamps, flaw=flaw, cure=cure, row=first + row)
        repeats = int(sum((np.diff(part) == 0.0).sum() for part in parts))
        if repeats:
            notices += (
                f"repeats the time of the row before in {repeats} of {len(time)} rows, which were spread "
                "evenly up to the next time",
            )
            parts = [_spread(part) for part in parts]
    if len(back):
        begins = _describe("begins again", time, back, number)
        notices += (f"{begins}; the sessions were kept apart by a gap of {JOINED:g} s",)
    return Clock(np.concatenate(list(_join(parts))), sessions, notices, row=sessions[len(back) > 0])


def longest_step(step: Floats, max_gap: float) -> float:
    """Return the longest step of time in s that is no gap: slow rows are farther apart than ``max_gap``."""
    return max(max_gap, LONGEST_GAP * float(np.median(step))) if len(step) else max_gap


def find_gaps(step: Floats, max_gap: float = MAX_GAP) -> NDArray[np.bool_]:
    """Return which steps of time in s are gaps, of the same shape."""
    return np.asarray(step > longest_step(step, max_gap) + 1e-6)  # seconds since 1970 are as coarse as that


def origin_of(time: float) -> float:
    """Return the time in s to subtract from times that begin here, so that single precision can hold them."""
    return time if abs(time) > EPOCH else 0.0


def unit_of_times(step: float, dt: float = np.nan) -> str:
    """Return the unit of times of which a step is ``dt`` s or, by default, one of feet; "" if none fits."""
    for unit, factor in CLOCKS.items():
        if step * factor <= 2.0 * MAX_GAP if np.isnan(dt) else abs(step * factor / dt - 1.0) < 0.1:
            return unit
    return ""


def _undo_overflow(stamps: Floats, number: NDArray[Any]) -> tuple[Floats, tuple[str, ...]]:
    """Return times of a counter that has not overflowed, and notices of its overflows."""
    step = np.diff(stamps)
    forward = step[step > 0.0]
    longest = max(MAX_GAP, 10.0 * float(np.median(forward))) if len(forward) else MAX_GAP
    for span in OVERFLOWS:
        over = (step < 0.0) & (step + span > 0.0) & (step + span <= min(longest, 0.01 * span))
        if over.any() and np.ptp(stamps) <= span:
            row = int(np.argmax(over)) + 1
            times = np.concatenate([[0.0], np.cumsum(over * span)]) + stamps
            many = f", and {over.sum() - 1} more times" if over.sum() > 1 else ""
            where = f"goes back by {-step[row - 1]:.10g} s at row {number[row]}{many}"
            return times, (
                f"{where}, as a clock does that overflows after {span:.10g} s; its times were continued",
            )
    return stamps, ()


def _describe(what: str, time: Floats, back: NDArray[np.intp], number: NDArray[Any]) -> str:
    row, many = int(back[0]), len(back)
    more = f", and at {many - 1} more rows" if many > 2 else ", and at one more row" * (many > 1)
    return f"{what} at row {number[row]} ({time[row - 1]:.13g} s, then {time[row]:.13g} s){more}"


def _disorder(time: Floats, back: NDArray[np.intp]) -> str:
    """Return the cure of rows that are out of order; "" of sessions, which follow each other."""
    order = np.argsort(time, kind="stable")
    if np.abs(order - np.arange(len(time))).max() <= NEAR:
        return "packets came late: sort the rows by their time."
    if np.median(np.diff([0, *back, len(time)])) < FEWEST:
        return "the rows are in no order: sort them by their time, if they are of one session."
    return ""


def _find_stop(time: Floats) -> int:
    """Return the row at which a clock stops although rows go on, -1 for none."""
    first, count, step = _runs(time)
    if len(first) < 2:
        return 0 if len(time) > 2 else -1
    usual = float(np.median(step[:-1] / count[:-1]))
    step[-1] = float(np.median(step[:-1]))
    late = count * usual - step > COARSEST
    return int(first[np.argmax(late)]) if late.any() else -1


def _spread(time: Floats) -> Floats:
    """Return times of which those that are equal are spread evenly up to the next one."""
    first, count, step = _runs(time)
    if len(first) == len(time) or len(first) < 2:
        return time
    usual = float(np.median(step[:-1] / count[:-1]))
    each = np.minimum(step / count, usual)
    place = np.arange(len(time)) - np.repeat(first, count)
    found: Floats = time + place * np.repeat(each, count)
    in_first = count[0] > 1 and step[0] - count[0] * usual > usual
    if in_first:  # The log began in the middle of its first second.
        found[: count[0]] = time[first[1]] - usual * np.arange(count[0], 0, -1)
    return found


def _runs(time: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    """Return of each run of equal times its first row, its length, and the step to the next time."""
    first = np.flatnonzero(np.diff(time, prepend=-np.inf))
    return first, np.diff(first, append=len(time)), np.diff(time[first], append=np.inf)


def _join(parts: list[Floats]) -> Iterator[Floats]:
    """Yield sessions on one clock, each behind the one before it."""
    end = -np.inf
    for part in parts:
        moved = part if end == -np.inf else part + (end + JOINED - part[0])
        end = float(moved[-1])
        yield moved
