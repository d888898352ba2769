r"""Causes why sets contradict each other: each known cause is tried, and ranked by its posterior odds.

A cause adds signals to the readings (a leap, a touch, a limb that bends), changes what was added (another
mass, another place, another limb), or reads gravity in another way (a late clock, held values, turned axes).
With each the fit is made again, on the same compressed rows. Beforehand all kinds of causes are equally
likely, and so are the choices of one kind, such as the sets in which it may be; times and delays are
unknowns. The evidence is Schwarz's (1978), with the priors of the fit in the likelihood L of n rows. The odds
of a cause with d unknowns more, one of c choices, are

.. math:: -2 \log p = -2 \log L + d \log n + 2 \log c,

each with the colour of all that it leaves, contradictions between sets as well.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.calibration.arrays import orthonormal
from surefoot.calibration.diagnosis import Diagnosis, Experience, Mistake, Tried, diagnose
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.check import BENT_CURE, TOO_FAST, bending_signals, measure_repeated
from surefoot.calibration.in_situ.data import InSituSet, Matrix, Vector, change_motion, read_later
from surefoot.calibration.in_situ.imu import add_turning
from surefoot.calibration.in_situ.model import (
    AXES,
    DIRECT,
    ENOUGH_MASSES,
    LEAST_LEVER,
    MASS,
    MOMENT,
    SPREAD_ROUNDING,
    STATIC,
    inertial_parameters,
    signals,
)
from surefoot.calibration.in_situ.solver.compress import CompressedSet, change_signals
from surefoot.calibration.in_situ.solver.problem import Problem, starts
from surefoot.calibration.in_situ.solver.solve import Solution, beside_channels, deviance, minima, solve
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.results import Finding

_THINNED = 2000  # samples of a set in which causes are looked for
_EDGES = 40  # stretches of a set at whose ends an event is looked for first
_FINER = 4  # by how much the search becomes finer; it ends at single samples
_SHORTEST = 3  # rows that a touch must last
_LIKELY = 2  # changes of axes that are fitted to the end
_GLANCE = 8  # evaluations by which these are chosen

_DELAYS = np.geomspace(0.03, 6.0, 24)
"""Delays in s between the IMU and the readings, either way, and time constants of filters."""

_ACCURACY = 2e-3  # share of a delay to which it is found: a message has three digits

_TINY = float(np.finfo(float).tiny)

_BEYOND = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
"""Shares of the rows that are tried for those in which a limb presses a stop."""

_AS_GOOD = 0.1  # share by which two costs may differ that are alike

_TOUCHING = "Leave that time out, or record the set again with nothing near the limb."
_WEIGH = "Weigh what was added and measure where it hung, or leave the set out."
_CLOCK = "Stamp both by one clock, and log the sensor without a filter of the driver."


@dataclass(frozen=True, eq=False)
class Evidence:
    """Data and fit that causes are judged by."""

    sets: tuple[InSituSet, ...]  # the sets
    solution: Solution
    """Of the problem without any cause. Loops of loads are part of it where sets show them: they look like a
    short delay."""
    response: Matrix | None = None  # of the maker's matrix, in counts per N and N m, shape (k, 6)

    @property
    def timed(self) -> bool:
        """Whether all sets have times, without which samples have no order."""
        return all(one.time is not None for one in self.sets)

    @property
    def problem(self) -> Problem:
        """That without any cause."""
        return self.solution.problem

    def at_rows(self, columns: Sequence[Matrix]) -> list[Matrix]:
        """Return means over the rows of the compressed sets, of columns, shape (n_j, q) a set."""
        return [part.at_rows(one) for part, one in zip(self.problem.sets, columns, strict=True)]

    def beside(self, words: str, cure: str, rows: Sequence[Matrix], free: int, choices: int) -> "Cause":
        """Return a cause that adds signals, at the rows of the compressed sets, to the readings."""
        problem = beside_channels(self.problem, rows)
        return Cause(words, cure, solve(problem, [self.solution.outer]), free, choices)

    def read_as(self, words: str, cure: str, sets: Sequence[InSituSet], free: int, choices: int) -> "Cause":
        """Return a cause by which gravity and motion were those of other sets, sample by sample."""
        problem = self.problem
        rows = self.at_rows([np.nan_to_num(signals(one, problem.moving)) for one in sets])
        beside = [part.source.signals[:, problem.motion.stop :] for part in problem.sets]
        parts = change_signals(problem.sets, [np.hstack(pair) for pair in zip(rows, beside, strict=True)])
        return Cause(words, cure, solve(replace(problem, sets=parts), [self.solution.outer]), free, choices)

    def change(self, changes: NDArray[np.float64]) -> Solution:
        """Fit with changes of the added parameters, shape (q, J, p)."""
        outer = np.pad(self.solution.outer, (0, len(changes)))
        return solve(replace(self.problem, changes=changes), [outer])

    def when(self, j: int, sample: int) -> str:
        """Return a moment of a set in words."""
        time = self.sets[j].time
        return f"sample {sample}" if time is None else f"{time[sample]:.1f} s"


class Cause(NamedTuple):
    """A cause that was tried."""

    words: str  # the cause, for a message
    cure: str  # advice for the user
    solution: Solution  # of the problem with it
    free: int  # number of unknowns that it adds
    choices: int  # number of alternatives of which it is the best


EXPERIENCE = Experience(unknown=0.2, mimicked=0.2, size=0.003, spread=0.6)
"""Sound sets leave 0.1 to 0.9 % of the spread, most of it hysteresis; see benchmarks/in_situ_spoilt.py."""

_BEST, _LEAST = 0.0025, 0.0005  # shares of the spread that good sensors leave, and the best ones
_SURE = 30.0  # nats by which a mistake must explain more for others to compete below the floor
_MAY_BE_SOUND = 0.05  # probability of residuals among sound sets above which they may be sound

_CLOSER = 0.5  # share of the residuals that the closest mistake may leave to be worth a word

_MISTAKES = 20.0  # kinds of mistakes, each of which is that much rarer than data without any

_LAW = 100.0
"""Readings that an error of the sensor's model is worth, however many samples repeat it. Loops of two laws
differ by a few numbers for each axis, and so do the loops of the same law at other swings."""


class Causes(NamedTuple):
    """What was found out about the causes of a contradiction."""

    diagnosis: Diagnosis  # probabilities of all that were tried
    closest: Tried | None  # leaves less than half of the residuals; None if no mistake does
    moved: float
    """Share by which the likeliest cause moves contact loads. Zero if it has many unknowns, which hysteresis
    of a law that the fit has not may look like."""

    @classmethod
    def of(cls, tried: Sequence[Tried], evidence: float, size: float, experience: Experience) -> "Causes":
        """Return the causes among those that were tried, beside the fit without any."""
        found = diagnose(tried, evidence, size, experience)
        closest = max(tried, key=lambda one: one.evidence, default=None)
        if closest and (closest.evidence - evidence < limits.CLEARER or closest.size > _CLOSER * size):
            closest = None
        return cls(found, closest, 0.0)


def find_causes(evidence: Evidence) -> Causes:
    """Try each known cause, and return their probabilities beside none of them and an unknown one."""
    found = list[Cause]()
    for look in _KINDS:
        # Bad data without one cause may have no answer with another.
        with suppress(np.linalg.LinAlgError):
            found += look(evidence)
    rows = sum(part.rows for part in evidence.problem.sets)
    size, before = _measure_left(evidence, evidence.solution), deviance(evidence.solution)
    # Where the residuals may be those of a sound sensor, smaller ones are no evidence of anything.
    least = _BEST if EXPERIENCE.sound(size) > _MAY_BE_SOUND else _LEAST
    best: dict[str, tuple[Tried, Cause]] = {}
    for one in found:
        left = _measure_left(evidence, one.solution)
        gain = 0.5 * (before - deviance(one.solution)) - penalise(one.free, rows, one.choices)
        better = np.log(max(size, least) / max(left, least))
        gain = min(gain, _LAW * float(better) - penalise(one.free, _LAW, one.choices)) - np.log(_MISTAKES)
        tried = Tried(Mistake("", one.words, _as_clause(one.cure)), gain, left)
        if one.words not in best or gain > best[one.words][0].evidence:
            best[one.words] = (tried, one)
    every = [tried for tried, _ in best.values()]
    if max((one.evidence for one in every), default=0.0) > _SURE:
        # Something is wrong. What it is shows also in residuals below those of good sensors.
        every = [
            one._replace(
                evidence=one.evidence + _LAW * float(np.log(least / np.clip(one.size, _LEAST, least)))
            )
            for one in every
        ]
    causes = Causes.of(every, 0.0, size, EXPERIENCE)
    likely = None if causes.diagnosis.likely is None else best[causes.diagnosis.likely.mistake.cause][1]
    if likely is None or likely.free > STATIC:
        return causes
    return causes._replace(moved=_measure_move(evidence.solution, likely.solution))


def _as_clause(sentence: str) -> str:
    return sentence[0].lower() + sentence[1:].removesuffix(".")


def _measure_left(evidence: Evidence, solution: Solution) -> float:
    """Return the share of the spread of forces and torques that a solution leaves, beside white noise.

    A slope of each set is the offset's drift. Without times nothing tells noise from all else within a set,
    so that only what sets disagree on counts.
    """
    to_wrench, timed = np.linalg.pinv(solution.A).T, evidence.timed
    left, spread, samples = np.zeros(AXES), np.zeros(AXES), 0.0
    for part, B in zip(solution.problem.sets, solution.predicted, strict=True):
        weight, u, read = np.split(part.source.columns, [1, 1 + part.source.inputs], axis=1)
        ramp = np.linspace(-1.0, 1.0, part.rows)[:, None] * weight if timed else weight[:, :0]
        basis, _ = orthonormal(np.hstack([weight, ramp]))
        rest = (read - u @ B.T) @ to_wrench
        rest = rest - basis @ (basis.T @ rest)
        left += np.sum(rest**2, axis=0)
        left -= np.sum(np.diff(rest, axis=0) ** 2, axis=0) / 2.0 if timed else 0.0
        level = (read - weight @ (weight.T @ read) / np.sum(weight**2)) @ to_wrench
        spread = np.maximum(spread, np.sum(level**2, axis=0) / np.sum(weight**2))
        samples += float(np.sum(weight**2))
    if not timed:
        left -= sum(np.sum((part.residual @ to_wrench) ** 2, axis=0) for part in evidence.problem.sets)
    share = np.sum(left.reshape(2, 3), axis=1) / np.maximum(np.sum(spread.reshape(2, 3), axis=1), _TINY)
    return float(np.sqrt(np.mean(np.maximum(share, 0.0)) / samples))


def _measure_move(one: Solution, other: Solution) -> float:
    """Return how far two fits disagree on contact loads, as a share; torques count by the limb's lever."""
    mass, *moment = one.limb[:STATIC]
    lever = max(float(np.linalg.norm(moment)) / max(abs(mass), _TINY), LEAST_LEVER)
    size = np.repeat([1.0, lever], 3)
    apart = (np.linalg.pinv(one.A) @ other.A - np.eye(AXES)) / size[:, None] * size
    return float(np.linalg.norm(apart) / np.sqrt(AXES))


