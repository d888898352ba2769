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

Loads may lag, axis by axis, as a spring body does, or the readings of gauges, channel by channel, as glue
does: then p is that of each channel's own load A_c w, and acts on the readings directly.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.linalg import block_diag

from surefoot.calibration.imu.static import savitzky_golay
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.colour import motion_frequency
from surefoot.calibration.in_situ.compress import UNUSED, CompressedSet, with_signals
from surefoot.calibration.in_situ.data import InSituOptions, InSituSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.model import AXES, DIRECT, signals
from surefoot.calibration.in_situ.problem import Problem, whitening
from surefoot.calibration.in_situ.solve import Solution, loop_shares, solve, transforms

__all__ = [
    "about_one_temperature",
    "beside_channels",
    "beside_loads",
    "check_gauges",
    "criterion",
    "drifting",
    "fit_loops",
    "lag_signals",
    "likeliest_loops",
    "shows_loops",
    "with_gains",
]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


_PLAYS = 8
"""The smallest loop that is followed is 2^-8 of the largest swing."""

_NARROW = 7
"""The loop of backlash is 2^-7 of the largest swing: the narrowest but one."""

_PROPORTIONAL, _BACKLASH = np.ones(_PLAYS), 2.0 ** (_NARROW - 1) * np.eye(_PLAYS)[_NARROW - 1]
"""Weights a of the plays, the widest first; a share of one of backlash is as wide as the largest load."""

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


Fitted = tuple[Problem, Solution]


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
    laws = [_of_loads(sets, problem, solution, options, law) for law in (_PROPORTIONAL, _BACKLASH)]
    return [*laws, _of_channels(sets, problem, solution, options)]


def shows_loops(problem: Problem) -> bool:
    """Return whether sets have rows enough to show loops."""
    return sum(part.rows for part in problem.sets) >= _ROWS_EACH * problem.inputs * len(problem.sets)


def likeliest_loops(plain: Fitted, loops: Sequence[Fitted]) -> Fitted:
    """Return the likeliest of the problems with loops; the plain one where they explain too little."""
    # What leads the load is no hysteresis but two clocks that disagree.
    lagging = [fitted for fitted in loops if _lags(loop_shares(*fitted))]
    return min([plain, *lagging], key=lambda fitted: criterion(*fitted))


def _lags(shares: NDArray[np.float64]) -> bool:
    return bool(np.max(shares) > 0.0 and np.min(shares) > -_LEADS * np.max(shares))


def criterion(problem: Problem, solution: Solution) -> float:
    """Return minus twice the log-likelihood, with Schwarz's penalty for what was free to fit (1978)."""
    left = whitened(problem, solution)
    rows = sum(part.rows for part in problem.sets)
    return deviance(problem.sets, left) + float(solution.jacobian.shape[1] * np.log(rows))


def deviance(parts: Sequence[CompressedSet], left: Sequence[Matrix]) -> float:
    """Return minus twice the log-likelihood of sets' rows at the channels' likeliest covariance.

    In the modes of their cosine transform rows are independent, with the power of the sets' colour, and
    channels have one covariance S in all of them: -2 log L = n (k (1 + log 2 pi) + log |S|) + k log |colour|.

    Args:
        parts: The sets, with n rows of k channels in all.
        left: What a fit leaves of them, as :func:`whitened` returns it.
    """
    rows, channels = sum(map(len, left)), left[0].shape[1]
    scatter = sum(one.T @ one for one in left)
    size = np.sqrt(np.maximum(np.diag(scatter), np.finfo(float).tiny))
    _, logdet = np.linalg.slogdet(scatter / np.outer(size, size))
    logdet += 2.0 * np.sum(np.log(size)) - channels * np.log(rows)
    of_colour = channels * sum(part.log_colour for part in parts)
    value = float(rows * (channels * (1.0 + np.log(2.0 * np.pi)) + logdet) + of_colour)
    return value if np.isfinite(value) else np.inf


def whitened(problem: Problem, solution: Solution) -> list[Matrix]:
    """Return what a solution leaves of each set's rows, in the order of time, by its colour, shape (m, k)."""
    found = []
    between = problem.unwhitened(solution.residual)
    for part, one in zip(problem.sets, between, strict=True):
        root = np.sqrt(part.colour.left(part.rows, part.spacing))[:, None]
        modes = dct(part.residual - part.score @ one, norm="ortho", axis=0) / root
        found.append(np.asarray(idct(modes, norm="ortho", axis=0)))
    return found


