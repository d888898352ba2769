r"""Hysteresis as signals of a linear fit.

The spring element of a sensor lags behind its load, as wide a loop over a large swing as over a small one in
proportion (Prandtl and Ishlinskii): its reading is the load and a share s of

.. math:: p(x) = \sum_i P_{r_i}(x) - \kappa x, \qquad r_i = X 2^{-i},

with play operators P of half-width :math:`r_i` and the largest amplitude X of the data. The loop shows s,
and the rest follows from s: such an element gives way by s more for each doubling of the swing, so that a
small mass added to a heavy limb seems to weigh more than alone, by s / ln 2. Left out, this makes the limb
too light by as much. What is taken off by :math:`\kappa` leaves p without correlation to x over the data;
it only sets the swing at which the matrix holds, that of the data.

Loads may lag, axis by axis, as a spring body does, or the readings of gauges, channel by channel, as glue
does: then p is that of each channel's own load A_c w, and acts on the readings directly.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from surefoot.calibration.in_situ.compress import with_signals
from surefoot.calibration.in_situ.covariance import whitening
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.model import AXES, signals
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.in_situ.solve import Problem, Solution, loop_shares, solve, transforms

__all__ = ["beside_channels", "beside_loads", "criterion", "lag_signals", "with_hysteresis"]

Matrix = NDArray[np.float64]

_PLAYS = 8
"""The smallest loop that is followed is 2^-8 of the largest swing."""

_SHARE_STD = 0.05
"""Expected size of the shares; that of an axis that no load reaches stays at zero."""

_LEADS = 0.3
"""A share this far below zero, as a part of the largest, is no hysteresis."""

_STEPS = 3000
"""Steps in which a set's plays are followed, if its limb turns slowly."""

_BLOCK = 250
"""Steps whose plays are held at once."""

_ROWS_EACH = 10
"""Rows that a set must have on average for each input of the response: few rows show loops in any noise."""

_ROUNDS = 2
"""Fits, as the loads whose loops these are come from the fit itself."""


def with_hysteresis(
    sets: Sequence[InSituSet], problem: Problem, solution: Solution, options: InSituOptions
) -> tuple[Problem, Solution] | None:
    """Return the problem with loops of loads or of channels, whichever is likelier, and its solution.

    Loops of loads are six more parameters, the shares s of the axes, behind the limb's; loops of channels are
    a signal for each channel that acts on the readings directly. None if loops explain too little. The
    problem and the solution that are given have no loops.
    """
    if sum(part.rows for part in problem.sets) < _ROWS_EACH * problem.inputs * len(problem.sets):
        return None
    plain = criterion(problem, solution)
    kinds = (_of_loads(sets, problem, solution, options), _of_channels(sets, problem, solution, options))
    # What leads the load is no hysteresis but two clocks that disagree.
    lagging = [fitted for fitted in kinds if _lags(loop_shares(*fitted))]
    best = min(lagging, key=lambda fitted: criterion(*fitted), default=None)
    return best if best is not None and criterion(*best) < plain else None


def _lags(shares: NDArray[np.float64]) -> bool:
    return bool(np.max(shares) > 0.0 and np.min(shares) > -_LEADS * np.max(shares))


def criterion(problem: Problem, solution: Solution) -> float:
    """Return minus twice the log-likelihood, with Schwarz's penalty for what was free to fit (1978).

    That is the solution's unknowns alone: what the sets' own maps leave and what the solution leaves of
    these maps add up to what it leaves of the readings.
    """
    rows = sum(part.rows for part in problem.sets)
    between = solution.residual @ np.linalg.inv(problem.whitening).T
    scatter = sum(part.scatter for part in problem.sets) + sum(one.T @ one for one in between)
    size = np.sqrt(np.diag(scatter))
    _, logdet = np.linalg.slogdet(scatter / np.outer(size, size))
    free = solution.jacobian.shape[1]
    of_colour = len(size) * sum(part.log_colour for part in problem.sets)
    return float(rows * (logdet + 2.0 * np.sum(np.log(size))) + of_colour + free * np.log(rows))


def _of_loads(
    sets: Sequence[InSituSet], plain: Problem, solution: Solution, options: InSituOptions
) -> tuple[Problem, Solution]:
    def lags(problem: Problem, solution: Solution) -> list[Matrix]:
        return _at_rows(sets, plain, lag_signals(_loads(sets, problem, solution)))

    return beside_loads(plain, solution, lags, _SHARE_STD, options)


