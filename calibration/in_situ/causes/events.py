"""Mistakes that act on the readings of sets: jumps, touches, other loads, and limbs that are not rigid."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, product
from operator import methodcaller

import numpy as np

from surefoot.calibration.arrays import orthonormal
from surefoot.calibration.diagnosis import Mistake
from surefoot.calibration.in_situ.causes.posed import Posed
from surefoot.calibration.in_situ.check import TOO_FAST, bending_signals
from surefoot.calibration.in_situ.data import InSituSet, Matrix, Vector
from surefoot.calibration.in_situ.imu import add_turning
from surefoot.calibration.in_situ.model import DIRECT, SPREAD_ROUNDING, STATIC, signals
from surefoot.calibration.in_situ.solver.compress import CompressedSet
from surefoot.calibration.in_situ.solver.problem import Problem
from surefoot.calibration.in_situ.solver.solve import Solution
from surefoot.calibration.reference import GRAVITY

_EDGES = 40  # stretches of a set at whose ends an event is looked for first
_FINER = 4  # by how much the search becomes finer; it ends at single samples
_SHORTEST = 3  # rows that a touch must last

_BEYOND = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
"""Shares of the rows that are tried for those in which a limb presses a stop."""

_CURE_BENT = "hold the joints beyond the sensor fast, or lighten what is added"

_CUT = "cut the set there into two{}, or record it again"
_TOUCHING = "leave that time out, or record the set again with nothing near the limb"

_EVENTS = (
    # kind, cause, cure, whether it ends again, and whether it goes with gravity, as a mass does
    ("jump", "the zero of '{name}' leaps at {begin}", _CUT.format(""), False, False),
    ("touch", "something touched the limb in '{name}' from {begin} to {end}", _TOUCHING, True, False),
    ("load", "what hangs in '{name}' changed at {begin}", _CUT.format(" with a mass each"), False, True),
)


def events(posed: Posed, plain: Solution) -> Iterator[Mistake]:
    """Yield the likeliest jump of a zero, touch, and change of what hangs there, in sets with times."""
    if not posed.timed:
        return
    parts, channels = posed.problem.sets, len(posed.problem.whitening)
    for kind, words, cure, ends, loads in _EVENTS:
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
        begin, end = (posed.when(j, int(parts[j].source.places[row])) for row in (first, last - 1))
        named = words.format(name=posed.sets[j].name, begin=begin, end=end)
        free = acts[j].shape[1] * channels + 1 + ends
        yield Mistake(kind, named, cure, methodcaller("beside", columns), free, len(parts))


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


def bending(posed: Posed, plain: Solution) -> Iterator[Mistake]:
    """Yield effects of posture or turning that are alike in all sets, which a rigid limb does not have.

    A limb bends by gravity; a sensor that is not linear, by its load, which grows with the added mass. A
    cable pulls by posture, or drags against the turning. A stop presses the more, the further the limb is
    beyond a posture. A limb that moves and was taken for still has forces by each product of its rates.
    """
    problem = posed.problem
    channels, gravity = len(problem.whitening), [part.source.signals[:, DIRECT] for part in problem.sets]
    every = [np.nan_to_num(signals(data, problem.moving)) for data in posed.sets]
    loads = [u @ T[:, : u.shape[1]].T for u, T in zip(every, plain.loads, strict=True)]
    largest = np.max([np.max(np.abs(load), axis=0) for load in loads], axis=0)
    shares = [load / np.where(largest > 0.0, largest, 1.0) for load in loads]
    cubes = posed.at_rows([np.concatenate([x**2, x**3], axis=1) for x in shares])
    postures = [np.column_stack([g, (g / GRAVITY) ** 3]) for g in gravity]
    bent = ("bending", "the limb bends as it turns, or the sensor is not linear", _CURE_BENT)
    pulls = (
        "cable",
        "something pulls at the limb as it turns, such as a cable",
        "let cables hang loose, or fix them",
    )
    stops = (
        "stop",
        "something touched the limb in all sets at one end of its motion, such as the floor",
        _TOUCHING,
    )
    tried: list[tuple[tuple[str, str, str], list[Matrix], int, int]] = [
        (bent, [bending_signals(g) for g in gravity], 0, 2),
        (bent, cubes, 0, 2),
        (pulls, postures, STATIC, 2),
        (stops, _find_stop(problem), -3, 1),
    ]
    if posed.timed:
        against = posed.at_rows([np.sign(np.gradient(u[:, DIRECT], axis=0)) for u in every])
        tried.append((pulls, against, 0, 2))
    moved = [] if problem.moving else list(map(_motion_of, posed.sets))
    if moved and all(len(one) for one in moved):
        fast = ("speed", TOO_FAST, "give the gyroscope's readings as well, or move slowly")
        tried.append((fast, posed.at_rows(moved), 0, 1))
    for words, columns, known, choices in tried:
        free = columns[0].shape[1] * channels - known
        yield Mistake(*words, methodcaller("beside", columns), free, choices)


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
