"""Joint angles and IMU data from which references are computed, in a log or in a table beside it."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from surefoot.arrays import Floats
from surefoot.experiments.logs.checks import clock_of, naming_cure
from surefoot.experiments.logs.columns import stack
from surefoot.experiments.logs.description import MotionFacts
from surefoot.experiments.logs.table import LogError, LogTable

CLOCK_SPAN = 257  # number of rows over which times are averaged, because delays are random

LOST, AROUND, FEWEST = 1.5, 16, 4
"""Rows may be lost where two rows are LOST periods apart or more. They are lost if the lower quartile of the
delays of the next AROUND rows (at least FEWEST) exceeds that of the rows before by most of a period."""

PACKET = "packet"  # optional column with the number of the packet
LARGEST_ANGLE = 2.1 * np.pi  # largest angle of a hinge in rad
LARGEST_FORCE, LARGEST_SPIN = 500.0, 100.0  # largest valid readings of an IMU in m/s^2 and rad/s
LARGEST_VALUE = 1e9  # larger values are errors in every unit

ACCELEROMETER = tuple(f"accelerometer_{axis}_m_s2" for axis in "xyz")
GYROSCOPE = tuple(f"gyroscope_{axis}_rad_s" for axis in "xyz")


class Motion(NamedTuple):
    """Joints and IMU in M rows at an even rate. Rows may be missing."""

    number: NDArray[np.int64]  # number of each row in periods, shape (M,)
    time: Floats  # in s on the clock of the feet, without jitter, shape (M,)
    period: float  # between two numbers in s
    joint: Floats  # angles of the model's hinges in rad, shape (M, J)
    accelerometer: Floats  # specific force in m/s^2, in the axes of the IMU or the torso, shape (M, 3)
    gyroscope: Floats  # in rad/s, in the same axes, shape (M, 3)

    def turn(self, joint: int) -> "Motion":
        """Return a copy with the sign of one joint inverted."""
        angles = self.joint.copy()
        angles[:, joint] *= -1.0
        return self._replace(joint=angles)

    def rotate(self, R_torso_imu: Floats) -> "Motion":
        """Return a copy with the vectors of the IMU in the axes of the torso."""
        force, spin = (part @ R_torso_imu.T for part in (self.accelerometer, self.gyroscope))
        return self._replace(accelerometer=force, gyroscope=spin)


def read_motion(table: LogTable, facts: MotionFacts, joints: Sequence[str]) -> Motion:
    """Return the joints of the model, in order, and the IMU from a table, without incomplete rows."""
    file = table.file
    unknown = [name for name in facts.held_rad if name not in joints]
    if unknown:
        raise LogError(f"{file}: motion.held_rad names {unknown}; the model's hinges are {list(joints)}.")
    measured = [name for name in joints if name not in facts.held_rad]
    names = [*(f"joint_{name}_rad" for name in measured), *ACCELEROMETER, *GYROSCOPE]
    without = any(f"joint_{name}_rad" not in table for name in measured)
    held = " A joint without a column is held at an angle by motion.held_rad." if without else ""
    table.require(["time_s", *names], naming_cure(table, names) + held)
    values = {name: table.numbers(name) for name in ("time_s", *names)}
    values["time_s"] = clock_of(values["time_s"], file, spread=False).time
    for name in names:
        if not np.isfinite(values[name]).any():
            raise LogError(
                f"{file}: column '{name}' holds no number in any of its {len(table)} rows; log it, or hold "
                "the joint at an angle with motion.held_rad."
            )
    if PACKET in table:
        values[PACKET] = table.numbers(PACKET)
    values = _rows_within(values, dict.fromkeys(names, LARGEST_VALUE), file)
    _check_units(values, measured, file)
    limits = dict.fromkeys(ACCELEROMETER, LARGEST_FORCE) | dict.fromkeys(GYROSCOPE, LARGEST_SPIN)
    values = _rows_within(values, limits, file)
    packet = values.get(PACKET)
    number, time, period = _clock(values["time_s"], packet, facts, file)
    still = {f"joint_{name}_rad": np.full(len(time), angle) for name, angle in facts.held_rad.items()}
    joint = stack(values | still, [f"joint_{name}_rad" for name in joints])
    force, spin = stack(values, ACCELEROMETER), stack(values, GYROSCOPE)
    return Motion(number, time, period, joint, force, spin)


def _rows_within(values: dict[str, Floats], limits: Mapping[str, float], file: str) -> dict[str, Floats]:
    """Return the rows in which columns are numbers within limits."""
    whole = np.all([np.abs(values[name]) <= limit for name, limit in limits.items()], axis=0)
    if whole.sum() < 8:
        raise LogError(
            f"{file}: only {whole.sum()} rows have all of joints and IMU, and 8 are needed; "
            "write all of them into the same rows."
        )
    return {name: column[whole] for name, column in values.items()}


def _clock(
    time: Floats, packet: Floats | None, facts: MotionFacts, file: str
) -> tuple[NDArray[np.int64], Floats, float]:
    """Return the numbers of the rows, their times without jitter, and the period."""
    if packet is None:
        number = count_rows(time, facts.dt_s)
    else:
        rising = (
            np.isfinite(packet).all() and (np.diff(packet) > 0).all() and (packet == packet.round()).all()
        )
        if not rising:
            raise LogError(
                f"{file}: column '{PACKET}' must hold whole numbers that increase; or leave it out."
            )
        number = (packet - packet[0]).astype(np.int64)
    even, period = even_times(time, number)
    if abs(period / facts.dt_s - 1.0) > 0.1:
        raise LogError(
            f"{file}: joints and IMU come every {period:.4g} s where the description says "
            f"{facts.dt_s:.4g} s; give motion.dt_s, the time between two of their rows in seconds."
        )
    return number, even - facts.delay_s, period


def even_times(time: Floats, number: NDArray[np.int64]) -> tuple[Floats, float]:
    """Return the times of numbered rows without jitter, and the period."""
    period = float(np.polyfit(number, time, 1)[0])
    late = uniform_filter1d(time - period * number, CLOCK_SPAN, mode="reflect")
    return np.asarray(period * number + late, dtype=np.float64), period


def count_rows(time: Floats, period: float) -> NDArray[np.int64]:
    """Number the rows. A lost row shifts all later rows, a late one does not."""
    number = np.arange(len(time))
    for row in (np.flatnonzero(np.diff(time) >= LOST * period) + 1).tolist():
        first, last = max(row - AROUND, 0), min(row + AROUND, len(time))
        late = time[first:last] - period * number[first:last]
        # Delays of earlier rows are not affected by later losses.
        before, after = late[: row - first], late[row - first :]
        jump = float(np.quantile(after, 0.25) - np.quantile(before, 0.25))
        if jump > 0.75 * period and min(len(before), len(after)) >= FEWEST:
            number[row:] += round(jump / period)
    return number


def even_rows(time: Floats, packet: Floats | None = None) -> tuple[NDArray[np.int64], Floats]:
    """Return numbers of rows and their times without jitter, or unchanged times if the rate is not even."""
    period = float(np.median(np.diff(time)))
    number = count_rows(time, period) if packet is None else (packet - packet[0]).astype(np.int64)
    if len(time) > FEWEST and (np.diff(number) > 0).all():
        even, _ = even_times(time, number)
        if np.quantile(np.abs(time - even), 0.9) <= 0.5 * period and (np.diff(even) > 0.0).all():
            return number, even
    return np.arange(len(time)), time


def means_since(time: Floats, values: Floats, rows: Floats, averaged: bool, longest: float) -> Floats:
    """Return means of a sensor between the times of other rows in s, (N,), NaN where unknown.

    Each of the M values of the sensor is instantaneous or, if ``averaged``, a mean since the previous value.
    Averaging prevents aliasing of vibrations. Lost values are interpolated over at most ``longest`` s.
    """
    number, even = even_rows(time)
    every = np.arange(number[-1] + 1)
    times, filled = np.interp(every, number, even), np.interp(every, number, values)
    mean = filled[1:] if averaged else 0.5 * (filled[1:] + filled[:-1])
    integral = np.append(0.0, np.cumsum(mean * np.diff(times)))
    edges = np.append(2.0 * rows[0] - rows[1], rows)
    found: Floats = np.diff(np.interp(edges, times, integral, left=np.nan, right=np.nan)) / np.diff(edges)
    gap = np.flatnonzero(np.diff(even) > longest)
    for start, end in zip(even[gap].tolist(), even[gap + 1].tolist(), strict=True):
        found[(edges[1:] > start) & (edges[:-1] < end)] = np.nan
    return found


def _check_units(values: Mapping[str, Floats], joints: Sequence[str], file: str) -> None:
    for name in joints:
        largest = float(np.abs(values[f"joint_{name}_rad"]).max())
        if largest > LARGEST_ANGLE:
            raise LogError(
                f"{file}: column 'joint_{name}_rad' goes to {largest:.4g}, and no hinge turns by more than "
                f"{LARGEST_ANGLE:.3g} rad; give radians, not degrees or ticks."
            )
    felt = float(np.median(np.sqrt(sum(values[name] ** 2 for name in ACCELEROMETER))))
    if not 7.0 < felt < 13.0:
        raise LogError(
            f"{file}: columns '{ACCELEROMETER[0]}' to '_z_m_s2' have a median length of {felt:.4g}, and a "
            "robot on the ground feels 9.81 m/s^2; give the specific force in m/s^2, gravity included."
        )
