r"""Hysteresis of a sensor, as a signal of the linear fit.

The spring element of a sensor lags behind its load x. Its loop is as wide over a large swing as over a small
one in proportion (Prandtl and Ishlinskii). Its reading is the load and a share s of

.. math:: p(x) = \sum_i P_{r_i}(x) - \kappa x, \qquad r_i = X 2^{-i},

with play operators P of half-width :math:`r_i` and the largest amplitude X of the data. The term in
:math:`\kappa` leaves p without correlation to x, so that the response A of the fit is the one at the swing of
the data. The lagging signal is computed from the loads of the fit without hysteresis.

**The gain depends on the swing.** An element with loops in proportion gives way by s more for each doubling
of the swing. At the ends of a cycle of amplitude a it reads

.. math:: g(a) = 1 + s \Big( \sum_{r_i < a} (1 - r_i / a) - \kappa \Big)

times what A says. A limb that turns swings each axis differently: the vertical force of a foot of 0.6 kg by
3.7 N about 10 N, its horizontal forces by 7 N. Contact loads come from any direction, so the matrix of the
answer holds at one amplitude of forces and one of torques, :func:`reference_amplitude`. The offset is the
reading without load: the load is taken to have grown from zero. For forces of a foot with 1 % hysteresis, the
matrix at the swings of the data was 1.7 % off, and this one is 0.3 % off.
"""

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import NamedTuple

import numpy as np

from surefoot.calibration.imu.static import savitzky_golay
from surefoot.calibration.in_situ.covariance import share_deviations
from surefoot.calibration.in_situ.data import InSituSet, Matrix, Vector
from surefoot.calibration.in_situ.model import DIRECT, signals
from surefoot.calibration.in_situ.solver.colour import motion_frequency
from surefoot.calibration.in_situ.solver.problem import Problem
from surefoot.calibration.in_situ.solver.solve import Solution, beside_loads, criterion, follow

_HALF_WIDTHS = 2.0 ** -np.arange(1.0, 9.0)  # half-widths of the plays, as shares of the largest amplitude
_ALL = np.concatenate([2.0 ** np.arange(12.0), _HALF_WIDTHS])  # with those that are wider than the data

SHARE_STD = 0.05  # expected size of the shares; that of an axis that no load reaches stays at zero

_LEADS, _CHANCE = 0.3, 3.0
"""A share this far below zero, as a part of the largest and in deviations, is no hysteresis. Without the
second, the weakest load of a foot ruled hysteresis out at 1.4 deviations."""

_STEPS = 1500  # steps in which the plays of a set are followed, if its limb turns slowly

_CUBIC, _PART = 7, 0.1
"""Samples over which loads are smoothed by cubics, if they are no more than this part of a period: noise of
0.1 m/s^2 showed loops in 10 of 12 sound logs without smoothing, and in none with it."""

_ROWS_EACH = 10
"""Rows that a set must have on average for each input of the response: few rows show loops in any noise."""


class Loops(NamedTuple):
    """Fits with hysteresis and without."""

    best: Solution  # the fit with hysteresis if that is worth its unknowns, else the plain one
    lagging: Solution  # the fit with hysteresis, worth it or not; the plain one if few rows show loops


def fit_hysteresis(sets: Sequence[InSituSet], plain: Solution) -> Loops:
    """Fit hysteresis to sets with times.

    A signal that leads the load is not hysteresis but two clocks that disagree.
    """
    lagging = lag_loads(sets, plain) if shows_loops(plain.problem) else plain
    worth = lagging is not plain and _lags(lagging) and criterion(lagging) < criterion(plain)
    return Loops(lagging if worth else plain, lagging)


def lag_loads(sets: Sequence[InSituSet], plain: Solution) -> Solution:
    """Return the fit with loops of the loads; the plain one if sets that contradict each other allow none.

    A set begins in the middle of all loops, or behind a load that grew from zero, whichever is likelier.
    """
    paths, found = [_path(data, plain.problem.moving) for data in sets], []
    for grown in (False, True):
        with suppress(np.linalg.LinAlgError):
            found.append(follow(partial(_beside, plain.problem, paths, grown), plain, 1))
    return min(found, key=criterion, default=plain)


def shows_loops(problem: Problem) -> bool:
    """Return whether sets have rows enough to show loops."""
    return sum(part.rows for part in problem.sets) >= _ROWS_EACH * problem.inputs * len(problem.sets)


def _lags(fit: Solution) -> bool:
    """Return whether readings lag behind loads: no share leads by more than chance."""
    leads = np.maximum(_LEADS * np.max(fit.shares), _CHANCE * share_deviations(fit))
    return bool(np.max(fit.shares) > 0.0 and np.all(fit.shares > -leads))


