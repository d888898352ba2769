r"""How a channel answers known loads: scale, offset, hysteresis, creep, nonlinearity and delay.

In newtons of its own scale, a reading is

.. math:: y / k = F + h\, H(F) + \sum_j s_j C_j(F) + a\, N(F) + z_0 + z(t) + n,

linear in all but the time constants of the creep: H, C and N are the stages of the emulated cells
(:mod:`surefoot.sensors.stages`) by one unit of their errors. Drift z and noise n make the residuals coloured;
means of blocks are fitted by their covariance (generalised least squares).
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter
from scipy.stats import chi2
from scipy.stats import t as student

from surefoot.arrays import Floats
from surefoot.experiments.instrument.rest import SURE, AtRest, Interval, normal_interval
from surefoot.sensors.stages.hysteresis import hysteresis
from surefoot.sensors.stages.mechanics import SMALLEST_LOOP

BLOCKS = 600  # most means that are fitted
SHORTEST = 0.2  # s of a block
AFTER = 0.3  # s after a change of the load in which a reading may still settle
SHOWN = 0.9  # probability that creep is there from which on it is fitted
UNIT = 1e-3  # of hysteresis, whose answer is linear in it
WINDOW = 0.6  # s of an even load before and after a step that shows a delay
LEAST_STEP = 0.2  # share of the range of loads
SHARP = 0.05  # share of a step that its first row may lack where readings are as old as their rows


class Response(NamedTuple):
    """Results of known loads; of all channels together unless it is said."""

    scale: Floats  # counts per N of each channel at the start, shape (K,)
    scale_std: Floats
    offset: Floats  # counts without a load at the start, shape (K,)
    hysteresis: Interval
    creep: Interval | None  # share of one exponential
    creep_time: float  # its time constant in s; NaN without
    nonlinearity: tuple[Interval, ...]  # of each channel
    delay: Interval | None  # mean age of readings in s

    def memory(self, time: Floats, load: Floats, capacity: float) -> Floats:
        """Hysteresis and creep in counts, shape (N, K)."""
        added = self.hysteresis.value * loop_of(load, capacity)
        if self.creep is not None:
            added = added + self.creep.value * creep_of(time, load, self.creep_time)
        return self.scale * added


def blocks_of(time: Floats, load: Floats) -> list[np.ndarray]:
    """Return the rows of blocks over which the load is constant, and has been for a while."""
    length = max(SHORTEST, (time[-1] - time[0]) / BLOCKS)
    # Load may differ from channel to channel: it changes where any does.
    changes = np.flatnonzero((np.diff(load, axis=0) != 0.0).any(axis=1)) + 1
    last = np.full(len(time), -np.inf)
    for row in changes:
        last[row:] = time[row]
    still = time - last >= AFTER
    number = ((time - time[0]) / length).astype(int)
    moves = np.zeros(number[-1] + 1, dtype=bool)
    moves[number[changes]] = True
    return [
        rows
        for rows in np.split(np.arange(len(time)), np.flatnonzero(np.diff(number)) + 1)
        if still[rows].all() and not moves[number[rows[0]]] and len(rows) > 1
    ]


class Blocks(NamedTuple):
    """Means over blocks, and their errors by noise and drift."""

    time: Floats  # middle of each in s, shape (B,)
    value: Floats  # counts, shape (B, K)
    load: Floats  # N, shape (B, K)
    hysteresis: Floats  # answers to the load in N by a unit of each error, shape (B, K)
    nonlinearity: Floats
    size: float  # conversions in each


def loop_of(load: Floats, capacity: float | Floats) -> Floats:
    """Hysteresis of a load in N, by a unit of its share, shape (N, K); capacities may be K."""
    element, rng = hysteresis(UNIT, capacity, smallest=SMALLEST_LOOP), np.random.default_rng(0)
    turns = np.flatnonzero(np.concatenate([[True], (np.diff(load, axis=0) != 0.0).any(axis=1)]))
    state, found = element.init(load.shape[1:], rng), []
    for now in load[turns]:
        reading, state = element.apply(now, state, rng, 0.0)
        found.append((reading - now) / UNIT)
    return np.repeat(np.array(found), np.diff(np.append(turns, len(load))), axis=0)


def creep_of(time: Floats, load: Floats, constant: float) -> Floats:
    """Creep under a load in N, by a unit of its share, shape (N, K); rows are even."""
    kept = np.exp(-float(np.median(np.diff(time))) / constant)
    followed: Floats = lfilter([1.0 - kept], [1.0, -kept], load, axis=0)
    return followed


def respond(
    time: Floats, raw: Floats, load: Floats, capacity: float, at_rest: AtRest, rate: float
) -> Response:
    """Fit the answer of K channels, counts or NaN, to known loads in N, both (N, K), at times in s.

    Known are the rated load in N, noise and drift at rest, and the conversions a second.
    """
    parts = blocks_of(time, load)

    inside, starts = np.concatenate(parts), np.cumsum([0, *map(len, parts[:-1])])

    def mean(values: Floats) -> Floats:
        there = np.isfinite(values[inside])
        sums = np.add.reduceat(np.where(there, values[inside], 0.0), starts, axis=0)
        return sums / np.maximum(np.add.reduceat(there, starts, axis=0, dtype=float), 1.0)

    u = np.clip(load / capacity, -1.0, 1.0)
    bend = 4.0 * capacity * (u - u * u)
    loops = loop_of(load, capacity)
    span = float(np.median([time[rows[-1]] - time[rows[0]] for rows in parts]))
    size = max(1.0, span * rate)
    blocks = Blocks(mean(time[:, None])[:, 0], mean(raw), mean(load), mean(loops), mean(bend), size)

    def crept(constant: float) -> Floats:
        return mean(creep_of(time, load, constant))

    longest, shortest = (time[-1] - time[0]) / 2.0, 3.0 * max(SHORTEST, span)
    factors = _factors(blocks, at_rest)
    plain = _fit(blocks, factors, [])
    grid = np.geomspace(shortest, longest, 8)
    costs = [_fit(blocks, factors, [crept(one)]).cost for one in grid]
    k = int(np.argmin(costs))
    inner = minimize_scalar(
        lambda x: _fit(blocks, factors, [crept(float(np.exp(x)))]).cost,
        bounds=(np.log(grid[max(k - 1, 0)]), np.log(grid[min(k + 1, len(grid) - 1)])),
        method="bounded",
        options={"xatol": 0.02},
    )
    constant = float(np.exp(inner.x))
    shows = plain.cost - float(inner.fun) > 0.5 * float(chi2.ppf(SHOWN, 2))
    if not shows:
        return _response(plain, None, np.nan, _delay(time, raw, load))
    # How surely the time constant is known widens what is known of the share.
    slope = (crept(1.05 * constant) - crept(constant / 1.05)) / (2.0 * np.log(1.05))
    found = _fit(blocks, factors, [crept(constant), slope])
    best = _fit(blocks, factors, [crept(constant)])
    return _response(best, found, constant, _delay(time, raw, load))


class _Fit(NamedTuple):
    theta: Floats  # shape (K, P): scale, offset, then the answers in counts
    std: Floats
    cost: float
    scale: Floats


def _fit(blocks: Blocks, factors: list[tuple[Floats, bool]], crept: list[Floats]) -> _Fit:
    """Fit each channel by generalised least squares; the columns are F, 1, H, N and the creep's."""
    channels = blocks.value.shape[1]
    thetas, stds, cost = [], [], 0.0
    for i in range(channels):
        A = np.column_stack(
            [blocks.load[:, i], np.ones(len(blocks.time)), blocks.hysteresis[:, i], blocks.nonlinearity[:, i]]
            + [one[:, i] for one in crept]
        )
        factor, y = factors[i], blocks.value[:, i]
        # Columns of one size; a column of zeros, as of a load that never turned, says nothing.
        size = np.linalg.norm(A, axis=0)
        used = size > 0.0
        WA = cho_solve(factor, A[:, used] / size[used])
        information = (A[:, used] / size[used]).T @ WA
        slope = float(np.polyfit(A[:, 0], y, 1)[0])
        inverse = np.linalg.pinv(information)
        theta, std = np.zeros(A.shape[1]), np.full(A.shape[1], np.inf)
        theta[used] = inverse @ (WA.T @ y) / size[used]
        std[used] = abs(slope) * np.sqrt(np.diagonal(inverse)) / size[used]
        r = y - A @ theta
        cost += 0.5 * float(r @ cho_solve(factor, r)) / slope**2
        thetas.append(theta)
        stds.append(std)
    theta, std = np.array(thetas), np.array(stds)
    return _Fit(theta, std, cost, theta[:, 0])


