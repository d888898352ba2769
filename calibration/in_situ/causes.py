r"""Causes why sets contradict each other: each known cause is tried, and scored by how much it explains.

A cause adds signals (a step, a touch, a limb that bends) or changes added masses; with each the fit is made
again, on compressed sets. They are compared by Schwarz's criterion (1978), -2 log L + d log n, each with the
colour of the noise that it leaves. Rows that still hang together count as fewer than they are,
n (1 - rho) / (1 + rho) by the correlation of whitened residuals from one to the next.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.calibration.arrays import orthonormal
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.check import BENT_CURE, bending_signals
from surefoot.calibration.in_situ.data import InSituSet, shift
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.judge import turns_of
from surefoot.calibration.in_situ.model import (
    DIRECT,
    INERTIA,
    MASS,
    MOMENT,
    STATIC,
    inertia_matrix,
    limb_parameters,
    signals,
)
from surefoot.calibration.in_situ.problem import Problem, starts
from surefoot.calibration.in_situ.solve import (
    Solution,
    beside_channels,
    deviance,
    minima,
    solve,
    whiten_residuals,
)

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

_THINNED = 2000
"""Samples of a set in which causes are looked for."""

_EDGES = 40
"""Stretches of a set at whose ends a step or a touch is looked for first."""

_FINER = 4
"""By how much the search becomes finer; it ends at single samples."""

_SHORTEST = 3
"""Rows that a touch must last."""

_STEPS = 8
"""Steps at most by which a turn of the IMU is found ..."""

_SCALED = 3
"""Fits by which the gain of a set is found: it acts on the limb, which is fitted with it."""

_SETTLED = 1e-4
"""... and the last of them in rad."""

_TURNS = 4
"""Turns by right angles from which an IMU's is searched, beside none."""

_LIKELY = 2
"""Changes of axes that are fitted to the end."""

_GLANCE = 8
"""Evaluations by which these are chosen."""

_LAG = (0.03, 6.0, 40)
"""Least and largest lag in s between the IMU and the readings that is looked for, and their number."""

_TINY = float(np.finfo(float).tiny)

_AS_GOOD = 0.1
"""Share by which two costs may differ that are alike."""

_TOUCHING = "Leave that time out, or record the set again with nothing near the limb."
_WEIGH = "Weigh what was added and measure where it hung, or leave the set out."


@dataclass(frozen=True, eq=False)
class Evidence:
    """Data and fit that causes are judged by.

    Attributes:
        sets: The sets.
        solution: Of the problem without hysteresis.
    """

    sets: tuple[InSituSet, ...]
    solution: Solution

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

    def change(self, changes: NDArray[np.float64]) -> Solution:
        """Fit with changes of the added parameters, shape (q, J, p)."""
        outer = np.pad(self.solution.outer, (0, len(changes)))
        return solve(replace(self.problem, changes=changes), [outer])

    def when(self, j: int, sample: int) -> str:
        """Return a moment of a set in words."""
        time = self.sets[j].time
        return f"sample {sample}" if time is None else f"{time[sample]:.1f} s"


class Cause(NamedTuple):
    """A cause that was tried.

    Attributes:
        words: The cause, for a message.
        cure: Advice for the user.
        solution: Of the problem with it.
        free: Number of unknowns that it adds.
        choices: Number of alternatives of which it is the best.
    """

    words: str
    cure: str
    solution: Solution
    free: int
    choices: int


def name_cause(symptom: Finding, evidence: Evidence, drift: Finding | None) -> Finding:
    """Add the likeliest cause to a symptom; return the symptom itself if no cause explains it.

    Args:
        symptom: Sets that contradict each other or themselves.
        evidence: Data and fit that causes are judged by.
        drift: A finding that a drift may explain, or None.
    """
    if drift is not None:
        symptom = symptom.with_cause(drift.reason, drift.cure)
    found = _rank_causes(evidence)
    if not found:
        return symptom
    shares: dict[str, float] = {}
    for cause, share in found:
        shares[cause.words] = shares.get(cause.words, 0.0) + share
    named = [f"{words} ({_format_percent(share)})" for words, share in list(shares.items())[:2]]
    cure = found[0][0].cure
    if drift is not None:
        cure += f" If that is not it: {symptom.cure}"
    return symptom.with_cause(f"Likeliest: {'; then '.join(named)}.", cure)


def _format_percent(share: float) -> str:
    return "> 99 %" if share > 0.99 else "< 1 %" if share < 0.01 else f"{share:.0%}".replace("%", " %")


