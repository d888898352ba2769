r"""Hysteresis as signals of a linear fit.

The spring element of a sensor lags behind its load, as wide a loop over a large swing as over a small one in
proportion (Prandtl and Ishlinskii); or one as wide over any swing, as a joint with backlash does. Its
reading is the load and a share s of

.. math:: p(x) = \sum_i a_i P_{r_i}(x) - \kappa x, \qquad r_i = X 2^{-i},

with play operators P of half-width :math:`r_i`, of all widths alike or of a narrow one alone, and the largest
amplitude X of the data. The loop shows s, and the rest follows from s: an element with loops in proportion
gives way by s more for each doubling of the swing, so that a small mass added to a heavy limb seems to weigh
more than alone, by s / ln 2. Left out, this makes the limb too light by as much. What is taken off by
:math:`\kappa` leaves p without correlation to x over the data; it only sets the swing at which the matrix
holds, that of the data.

Glue and metal creep besides: after a step they go on giving way for seconds and minutes, by about as much in
each octave of time. Then p is the sum of what loads were by filters of the first order, less
:math:`\kappa x` as well.

Loads may lag, axis by axis, as a spring body does, or the readings of gauges, channel by channel, as glue
does: then p is that of each channel's own load A_c w, and acts on the readings directly.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from surefoot.calibration.imu.static import savitzky_golay
from surefoot.calibration.in_situ.colour import motion_frequency
from surefoot.calibration.in_situ.data import InSituOptions, InSituSet
from surefoot.calibration.in_situ.model import AXES, DIRECT, signals
from surefoot.calibration.in_situ.problem import Problem
from surefoot.calibration.in_situ.solve import (
    Fitted,
    Solution,
    beside_channels,
    beside_loads,
    criterion,
    loop_shares,
    solve,
    transforms,
)

__all__ = ["fit_creep", "fit_loops", "likeliest_loops", "shows_loops"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


_PLAYS = 8
"""The smallest loop that is followed is 2^-8 of the largest swing."""

_NARROW = 7
"""The loop of backlash is 2^-7 of the largest swing: the narrowest but one."""

_PROPORTIONAL, _BACKLASH = np.ones(_PLAYS), 2.0 ** (_NARROW - 1) * np.eye(_PLAYS)[_NARROW - 1]
"""Weights a of the plays, the widest first; a share of one of backlash is as wide as the largest load."""

_CREEPING = np.geomspace(4.0, 128.0, 6)
"""Time constants of creep in s, an octave apart: faster ones look like a clock that is late, slower ones like
a drift."""

_NEARLY = 0.9
"""Share of what creep explains from which on loops are the law. Chosen: of loops with thresholds of ratio 3,
where the law has 2, they explain 0.94 to 0.99 of it, of emulated sensors that creep 0.2 to 0.83."""

_MOST_CREEP = 0.01
"""Share of the load in an octave of time beyond which it is no creep but a fit of something else: load cells
state 0.001 in half an hour, a swing of a few seconds on a robot that balances looked like 0.03 to 0.06."""

_SHARE_STD = 0.05
"""Expected size of the shares; that of an axis that no load reaches stays at zero."""

_LEADS = 0.3
"""A share this far below zero, as a part of the largest, is no hysteresis."""

_STEPS = 3000
"""Steps in which a set's plays are followed, if its limb turns slowly."""

_CUBIC, _PART = 7, 0.1
"""Samples over which loads are smoothed by cubics, if they are no more than this part of a period: noise of
0.1 m/s^2 showed loops in 10 of 12 sound logs without, and in none with."""

_BLOCK = 250
"""Steps whose plays are held at once."""

_ROWS_EACH = 10
"""Rows that a set must have on average for each input of the response: few rows show loops in any noise."""

_ROUNDS = 2
"""Fits, as the loads whose loops these are come from the fit itself."""


_Law = Callable[[Sequence[Matrix]], list[Matrix]]
"""What lags behind the loads of each set, (n_j, a) each."""