def _of_loads(
    sets: Sequence[InSituSet], plain: Problem, solution: Solution, options: InSituOptions, law: Vector
) -> tuple[Problem, Solution]:
    def lags(problem: Problem, solution: Solution) -> list[Matrix]:
        return _at_rows(sets, plain, lag_signals(_loads(sets, problem, solution), law))

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


def _plays(wrenches: Sequence[Matrix], slack: Matrix, weights: Vector) -> list[Matrix]:
    """Return the weighted sums of the plays of each axis or channel, (n_j, a) each."""
    longest = max(len(wrench) for wrench in wrenches)
    loads = np.stack([np.pad(w, ((0, longest - len(w)), (0, 0)), mode="edge") for w in wrenches], axis=1)
    play, sums = loads[0][..., None] * np.ones(slack.shape[1]), np.empty_like(loads)
    for first in range(0, longest, _BLOCK):
        block = loads[first : first + _BLOCK, ..., None]
        low, high = block - slack, block + slack
        plays = np.empty_like(low)
        for i in range(len(block)):
            play = np.minimum(np.maximum(play, low[i]), high[i], out=plays[i])
        sums[first : first + _BLOCK] = np.sum(plays * weights, axis=-1)
    return [sums[: len(wrench), j] for j, wrench in enumerate(wrenches)]


def lag_signals(wrenches: Sequence[Matrix], law: Vector = _PROPORTIONAL) -> list[Matrix]:
    """Return p of the loads of each set, axis by axis or channel by channel.

    Args:
        wrenches: In the order of time, without gaps, shape (n_j, a) each.
        law: Weights of the plays, the widest first, shape (8,).

    Returns:
        p in the unit of the loads, shape (n_j, a) each, of zero mean over a set: the mean is the offset's.
    """
    amplitude = np.max([np.ptp(wrench, axis=0) / 2.0 for wrench in wrenches], axis=0)
    slack = amplitude[:, None] * 0.5 ** np.arange(1, _PLAYS + 1)
    used = law > 0.0
    lags = _plays(wrenches, slack[:, used], law[used])
    loads = [wrench - wrench.mean(axis=0) for wrench in wrenches]
    common = sum(np.sum(lag * load, axis=0) for lag, load in zip(lags, loads, strict=True))
    square = sum(np.sum(load**2, axis=0) for load in loads)
    kappa = common / np.where(square > 0.0, square, 1.0)
    signals = [lag - kappa * wrench for lag, wrench in zip(lags, wrenches, strict=True)]
    return [signal - signal.mean(axis=0) for signal in signals]


_GAIN_STD = 0.005
"""Expected size of the gains in 1/K; that of an axis that no load reaches stays at zero."""


def about_one_temperature(
    sets: tuple[InSituSet, ...],
) -> tuple[tuple[InSituSet, ...], float | None, list[Finding]]:
    """Return sets with temperatures less their mean, the mean in their unit, and what is to be said.

    Temperatures that show no effect are left out; the mean is None then.
    """
    given = [data.temperature for data in sets if data.temperature is not None]
    if not given:
        return sets, None, []
    words, mean = "", float(np.nanmean(np.concatenate(given)))
    if len(given) < len(sets):
        missing = ", ".join(f"'{data.name}'" for data in sets if data.temperature is None)
        words = f"{missing} has no temperature, so that of the others was left out."
    elif (within := float(np.sqrt(np.mean([np.nanvar(one) for one in given])))) < limits.WARMING:
        words = (
            f"The temperature varies by {within:.2g} K within sets, too little to show its effect "
            f"({limits.WARMING} K): it was left out."
        )
    elif (left := _left_by(sets, lambda data: data.gravity)) < limits.NOT_GRAVITY:
        words = (
            f"The temperature went with gravity: what gravity explains leaves {left:.0%} of its spread. It "
            "was left out; let the sensor warm or cool while the limb turns several times."
        )
    if words:
        left_out = Finding("temperature", words, refuses=False)
        return tuple(replace(data, temperature=None) for data in sets), None, [left_out]
    centred = [replace(data, temperature=one - mean) for data, one in zip(sets, given, strict=True)]
    return tuple(centred), mean, _with_time(sets)


def _with_time(sets: Sequence[InSituSet]) -> list[Finding]:
    """Return a warning if the temperature rose, or fell, with time in all sets alike."""
    if any(data.time is None for data in sets):
        return []
    left = _left_by(sets, lambda data: np.asarray(data.time)[:, None], common=True)
    if left >= limits.NOT_GRAVITY:
        return []
    words = (
        f"The temperature went with time: one slope leaves {left:.0%} of its spread, so that its coefficient "
        "may be that of a drift (matrix and limb do not lean on which it is). Let the sensor warm in one set "
        "and cool in another."
    )
    return [Finding("temperature", words, refuses=False)]