def _rank_causes(evidence: Evidence) -> list[tuple[Cause, float]]:
    """Return causes that explain something, the likeliest first, and how likely each is beside the others."""
    tried = [Cause("", "", evidence.solution, 0, 1)]
    for look in (
        _try_steps,
        _try_bending,
        _try_pull,
        _try_frame,
        _try_exchange,
        _try_masses,
        _try_limb,
        _try_sensor,
    ):
        # Bad data without one cause may have no answer with another.
        with suppress(np.linalg.LinAlgError):
            tried += look(evidence)
    values = [deviance(cause.solution) for cause in tried]
    left = whiten_residuals(tried[int(np.argmin(values))].solution)
    share, rows = _independent(left), sum(map(len, left))
    # The best of n alternatives gains 2 log n by chance.
    scores = np.array(
        [
            share * value + cause.free * np.log(share * rows) + 2.0 * np.log(cause.choices)
            for value, cause in zip(values, tried, strict=True)
        ]
    )
    weights = np.exp(-0.5 * (scores - scores.min()))
    weights /= weights.sum()
    order = np.argsort(scores)
    return [(tried[i], float(weights[i])) for i in order[: list(order).index(0)]]


def _independent(left: Sequence[Matrix]) -> float:
    """Return the share of rows that are worth an independent one, by the correlation of neighbours."""
    before, after = (np.concatenate([one[cut] for one in left]) for cut in (slice(-1), slice(1, None)))
    size = float(np.sqrt(np.sum(before**2) * np.sum(after**2)))
    rho = float(np.sum(before * after)) / size if size > 0.0 else 0.0
    return float(np.clip((1.0 - rho) / (1.0 + rho), 1e-3, 1.0))


# Events within a set: signals that act on its readings.