def beside_loads(
    plain: Problem,
    solution: Solution,
    columns: Callable[[Problem, Solution], list[Matrix]],
    std: float,
    options: InSituOptions,
) -> tuple[Problem, Solution]:
    """Return the problem with signals that follow from the loads, and its solution.

    Each is one more parameter behind the limb's: what an axis reads of its signal.

    Args:
        plain: The problem without.
        solution: Its solution.
        columns: Returns the signals of the axes at the rows of each set, shape (m, 6), by a solution.
        std: Expected size of the parameters.
        options: Of the fit.
    """
    limb_root = block_diag(plain.limb_root, np.eye(AXES) / std)
    p, _, s = plain.basis.shape
    basis = np.zeros((p + AXES, AXES, s + AXES))
    basis[:p, :, :s] = plain.basis
    # Each axis's signal, times its parameter, adds to the wrench along that axis.
    basis[p:, :, s:] = np.eye(AXES)[:, :, None] * np.eye(AXES)[:, None, :]
    problem = plain
    start = np.concatenate([solution.limb, np.zeros(AXES), solution.outer[plain.parameters :]])
    for _ in range(_ROUNDS):
        parts = with_signals(plain.sets, columns(problem, solution), options, first=s)
        problem = replace(
            plain,
            sets=parts,
            added=np.pad(plain.added, ((0, 0), (0, AXES))),
            whitening=whitening(parts),
            basis=basis,
            limb=np.pad(plain.limb, (0, AXES)),
            limb_root=limb_root,
        )
        solution = solve(problem, [start])
        start = solution.outer
    return problem, solution


def _of_channels(
    sets: Sequence[InSituSet], plain: Problem, solution: Solution, options: InSituOptions
) -> tuple[Problem, Solution]:
    problem = plain
    for _ in range(_ROUNDS):
        lags = lag_signals([load @ solution.A.T for load in _loads(sets, problem, solution)])
        problem = beside_channels(plain, _at_rows(sets, plain, lags), options)
        solution = solve(problem, [solution.outer])
    return problem, solution


def beside_channels(plain: Problem, columns: Sequence[Matrix], options: InSituOptions) -> Problem:
    """Return the problem with signals that act on the readings directly, at the rows of each set, (m, q)."""
    parts = with_signals(plain.sets, columns, options)
    return replace(
        plain,
        sets=parts,
        channel_lags=plain.channel_lags + columns[0].shape[1],
        whitening=whitening(parts),
    )


def _stride(data: InSituSet) -> int:
    return max(len(data.raw) // _STEPS, 1)


def _loads(sets: Sequence[InSituSet], problem: Problem, solution: Solution) -> list[Matrix]:
    """Return wrenches that the limb and what was added exert, (n_j, 6) each; the last one is held in gaps.

    Between turning points a play only follows, so that few samples of a slow sweep are enough.
    """
    loads = []
    for j, data in enumerate(sets):
        u = signals(data, problem.moving, _stride(data))
        whole = np.isfinite(u).all(axis=1)
        latest = np.maximum.accumulate(np.where(whole, np.arange(len(u)), -1))
        latest[latest < 0] = int(np.argmax(whole))
        transform = transforms(problem, solution)[j, :AXES, : u.shape[1]]
        loads.append(u[latest] @ transform.T)
    return loads


def _at_rows(sets: Sequence[InSituSet], problem: Problem, lags: Sequence[Matrix]) -> list[Matrix]:
    """Return lags at the rows of the compressed sets, (m_j, a) each."""
    found = []
    for data, part, lag in zip(sets, problem.sets, lags, strict=True):
        places = _stride(data) * np.arange(len(lag))
        found.append(np.stack([np.interp(part.index, places, one) for one in lag.T], axis=1))
    return found


def _plays(wrenches: Sequence[Matrix], slack: Matrix) -> list[Matrix]:
    """Return the sums of the plays of each axis or channel, (n_j, a) each."""
    longest = max(len(wrench) for wrench in wrenches)
    loads = np.stack([np.pad(w, ((0, longest - len(w)), (0, 0)), mode="edge") for w in wrenches], axis=1)
    play, sums = loads[0][..., None] * np.ones(slack.shape[1]), np.empty_like(loads)
    for first in range(0, longest, _BLOCK):
        block = loads[first : first + _BLOCK, ..., None]
        low, high = block - slack, block + slack
        plays = np.empty_like(low)
        for i in range(len(block)):
            play = np.minimum(np.maximum(play, low[i]), high[i], out=plays[i])
        sums[first : first + _BLOCK] = plays.sum(axis=-1)
    return [sums[: len(wrench), j] for j, wrench in enumerate(wrenches)]


def lag_signals(wrenches: Sequence[Matrix]) -> list[Matrix]:
    """Return p of the loads of each set, axis by axis or channel by channel.

    Args:
        wrenches: In the order of time, without gaps, shape (n_j, a) each.

    Returns:
        p in the unit of the loads, shape (n_j, a) each, of zero mean over a set: the mean is the offset's.
    """
    amplitude = np.max([np.ptp(wrench, axis=0) / 2.0 for wrench in wrenches], axis=0)
    slack = amplitude[:, None] * 0.5 ** np.arange(1, _PLAYS + 1)
    lags = _plays(wrenches, slack)
    loads = [wrench - wrench.mean(axis=0) for wrench in wrenches]
    common = sum(np.sum(lag * load, axis=0) for lag, load in zip(lags, loads, strict=True))
    square = sum(np.sum(load**2, axis=0) for load in loads)
    kappa = common / np.where(square > 0.0, square, 1.0)
    signals = [lag - kappa * wrench for lag, wrench in zip(lags, wrenches, strict=True)]
    return [signal - signal.mean(axis=0) for signal in signals]
