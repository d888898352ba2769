"""What would mislead an in-situ fit, and what it can do without; private to the log's reader.

A check either refuses, with file, column, what was found and the cure, or puts a notice on the list and hands
on what is left.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surefoot.experiments.force_torque.config import InSituConfig
from surefoot.experiments.force_torque.table import Samples
from surefoot.experiments.logs.checks import LogError

__all__ = [
    "check_channels",
    "contiguous",
    "in_time",
    "with_values",
]

FEWEST = 8
"""Samples without which a set is no set: an affine map of gravity has four unknowns a channel."""

MANY = 0.01
"""Share of a channel's readings at the end of its range from which the channel is saturated, not grazed."""

MOSTLY = 0.5
"""Share of missing readings from which a channel counts as dead."""

RAILS = (-32768.0, 32767.0, 65535.0, -8388608.0, 8388607.0)
"""Last codes of 16- and 24-bit converters; 0 is left out, as it is a reading like others."""


def with_values(samples: Samples, notices: list[str]) -> Samples:
    """Leave out rows without gravity, rotation or temperature; a missing reading of a channel stays NaN."""
    names, file = samples.names, samples.file
    groups: list[tuple[tuple[str, ...], NDArray[np.float64]]] = [(names.acceleration, samples.acceleration)]
    if samples.angular_velocity is not None and names.angular_velocity is not None:
        groups.append((names.angular_velocity, samples.angular_velocity))
    if samples.temperature is not None and names.temperature is not None:
        groups.append(((names.temperature,), samples.temperature[:, None]))
    if samples.time is not None and names.time is not None:
        groups.append(((names.time,), samples.time[:, None]))
    keep = np.ones(len(samples.rows), dtype=bool)
    for columns, values in [*groups, (names.raw, samples.raw)]:
        for name, column in zip(columns, values.T, strict=True):
            if np.isinf(column).any():
                row = int(samples.rows[int(np.argmax(np.isinf(column)))])
                raise LogError(
                    f"{file}: column '{name}' is infinite at row {row}; leave the cell empty where no sample "
                    "arrived."
                )
            missing = np.isnan(column)
            share = float(missing.mean())
            if missing.all():
                raise LogError(
                    f"{file}: column '{name}' holds no value in any of the {len(column)} rows of set "
                    f"'{samples.name}'; check its cable and the column's name."
                )
            if share > MOSTLY:
                raise LogError(
                    f"{file}: column '{name}' holds no value in {100 * share:.0f} % of the rows of set "
                    f"'{samples.name}'; record the set again, or leave the column out."
                )
            if missing.any():
                notices.append(
                    f"{file}: column '{name}' holds no value in {missing.sum()} of {len(column)} rows "
                    f"({100 * share:.2g} %) of set '{samples.name}'; the fit does without these samples."
                )
            if columns is not names.raw:
                keep &= ~missing
    left = samples if keep.all() else samples.take(keep)
    _enough(left)
    return left


def _enough(samples: Samples) -> None:
    whole = int(np.isfinite(samples.raw).all(axis=1).sum())
    if whole < FEWEST:
        raise LogError(
            f"{samples.file}: set '{samples.name}' has {whole} whole samples, and a set needs at least "
            f"{FEWEST}; record it for longer, or leave its rows out."
        )


def in_time(samples: Samples, notices: list[str]) -> Samples:
    """Drop rows that are there twice, and refuse times that go back, stand still or are in other units."""
    time, name, file = samples.time, samples.names.time, samples.file
    if time is None:
        return samples
    step = np.diff(time)
    if (step < 0.0).any():
        i = int(np.argmax(step < 0.0)) + 1
        raise LogError(
            f"{file}: column '{name}' goes back at row {samples.rows[i]} of set '{samples.name}' "
            f"({time[i - 1]:.6g} s, then {time[i]:.6g} s); sort the rows, or give each recording a set of "
            "its own."
        )
    again = np.concatenate([[False], step == 0.0])
    if again.any():
        same = _same_as_before(samples)
        wrong = again & ~same
        if wrong.any():
            i = int(np.argmax(wrong))
            raise LogError(
                f"{file}: column '{name}' is {time[i]:.6g} s at rows {samples.rows[i - 1]} and "
                f"{samples.rows[i]} of set '{samples.name}', and the rows differ; give each sample its own "
                "time, with more digits if they were rounded away."
            )
        notices.append(
            f"{file}: {again.sum()} rows of set '{samples.name}' repeat the row before them; they were "
            "dropped."
        )
        samples = samples.take(~again)
        _enough(samples)
        assert samples.time is not None
        step = np.diff(samples.time)
    usual = float(np.median(step))
    if samples.angular_velocity is not None and usual > 0.5:
        near = min((1e3, "ms"), (1e6, "us"), (1e9, "ns"), key=lambda u: abs(np.log(usual / u[0] / 0.01)))
        raise LogError(
            f"{file}: column '{name}' steps by {usual:.4g} s in set '{samples.name}', too slowly to follow a "
            f"gyroscope; it looks like {near[1]}: say units.time = '{near[1]}'."
        )
    gaps = step > 3.0 * usual
    # Poses that were held one by one have no rate, so that a pause between two of them is no gap.
    if gaps.any() and gaps.mean() < 0.1:
        notices.append(
            f"{file}: column '{name}' leaps {gaps.sum()} times in set '{samples.name}', the longest by "
            f"{step.max():.3g} s where rows are {usual:.3g} s apart; the fit does without what is missing."
        )
    return samples


def _same_as_before(samples: Samples) -> NDArray[np.bool_]:
    parts = [samples.raw, samples.acceleration]
    if samples.angular_velocity is not None:
        parts.append(samples.angular_velocity)
    if samples.temperature is not None:
        parts.append(samples.temperature[:, None])
    values = np.concatenate(parts, axis=1)
    same = np.zeros(len(values), dtype=bool)
    same[1:] = ((values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))).all(axis=1)
    return same


def contiguous(time: NDArray[np.float64]) -> list[slice]:
    """Part times at their gaps."""
    step = np.diff(time)
    edges = [0, *(np.flatnonzero(step > 3.0 * np.median(step)) + 1).tolist(), len(time)]
    return [slice(first, last) for first, last in pairwise(edges)]


def check_channels(samples: Samples, config: InSituConfig, notices: list[str]) -> Samples:
    """Refuse channels that are stuck or saturated; readings that only graze the end are taken out."""
    raw = samples.raw.copy()
    low, high = config.range_count if config.range_count is not None else (-np.inf, np.inf)
    for name, column in zip(samples.names.raw, raw.T, strict=True):
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
        ends = [low, high] if config.range_count is not None else list(RAILS)
        stuck = np.isin(column, ends)
        share = float(stuck.sum() / len(there))
        if share > MANY:
            end = column[stuck][0]
            raise LogError(
                f"{at} stands at {end:g}, the end of its range, in {100 * share:.2g} % of the readings of "
                f"set '{samples.name}'; hang less on the limb, or lower the amplifier's gain or offset."
            )
        if stuck.any():
            notices.append(
                f"{at} touches the end of its range in {stuck.sum()} readings of set '{samples.name}'; the "
                "fit does without them."
            )
            column[stuck] = np.nan
    left = replace(samples, raw=raw)
    _enough(left)
    return left
