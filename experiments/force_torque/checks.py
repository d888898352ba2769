"""What would mislead an in-situ fit, and what it can do without.

A check either refuses with file, column, what was found and the cure, or adds a notice and returns what is
left.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surefoot.experiments.force_torque.table import Samples
from surefoot.experiments.logs.table import LogError

__all__ = ["check_channels", "check_times", "check_values", "contiguous"]

FEWEST = 8
"""Samples without which a set is no set: an affine map of gravity has four unknowns a channel."""

MANY = 0.01
"""Share of a channel's readings at the end of its range from which the channel is saturated, not grazed."""

MOSTLY = 0.5
"""Share of missing readings from which a channel counts as dead."""

RAILS = (-32768.0, 32767.0, 65535.0, -8388608.0, 8388607.0)
"""Last codes of 16- and 24-bit converters; 0 is left out, as it is a reading like others."""

GAP = 3.0
"""Times the usual step from which two rows have a gap between them."""

POSES = 0.1
"""Share of gaps from which the rows are poses held one by one, which have no rate: no pause is a gap."""

SLOWEST_GYROSCOPE = 0.5
"""Time in s between two rows from which a gyroscope cannot be followed."""


def check_values(samples: Samples, notices: list[str]) -> Samples:
    """Return the rows with gravity, rotation, temperature and time; a missing reading stays NaN.

    Raises:
        LogError: If a value is infinite, or a column holds none in most rows.
    """
    columns, file = samples.columns, samples.file
    keep = np.ones(len(samples.rows), dtype=bool)
    for names, values in (
        (samples.acceleration_names, samples.acceleration),
        (columns.angular_velocity, samples.angular_velocity),
        ((columns.temperature,), samples.temperature),
        ((columns.time,), samples.time),
        (samples.channels, samples.raw),
    ):
        if values is None or names is None:
            continue
        for name, column in zip(names, values.reshape(len(keep), -1).T, strict=True):
            at, missing = f"{file}: column '{name}'", np.isnan(column)
            share = float(missing.mean())
            if np.isinf(column).any():
                row = int(samples.rows[int(np.argmax(np.isinf(column)))])
                raise LogError(
                    f"{at} is infinite at row {row}; leave the cell empty where no sample arrived."
                )
            if missing.all():
                raise LogError(
                    f"{at} holds no value in any of the {len(column)} rows of set '{samples.name}'; check "
                    "its cable and the column's name."
                )
            if share > MOSTLY:
                raise LogError(
                    f"{at} holds no value in {100 * share:.0f} % of the rows of set '{samples.name}'; "
                    "record the set again, or leave the column out."
                )
            if missing.any():
                notices.append(
                    f"{at} holds no value in {missing.sum()} of {len(column)} rows ({100 * share:.2g} %) of "
                    f"set '{samples.name}'; the fit does without these samples."
                )
            if values is not samples.raw:
                keep &= ~missing
    return _enough(samples if keep.all() else samples.take(keep))


