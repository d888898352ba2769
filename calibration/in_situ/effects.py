r"""Effects of a sensor beside its response, as signals of a linear fit: hysteresis and temperature.

**Hysteresis.** The spring element of a sensor lags behind its load, as wide a loop over a large swing as over
a small one in proportion (Prandtl and Ishlinskii); or one as wide over any swing, as a joint with backlash
does. Its reading is the load and a share s of

.. math:: p(x) = \sum_i P_{r_i}(x) - \kappa x, \qquad r_i = X 2^{-i},

with play operators P of half-width :math:`r_i`, and the largest amplitude X of the data; for backlash
:math:`p(x) = (P_r(x) - x) / s` with the one width that the share itself says, :math:`r = X s / 2`. The
loop shows s, and the rest follows from s: an element with loops in proportion gives way by s more for each
doubling of the swing, so that a small mass added to a heavy limb seems to weigh more than alone, by s / ln 2.
Left out, this makes the limb too light by as much. The term in :math:`\kappa` leaves p without correlation to
x over the data; it only sets the swing at which the matrix holds, that of the data. By backlash the matrix
holds for all that moves: taken in phase as well, a joint of 1 % made gains 0.4 % too small.

Glue and metal creep besides: after a step they go on giving way for seconds and minutes, by about as much in
each octave of time. Then p is the sum of the past loads by filters of the first order, less :math:`\kappa x`.

The lagging signal follows from the fit's own loads, so that a fit is made again until it settles. Backlash is
narrow: an error of the limb's first moment moves the times at which a torque turns by as much as it is wide.
How it moves them is part of the fit (:func:`_turn`): without that, a limb of 5 kg beside backlash of 1 % came
out up to 1.4 % off, at a squared error of 6 times the covariance (NEES).

Loads may lag, axis by axis, as a spring body does, or the readings of gauges, channel by channel, as glue
does: then p is that of each channel's own load A_c w, and acts on the readings directly.

**Temperature** acts on the readings and, times the load of each axis, on the gains, where it is worth it.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from surefoot.calibration.imu.static import savitzky_golay
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.covariance import share_deviations
from surefoot.calibration.in_situ.data import InSituSet, Matrix, Vector
from surefoot.calibration.in_situ.model import AXES, DIRECT, MASS, MOMENT, signals
from surefoot.calibration.in_situ.solver.colour import motion_frequency
from surefoot.calibration.in_situ.solver.problem import CREEPING, Law, Problem
from surefoot.calibration.in_situ.solver.solve import (
    Solution,
    beside_channels,
    beside_loads,
    criterion,
    follow,
)
from surefoot.calibration.results import Finding

_HALF_WIDTHS = 2.0 ** -np.arange(1.0, 9.0)  # half-widths of the plays, as shares of the largest amplitude
_NARROW = _HALF_WIDTHS[-2]  # that from which the search for backlash begins

_NEARLY = 0.9
"""Share of creep's gain from which on loops are the law. Chosen: of loops with thresholds of ratio 3,
where the law has 2, they explain 0.94 to 0.99 of it, of emulated sensors that creep 0.2 to 0.83."""

_MOST_CREEP = 0.01
"""Share of the load in an octave of time beyond which it is no creep but a fit of something else: load cells
state 0.001 in half an hour, a swing of a few seconds on a robot that balances looked like 0.03 to 0.06."""

_SHARE_STD = 0.05  # expected size of the shares; that of an axis that no load reaches stays at zero

_LEADS, _CHANCE = 0.3, 3.0
"""A share this far below zero, as a part of the largest and in deviations, is no hysteresis. Without the
second, the weakest load of a foot that crept ruled creep out at 1.4 deviations, and another law was too
sure."""

_STEPS, _BLOCK = 1500, 250
"""Steps in which a set's plays are followed, if its limb turns slowly, and those that are held at once."""

_CUBIC, _PART = 7, 0.1
"""Samples over which loads are smoothed by cubics, if they are no more than this part of a period: noise of
0.1 m/s^2 showed loops in 10 of 12 sound logs without, and in none with."""

_ROWS_EACH = 10
"""Rows that a set must have on average for each input of the response: few rows show loops in any noise."""

_REFINED, _SETTLED = 10, 1.0
"""Fits by the likeliest law at most, as the loads that lag come from the fit itself, until they change by so
many nats."""

_STEP = 1e-6  # angle in rad by which a first moment is turned to see its effect on backlash


