r"""The clock of an IMU that is late against the readings.

Gravity that was read late by d makes :math:`r = A T u(t + d) + o`, to first order a column
:math:`A T \dot u` of readings more. Two looks find d: one at each set's own linear map, which large delays
and fast motion show at once, and one beside all else that a fit explains. The second is needed where a
sensor has hysteresis, since its readings lag as well: what a late IMU adds cancels part of a loop, and the
rest looks like a narrow one. The two differ after each turn of the limb, where a delay acts at once and a
loop grows.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from surefoot.calibration.in_situ.beside import criterion
from surefoot.calibration.in_situ.covariance import disagreement
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.judge import projected
from surefoot.calibration.in_situ.model import signals
from surefoot.calibration.in_situ.rows import means
from surefoot.calibration.in_situ.solve import Problem, Solution, transforms

__all__ = ["LONGEST", "SHORTEST", "DelayLeft", "guess_delay", "likeliest_delay", "shift"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

_ROWS = 1500
"""Rows of a set in which a delay is looked for."""

_DRIFT = 6
"""Cosines over a set's time that an offset may follow meanwhile."""

_ROUNDS, _SETTLED = 6, 1e-4
"""Steps at most, and the last one in s."""

LONGEST = 1.0
"""Delay in s beyond which it is none."""

SHORTEST = 1e-3
"""Delay in s below which nothing is shifted: half of a sample at 500 Hz."""

_EXPLAINS = 0.5
"""Share of the residual's square that a delay leaves at most: a turned IMU or hysteresis leave more."""


def guess_delay(sets: Sequence[InSituSet], moving: bool) -> float:
    """Return by how much gravity is late in s, by each set's own map; zero unless it explains much."""
    if any(data.time is None or len(data.raw) < 8 * _DRIFT for data in sets):
        return 0.0
    delay, before, after = 0.0, np.inf, np.inf
    for i in range(_ROUNDS):
        left, along, square = np.array([_slope(shift(data, delay), moving) for data in sets]).sum(axis=0)
        before, after = (left if i == 0 else before), left
        step = float(along / max(square, np.finfo(float).tiny))
        if not np.isfinite(step) or abs(delay + step) > LONGEST:
            return 0.0
        if abs(step) < (_SETTLED if delay else SHORTEST):
            break
        delay += step
    return delay if delay >= SHORTEST and after <= _EXPLAINS * before else 0.0


_LAW = 0.1
"""Share of the delay that loops look like by which a law of hysteresis other than the fit's may feign one:
thresholds of ratio 3 in the place of 2 feign a tenth."""

_NONE = np.finfo(float).tiny


class DelayLeft(NamedTuple):
    """By how much gravity is still late beside all that a fit explains.

    Attributes:
        delay: In s; negative where it is early.
        std: Its deviation.
    """

    delay: float
    std: float

    @property
    def nats(self) -> float:
        """What the delay explains."""
        return 0.5 * (self.delay / self.std) ** 2


def likeliest_delay(sets: Sequence[InSituSet], fits: Sequence[tuple[Problem, Solution]]) -> DelayLeft:
    """Return the delay beside the fit that would be the likeliest with it.

    Delays and loops cancel each other, so that the fit without the delay is no guide.

    Args:
        sets: As they were fitted, each with times.
        fits: Problems with loops of hysteresis by each law, and their solutions.
    """
    tried = [(criterion(*one), delay_left(sets, *one)) for one in fits]
    return min(tried, key=lambda one: one[0] - 2.0 * one[1].nats * (one[1].delay > 0.0))[1]