def _left_by(
    sets: Sequence[InSituSet], columns: Callable[[InSituSet], Matrix], common: bool = False
) -> float:
    """Return the share of the temperature's spread within sets that is not linear in columns.

    ``common`` is for one slope in all sets rather than one in each.
    """
    parts = []
    for data in sets:
        assert data.temperature is not None
        together = np.column_stack([data.temperature, columns(data)])
        together = together[np.isfinite(together).all(axis=1)]
        parts.append(together - together.mean(axis=0))
    left = 0.0
    for part in [np.concatenate(parts)] if common else parts:
        warmth, of = part[:, 0], part[:, 1:]
        left += float(np.sum((warmth - of @ np.linalg.lstsq(of, warmth, rcond=None)[0]) ** 2))
    return float(np.sqrt(left / sum(float(np.sum(part[:, 0] ** 2)) for part in parts)))


def drifting(parts: Sequence[CompressedSet]) -> Finding | None:
    """Return that an offset drifted as the temperature changed, and the cure; None if nothing shows it.

    A drift that went with the temperature of a set hides in that set's own coefficient: no residual shows it,
    but the coefficients of sets disagree. The temperature is the last signal of the sets.
    """
    root = whitening(parts)
    own = np.array([part.response[:, -1] for part in parts])
    gram = np.array([part.gram[-1, -1] for part in parts])
    square = np.array([part.uu[-1, -1] ** 2 for part in parts])
    worth = np.where(gram > UNUSED, square / np.maximum(gram, UNUSED), 0.0)
    freedom = (np.count_nonzero(worth) - 1) * len(root)
    if freedom <= 0:
        return None
    off = (own - worth @ own / np.sum(worth)) @ root.T
    if worth @ np.sum(off**2, axis=1) < limits.COEFFICIENTS**2 * freedom:
        return None
    channel = int(np.argmax(np.ptp(own, axis=0)))
    low, high = np.min(own[:, channel]), np.max(own[:, channel])
    return Finding(
        "drift by temperature",
        "The offset drifted as the temperature changed: single sets show coefficients of channel "
        f"{channel} from {low:.3g} to {high:.3g} counts/K.",
        "Let the sensor warm and cool within each set, or leave the temperature out: a drift is followed "
        "without it.",
        refuses=False,
    )


def with_gains(
    problem: Problem, solution: Solution, options: InSituOptions
) -> tuple[Problem, Solution] | None:
    """Return the problem with gains of the axes by temperature, and its solution; None if not worth it.

    Args:
        problem: With the temperature as a signal, without hysteresis.
        solution: Its solution.
        options: Of the fit.
    """

    def warm_loads(at: Problem, found: Solution) -> list[Matrix]:
        return _warm_loads(problem, transforms(at, found))

    fitted, found = beside_loads(problem, solution, warm_loads, _GAIN_STD, options)
    if criterion(fitted, found) >= criterion(problem, solution):
        return None
    return replace(fitted, gains=AXES), found


def check_gauges(problem: Problem, solution: Solution, options: InSituOptions) -> list[Finding]:
    """Return a warning where gains go with the temperature otherwise than axis by axis.

    Args:
        problem: With the temperature as a signal; with gains of the axes and hysteresis if they are worth it.
        solution: Its solution.
        options: Of the fit.
    """
    warm = [load @ solution.A.T for load in _warm_loads(problem, transforms(problem, solution))]
    freer = beside_channels(problem, warm, options)
    if criterion(freer, solve(freer, [solution.outer])) >= criterion(problem, solution):
        return []
    words = (
        "The gains of single channels follow the temperature, each its own way, where the fit has one an "
        "axis: its matrix is less sure than it says. Let the sensor warm up before it is calibrated."
    )
    return [Finding("temperature", words, refuses=False)]


def _warm_loads(problem: Problem, T: NDArray[np.float64]) -> list[Matrix]:
    """Return the temperature times the load by each set's transform at the rows of each set, (m, 6) each."""
    inputs, found = problem.basis.shape[2], []
    for part, transform in zip(problem.sets, T[:, :AXES, :inputs], strict=True):
        signals = part.source.signals
        kelvin = signals[:, inputs, None]  # the first signal behind those of the loads
        found.append(kelvin * (signals[:, :inputs] @ transform.T))
    return found