def _factors(blocks: Blocks, at_rest: AtRest) -> list[tuple[Floats, bool]]:
    """Return the Cholesky factors of the errors of each channel's means by noise and drift, in N^2."""
    t = blocks.time - blocks.time[0]
    walked = np.minimum(t[:, None], t[None])
    found: list[tuple[Floats, bool]] = []
    for i, load in enumerate(blocks.load.T):
        if i and np.array_equal(load, blocks.load[:, i - 1]):
            found.append(found[-1])
            continue
        drift = at_rest.scale.value**2 if at_rest.scale else 0.0
        C = (at_rest.offset.value**2 + drift * np.outer(load, load)) * walked
        C += (at_rest.noise.value**2 / blocks.size + 1e-12 * np.trace(C) / len(t)) * np.eye(len(t))
        found.append(cho_factor(C, lower=True))
    return found


def _response(fit: _Fit, joint: _Fit | None, constant: float, delay: Interval | None) -> Response:
    """Return shares of all channels together: means by their variances."""
    wide = fit if joint is None else joint

    def together(column: int) -> Interval:
        shares, std = fit.theta[:, column] / fit.scale, wide.std[:, column] / np.abs(fit.scale)
        weight = 1.0 / std**2
        if not weight.sum() > 0.0:
            return Interval(0.0, -np.inf, np.inf)
        value, spread = float((weight * shares).sum() / weight.sum()), float(weight.sum() ** -0.5)
        return normal_interval(value, spread)

    bends = zip(fit.theta[:, 3] / fit.scale, wide.std[:, 3] / np.abs(fit.scale), strict=True)
    return Response(
        scale=fit.scale,
        scale_std=wide.std[:, 0],
        offset=fit.theta[:, 1],
        hysteresis=together(2),
        creep=None if joint is None else together(4),
        creep_time=constant,
        nonlinearity=tuple(normal_interval(float(a), float(s)) for a, s in bends),
        delay=delay,
    )