def _measure_gains(evidence: Evidence, j: int, columns: Matrix) -> Vector:
    """Measure how much of a set's residual each column explains: columns (n, K), gains (K,)."""
    data, part = evidence.sets[j], evidence.problem.sets[j]
    rows = np.flatnonzero(part.source.used)
    rows = rows[:: max(len(rows) // _THINNED, 1)]
    u = signals(data, evidence.problem.moving)[rows]
    span = np.linspace(-1.0, 1.0, len(rows))
    basis, _ = orthonormal(np.column_stack([np.ones(len(rows)), span, u]), 1e-9)
    z = columns[rows] - basis @ (basis.T @ columns[rows])
    raw = data.raw[rows]
    residual = raw - basis @ (basis.T @ raw)
    white = np.linalg.cholesky(np.linalg.pinv(residual.T @ residual / len(rows), hermitian=True))
    size = np.sum(z**2, axis=0)
    seen = size > 1e-9 * np.maximum(np.sum(columns[rows] ** 2, axis=0), 1e-300)
    gain = np.sum((z.T @ residual @ white) ** 2, axis=1) / np.where(seen, size, 1.0)
    return np.where(seen, gain, 0.0)


def _try_steps(evidence: Evidence) -> Iterator[Cause]:
    """Yield the likeliest leap of a zero, and the likeliest time in which something touched the limb."""
    channels, count = len(evidence.problem.whitening), len(evidence.sets)
    for touch in (False, True):
        _, j, first, last, choices = max(_best_time(evidence, j, touch) for j in range(count))
        columns = [np.zeros((len(data.raw), 1)) for data in evidence.sets]
        columns[j][first:last] = 1.0
        name, begin = evidence.sets[j].name, evidence.when(j, first)
        words, cure = (
            f"the zero of '{name}' leaps at {begin}",
            "Cut the set there into two, or record it again.",
        )
        if touch:
            words = f"something touched the limb in '{name}' from {begin} to {evidence.when(j, last - 1)}"
            cure = _TOUCHING
        yield evidence.beside(words, cure, evidence.at_rows(columns), channels + 1 + touch, choices * count)


def _best_time(evidence: Evidence, j: int, touch: bool) -> tuple[float, int, int, int, int]:
    """Find the likeliest span of samples of a set: gain, set, span, and number of spans tried.

    A touch ends, the leap of a zero does not.
    """
    n = len(evidence.sets[j].raw)
    place = np.arange(n)[:, None]

    def best(spans: list[tuple[int, int]]) -> tuple[int, int, float]:
        first, last = np.array(spans).T
        gains = _measure_gains(evidence, j, ((place >= first) & (place < last)).astype(np.float64))
        i = int(np.argmax(gains))
        return int(first[i]), int(last[i]), float(gains[i])

    def near(edge: int, width: int) -> NDArray[np.int_]:
        steps = np.linspace(-width, width, 2 * _FINER + 1).astype(int)
        return np.unique(np.clip(edge + steps, 1, n - 1))

    edges = np.unique(np.linspace(0, n, _EDGES + 1).astype(int))[1:-1].tolist()
    spans = list(combinations(edges, 2)) if touch else [(edge, n) for edge in edges]
    first, last, gain = best(spans)
    for width in (n // _EDGES, n // _EDGES // _FINER, _FINER):
        ends = near(last, width) if touch else [n]
        fine = [(a, b) for a in near(first, width) for b in ends if b - a >= _SHORTEST]
        first, last, gain = best([*fine, (first, last)])
    return gain, j, first, last, len(spans)


def _try_bending(evidence: Evidence) -> Iterator[Cause]:
    """Yield a limb that gives way with gravity's squares, and a sensor with squares and cubes of loads."""
    # A limb that bends does so by gravity, a sensor by its load, which grows with the added mass.
    loads = [np.nan_to_num(signals(data, evidence.problem.moving)) for data in evidence.sets]
    loads = [u @ T[:, : u.shape[1]].T for u, T in zip(loads, evidence.solution.loads, strict=True)]
    largest = np.max([np.max(np.abs(load), axis=0) for load in loads], axis=0)
    shares = [load / np.where(largest > 0.0, largest, 1.0) for load in loads]
    words = "the limb bends as it turns, or the sensor is not linear"
    for columns in (
        [bending_signals(part.source.signals[:, DIRECT]) for part in evidence.problem.sets],
        evidence.at_rows([np.concatenate([x**2, x**3], axis=1) for x in shares]),
    ):
        free = columns[0].shape[1] * len(evidence.problem.whitening)
        yield evidence.beside(words, BENT_CURE, columns, free, 1)


def _try_pull(evidence: Evidence) -> Iterator[Cause]:
    """Yield a load of all sets that goes with gravity as no rigid limb's does, such as a cable's pull."""
    columns = [part.source.signals[:, DIRECT] for part in evidence.problem.sets]
    free = columns[0].shape[1] * len(evidence.problem.whitening) - STATIC
    words = "something pulls at the limb as it turns, such as a cable"
    yield evidence.beside(
        words, "Let cables hang loose, or fix them on one side of the sensor.", columns, free, 1
    )


def find_lag(sets: Sequence[InSituSet]) -> tuple[float, float]:
    """Return by how many s gravity comes after the readings, and the share of residual that this leaves.

    Hysteresis looks like a short lag: what it may leave needs none.
    """
    steps = np.geomspace(_LAG[0], _LAG[1], _LAG[2])
    left = {lag: _lagging_residual(sets, lag) for lag in (0.0, *steps, *-steps)}
    lag = min(left, key=left.__getitem__)
    return (
        (float(lag), float(np.exp(left[lag] - left[0.0]))) if left[0.0] > np.log(limits.LOOPS) else (0.0, 1.0)
    )


def _lagging_residual(sets: Sequence[InSituSet], lag: float) -> float:
    """Return the logarithm of the share of the readings that gravity leaves at a lag, rms over all."""
    found = []
    for data in sets:
        late = shift(data, lag)
        u = np.column_stack([np.ones(len(late.raw)), signals(late, late.moves)])
        rows = np.flatnonzero(np.isfinite(np.column_stack([u, late.raw])).all(axis=1))
        rows = rows[:: max(len(rows) // _THINNED, 1)]
        if len(rows) <= 2 * u.shape[1]:
            return np.inf
        basis, _ = orthonormal(u[rows], 1e-9)
        raw = late.raw[rows] - np.mean(late.raw[rows], axis=0)
        square = np.mean((raw - basis @ (basis.T @ raw)) ** 2, axis=0) / np.maximum(
            np.mean(raw**2, axis=0), _TINY
        )
        found.append(np.mean(square))
    return float(0.5 * np.log(np.maximum(np.mean(found), _TINY)))


def _try_sensor(evidence: Evidence) -> Iterator[Cause]:
    """Yield a channel whose gain changes at a set, and a set that another sensor has read."""
    parts, A = evidence.problem.sets, evidence.solution.A
    channels, count = len(evidence.problem.whitening), len(parts)
    cure = "Check its cable and the amplifier's gain, and record all sets with one sensor."
    zeros = [np.zeros((part.rows, 3)) for part in parts]
    of_gravity = [part.source.signals[:, DIRECT] for part in parts]
    loads = [g @ T[:, :3].T for g, T in zip(of_gravity, evidence.solution.loads, strict=True)]
    for j in range(count):
        name = evidence.sets[j].name
        other = [*zeros[:j], of_gravity[j], *zeros[j + 1 :]]
        words = f"another sensor, gain or order of channels in '{name}'"
        yield evidence.beside(words, cure, other, 3 * channels, count)
        for channel in range(channels) if j else ():
            read = [(load @ A[channel])[:, None] * (i >= j) for i, load in enumerate(loads)]
            words = f"channel {channel} has another gain from '{name}' on"
            yield evidence.beside(words, cure, read, channels, channels * (count - 1))


# Added masses: other masses, places and turns.


def _try_masses(evidence: Evidence) -> Iterator[Cause]:
    """Yield, for each set, another mass at the place that was given, and the mass at another place.

    Nobody hangs a mass that is not positive or a hundred times what limbs bear, or out of reach.
    """
    count, added = len(evidence.sets), evidence.problem.added
    for j, data in enumerate(evidence.sets):
        given, place, name = data.added_mass, data.added_com, data.name
        of_body = np.zeros((4, *added.shape))
        of_body[range(4), j, range(4)] = 1.0
        if given == 0.0:
            fit = evidence.change(of_body)
            mass, moment = float(fit.changes[0]), fit.changes[1:]
            if mass > 0.0:
                words = f"{mass:.3f} kg hung in '{name}' at {_place(moment / mass)} m, and nothing was given"
                yield Cause(words, _WEIGH, fit, 4, count)
            continue
        of_mass = np.zeros((1, *added.shape))
        of_mass[0, j] = added[j]
        fit = evidence.change(of_mass)
        mass = given * (1.0 + float(fit.changes[0]))
        words = f"the added mass of '{name}' is {mass:.3f} kg, and {given:.3f} kg was given"
        if 0.0 < mass < limits.HEAVIEST:
            yield Cause(words, _WEIGH, fit, 1, count)
        fit = evidence.change(given * of_body[1:])
        there = f"{_place(place + fit.changes)} m, and {_place(place)} was given"
        words = f"the added mass of '{name}' hangs at {there}"
        if float(np.linalg.norm(place + fit.changes)) < limits.LONGEST_ARM:
            yield Cause(words, _WEIGH, fit, 3, count)


def _try_limb(evidence: Evidence) -> Iterator[Cause]:
    """Yield a limb that is another from a set on, and a set whose readings have another gain."""
    count, added = len(evidence.sets), evidence.problem.added
    for j in range(count):
        name = evidence.sets[j].name
        of_body = np.zeros((4, *added.shape))
        of_body[range(4), j:, range(4)] = 1.0
        if j:
            fit = evidence.change(of_body)
            mass = float(fit.changes[0])
            place = fit.changes[1:] / (mass or 1.0)
            side = "more" if mass > 0.0 else "less"
            more = f"{abs(mass):.3f} kg {side} than was given hangs at {_place(place)} m"
            words = f"from '{name}' on {more}: the limb is another, or a driver takes a payload off"
            if abs(mass) < limits.HEAVIEST and float(np.linalg.norm(place)) < limits.LONGEST_ARM:
                yield Cause(
                    words, "Leave the limb and the driver's payload as they are in all sets.", fit, 4, count
                )
        of_all = np.zeros((1, *added.shape))
        gain, outer = 1.0, evidence.solution.limb
        for _ in range(_SCALED):
            of_all[0, j, : len(outer)] = added[j, : len(outer)] + outer
            fit = evidence.change(of_all)
            gain, outer = 1.0 + float(fit.changes[0]), fit.limb
        words = f"the readings of '{name}' are {gain:.3f} times as large as in the others: another gain"
        if 0.0 < gain < limits.HEAVIEST:
            yield Cause(words, "Set the amplifier as in the other sets, or leave the set out.", fit, 1, count)


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


def _try_turn(evidence: Evidence) -> Iterator[Cause]:
    """Yield an IMU that is turned against the sensor.

    A turned IMU has the same effect as a sensor turned with it whose added masses were measured in the
    frame before the turn.
    """
    plain = evidence.problem
    if not np.any(plain.added[:, MASS] > 0.0) or plain.rotation:
        return
    found = []
    for turn in Rotation.create_group("O"):
        outer = _rotate(evidence.solution.outer[None], turn.as_matrix())[0]
        cost = solve(replace(plain, added=_rotate(plain.added, turn.as_matrix())), [outer], _GLANCE).cost
        found.append((turn.magnitude() > 0.0, cost, turn, outer))
    # From none, and from the right angles that come next to it.
    tried = sorted(found, key=lambda one: one[:2])[: 1 + _TURNS]
    fits = [_fit_turn(plain, turn, outer) for _, _, turn, outer in tried]
    lowest = min(fit.cost for _, fit in fits)
    # Masses in one plane do not tell a sensor from its mirror image: the smaller turn is likelier.
    near = [(turn.magnitude(), fit) for turn, fit in fits if fit.cost <= (1.0 + _AS_GOOD) * lowest]
    angle, fit = min(near, key=lambda one: one[0])
    words = f"the IMU is turned by {np.degrees(angle):.0f} degrees against the sensor's frame"
    cure = (
        "Give its rotation (R_sensor_accelerometer), or let the fit find it: 'estimate_rotation', with the "
        "limb at rest."
    )
    yield Cause(words, cure, fit, 3, 1)


def _try_frame(evidence: Evidence) -> Iterator[Cause]:
    """Yield other axes of the places, and a turned IMU where it explains more: exact axes are likelier."""
    axes, turns = list(_try_axes(evidence)), list(_try_turn(evidence))
    best = min((cause.solution.cost for cause in axes), default=np.inf)
    yield from axes
    yield from (cause for cause in turns if best > (1.0 + _AS_GOOD) * cause.solution.cost)


def _try_axes(evidence: Evidence) -> Iterator[Cause]:
    """Yield axes of all places, or of the IMU, that have other signs or another order.

    Without a maker's matrix the opposite of all axes fits as well: its torques are opposite then.
    """
    plain = evidence.problem
    if not np.any(plain.added[:, MASS] > 0.0) or plain.rotation:
        return
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=2)):
        axes = np.eye(3)[list(order)] * np.array([1.0, *signs])[:, None]
        if np.array_equal(axes, np.eye(3)):
            continue
        outer = _rotate(evidence.solution.outer[None], axes)[0]
        problem = replace(plain, added=_rotate(plain.added, axes))
        found.append((solve(problem, [outer], _GLANCE).cost, axes, problem, outer))
    for _, axes, problem, outer in sorted(found, key=lambda one: one[0])[:_LIKELY]:
        best = minima(problem, [outer, *starts(problem, None, None)])[0]
        cure = "Measure places in the sensor's frame, and give the IMU's rotation (R_sensor_accelerometer)."
        yield Cause(_axes_in_words(axes), cure, best, 0, len(found))


def _axes_in_words(axes: Matrix) -> str:
    """Return a change of axes, or the opposite of it, in words."""
    if np.all(np.diag(axes)):
        signs = np.diag(axes)
        a = "xyz"[int(np.flatnonzero(signs == (1.0 if np.sum(signs) < 0.0 else -1.0))[0])]
        turn = f"the IMU is turned by 180 degrees about {a}"
        return f"{a} of all places or of the IMU has the other sign, or {turn}"
    if np.all(axes >= 0.0) or np.all(axes <= 0.0):
        order = ", ".join("xyz"[i] for i in np.argmax(np.abs(axes), axis=1))
        return f"axes of all places or of the IMU are swapped: x, y, z as given are {order}"
    turn = Rotation.from_matrix(axes * np.linalg.det(axes))
    about = turn.as_rotvec() / turn.magnitude()
    degrees = np.degrees(turn.magnitude())
    return f"the IMU is turned by {degrees:.0f} degrees about {_place(about)} against the sensor's frame"


def _fit_turn(plain: Problem, turn: Rotation, outer: Vector) -> tuple[Rotation, Solution]:
    """Find the turn of the added masses next to one, by small steps, and the fit with it."""
    best = solve(replace(plain, added=_rotate(plain.added, turn.as_matrix())), [outer])
    for _ in range(_STEPS):
        added = best.problem.added
        step = solve(replace(best.problem, changes=turns_of(added)), [np.pad(best.outer, (0, 3))]).changes
        for share in (1.0, 0.3, 0.1):
            further = Rotation.from_rotvec(share * step)
            tried = solve(replace(plain, added=_rotate(added, further.as_matrix())), [best.outer])
            if tried.cost < best.cost:
                break
        else:
            break
        best, turn = tried, further * turn
        if share * np.max(np.abs(step)) < _SETTLED:
            break
    return turn, best


def _rotate(parameters: Matrix, R: Matrix) -> Matrix:
    """Return inertial parameters, shape (n, p), of bodies that are turned or mirrored."""
    turned = parameters.copy()
    turned[:, MOMENT] = parameters[:, MOMENT] @ R.T
    if parameters.shape[1] >= INERTIA.stop:
        for one, given in zip(turned, parameters, strict=True):
            I = R @ inertia_matrix(given) @ R.T  # noqa: E741 - as in the equations
            one[INERTIA] = limb_parameters(0.0, one[MOMENT], I)[INERTIA]
    return np.asarray(turned)