def _beside(plain: Problem, paths: Sequence[tuple[Matrix, int]], grown: bool, fit: Solution) -> Problem:
    """Return the problem with one more signal for each axis: the lag of its load by a fit."""
    loads = [u @ T[:, : u.shape[1]].T for (u, _), T in zip(paths, fit.loads, strict=True)]
    lags = _plays(loads, _largest(loads)[:, None] * _HALF_WIDTHS, grown)
    kappa = _in_phase(lags, loads)
    rows = []
    for lag, load, part, (_, stride) in zip(lags, loads, plain.sets, paths, strict=True):
        signal = lag - kappa * load
        # The mean over a set belongs to the offset.
        signal = signal - signal.mean(axis=0)
        places = stride * np.arange(len(lag))
        rows.append(np.stack([np.interp(part.source.places, places, one) for one in signal.T], axis=1))
    return beside_loads(plain, rows, SHARE_STD)


def _path(data: InSituSet, moving: bool) -> tuple[Matrix, int]:
    """Return every so many signals, (n, s), and the number of samples between; gaps repeat the last one.

    They are smoothed where a few samples are a small part of a turn of the limb: plays that follow noise
    would be signals with less of it, and a loop in nothing but noise.
    """
    stride = max(len(data.raw) // _STEPS, 1)
    u = signals(data, moving, stride)
    whole = np.isfinite(u).all(axis=1)
    latest = np.maximum.accumulate(np.where(whole, np.arange(len(u)), -1))
    latest[latest < 0] = int(np.argmax(whole))
    u = u[latest]
    return (savitzky_golay(u, _CUBIC) if turns_slowly(u[:, DIRECT]) else u), stride


def turns_slowly(gravity: Matrix) -> bool:
    """Return whether a few samples of gravity, (n, 3), are a small part of a turn of the limb."""
    return len(gravity) > _CUBIC and motion_frequency(gravity, 1.0) * _CUBIC < _PART


def _plays(loads: Sequence[Matrix], slack: Matrix, grown: bool = False) -> list[Matrix]:
    """Return the sums of the plays of each axis, (n_j, 6) each, by their half-widths, shape (6, p).

    Each set begins in the middle of all loops, or behind a load that has ``grown`` from zero.
    """
    longest = max(len(load) for load in loads)
    # All sets at once; the shorter ones rest at their ends.
    every = np.stack([np.pad(one, ((0, longest - len(one)), (0, 0)), mode="edge") for one in loads], axis=1)
    first, sums = every[0][..., None], np.empty_like(every)
    play = np.clip(0.0 if grown else first, first - slack, first + slack)
    for i, load in enumerate(every[..., None]):
        play = np.minimum(np.maximum(play, load - slack), load + slack)
        sums[i] = play.sum(axis=-1)
    return [sums[: len(load), j] for j, load in enumerate(loads)]


def _largest(loads: Sequence[Matrix]) -> Vector:
    """Return X, half of the widest swing of each axis, shape (6,)."""
    return np.asarray(np.max([np.ptp(load, axis=0) for load in loads], axis=0) / 2.0)


def _in_phase(lags: Sequence[Matrix], loads: Sequence[Matrix]) -> Vector:
    """Return kappa of each axis over all sets, shape (6,)."""
    centred = [load - load.mean(axis=0) for load in loads]
    common = sum(np.sum(lag * load, axis=0) for lag, load in zip(lags, centred, strict=True))
    square = sum(np.sum(load**2, axis=0) for load in centred)
    return np.asarray(common / np.where(square > 0.0, square, 1.0))


def reference_amplitude(loads: Sequence[Matrix]) -> Vector:
    """Return the amplitudes at which the matrix of an answer holds, in N and N m, shape (6,).

    They are the geometric means of the largest forces and of the largest torques of the three axes, of loads
    (n_j, 6) of all sets.
    """
    reach = np.max([np.max(np.abs(load), axis=0) for load in loads], axis=0).reshape(2, 3)
    reach = np.maximum(reach, np.finfo(float).tiny)
    return np.repeat(np.exp(np.mean(np.log(reach), axis=1)), 3)


class Gains(NamedTuple):
    """What hysteresis adds to the fitted response."""

    amplitude: Vector  # in N and N m, of cycles at whose ends the matrix of the answer holds, shape (6,)
    matrix: Vector  # what the axes then read, over what the fitted response says, shape (6,)
    stored: Matrix  # mean wrench that each set reads by loads that grew from zero, beside A w, shape (J, 6)


def gains_of(sets: Sequence[InSituSet], solution: Solution) -> Gains | None:
    """Return the gains by which hysteresis changes the response of a fit, or None without hysteresis."""
    if not solution.problem.hysteresis:
        return None
    paths = [_path(data, solution.problem.moving)[0] for data in sets]
    loads = [u @ T[:, : u.shape[1]].T for u, T in zip(paths, solution.loads, strict=True)]
    amplitude, shares = reference_amplitude(loads), solution.shares
    # A swing that is too small to follow counts as one.
    widest = np.maximum(_largest(loads), _HALF_WIDTHS[-1] * amplitude)[:, None]
    kappa, slack = _in_phase(_plays(loads, widest * _HALF_WIDTHS), loads), widest * _ALL
    opened = np.sum(np.maximum(1.0 - slack / amplitude[:, None], 0.0), axis=1)
    plays = _plays(loads, slack, grown=True)
    stored = [shares * (play - kappa * load).mean(axis=0) for play, load in zip(plays, loads, strict=True)]
    return Gains(amplitude, 1.0 + shares * (opened - kappa), np.array(stored))