def _delay(time: Floats, raw: Floats, load: Floats) -> Interval | None:
    """Return the mean age of readings, by their distance from a step; ``None`` if no step shows it.

    The area between load and reading after a step of size D is D times the age, whatever filter made it. Rows
    that are not in step with the converter miss half a row of it; ones that are miss none.
    """
    dt = float(np.median(np.diff(time)))
    width = round(WINDOW / dt)
    ages, first = [], []
    for i in range(raw.shape[1]):
        F, y = load[:, i], raw[:, i]
        span = float(np.ptp(F))
        for row in np.flatnonzero(np.abs(np.diff(F)) > LEAST_STEP * span) + 1:
            before, after = slice(row - width, row), slice(row, row + width)
            if row < width or row + width > len(F) or np.ptp(F[before]) > 0.0 or np.ptp(F[after]) > 0.0:
                continue
            start, end = np.nanmedian(y[before]), np.nanmedian(y[row + width // 2 : row + width])
            lacking = (end - y[after][: width // 2]) / (end - start)
            if np.isfinite(lacking).all():
                ages.append(dt * float(lacking.sum()))
                first.append(float(lacking[0]))
    if len(ages) < 3 or np.mean(first) < SHARP:
        return None
    values = np.array(ages)
    half = float(student.ppf(0.5 + SURE / 2.0, len(values) - 1)) * values.std(ddof=1) / np.sqrt(len(values))
    middle = float(values.mean()) + 0.5 * dt
    return Interval(middle, middle - half - 0.5 * dt, middle + half)