def penalise(free: int, rows: float, choices: int) -> float:
    """Return the nats that the best of some alternatives, with free unknowns, gains by chance."""
    return float(0.5 * free * np.log(rows) + np.log(choices))


def tell_causes(symptom: Finding, causes: Causes, instead: str = "") -> Finding:
    """Add the likeliest cause to a symptom, or that none is known; the cure ``instead`` if that is not it."""
    diagnosis, closest = causes.diagnosis, causes.closest
    if diagnosis.none > 0.5 or not diagnosis.causes:
        return symptom
    if diagnosis.likely:
        cure = f"{diagnosis.cure} If that is not it: {instead}" if instead else diagnosis.cure
        return symptom.with_cause(diagnosis.sentence(), cure)
    if closest is None:
        return symptom.with_cause(diagnosis.sentence(), symptom.cure)
    words = (
        f"{diagnosis.sentence()} The closest of them: {closest.mistake.cause}, which leaves "
        f"{closest.size:.2g} of the readings' spread."
    )
    return symptom.with_cause(words, f"{symptom.cure} Or {closest.mistake.cure}.".lstrip())


# Events within a set: signals that act on its readings.


class _Event(NamedTuple):
    """Something that happens in one set."""

    words: str  # with the set, its beginning and its end
    cure: str  # advice for the user
    ends: bool  # whether it ends again
    loads: bool  # whether it goes with gravity, as a mass does


