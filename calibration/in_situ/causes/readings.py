"""Mistakes in the recording: clocks, filters, values that were held, and other sensors or gains."""

from collections.abc import Callable, Iterator, Sequence
from operator import methodcaller

import numpy as np
import scipy

from surefoot.calibration.arrays import orthonormal
from surefoot.calibration.diagnosis import Mistake
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.causes.posed import Posed
from surefoot.calibration.in_situ.check import measure_repeated
from surefoot.calibration.in_situ.data import InSituSet, Matrix, change_motion, read_later
from surefoot.calibration.in_situ.model import DIRECT, SPREAD_ROUNDING, signals
from surefoot.calibration.in_situ.solver.solve import Solution

_TINY = float(np.finfo(float).tiny)

_THINNED = 2000  # samples of a set in which causes are looked for

_DELAYS = np.geomspace(0.03, 6.0, 24)
"""Delays in s between the IMU and the readings, either way, and time constants of filters."""

_ACCURACY = 2e-3  # share of a delay to which it is found: a message has three digits

_CLOCK = "stamp both by one clock, and log the sensor without a filter of the driver"


def clocks(posed: Posed, plain: Solution) -> Iterator[Mistake]:
    """Yield clocks that disagree, filters, and values that were held."""
    if not posed.timed:
        return
    held = max(map(measure_repeated, posed.sets)) > limits.REPEATED
    for kind, words, cure, change, values in _READINGS:
        if change is _hold and not held:
            continue
        x = _find_size(posed.sets, change, values)
        sets = [_change(data, change, x) for data in posed.sets]
        undo = methodcaller("read_as", sets)
        yield Mistake(kind, words.format(abs(x)), cure, undo, int(len(values) > 1))


def _find_size(sets: Sequence[InSituSet], change: "_Change", values: Sequence[float]) -> float:
    """Return the size of a change of gravity that explains most: the best of a grid, made finer."""

    def measure(x: float) -> float:
        return _share_left([_change(data, change, x) for data in sets])

    best = int(np.argmin([measure(x) for x in values])) if len(values) > 1 else 0
    near = values[max(best - 1, 0) : best + 2]
    if len(near) == 1:
        return near[0]
    options = {"xatol": _ACCURACY * abs(values[best])}
    found = scipy.optimize.minimize_scalar(
        measure, bounds=(min(near), max(near)), method="bounded", options=options
    )
    return float(found.x)


def _change(data: InSituSet, change: "_Change", x: float) -> InSituSet:
    """Change gravity and motion; gaps are filled, as filters need all values."""

    def fill(values: Matrix) -> Matrix:
        at = np.flatnonzero(np.isfinite(values).all(axis=1))
        return np.stack([np.interp(np.arange(len(values)), at, one[at]) for one in values.T], axis=1)

    return change_motion(data, lambda values: change(fill(values), data, x))


def _low_pass(values: Matrix, data: InSituSet, seconds: float) -> Matrix:
    """Return the low-passed values, shape (n, 3), by a filter of the first order."""
    assert data.time is not None
    kept = float(np.exp(-np.median(np.diff(data.time)) / seconds))
    return np.asarray(
        scipy.signal.lfilter([1.0 - kept], [1.0, -kept], values, axis=0, zi=kept * values[:1])[0]
    )


def _hold(values: Matrix, data: InSituSet, _: float) -> Matrix:
    """Return values as they were when readings that repeat were read."""
    fresh = np.append(True, np.any(data.raw[1:] != data.raw[:-1], axis=1))
    return np.asarray(values[np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))])


_Change = Callable[[Matrix, InSituSet, float], Matrix]

_READINGS: tuple[tuple[str, str, str, _Change, tuple[float, ...]], ...] = (
    ("clock", "the IMU came about {:.3g} s after the readings", _CLOCK, read_later, tuple(_DELAYS)),
    ("clock", "the readings came about {:.3g} s after the IMU", _CLOCK, read_later, tuple(-_DELAYS)),
    (
        "filter",
        "the readings came about {:.3g} s after the IMU, as through a low-pass filter",
        _CLOCK,
        _low_pass,
        tuple(_DELAYS),
    ),
    (
        "automatic zero",
        "the driver takes a zero off that follows the readings within {:.3g} s",
        "log the sensor's own readings, with no automatic zero in the driver",
        lambda values, data, seconds: values - _low_pass(values, data, seconds),
        tuple(10.0 * _DELAYS),
    ),
    (
        "held",
        "readings repeat the ones before: the driver is slower than the log, or hangs",
        "log each sample of the sensor once, at the time at which it was read",
        _hold,
        (0.0,),
    ),
)
"""Kinds, causes, cures, how gravity was to be read then, and the sizes that are tried."""


def _share_left(sets: Sequence[InSituSet]) -> float:
    """Return the share of the readings that gravity leaves in each set by itself, rms over all."""
    found = []
    for data in sets:
        u = np.column_stack([np.ones(len(data.raw)), signals(data, data.moves)])
        rows = np.flatnonzero(np.isfinite(np.column_stack([u, data.raw])).all(axis=1))
        rows = rows[:: max(len(rows) // _THINNED, 1)]
        if len(rows) <= 2 * u.shape[1]:
            return np.inf
        basis, _ = orthonormal(u[rows], SPREAD_ROUNDING)
        raw = data.raw[rows] - np.mean(data.raw[rows], axis=0)
        left = np.mean((raw - basis @ (basis.T @ raw)) ** 2, axis=0)
        found.append(np.mean(left / np.maximum(np.mean(raw**2, axis=0), _TINY)))
    return float(np.sqrt(np.mean(found)))


def sensors(posed: Posed, plain: Solution) -> Iterator[Mistake]:
    """Yield a channel whose gain changes at a set, and a set that another sensor has read."""
    parts, A = posed.problem.sets, plain.A
    channels, count = len(A), len(parts)
    cure = "check its cable and the amplifier's gain, and record all sets with one sensor"
    of_gravity = [part.source.signals[:, DIRECT] for part in parts]
    loads = [g @ T[:, :3].T for g, T in zip(of_gravity, plain.loads, strict=True)]
    for j in range(count):
        name = posed.sets[j].name
        other = [(i == j) * g for i, g in enumerate(of_gravity)]
        words = f"another sensor, gain or order of channels in '{name}'"
        yield Mistake("sensor", words, cure, methodcaller("beside", other), 3 * channels, count)
        for channel in range(channels) if j else ():
            read = [(load @ A[channel])[:, None] * (i >= j) for i, load in enumerate(loads)]
            words = f"channel {channel} has another gain from '{name}' on"
            undo = methodcaller("beside", read)
            yield Mistake("gain", words, cure, undo, channels, channels * (count - 1))