def check_times(samples: Samples, notices: list[str]) -> Samples:
    """Return the samples without rows that repeat the one before.

    Raises:
        LogError: If times go back, stand still or are in other units.
    """
    time = samples.time
    if time is None:
        return samples
    at = f"{samples.file}: column '{samples.columns.time}'"
    step = np.diff(time)
    if (step < 0.0).any():
        i = int(np.argmax(step < 0.0)) + 1
        raise LogError(
            f"{at} goes back at row {samples.rows[i]} of set '{samples.name}' ({time[i - 1]:.6g} s, then "
            f"{time[i]:.6g} s); sort the rows, or give each recording a set of its own."
        )
    again = np.concatenate([[False], step == 0.0])
    if again.any():
        wrong = again & ~_same_as_before(samples)
        if wrong.any():
            i = int(np.argmax(wrong))
            raise LogError(
                f"{at} is {time[i]:.6g} s at rows {samples.rows[i - 1]} and {samples.rows[i]} of set "
                f"'{samples.name}', and the rows differ; give each sample its own time, with more digits if "
                "they were rounded away."
            )
        notices.append(
            f"{samples.file}: {again.sum()} rows of set '{samples.name}' repeat the row before them; they "
            "were dropped."
        )
        samples, step = _enough(samples.take(~again)), np.diff(time[~again])
    usual = float(np.median(step))
    if samples.angular_velocity is not None and usual > SLOWEST_GYROSCOPE:
        near = min((1e3, "ms"), (1e6, "us"), (1e9, "ns"), key=lambda u: abs(np.log(usual / u[0] / 0.01)))
        raise LogError(
            f"{at} steps by {usual:.4g} s in set '{samples.name}', too slowly to follow a gyroscope; it "
            f"looks like {near[1]}: say units.time = '{near[1]}'."
        )
    gaps = step > GAP * usual
    if gaps.any() and gaps.mean() < POSES:
        notices.append(
            f"{at} leaps {gaps.sum()} times in set '{samples.name}', the longest by {step.max():.3g} s "
            f"where rows are {usual:.3g} s apart; the fit does without what is missing."
        )
    return samples


def contiguous(time: NDArray[np.float64]) -> list[slice]:
    """Return the parts of times between their gaps."""
    step = np.diff(time)
    edges = [0, *(np.flatnonzero(step > GAP * np.median(step)) + 1).tolist(), len(time)]
    return [slice(first, last) for first, last in pairwise(edges)]


def check_channels(samples: Samples, range_count: tuple[float, float] | None, notices: list[str]) -> Samples:
    """Return the samples without readings that only graze the end of the range.

    Raises:
        LogError: If a channel is stuck, saturated, or beyond its range.
    """
    raw = samples.raw.copy()
    low, high = range_count or (-np.inf, np.inf)
    for name, column in zip(samples.channels, raw.T, strict=True):
        at = f"{samples.file}: column '{name}'"
        there = column[np.isfinite(column)]
        if np.ptp(there) == 0.0:
            raise LogError(
                f"{at} is {there[0]:g} in all {len(there)} readings of set '{samples.name}', and a channel "
                "that lives follows gravity; check its cable and its converter."
            )
        if there.max() > high or there.min() < low:
            worst = there.max() if there.max() > high else there.min()
            raise LogError(
                f"{at} reads {worst:g} in set '{samples.name}', outside sensor.range_count = [{low:g}, "
                f"{high:g}]; correct the range, or give the columns in counts."
            )
        stuck = np.isin(column, range_count or RAILS)
        share = float(stuck.sum() / len(there))
        if share > MANY:
            raise LogError(
                f"{at} stands at {column[stuck][0]:g}, the end of its range, in {100 * share:.2g} % of the "
                f"readings of set '{samples.name}'; hang less on the limb, or lower the amplifier's gain or "
                "offset."
            )
        if stuck.any():
            notices.append(
                f"{at} touches the end of its range in {stuck.sum()} readings of set '{samples.name}'; the "
                "fit does without them."
            )
            column[stuck] = np.nan
    return _enough(replace(samples, raw=raw))


def _enough(samples: Samples) -> Samples:
    whole = int(np.isfinite(samples.raw).all(axis=1).sum())
    if whole < FEWEST:
        raise LogError(
            f"{samples.file}: set '{samples.name}' has {whole} whole samples, and a set needs at least "
            f"{FEWEST}; record it for longer, or leave its rows out."
        )
    return samples


def _same_as_before(samples: Samples) -> NDArray[np.bool_]:
    parts = (samples.raw, samples.acceleration, samples.angular_velocity, samples.temperature)
    values = np.column_stack([part for part in parts if part is not None])
    same = np.zeros(len(values), dtype=bool)
    same[1:] = ((values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))).all(axis=1)
    return same