_EVENTS = (
    _Event(
        "the zero of '{name}' leaps at {begin}",
        "Cut the set there into two, or record it again.",
        ends=False,
        loads=False,
    ),
    _Event("something touched the limb in '{name}' from {begin} to {end}", _TOUCHING, ends=True, loads=False),
    _Event(
        "what hangs in '{name}' changed at {begin}",
        "Cut the set there into two with a mass each, or record it again.",
        ends=False,
        loads=True,
    ),
)


def _try_events(evidence: Evidence) -> Iterator[Cause]:
    """Yield the likeliest leap of a zero, touch, and change of what hangs there, in sets with times."""
    if not evidence.timed:
        return
    parts, channels = evidence.problem.sets, len(evidence.problem.whitening)
    for words, cure, ends, loads in _EVENTS:
        acts = [np.ones((part.rows, 1)) for part in parts]
        if loads:
            acts = [
                np.hstack([one, part.source.signals[:, DIRECT]])
                for one, part in zip(acts, parts, strict=True)
            ]
        found = [_find_span(part, one, ends) for part, one in zip(parts, acts, strict=True)]
        j = int(np.argmax([gain for gain, *_ in found]))
        _, first, last = found[j]
        rows = np.arange(parts[j].rows)
        columns = [np.zeros_like(one) for one in acts]
        columns[j] = acts[j] * ((rows >= first) & (rows < last))[:, None]
        begin, end = (evidence.when(j, int(parts[j].source.places[row])) for row in (first, last - 1))
        named = words.format(name=evidence.sets[j].name, begin=begin, end=end)
        yield evidence.beside(named, cure, columns, acts[j].shape[1] * channels + 1 + ends, len(parts))