def fit_hysteresis(sets: Sequence[InSituSet], plain: Solution) -> tuple[Solution, list[Solution]]:
    """Fit hysteresis by each law to sets with times; none where few rows show it.

    Returns the likeliest fit, the plain one where no law explains enough, and the fits with loops, worth it
    or not: a late clock is judged beside them.
    """
    if not shows_loops(plain.problem):
        return plain, [plain]
    middle = _Motion.of(sets, plain.problem)
    begins = [(at, _try(at.lag_loads, plain, 1)) for at in (middle._replace(behind=True), middle)]
    at, of_loads = min(begins, key=lambda one: np.inf if one[1] is None else criterion(one[1]))
    loops = {at.lag_loads: of_loads} if of_loads else {}
    laws = {at.lag_with_backlash: 2, at.lag_channels: 1}
    loops |= {make: fit for make, rounds in laws.items() if (fit := _try(make, plain, rounds))}
    # A signal that leads the load is no hysteresis but two clocks that disagree.
    lagging = {make: fit for make, fit in loops.items() if _lags(fit)}
    make = min(lagging, key=lambda one: criterion(lagging[one]), default=None)
    best = plain if make is None or criterion(lagging[make]) >= criterion(plain) else lagging[make]
    creep = _try(at.lag_by_creep, plain, 1)
    # Creep follows loops of another make too: it must explain clearly more than those from the middle.
    if creep is not None and _lags(creep) and np.max(creep.shares) <= _MOST_CREEP:
        before, after, alike = (criterion(one) for one in (plain, creep, begins[1][1] or plain))
        if after < criterion(best) and before - alike < _NEARLY * (before - after):
            make, best = at.lag_by_creep, creep
    if make is not None and best is not plain:
        best = _refine(best, make)
    return best, list(loops.values()) or [plain]


def lag_loads(sets: Sequence[InSituSet], plain: Solution) -> Solution:
    """Return the fit with loops in proportion to the loads; the plain one where that leads nowhere.

    Sets that contradict each other do not say how their loops begin.
    """
    return _try(_Motion.of(sets, plain.problem).lag_loads, plain, 1) or plain


def _try(make: Callable[[Solution], Problem], fit: Solution, rounds: int) -> Solution | None:
    """Fit a law; None where that leads nowhere, as where sets contradict each other."""
    with suppress(np.linalg.LinAlgError):
        return follow(make, fit, rounds)
    return None


def _refine(fit: Solution, make: Callable[[Solution], Problem]) -> Solution:
    """Follow the loads until the fit settles; the likeliest on the way, as a step may be too long."""
    best, lowest, last = fit, criterion(fit), np.inf
    for _ in range(_REFINED):
        finer = _try(make, fit, 1)
        if finer is None:
            break
        fit, value = finer, criterion(finer)
        if value < lowest:
            best, lowest = fit, value
        if abs(value - last) < 2.0 * _SETTLED:
            break
        last = value
    return best


def shows_loops(problem: Problem) -> bool:
    """Return whether sets have rows enough to show loops."""
    return sum(part.rows for part in problem.sets) >= _ROWS_EACH * problem.inputs * len(problem.sets)


def _lags(fit: Solution) -> bool:
    """Return whether readings lag behind loads: no share leads by more than chance."""
    leads = np.maximum(_LEADS * np.max(fit.shares), _CHANCE * share_deviations(fit))
    return bool(np.max(fit.shares) > 0.0 and np.all(fit.shares > -leads))