def fit_loops(
    sets: Sequence[InSituSet], problem: Problem, solution: Solution, options: InSituOptions
) -> list[Fitted]:
    """Return the problem with loops of loads by each law and with loops of channels, each with its solution.

    Loops of loads are six more parameters, the shares s of the axes, behind the limb's; loops of channels are
    a signal for each channel that acts on the readings directly. None of them where few rows show them. The
    problem and the solution that are given have no loops.
    """
    if not shows_loops(problem):
        return []
    laws = [partial(_play_sums, weights=weights) for weights in (_PROPORTIONAL, _BACKLASH)]
    loads = [_of_loads(sets, problem, solution, options, law) for law in laws]
    return [*loads, _of_channels(sets, problem, solution, options)]


def fit_creep(
    sets: Sequence[InSituSet], problem: Problem, solution: Solution, options: InSituOptions
) -> Fitted | None:
    """Return the same with loads that creep, for sets with times: no guide to a clock, it lags like one."""
    if not shows_loops(problem) or any(data.time is None for data in sets):
        return None
    law = partial(_creeps, steps=[_step(data) for data in sets])
    return _of_loads(sets, problem, solution, options, law, _SHARE_STD / len(_CREEPING))


def shows_loops(problem: Problem) -> bool:
    """Return whether sets have rows enough to show loops."""
    return sum(part.rows for part in problem.sets) >= _ROWS_EACH * problem.inputs * len(problem.sets)


def likeliest_loops(plain: Fitted, loops: Sequence[Fitted], creep: Fitted | None) -> Fitted:
    """Return the likeliest of the problems with loops; the plain one where they explain too little.

    Creep follows loops of another make as well: it must explain clearly more than they do.
    """
    # What leads the load is no hysteresis but two clocks that disagree.
    lagging = [fitted for fitted in loops if _lags(fitted)]
    best = min([plain, *lagging], key=lambda fitted: criterion(*fitted))
    if creep is None or not _lags(creep) or np.max(loop_shares(*creep)) > _MOST_CREEP:
        return best
    before = criterion(*plain)
    explained = before - criterion(*creep)
    return creep if before - criterion(*best) < _NEARLY * explained else best


def _lags(fitted: Fitted) -> bool:
    shares = loop_shares(*fitted)
    return bool(np.max(shares) > 0.0 and np.min(shares) > -_LEADS * np.max(shares))


def _of_loads(
    sets: Sequence[InSituSet],
    plain: Problem,
    solution: Solution,
    options: InSituOptions,
    law: _Law,
    std: float = _SHARE_STD,
) -> Fitted:
    def lags(problem: Problem, solution: Solution) -> list[Matrix]:
        loads = _loads(sets, problem, solution)
        return _at_rows(sets, plain, _out_of_phase(law(loads), loads))

    return beside_loads(plain, solution, lags, std, options)


def _of_channels(
    sets: Sequence[InSituSet], plain: Problem, solution: Solution, options: InSituOptions
) -> Fitted:
    problem = plain
    for _ in range(_ROUNDS):
        loads = [load @ solution.A.T for load in _loads(sets, problem, solution)]
        lags = _out_of_phase(_play_sums(loads, _PROPORTIONAL), loads)
        problem = beside_channels(plain, _at_rows(sets, plain, lags), options)
        solution = solve(problem, [solution.outer])
    return problem, solution