def _find_span(part: CompressedSet, acts: Matrix, ends: bool) -> tuple[float, int, int]:
    """Find the likeliest rows of an event, from one to before another, and how much they explain.

    It acts on the readings by ``acts``, shape (m, q), and to the end of the set unless it ends.
    """
    n, rows = part.rows, np.arange(part.rows)

    def best(spans: list[tuple[int, int]]) -> tuple[float, int, int]:
        masks = ((rows >= first) & (rows < last) for first, last in spans)
        gains = _measure_gains([part], ([acts * mask[:, None]] for mask in masks))
        i = int(np.argmax(gains))
        return float(gains[i]), *spans[i]

    def near(edge: int, width: int) -> list[int]:
        steps = np.linspace(-width, width, 2 * _FINER + 1).astype(int)
        return sorted({*np.clip(edge + steps, 1, n - 1).tolist()})

    edges = np.unique(np.linspace(0, n, _EDGES + 1).astype(int))[1:-1].tolist()
    gain, first, last = best(list(combinations(edges, 2)) if ends else [(edge, n) for edge in edges])
    for width in (n // _EDGES, n // _EDGES // _FINER, _FINER):
        others = near(last, width) if ends else [n]
        fine = [(a, b) for a in near(first, width) for b in others if b - a >= _SHORTEST]
        gain, first, last = best([*fine, (first, last)])
    return gain, first, last


def _measure_gains(parts: Sequence[CompressedSet], acts: Iterable[Sequence[Matrix]]) -> Vector:
    """Measure how much of the residuals of sets columns explain, each (m, q) a set, one number for each.

    Rows are not weighted against drift, which an event looks like: a ramp of each set is taken off instead.
    """
    weights, bases, left = [part.source.weight[:, None] for part in parts], [], []
    for part, weight in zip(parts, weights, strict=True):
        known = np.column_stack([np.ones(part.rows), np.linspace(-1.0, 1.0, part.rows), part.source.signals])
        bases.append(orthonormal(weight * known, SPREAD_ROUNDING)[0])
        read = part.source.columns[:, 1 + part.source.inputs :]
        left.append(read - bases[-1] @ (bases[-1].T @ read))
    white, _ = orthonormal(np.concatenate(left), SPREAD_ROUNDING)
    gains = []
    for columns in acts:
        added = [weight * one for weight, one in zip(weights, columns, strict=True)]
        z = np.concatenate([one - basis @ (basis.T @ one) for one, basis in zip(added, bases, strict=True)])
        seen = np.sum(z**2, axis=0) > SPREAD_ROUNDING * sum(np.sum(one**2, axis=0) for one in added)
        along = orthonormal(z[:, seen], 1e-6)[0] if seen.any() else z[:, :0]
        gains.append(len(z) * float(np.sum((along.T @ white) ** 2)))
    return np.array(gains)


def _try_bending(evidence: Evidence) -> Iterator[Cause]:
    """Yield what goes with posture or turning alike in all sets, as no rigid limb does.

    A limb bends by gravity; a sensor that is not linear, by its load, which grows with the added mass. A
    cable pulls by posture, or drags against the turning. A stop presses the more, the further the limb is
    beyond a posture. A limb that moves and was taken for still has forces by each product of its rates.
    """
    problem = evidence.problem
    channels, gravity = len(problem.whitening), [part.source.signals[:, DIRECT] for part in problem.sets]
    squares = [bending_signals(g) for g in gravity]
    every = [np.nan_to_num(signals(data, problem.moving)) for data in evidence.sets]
    loads = [u @ T[:, : u.shape[1]].T for u, T in zip(every, evidence.solution.loads, strict=True)]
    largest = np.max([np.max(np.abs(load), axis=0) for load in loads], axis=0)
    shares = [load / np.where(largest > 0.0, largest, 1.0) for load in loads]
    cubes = evidence.at_rows([np.concatenate([x**2, x**3], axis=1) for x in shares])
    postures = [np.column_stack([g, (g / GRAVITY) ** 3]) for g in gravity]
    bent = "the limb bends as it turns, or the sensor is not linear"
    pulls, loose = (
        "something pulls at the limb as it turns, such as a cable",
        "Let cables hang loose, or fix them.",
    )
    stops = "something touched the limb in all sets at one end of its motion, such as the floor"
    for words, cure, columns, known, choices in (
        (bent, BENT_CURE, squares, 0, 2),
        (bent, BENT_CURE, cubes, 0, 2),
        (pulls, loose, postures, STATIC, 2),
        (stops, _TOUCHING, _find_stop(problem), -3, 1),
    ):
        yield evidence.beside(words, cure, columns, columns[0].shape[1] * channels - known, choices)
    if evidence.timed:
        against = evidence.at_rows([np.sign(np.gradient(u[:, DIRECT], axis=0)) for u in every])
        yield evidence.beside(pulls, loose, against, against[0].shape[1] * channels, 2)
    moved = [] if problem.moving else list(map(_motion_of, evidence.sets))
    if moved and all(len(one) for one in moved):
        cure = "Give the gyroscope's readings as well, or move slowly."
        yield evidence.beside(TOO_FAST, cure, evidence.at_rows(moved), moved[0].shape[1] * channels, 1)


def _find_stop(problem: Problem) -> list[Matrix]:
    """Return how far gravity is beyond the plane that explains most, at the rows of each set, (m, 1)."""
    directions = np.array([one for one in product((-1.0, 0.0, 1.0), repeat=3) if any(one)])
    along = [part.source.signals[:, DIRECT] @ directions.T for part in problem.sets]
    planes = np.quantile(np.concatenate(along), 1.0 - np.array(_BEYOND), axis=0)
    tried = [
        [np.maximum(one[:, i : i + 1] - plane[i], 0.0) for one in along]
        for plane, i in product(planes, range(len(directions)))
    ]
    return tried[int(np.argmax(_measure_gains(problem.sets, tried)))]


def _motion_of(data: InSituSet) -> Matrix:
    """Return the signals of rotation that gravity shows by its own turning, (n, 9); none if it shows none."""
    moved, places = add_turning(data)
    if not moved.moves:
        return np.zeros((0, 0))
    turning = signals(moved, True)[:, DIRECT.stop :]
    return np.stack([np.interp(np.arange(len(data.raw)), places, one) for one in turning.T], axis=1)


# Gravity that was read in another way.


def _try_reading(evidence: Evidence) -> Iterator[Cause]:
    """Yield clocks that disagree, filters, and values that were held."""
    if not evidence.timed:
        return
    held = max(map(measure_repeated, evidence.sets)) > limits.REPEATED
    for words, cure, change, values in _READINGS:
        if change is _hold and not held:
            continue
        x = _find_size(evidence.sets, change, values)
        sets = [_change(data, change, x) for data in evidence.sets]
        yield evidence.read_as(words.format(abs(x)), cure, sets, int(len(values) > 1), 1)


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

_READINGS: tuple[tuple[str, str, _Change, tuple[float, ...]], ...] = (
    ("the IMU came about {:.3g} s after the readings", _CLOCK, read_later, tuple(_DELAYS)),
    ("the readings came about {:.3g} s after the IMU", _CLOCK, read_later, tuple(-_DELAYS)),
    (
        "the readings came about {:.3g} s after the IMU, as through a low-pass filter",
        _CLOCK,
        _low_pass,
        tuple(_DELAYS),
    ),
    (
        "the driver takes a zero off that follows the readings within {:.3g} s",
        "Log the sensor's own readings, with no automatic zero in the driver.",
        lambda values, data, seconds: values - _low_pass(values, data, seconds),
        tuple(10.0 * _DELAYS),
    ),
    (
        "readings repeat the ones before: the driver is slower than the log, or hangs",
        "Log each sample of the sensor once, at the time at which it was read.",
        _hold,
        (0.0,),
    ),
)
"""Causes in words, their cures, how gravity was to be read then, and the sizes that are tried."""


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


def _try_sensor(evidence: Evidence) -> Iterator[Cause]:
    """Yield a channel whose gain changes at a set, and a set that another sensor has read."""
    parts, A = evidence.problem.sets, evidence.solution.A
    channels, count = len(evidence.problem.whitening), len(parts)
    cure = "Check its cable and the amplifier's gain, and record all sets with one sensor."
    of_gravity = [part.source.signals[:, DIRECT] for part in parts]
    loads = [g @ T[:, :3].T for g, T in zip(of_gravity, evidence.solution.loads, strict=True)]
    for j in range(count):
        name = evidence.sets[j].name
        other = [(i == j) * g for i, g in enumerate(of_gravity)]
        words = f"another sensor, gain or order of channels in '{name}'"
        yield evidence.beside(words, cure, other, 3 * channels, count)
        for channel in range(channels) if j else ():
            read = [(load @ A[channel])[:, None] * (i >= j) for i, load in enumerate(loads)]
            words = f"channel {channel} has another gain from '{name}' on"
            yield evidence.beside(words, cure, read, channels, channels * (count - 1))


# Added masses: other masses, places and turns.


def _try_masses(evidence: Evidence) -> Iterator[Cause]:
    """Yield a scale that grows, another mass or place of a set, and another limb from a set on.

    Nobody hangs a mass that is not positive or a hundred times what limbs bear, or out of reach. A sensor
    that reads more from set to set reads all that hangs there as so much more.
    """
    count, added = len(evidence.sets), evidence.problem.added
    if count > ENOUGH_MASSES:
        fit = evidence.change((np.arange(count)[:, None] * (evidence.solution.limb + added))[None])
        change = float(fit.changes[0])
        words = f"the sensor's scale changes by {100.0 * change:+.1f} % from set to set"
        cure = "Let the sensor warm up, and check the supply of its amplifier."
        if limits.LEAST_GAIN < 1.0 + (count - 1) * change < limits.LARGEST_GAIN:
            yield Cause(words, cure, fit, 1, 1)
    for j, data in enumerate(evidence.sets):
        given, at, name = data.added_mass, data.added_com, data.name
        if given > 0.0:
            of_mass = np.zeros((1, *added.shape))
            of_mass[0, j] = added[j]
            fit = evidence.change(of_mass)
            mass = given * (1.0 + float(fit.changes[0]))
            words = f"the added mass of '{name}' is {mass:.3f} kg, and {given:.3f} kg was given"
            if 0.0 < mass < limits.HEAVIEST:
                yield Cause(words, _WEIGH, fit, 1, count)
            of_place = np.zeros((3, *added.shape))
            of_place[range(3), j, range(MOMENT.start, MOMENT.stop)] = given
            fit = evidence.change(of_place)
            place = at + fit.changes
            words = f"the added mass of '{name}' hangs at {_place(place)} m, and {_place(at)} was given"
            if float(np.linalg.norm(place)) < limits.LONGEST_ARM:
                yield Cause(words, _WEIGH, fit, 3, count)
        if j:
            of_body = np.zeros((STATIC, *added.shape))
            of_body[range(STATIC), j:, range(STATIC)] = 1.0
            fit = evidence.change(of_body)
            mass, place = float(fit.changes[0]), fit.changes[1:] / (float(fit.changes[0]) or 1.0)
            side = "more" if mass > 0.0 else "less"
            more = f"{abs(mass):.3f} kg {side} than was given hangs at {_place(place)} m"
            words = f"from '{name}' on {more}: the limb is another, or a driver takes a payload off"
            bears = min(fit.limb[MASS], fit.limb[MASS] + mass) > 0.0 and mass < limits.HEAVIEST
            if bears and float(np.linalg.norm(place)) < limits.LONGEST_ARM:
                cure = "Leave the limb and the driver's payload as they are in all sets."
                yield Cause(words, cure, fit, 4, count)


def _place(place: Vector) -> str:
    return "({:.3f}, {:.3f}, {:.3f})".format(*place)


def _try_exchange(evidence: Evidence) -> Iterator[Cause]:
    """Yield two sets whose masses are exchanged."""
    added = evidence.problem.added
    pairs = [(i, j) for i, j in combinations(range(len(added)), 2) if not np.allclose(added[i], added[j])]
    for i, j in pairs:
        order = np.arange(len(added))
        order[[i, j]] = j, i
        problem = replace(evidence.problem, added=added[order])
        best = minima(problem, [evidence.solution.outer, *starts(problem, None, None)])[0]
        words = f"what was added in '{evidence.sets[i].name}' and '{evidence.sets[j].name}' is exchanged"
        yield Cause(words, _WEIGH, best, 0, len(pairs))


def _try_frame(evidence: Evidence) -> Iterator[Cause]:
    """Yield other axes of the places, and a turned IMU where it explains more: exact axes are likelier."""
    if not np.any(evidence.problem.added[:, MASS] > 0.0) or evidence.problem.rotation:
        return
    axes = list(_try_axes(evidence))
    turn = _try_turn(evidence)
    best = min((cause.solution.cost for cause in axes), default=np.inf)
    yield from axes
    if best > (1.0 + _AS_GOOD) * turn.solution.cost:
        yield turn


def _turn_limb(outer: Vector, axes: Matrix) -> Vector:
    """Return outer unknowns with the limb's first moment in other axes."""
    turned = outer.copy()
    turned[MOMENT] = axes @ outer[MOMENT]
    return turned


def _try_turn(evidence: Evidence) -> Cause:
    """Return an IMU that is turned against the sensor: of two turns as good as each other the smaller one.

    Masses in one plane do not tell a sensor from its mirror image.
    """
    outer, turns = evidence.solution.outer, Rotation.create_group("O")
    begin = [np.append(_turn_limb(outer, turn.as_matrix()), turn.as_rotvec()) for turn in turns]
    found = minima(replace(evidence.problem, rotation=True), begin)
    best = min(found, key=lambda one: Rotation.from_matrix(one.rotation).magnitude())
    angle = np.degrees(Rotation.from_matrix(best.rotation).magnitude())
    cure = (
        "Give its rotation (R_sensor_accelerometer), or let the fit find it: 'estimate_rotation', with the "
        "limb at rest."
    )
    return Cause(f"the IMU is turned by {angle:.0f} degrees against the sensor's frame", cure, best, 3, 1)


def _try_axes(evidence: Evidence) -> Iterator[Cause]:
    """Yield axes of all places, or of the IMU, that have other signs or another order."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=2)):
        axes = np.eye(3)[list(order)] * np.array([1.0, *signs])[:, None]
        # With their opposite, the fewest changes first; no change is no cause.
        pair = sorted((axes, -axes), key=lambda one: (-np.trace(one), -np.sum(one)))
        pair = [one for one in pair if not np.array_equal(one, np.eye(3))]
        glances = (_change_axes(evidence, one) for one in pair)
        cost = min(solve(problem, [outer], _GLANCE).cost for problem, outer in glances)
        found.append((cost, pair))
    for _, pair in sorted(found, key=lambda one: one[0])[:_LIKELY]:
        words, best = _tell_signs(evidence, pair)
        cure = "Measure places in the sensor's frame, and give the IMU's rotation (R_sensor_accelerometer)."
        yield Cause(words, cure, best, 0, len(found))


def _change_axes(evidence: Evidence, axes: Matrix) -> tuple[Problem, Vector]:
    """Return the problem with all places in other axes, and outer unknowns to start from."""
    plain = evidence.problem
    added = [inertial_parameters(one.added_mass, axes @ one.added_com, plain.moving) for one in evidence.sets]
    problem = replace(plain, added=np.pad(added, ((0, 0), (0, plain.parameters - len(added[0])))))
    return problem, _turn_limb(evidence.solution.outer, axes)


def _tell_signs(evidence: Evidence, pair: Sequence[Matrix]) -> tuple[str, Solution]:
    """Fit axes and their opposite; return the likelier in words, or both, and its solution.

    At rest places show in torques m c x g alone: the opposite places fit as well with the opposite response
    to torques. The maker's matrix tells which it is, and so do the limb's place and its motion.
    """
    fits = []
    for axes in pair:
        problem, outer = _change_axes(evidence, axes)
        fits.append(minima(problem, [outer, *starts(problem, None, None)])[0])
    odds = [-0.5 * deviance(one) for one in fits]
    alike = len(pair) > 1 and abs(odds[0] - odds[1]) < limits.CLEARER
    if evidence.response is not None and alike:
        off = [evidence.problem.whitening @ (one.A - evidence.response) for one in fits]
        odds = [-float(np.sum(one**2)) for one in off]
    likelier = int(np.argmax(odds))
    words = "axes of all places or of the IMU are others, or the IMU is turned: x, y, z as given are "
    if evidence.response is None and alike:
        more = f"; {_name_axes(pair[1])} fit as well, with all torques negated"
        return words + _name_axes(pair[0]) + more, fits[0]
    return words + _name_axes(pair[likelier]), fits[likelier]


def _name_axes(axes: Matrix) -> str:
    return ", ".join(("-" if np.sum(row) < 0.0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in axes)


_KINDS = (_try_events, _try_bending, _try_reading, _try_frame, _try_exchange, _try_masses, _try_sensor)