def delay_left(sets: Sequence[InSituSet], problem: Problem, solution: Solution) -> DelayLeft:
    """Return the delay that a fit leaves, with all of its unknowns free to follow.

    Args:
        sets: As they were fitted, each with times.
        problem: The problem.
        solution: Its solution.
    """
    between, along, square, like, whole = [], 0.0, _NONE, 0.0, _NONE
    predicted = solution.response @ transforms(problem, solution)
    for data, part, B in zip(sets, problem.sets, predicted, strict=True):
        source = part.source
        at = np.interp(part.index, np.arange(len(data.raw)), np.asarray(data.time))
        rate = np.gradient(source.signals[:, problem.motion], at, axis=0) @ B[:, problem.motion].T
        loops = source.signals[:, problem.of_lags] @ B[:, problem.of_lags].T
        columns = np.column_stack([rate, loops]) * source.weight[:, None]
        columns = part.colour.weigh(
            np.column_stack([source.columns[:, : source.terms], columns]), part.spacing
        )
        basis, columns = np.linalg.qr(columns[:, : source.terms])[0], columns[:, source.terms :]
        late, loops = np.hsplit(columns - basis @ (basis.T @ columns), 2)
        seen = part.score.T @ late
        between.append(part.whiten @ seen @ problem.whitening.T)
        power = np.sqrt(part.colour.left(part.rows, part.spacing))[:, None]
        within, left, late, loops = (
            dct(one, norm="ortho", axis=0) / power @ problem.whitening.T
            for one in (late - part.score @ seen, part.residual, late, loops)
        )
        along, square = along + float(np.sum(within * left)), square + float(np.sum(within**2))
        like, whole = like + float(np.sum(late * loops)), whole + float(np.sum(late**2))
    # Sets that contradict each other say little of a clock.
    believed = 1.0 / disagreement(problem, solution)[:, None]
    free = projected(solution, np.stack(between).reshape(-1, 1))[: solution.residual.size]
    free = free.reshape(solution.residual.shape) * believed
    along -= float(np.sum(free * solution.residual * believed))
    square += float(np.sum(free**2))
    return DelayLeft(along / square, float(np.hypot(square**-0.5, _LAW * like / whole)))


def _slope(data: InSituSet, moving: bool) -> tuple[float, float, float]:
    """Return the square that a set's linear fit leaves, and its products with B dg/dt and of that alone."""
    assert data.time is not None
    u = signals(data, moving)
    whole = np.isfinite(u).all(axis=1) & np.isfinite(data.raw).all(axis=1)
    width = max(int(np.sum(whole)) // _ROWS, 1)
    rows = means(np.column_stack([data.time, u, data.raw])[whole], width)
    time, u, raw = rows[:, 0], rows[:, 1 : 1 + u.shape[1]], rows[:, 1 + u.shape[1] :]
    share = (time - time[0]) / max(float(time[-1] - time[0]), np.finfo(float).tiny)
    offset = np.cos(np.pi * share[:, None] * np.arange(_DRIFT))
    size = np.maximum(np.std(u, axis=0), np.finfo(float).tiny)
    columns = np.concatenate([u / size, offset], axis=1)
    left, singular, right = np.linalg.svd(columns, full_matrices=False)
    kept = singular > 1e-9 * singular[0]
    left = left[:, kept]
    slope = (right[kept].T / singular[kept]) @ (left.T @ raw)
    residual = raw - left @ (left.T @ raw)
    rate = np.gradient(u, time, axis=0) / size @ slope[: u.shape[1]]
    rate -= left @ (left.T @ rate)
    noise = np.linalg.pinv(residual.T @ residual / len(raw), rcond=1e-9, hermitian=True)
    return (
        float(np.sum(residual**2 / np.maximum(np.var(raw, axis=0), np.finfo(float).tiny))),
        float(np.sum((rate @ noise) * residual)),
        float(np.sum((rate @ noise) * rate)),
    )


def shift(data: InSituSet, delay: float) -> InSituSet:
    """Return a set with gravity and motion as they were read later by the delay; the ends drop out."""
    time = data.time
    if not delay:
        return data
    assert time is not None
    kept = (time + delay >= time[0]) & (time + delay <= time[-1])

    def later(values: Matrix) -> Matrix:
        return np.stack([np.interp(time[kept] + delay, time, one) for one in values.T], axis=1)

    rate, acceleration = data.angular_velocity, data.angular_acceleration
    return replace(
        data,
        raw=data.raw[kept],
        time=time[kept],
        temperature=None if data.temperature is None else data.temperature[kept],
        gravity=later(data.gravity),
        angular_velocity=None if rate is None else later(rate),
        angular_acceleration=None if acceleration is None else later(acceleration),
    )