class _Motion(NamedTuple):
    """Steps in which the loads of sets are followed, and the problems with lags behind these loads."""

    plain: Problem
    signals: list[Matrix]  # of each set, smoothed, (n_j, s)
    strides: list[int]  # samples in a step
    steps: list[float]  # time of a step in s
    behind: bool = False
    """Whether sets begin behind a load that came from nothing, rather than in the middle of a loop."""

    @classmethod
    def of(cls, sets: Sequence[InSituSet], plain: Problem) -> "_Motion":
        """Take so many steps that a play, which only follows between turning points, is seen."""
        strides = [max(len(data.raw) // _STEPS, 1) for data in sets]
        times = [float(np.median(np.diff(np.asarray(data.time)))) for data in sets]
        paths = [_path(data, plain.moving, stride) for data, stride in zip(sets, strides, strict=True)]
        return cls(plain, paths, strides, [n * dt for n, dt in zip(strides, times, strict=True)])

    def loads(self, fit: Solution) -> list[Matrix]:
        """Return wrenches of the limb and the added mass by a fit, (n_j, 6) each."""
        return [u @ T[:, : u.shape[1]].T for u, T in zip(self.signals, fit.loads, strict=True)]

    def rows(self, lags: Sequence[Matrix]) -> list[Matrix]:
        """Return lags at the rows of the compressed sets, (m_j, a) each."""
        found = []
        for stride, part, lag in zip(self.strides, self.plain.sets, lags, strict=True):
            places = stride * np.arange(len(lag))
            found.append(np.stack([np.interp(part.source.places, places, one) for one in lag.T], axis=1))
        return found

    def plays(
        self, loads: Sequence[Matrix], half_widths: Matrix | Vector, weights: Matrix | float = 1.0
    ) -> list[Matrix]:
        """Return weighted sums of the plays of each axis or channel, (n_j, a) each."""
        slack = np.max([np.ptp(load, axis=0) / 2.0 for load in loads], axis=0)[:, None] * half_widths
        longest = max(len(load) for load in loads)
        every = np.stack(
            [np.pad(one, ((0, longest - len(one)), (0, 0)), mode="edge") for one in loads], axis=1
        )
        first = every[0][..., None]
        play = np.clip(0.0 if self.behind else first, first - slack, first + slack)
        sums = np.empty_like(every)
        for begin in range(0, longest, _BLOCK):
            block = every[begin : begin + _BLOCK, ..., None]
            low, high = block - slack, block + slack
            plays = np.empty_like(low)
            for i in range(len(block)):
                play = np.minimum(np.maximum(play, low[i]), high[i], out=plays[i])
            sums[begin : begin + _BLOCK] = np.sum(plays * weights, axis=-1)
        return [sums[: len(load), j] for j, load in enumerate(loads)]

    def lag_loads(self, fit: Solution) -> Problem:
        """Let the loads of the axes lag by loops in proportion to the swing."""
        loads = self.loads(fit)
        return beside_loads(
            self.plain, self.rows(_out_of_phase(self.plays(loads, _HALF_WIDTHS), loads)), _SHARE_STD
        )

    def lag_by_creep(self, fit: Solution) -> Problem:
        """Let the loads of the axes creep; one that hangs for long has crept in all octaves of time."""
        loads = self.loads(fit)
        lags, std = _creeps(loads, self.steps), _SHARE_STD / len(CREEPING)
        problem = beside_loads(self.plain, self.rows(_out_of_phase(lags, loads)), std)
        return replace(problem, law=Law.CREEP)

    def lag_channels(self, fit: Solution) -> Problem:
        """Let the loads of the channels lag."""
        loads = [load @ fit.A.T for load in self.loads(fit)]
        return beside_channels(self.plain, self.rows(_out_of_phase(self.plays(loads, _HALF_WIDTHS), loads)))

    def lag_with_backlash(self, fit: Solution) -> Problem:
        """Let the loads of the axes lag by the one width that a share says itself."""
        loads = self.loads(fit)
        shares, half = np.zeros(AXES), np.full((AXES, 1), _NARROW)
        if fit.problem.hysteresis:
            shares = fit.shares
            half = np.clip(0.5 * shares, _HALF_WIDTHS[-1], _HALF_WIDTHS[0])[:, None]

        def lag(loads: Sequence[Matrix]) -> list[Matrix]:
            plays = self.plays(loads, half, 0.5 / half)
            return [play - load * (0.5 / half)[:, 0] for play, load in zip(plays, loads, strict=True)]

        bodies = fit.limb + fit.problem.added
        turns = [_turn(load, body) for load, body in zip(loads, bodies, strict=True)]
        near = lag([load + _STEP * slope for load, (slope, _) in zip(loads, turns, strict=True)])
        columns = [
            np.column_stack([((there - here) / _STEP)[:, _TORQUES] * share, here])
            for there, here, (_, share) in zip(near, lag(loads), turns, strict=True)
        ]
        slopes = np.zeros((len(_TORQUES), AXES, self.plain.parameters))
        slopes[range(len(_TORQUES)), _TORQUES, _MOMENTS] = shares[_TORQUES]
        problem = beside_loads(self.plain, self.rows(columns), _SHARE_STD, slopes)
        return replace(problem, law=Law.BACKLASH)


def _path(data: InSituSet, moving: bool, stride: int) -> Matrix:
    """Return every so many signals, (n, s); the last one is held in gaps.

    They are smoothed where a few samples are a small part of a turn of the limb: plays that follow noise
    would be signals with less of it, and a loop in nothing but noise.
    """
    u = signals(data, moving, stride)
    whole = np.isfinite(u).all(axis=1)
    latest = np.maximum.accumulate(np.where(whole, np.arange(len(u)), -1))
    latest[latest < 0] = int(np.argmax(whole))
    u = u[latest]
    return savitzky_golay(u, _CUBIC) if turns_slowly(u[:, DIRECT]) else u


def turns_slowly(gravity: Matrix) -> bool:
    """Return whether a few samples of gravity, (n, 3), are a small part of a turn of the limb."""
    return len(gravity) > _CUBIC and motion_frequency(gravity, 1.0) * _CUBIC < _PART


_TORQUES, _MOMENTS = np.array([3, 3, 4, 4, 5, 5]), np.array([2, 3, 1, 3, 1, 2])
"""Torques, and the first moments among the parameters that they depend on."""


def _turn(load: Matrix, body: Vector) -> tuple[Matrix, Vector]:
    """Turn a first moment a little about each axis; one that grows only makes a lag larger.

    Returns slopes of the loads, (n, 6), and their shares by each first moment that torques depend on, (6,).
    """
    moment = body[MOMENT]
    size = float(np.linalg.norm(moment)) + np.finfo(float).tiny
    across = np.cross(np.eye(3), moment)
    across /= np.linalg.norm(across, axis=1, keepdims=True) + np.finfo(float).tiny
    torque = np.einsum("ana->na", np.cross(across[:, None], load[:, :3]))
    added = np.concatenate([np.zeros_like(torque), size / body[MASS] * torque], axis=1)
    return added, across[_TORQUES - 3, _MOMENTS - 1] / size


def _creeps(wrenches: Sequence[Matrix], steps: Sequence[float]) -> list[Matrix]:
    """Return the sums of past loads by filters of the first order, (n_j, a) each.

    The motion before a set is not known: filters begin at the mean of its loads. If they began at the first
    load, their transient would look like drift.
    """
    found = []
    for wrench, step in zip(wrenches, steps, strict=True):
        kept, mean = np.exp(-step / CREEPING), wrench.mean(axis=0, keepdims=True)
        at = [scipy.signal.lfilter([1.0 - k], [1.0, -k], wrench, axis=0, zi=k * mean)[0] for k in kept]
        found.append(np.sum(at, axis=0))
    return found


def _out_of_phase(lags: Sequence[Matrix], wrenches: Sequence[Matrix]) -> list[Matrix]:
    """Take the part in phase with the loads of all sets off the lags, (n_j, a) each.

    It has no mean over a set: the mean is the offset's.
    """
    loads = [wrench - wrench.mean(axis=0) for wrench in wrenches]
    common = sum(np.sum(lag * load, axis=0) for lag, load in zip(lags, loads, strict=True))
    square = sum(np.sum(load**2, axis=0) for load in loads)
    kappa = common / np.where(square > 0.0, square, 1.0)
    signals = [lag - kappa * wrench for lag, wrench in zip(lags, wrenches, strict=True)]
    return [signal - signal.mean(axis=0) for signal in signals]


_GAIN_STD = 0.005  # expected size of the gains in 1/K; that of an axis that no load reaches stays at zero


def centre_temperatures(
    sets: tuple[InSituSet, ...],
) -> tuple[tuple[InSituSet, ...], float | None, list[Finding]]:
    """Return sets with temperatures less their mean, the mean in their unit, and findings.

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
    elif (left := _measure_rest(sets, lambda data: data.gravity)) < limits.NOT_GRAVITY:
        words = (
            f"The temperature went with gravity: what gravity explains leaves {left:.0%} of its spread. It "
            "was left out; let the sensor warm or cool while the limb turns several times."
        )
    if words:
        return tuple(replace(data, temperature=None) for data in sets), None, _warn(words)
    if all(data.time is not None for data in sets):
        left = _measure_rest(sets, lambda data: np.asarray(data.time), common=True)
        if left < limits.NOT_GRAVITY:
            words = (
                f"The temperature went with time: one slope leaves {left:.0%} of its spread, so that its "
                "coefficient may be that of a drift (matrix and limb do not lean on which it is). Let the "
                "sensor warm in one set and cool in another."
            )
    centred = [replace(data, temperature=one - mean) for data, one in zip(sets, given, strict=True)]
    return tuple(centred), mean, _warn(words)


def _warn(words: str) -> list[Finding]:
    return [Finding("temperature", words, refuses=False)] if words else []


def _measure_rest(
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


def add_gains(plain: Solution) -> Solution:
    """Return a fit with gains of the axes by temperature, or the plain one where they are not worth it.

    The plain one has the temperature as a signal, without hysteresis.
    """

    def warm(fit: Solution) -> Problem:
        return beside_loads(plain.problem, _warm_loads(plain.problem, fit), _GAIN_STD)

    fitted = follow(warm, plain, 2)
    if criterion(fitted) >= criterion(plain):
        return plain
    return replace(fitted, problem=replace(fitted.problem, gains=AXES))


def _warm_loads(problem: Problem, fit: Solution) -> list[Matrix]:
    """Return the temperature times the load by a fit at the rows of a problem's sets, (m, 6) each."""
    inputs, found = problem.basis.shape[2], []
    for part, T in zip(problem.sets, fit.loads, strict=True):
        signals = part.source.signals
        kelvin = signals[:, inputs, None]  # the first signal behind those of the loads
        found.append(kelvin * (signals[:, :inputs] @ T[:, :inputs].T))
    return found