def _stride(data: InSituSet) -> int:
    return max(len(data.raw) // _STEPS, 1)


def _loads(sets: Sequence[InSituSet], problem: Problem, solution: Solution) -> list[Matrix]:
    """Return wrenches that the limb and what was added exert, (n_j, 6) each; the last one is held in gaps.

    Between turning points a play only follows, so that few samples of a slow sweep are enough. They are
    smoothed: plays that follow noise would be signals with less of it, and a loop in nothing but noise.
    """
    loads = []
    for j, data in enumerate(sets):
        u = signals(data, problem.moving, _stride(data))
        whole = np.isfinite(u).all(axis=1)
        latest = np.maximum.accumulate(np.where(whole, np.arange(len(u)), -1))
        latest[latest < 0] = int(np.argmax(whole))
        transform = transforms(problem, solution)[j, :AXES, : u.shape[1]]
        loads.append(_smooth(u[latest]) @ transform.T)
    return loads


def _smooth(u: Matrix) -> Matrix:
    """Return signals as cubics over a few samples, where these are a small part of a turn of the limb."""
    turns = motion_frequency(u[:, DIRECT], 1.0)
    return savitzky_golay(u, _CUBIC) if turns * _CUBIC < _PART and len(u) > _CUBIC else u


def _at_rows(sets: Sequence[InSituSet], problem: Problem, lags: Sequence[Matrix]) -> list[Matrix]:
    """Return lags at the rows of the compressed sets, (m_j, a) each."""
    found = []
    for data, part, lag in zip(sets, problem.sets, lags, strict=True):
        places = _stride(data) * np.arange(len(lag))
        found.append(np.stack([np.interp(part.index, places, one) for one in lag.T], axis=1))
    return found


def _step(data: InSituSet) -> float:
    """Return the time between steps in which a set's loads are followed, in s."""
    return _stride(data) * float(np.median(np.diff(np.asarray(data.time))))


def _play_sums(wrenches: Sequence[Matrix], weights: Vector) -> list[Matrix]:
    """Return the weighted sums of the plays of each axis or channel, the widest first, (n_j, a) each."""
    amplitude = np.max([np.ptp(wrench, axis=0) / 2.0 for wrench in wrenches], axis=0)
    used = weights > 0.0
    slack = amplitude[:, None] * 0.5 ** np.arange(1, _PLAYS + 1)[used]
    longest = max(len(wrench) for wrench in wrenches)
    loads = np.stack([np.pad(w, ((0, longest - len(w)), (0, 0)), mode="edge") for w in wrenches], axis=1)
    play, sums = loads[0][..., None] * np.ones(slack.shape[1]), np.empty_like(loads)
    for first in range(0, longest, _BLOCK):
        block = loads[first : first + _BLOCK, ..., None]
        low, high = block - slack, block + slack
        plays = np.empty_like(low)
        for i in range(len(block)):
            play = np.minimum(np.maximum(play, low[i]), high[i], out=plays[i])
        sums[first : first + _BLOCK] = np.sum(plays * weights[used], axis=-1)
    return [sums[: len(wrench), j] for j, wrench in enumerate(wrenches)]


def _creeps(wrenches: Sequence[Matrix], steps: Sequence[float]) -> list[Matrix]:
    """Return the sums of what loads were by filters of the first order, (n_j, a) each.

    What a set's limb did before is not known: filters begin at the mean of its loads. From the first load
    they would feign a drift.
    """
    found = []
    for wrench, step in zip(wrenches, steps, strict=True):
        kept, mean = np.exp(-step / _CREEPING), wrench.mean(axis=0, keepdims=True)
        at = [lfilter([1.0 - k], [1.0, -k], wrench, axis=0, zi=k * mean)[0] for k in kept]
        found.append(np.sum(at, axis=0))
    return found


def _out_of_phase(lags: Sequence[Matrix], wrenches: Sequence[Matrix]) -> list[Matrix]:
    """Return what lags without what of it goes with the loads of all sets, (n_j, a) each.

    It has no mean over a set: the mean is the offset's.
    """
    loads = [wrench - wrench.mean(axis=0) for wrench in wrenches]
    common = sum(np.sum(lag * load, axis=0) for lag, load in zip(lags, loads, strict=True))
    square = sum(np.sum(load**2, axis=0) for load in loads)
    kappa = common / np.where(square > 0.0, square, 1.0)
    signals = [lag - kappa * wrench for lag, wrench in zip(lags, wrenches, strict=True)]
    return [signal - signal.mean(axis=0) for signal in signals]
