"""Check a log: raise an error with a remedy for misleading input, and leave out other bad samples."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY
from surefoot.calibration.arrays import skew
from surefoot.experiments.force_torque.table import Samples
from surefoot.experiments.logs.clock import read_clock
from surefoot.experiments.logs.table import LogError

FEWEST = 8  # minimum number of samples per set: an affine map of gravity has four unknowns per channel
MANY = 0.01  # maximum share of readings per channel that are at an end of the range
MOSTLY = 0.5  # maximum share of missing values per column
RAILS = (-32768.0, 32767.0, 65535.0, -8388608.0, 8388607.0)  # end values of 16-bit and 24-bit converters
GAP = 3.0  # multiple of the median time step; a longer step is a gap
POSES = 0.1  # maximum share of gaps; with more, the rows are single poses without a sample rate
SLOWEST_GYROSCOPE = 0.5  # maximum median time step in s for the integration of a gyroscope
TURNED = 0.5  # interval in s for the integration of both sides of dg/dt = -w x g
TURNS = 0.5  # RMS change of gravity in m/s^2 over that interval; the gyroscope must explain larger changes
FLAT = 1e-3  # relative tolerance of singular values in the fit of the IMU's lever arm
CLEAR = 0.5  # minimum correlation for a reliable regression slope
LARGEST = 1e9  # values are clipped to this magnitude, so that their squares stay finite

_LOOKS = {
    1.0: "it looks like g: say units.acceleration = 'g'",
    1000.0: "it looks like thousandths of g: say units.acceleration = 'mg'",
    GRAVITY**2: "it looks like m/s^2 already: say units.acceleration = 'm/s^2'",
    1e-3 * GRAVITY**2: "it looks like m/s^2 already: say units.acceleration = 'm/s^2'",
    1e3 * GRAVITY: "it looks like mm/s^2: convert the columns to m/s^2",
    1e2 * GRAVITY: "it looks like cm/s^2: convert the columns to m/s^2",
}
"""Likely unit of an acceleration, by its length at rest in m/s^2."""


def check_samples(samples: Samples, range_count: tuple[float, float] | None, notices: list[str]) -> Samples:
    """Return the samples that a fit can use, and append a notice for those left out.

    Raises:
        LogError: If values are misleading.
    """
    samples = _check_times(_check_values(samples, notices), notices)
    samples = _check_channels(samples, range_count, notices)
    _check_acceleration(samples)
    _check_spin(samples)
    return samples


def _check_values(samples: Samples, notices: list[str]) -> Samples:
    """Return the rows that are complete except for readings. Missing readings stay NaN."""
    columns = samples.columns
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
            at, missing = f"{samples}: column '{name}'", np.isnan(column)
            share = f"{missing.sum()} of {len(column)} rows ({100 * missing.mean():.3g} %)"
            if np.isinf(column).any():
                row = samples.rows[np.argmax(np.isinf(column))]
                raise LogError(
                    f"{at} is infinite at row {row}; leave the cell empty where no sample arrived."
                )
            if missing.mean() > MOSTLY:
                raise LogError(
                    f"{at} holds no value in {share}; check its cable and the column's name, and record the "
                    "set again, or leave the column out."
                )
            if missing.any():
                notices.append(f"{at} holds no value in {share}; the fit does without these samples.")
            if values is not samples.raw:
                keep &= ~missing
    return _enough(samples if keep.all() else samples.take(keep))


def _check_times(samples: Samples, notices: list[str]) -> Samples:
    """Return samples with increasing times and no repeated rows. Raise LogError if the clock is unusable."""
    time = samples.time
    if time is None:
        return samples
    at = f"{samples}: column '{samples.columns.time}'"
    again = np.concatenate([[False], np.diff(time) == 0.0]) & _same_as_before(samples)
    if again.any():
        notices.append(f"{samples}: {again.sum()} rows repeat the row before them; they were dropped.")
        samples = _enough(samples.take(~again))
    clock = read_clock(time[~again], rows=samples.rows)
    if clock.flaw:
        raise LogError(f"{at} {clock.flaw}; {clock.cure}")
    notices += [f"{at} {text}." for text in clock.notices]
    samples, step = replace(samples, time=clock.time), np.diff(clock.time)
    usual = float(np.median(step))
    if samples.angular_velocity is not None and usual > SLOWEST_GYROSCOPE:
        near = min((1e3, "ms"), (1e6, "us"), (1e9, "ns"), key=lambda u: abs(np.log(usual / u[0] / 0.01)))
        raise LogError(
            f"{at} steps by {usual:.4g} s, too slowly to follow a gyroscope; it looks like {near[1]}: say "
            f"units.time = '{near[1]}'."
        )
    gaps = step > GAP * usual
    if gaps.any() and gaps.mean() < POSES:
        notices.append(
            f"{at} leaps {gaps.sum()} times, the longest by {step.max():.3g} s where rows are {usual:.3g} s "
            "apart; the fit does without what is missing."
        )
    return samples


def contiguous(time: Floats) -> list[slice]:
    """Return one slice per section without gaps."""
    step = np.diff(time)
    edges = [0, *(np.flatnonzero(step > GAP * np.median(step)) + 1).tolist(), len(time)]
    return [slice(first, last) for first, last in pairwise(edges)]


def _check_channels(samples: Samples, range_count: tuple[float, float] | None, notices: list[str]) -> Samples:
    """Return the samples with saturated readings set to NaN, or raise LogError if a channel is unusable."""
    raw = samples.raw.copy()
    low, high = range_count or (-np.inf, np.inf)
    for name, column in zip(samples.channels, raw.T, strict=True):
        at, there = f"{samples}: column '{name}'", column[np.isfinite(column)]
        if np.ptp(there) == 0.0:
            raise LogError(
                f"{at} is {there[0]:g} in all {len(there)} readings, and a channel that lives follows "
                "gravity; check its cable and its converter."
            )
        if there.max() > high or there.min() < low:
            worst = there.max() if there.max() > high else there.min()
            raise LogError(
                f"{at} reads {worst:g}, outside sensor.range_count = [{low:g}, {high:g}]; correct the range, "
                "or give the columns in counts."
            )
        stuck = np.isin(column, range_count or RAILS)
        share = stuck.sum() / len(there)
        if share > MANY:
            raise LogError(
                f"{at} stands at {column[stuck][0]:g}, the end of its range, in {100 * share:.2g} % of its "
                "readings; hang less on the limb, or lower the amplifier's gain or offset."
            )
        if stuck.any():
            notices.append(
                f"{at} touches the end of its range in {stuck.sum()} readings; the fit does without them."
            )
            column[stuck] = np.nan
    return _enough(replace(samples, raw=raw))


def _enough(samples: Samples) -> Samples:
    whole = int(np.isfinite(samples.raw).all(axis=1).sum())
    if whole < FEWEST:
        raise LogError(
            f"{samples}: has {whole} whole samples, and a set needs at least {FEWEST}; record it for longer, "
            "or leave its rows out."
        )
    return samples


def _same_as_before(samples: Samples) -> NDArray[np.bool_]:
    parts = (samples.raw, samples.acceleration, samples.angular_velocity, samples.temperature)
    values = np.column_stack([part for part in parts if part is not None])
    # Two missing readings count as equal.
    values = np.nan_to_num(values, nan=np.inf)
    return np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])


def _check_acceleration(samples: Samples) -> None:
    """Raise LogError if the accelerations at rest do not match gravity in the specified unit."""
    size = np.linalg.norm(np.clip(samples.acceleration, -LARGEST, LARGEST), axis=1)
    felt = float(np.median(size))
    # A swinging limb has larger accelerations. Wrong units differ by a factor of at least 9.8.
    wide = 0.5 if samples.angular_velocity is not None else 0.2
    if 1.0 - wide < felt / GRAVITY < 1.0 + wide:
        return
    looks = [text for value, text in _LOOKS.items() if 0.8 < felt / value < 1.2]
    looks += ["give m/s^2 with gravity in it, or say units.acceleration"]
    raise LogError(
        f"{samples}: {_name(samples.acceleration_names)} have a median length of {felt:.4g} m/s^2, and a "
        f"limb that hangs still feels {GRAVITY:.4g}; {looks[0]}."
    )


def _check_spin(samples: Samples) -> None:
    """Raise LogError if the units or signs of a gyroscope do not match the rotation of gravity.

    In the frame of the limb, gravity changes by dg/dt = -w x g. If units and signs agree, the regression of
    its change on the integral of the right-hand side has a slope of 1. An IMU with a lever arm p from the
    axis measures an additional acceleration K p, which is also fitted.
    """
    spin, time = samples.angular_velocity, samples.time
    if spin is None or time is None:
        return
    expected, seen, beside = [], [], []
    stride = max(1, round(TURNED / float(np.median(np.diff(time)))))
    for part in contiguous(time):
        if part.stop - part.start <= stride:
            continue
        a, t, w = samples.acceleration[part], time[part], spin[part]
        across = skew(w)
        swung = np.concatenate([skew(np.gradient(w, t, axis=0)), across @ across], axis=2)
        felt = np.concatenate([-np.cross(w, a)[..., None], across @ swung], axis=2)
        total = np.zeros_like(felt)
        total[1:] = np.cumsum(0.5 * (felt[1:] + felt[:-1]) * np.diff(t)[:, None, None], axis=0)
        turned = total[stride:] - total[:-stride]
        expected.append(turned[..., 0].ravel())
        seen.append((a[stride:] - a[:-stride]).ravel())
        beside.append(
            np.concatenate([swung[stride:] - swung[:-stride], turned[..., 1:]], axis=2).reshape(-1, 12)
        )
    if not expected:
        return
    x, y, columns = np.concatenate(expected), np.concatenate(seen), np.concatenate(beside)
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    swings = columns @ np.linalg.lstsq(columns, np.column_stack([x, y]), rcond=FLAT)[0]
    x, y = x - swings[:, 0], y - swings[:, 1]
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    at = f"{samples}: {_name(samples.columns.angular_velocity or ())}"
    if xx == 0.0 or yy == 0.0:
        return
    if abs(xy) < CLEAR * np.sqrt(xx * yy):
        if yy > len(y) * TURNS**2:
            raise LogError(
                f"{at} do not say how gravity turns (correlation {xy / np.sqrt(xx * yy):.2f}); give the "
                "gyroscope's axes in the accelerometer's order and frame, less its bias, by one clock."
            )
        return
    slope = xy / xx
    if slope < 0.0:
        raise LogError(
            f"{at} turn gravity the wrong way round; turn their signs, or give both of the IMU's vectors in "
            "one right-handed frame."
        )
    if not 0.5 < slope < 2.0:
        cure = (
            "they look like deg/s: say units.angular_velocity = 'deg/s'"
            if 0.01 < slope < 0.03
            else "give rad/s, and time in seconds"
        )
        raise LogError(f"{at} say {1 / slope:.2g} times the rate at which gravity turns; {cure}.")


def _name(columns: tuple[str, ...]) -> str:
    return f"columns '{columns[0]}' to '{columns[-1]}'"
