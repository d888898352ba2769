r"""What is wrong with sets that contradict each other: every cause that is known, by how much it explains.

A cause changes the problem of the fit: it adds signals that act on the readings (a step, a touch, a channel
that ends early, a limb that bends or moves fast), or it changes what was added (a mass, a place, two sets
exchanged, an IMU that is turned). With each the fit is made again, on compressed sets, and causes are
compared by Schwarz's criterion (1978), -2 log L + d log n. Samples whose residuals hang together count as
fewer than they are, n (1 - rho) / (1 + rho) by their correlation from one to the next.

"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.calibration.in_situ.answer_checks import added_slope, projected
from surefoot.calibration.in_situ.compress import CompressedSet, with_signals
from surefoot.calibration.in_situ.covariance import noise_level, whitening
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.input_checks import BENT_CURE, TOO_FAST, turning
from surefoot.calibration.in_situ.model import (
    DIRECT,
    INERTIA,
    MASS,
    MOMENT,
    PAIRS,
    inertia_matrix,
    inertial_parameters,
    limb_parameters,
    signals,
)
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.in_situ.solve import Problem, Solution, minima, solve, starts
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.results import CalibrationRefused

__all__ = ["Evidence", "Likely", "explained", "likeliest"]

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

_QUANTILES = (0.5, 0.65, 0.8, 0.9, 0.96)
"""Shares of the samples below the thresholds that are tried."""

_STEPS = 8
"""Steps of Gauss and Newton by which what was added is fitted."""

_SETTLED = 1e-4
"""Change of it, in m or as a share, that ends them."""

_DIFFERENCE = 1e-5
"""By how much it is changed to see its effect."""

_TURNS = 4
"""Turns by right angles from which an IMU's is searched, beside none."""

_AS_GOOD = 0.1
"""Share by which two costs may differ that are alike."""

_TOUCHING = "Leave that time out, or record the set again with nothing near the limb."
_SLOWLY = "Give the gyroscope's readings as well, or move slowly."
_WEIGH = "Weigh what was added and measure where it hung, or leave the set out."


@dataclass(frozen=True, eq=False)
class Evidence:
    """What causes are judged by.

    Attributes:
        sets: The sets.
        problem: Of the fit, without hysteresis.
        solution: Its solution.
        options: Of the fit.
    """

    sets: tuple[InSituSet, ...]
    problem: Problem
    solution: Solution
    options: InSituOptions

    def beside(self, columns: Sequence[Matrix]) -> Problem:
        """Return the problem with signals that act on the readings, shape (n_j, q) a set."""
        plain = self.problem
        rows = [part.at_rows(one) for part, one in zip(plain.sets, columns, strict=True)]
        parts = with_signals(plain.sets, rows, self.options)
        return replace(
            plain,
            sets=parts,
            channel_lags=columns[0].shape[1],
            whitening=whitening(parts),
            level=noise_level(parts),
        )

    def alone(self, j: int, column: Vector) -> Problem:
        """Return the problem with a signal of one set, shape (n_j,)."""
        return self.beside(
            [column[:, None] if i == j else np.zeros((len(data.raw), 1)) for i, data in enumerate(self.sets)]
        )

    def when(self, j: int, sample: int) -> str:
        """Return a moment of a set in words."""
        time = self.sets[j].time
        return f"sample {sample}" if time is None else f"{time[sample]:.1f} s"


class Cause(NamedTuple):
    """A cause that was tried.

    Attributes:
        words: What it is.
        cure: What to do about it.
        problem: Of the fit with it.
        solution: Of the fit with it.
        free: Number of unknowns that it adds.
        choices: Number of alternatives of which it is the best.
    """

    words: str
    cure: str
    problem: Problem
    solution: Solution
    free: int
    choices: int


class Likely(NamedTuple):
    """A cause and how likely it is beside the others."""

    cause: Cause
    share: float


def likeliest(evidence: Evidence) -> list[Likely]:
    """Return causes that explain something, the likeliest first."""
    nothing = Cause("", "", evidence.problem, evidence.solution, 0, 1)
    tried = [nothing]
    for look in CAUSES:
        # What is garbage with one cause left out may have no answer with another.
        with suppress(np.linalg.LinAlgError):
            tried += look(evidence)
    values = [_deviance(cause) for cause in tried]
    best = tried[int(np.argmin(values))]
    rows = sum(part.rows for part in evidence.problem.sets)
    share = _independent(best.problem.sets)
    # Twice the logarithm of the number of alternatives is what the best of them gains by chance.
    scores = np.array(
        [
            share * value + cause.free * np.log(share * rows) + 2.0 * np.log(cause.choices)
            for value, cause in zip(values, tried, strict=True)
        ]
    )
    weights = np.exp(-0.5 * (scores - scores.min()))
    weights /= weights.sum()
    order = np.argsort(scores)
    return [Likely(tried[i], float(weights[i])) for i in order[: list(order).index(0)]]


def _deviance(cause: Cause) -> float:
    """Return minus twice the log-likelihood at the noise's likeliest covariance; infinite for no answer."""
    parts = cause.problem.sets
    rows = sum(part.rows for part in parts)
    left = (cause.solution.residual @ np.linalg.inv(cause.problem.whitening).T).reshape(-1, len(parts[0].rr))
    scatter = left.T @ left + sum(part.rr.T @ part.rr for part in parts)
    size = np.sqrt(np.maximum(np.diag(scatter), np.finfo(float).tiny))
    _, logdet = np.linalg.slogdet(scatter / np.outer(size, size))
    of_colour = len(size) * sum(part.log_colour for part in parts)
    value = float(rows * (logdet + 2.0 * np.sum(np.log(size))) + of_colour)
    return value if np.isfinite(value) else np.inf


def explained(symptom: CalibrationRefused, evidence: Evidence, warnings: Sequence[str]) -> CalibrationRefused:
    """Return a refusal with what likeliest lies behind it; the symptom itself if no cause explains it.

    ``warnings`` are those of the sets, which may say it already.
    """
    fast = [text for text in warnings if TOO_FAST in text]
    if fast:
        return CalibrationRefused(f"{symptom.reason} {fast[0]}", _SLOWLY)
    found = likeliest(evidence)[:2]
    if not found:
        return symptom
    named = [f"{cause.words} ({_percent(share)})" for cause, share in found]
    return CalibrationRefused(f"{symptom.reason} Likeliest: {'; then '.join(named)}.", found[0].cause.cure)


def _percent(share: float) -> str:
    return "> 99 %" if share > 0.99 else "< 1 %" if share < 0.01 else f"{share:.0%}".replace("%", " %")


def _independent(parts: Sequence[CompressedSet]) -> float:
    """Return the share of rows that are worth an independent one, by the correlation of neighbours."""
    before = np.concatenate([part.residual[:-1] for part in parts])
    after = np.concatenate([part.residual[1:] for part in parts])
    size = float(np.sqrt(np.sum(before**2) * np.sum(after**2)))
    rho = float(np.sum(before * after)) / size if size > 0.0 else 0.0
    return float(np.clip((1.0 - rho) / (1.0 + rho), 1e-3, 1.0))


# What happened within a set: signals that act on its readings.


def _gains(evidence: Evidence, j: int, columns: Matrix) -> Vector:
    """Return by how much each of the columns, shape (n, K), explains what a set's fit leaves, shape (K,)."""
    data, part = evidence.sets[j], evidence.problem.sets[j]
    rows = np.flatnonzero(part.used)
    rows = rows[:: max(len(rows) // _THINNED, 1)]
    u = signals(data, evidence.problem.moving)[rows]
    span = np.linspace(-1.0, 1.0, len(rows))
    left, singular, _ = np.linalg.svd(
        np.column_stack([np.ones(len(rows)), span, u / np.maximum(np.ptp(u, axis=0), 1e-300)]),
        full_matrices=False,
    )
    basis = left[:, singular > 1e-9 * singular[0]]
    z = columns[rows] - basis @ (basis.T @ columns[rows])
    raw = data.raw[rows]
    residual = raw - basis @ (basis.T @ raw)
    white = np.linalg.cholesky(np.linalg.pinv(residual.T @ residual / len(rows), hermitian=True))
    size = np.sum(z**2, axis=0)
    seen = size > 1e-9 * np.maximum(np.sum(columns[rows] ** 2, axis=0), 1e-300)
    gain = np.sum((z.T @ residual @ white) ** 2, axis=1) / np.where(seen, size, 1.0)
    return np.where(seen, gain, 0.0)


def _steps_and_touches(evidence: Evidence) -> Iterator[Cause]:
    """Yield the likeliest leap of a zero, and the likeliest time in which something touched the limb."""
    channels = len(evidence.problem.whitening)
    for touch in (False, True):
        found = []
        for j, data in enumerate(evidence.sets):
            n = len(data.raw)
            edges = np.unique(np.linspace(0, n, _EDGES + 1).astype(int))
            spans = _spans(edges, n, touch)
            first, last, gain = _best_span(evidence, j, spans)
            for width in (n // _EDGES, n // _EDGES // _FINER, _FINER):
                near = [_near(first, width, n), _near(last, width, n) if touch else np.array([n])]
                fine = [(a, b) for a in near[0] for b in near[1] if b - a >= _SHORTEST]
                first, last, gain = _best_span(evidence, j, [*fine, (first, last)])
            found.append((gain, j, first, last, len(spans)))
        gain, j, first, last, choices = max(found)
        column = np.zeros(len(evidence.sets[j].raw))
        column[first:last] = 1.0
        name, begin = evidence.sets[j].name, evidence.when(j, first)
        words = (
            f"something touched the limb in '{name}' from {begin} to {evidence.when(j, last - 1)}"
            if touch
            else f"the zero of '{name}' leaps at {begin}"
        )
        cure = _TOUCHING if touch else "Cut the set there into two, or record it again."
        problem = evidence.alone(j, column)
        yield Cause(
            words,
            cure,
            problem,
            solve(problem, [evidence.solution.outer]),
            channels + 1 + touch,
            choices * len(evidence.sets),
        )


def _spans(edges: NDArray[np.int_], n: int, touch: bool) -> list[tuple[int, int]]:
    if touch:
        return [(int(a), int(b)) for a, b in combinations(edges[1:-1], 2)]
    return [(int(a), n) for a in edges[1:-1]]


def _near(edge: int, width: int, n: int) -> NDArray[np.int_]:
    return np.unique(np.clip(edge + np.linspace(-width, width, 2 * _FINER + 1).astype(int), 1, n - 1))


def _best_span(evidence: Evidence, j: int, spans: list[tuple[int, int]]) -> tuple[int, int, float]:
    """Return the likeliest of the spans of samples (first, last) and what it explains."""
    place = np.arange(len(evidence.sets[j].raw))[:, None]
    first, last = np.array(spans).T
    gains = _gains(evidence, j, ((place >= first) & (place < last)).astype(np.float64))
    best = int(np.argmax(gains))
    return int(first[best]), int(last[best]), float(gains[best])


def _ends(evidence: Evidence) -> Iterator[Cause]:
    """Yield the channel of a set that likeliest ends early."""
    best, column, words = 0.0, None, ""
    for j, data in enumerate(evidence.sets):
        predicted = _predicted(evidence, j)
        for channel in range(data.channels):
            for sign, side in ((1.0, "above"), (-1.0, "below")):
                one = sign * predicted[:, channel]
                tops = np.quantile(one, _QUANTILES)
                hinges = np.maximum(one[:, None] - tops, 0.0)
                gains = _gains(evidence, j, hinges)
                k = int(np.argmax(gains))
                if gains[k] > best:
                    best, column, of_set = float(gains[k]), hinges[:, k], j
                    words = f"channel {channel} of '{data.name}' is clipped {side} {sign * tops[k]:.4g}"
    if column is None:
        return
    problem = evidence.alone(of_set, column)
    choices = 2 * len(_QUANTILES) * len(evidence.problem.whitening) * len(evidence.sets)
    yield Cause(
        words,
        "Take the load off, set the hardware's offset again, or lower the gain.",
        problem,
        solve(problem, [evidence.solution.outer]),
        len(evidence.problem.whitening),
        choices,
    )


def _predicted(evidence: Evidence, j: int) -> Matrix:
    """Return readings of a set by its own linear fit, without its offset, shape (n, k)."""
    u = signals(evidence.sets[j], evidence.problem.moving)
    response = evidence.problem.sets[j].response[:, : u.shape[1]]
    return np.asarray(np.nan_to_num(u @ response.T))


def _postures(evidence: Evidence) -> Iterator[Cause]:
    """Yield the likeliest end of the limb's range at which it touches something, in one set and in all."""
    gains = []
    for j, data in enumerate(evidence.sets):
        hinges, names = _hinges(data)
        gains.append(_gains(evidence, j, hinges))
    table, channels = np.array(gains), len(evidence.problem.whitening)
    j, k = divmod(int(np.argmax(table)), table.shape[1])
    one = evidence.alone(j, _hinges(evidence.sets[j])[0][:, k])
    everywhere = int(np.argmax(table.sum(axis=0)))
    both = evidence.beside([_hinges(data)[0][:, [everywhere]] for data in evidence.sets])
    for problem, name, where in ((one, f" in '{evidence.sets[j].name}'", k), (both, "", everywhere)):
        yield Cause(
            f"the limb touches something{name} where gravity has much of {names[where]}",
            _TOUCHING,
            problem,
            solve(problem, [evidence.solution.outer]),
            channels,
            table.size if name else table.shape[1],
        )


def _hinges(data: InSituSet) -> tuple[Matrix, list[str]]:
    """Return how far gravity is beyond thresholds along each axis, shape (n, K), and the axes' names."""
    columns, names = [], []
    for axis in range(3):
        for sign, name in ((1.0, "+"), (-1.0, "-")):
            along = sign * np.nan_to_num(data.gravity[:, axis])
            for top in np.quantile(along, _QUANTILES):
                columns.append(np.maximum(along - top, 0.0))
                names.append(f"{name}{'xyz'[axis]}")
    return np.stack(columns, axis=1), names


# What holds for all sets.


def _bending(evidence: Evidence) -> Iterator[Cause]:
    """Yield a limb that gives way with gravity's squares."""
    columns = []
    for data in evidence.sets:
        g = np.nan_to_num(data.gravity) / GRAVITY
        # The sixth square follows from the length of gravity.
        columns.append(np.stack([g[:, i] * g[:, j] for i, j in PAIRS if (i, j) != (2, 2)], axis=1))
    problem = evidence.beside(columns)
    yield Cause(
        "the limb bends as it turns, or the sensor is not linear",
        BENT_CURE,
        problem,
        solve(problem, [evidence.solution.outer]),
        columns[0].shape[1] * len(problem.whitening),
        1,
    )


def _speed(evidence: Evidence) -> Iterator[Cause]:
    """Yield a limb that moved too fast: what it turned by, as gravity shows it, acts on the readings."""
    moving = [turning(data) for data in evidence.sets]
    if evidence.problem.moving or not all(data.moves for data in moving):
        return
    columns = [signals(data, moving=True)[:, DIRECT.stop :] for data in moving]
    problem = evidence.beside(columns)
    yield Cause(
        TOO_FAST,
        _SLOWLY,
        problem,
        solve(problem, [evidence.solution.outer]),
        columns[0].shape[1] * len(problem.whitening),
        1,
    )


# What was added.


def _masses(evidence: Evidence) -> Iterator[Cause]:
    """Yield, for each set, another mass at the place that was given, and the mass at another place."""
    count = len(evidence.sets)
    for j, data in enumerate(evidence.sets):
        given, place = data.added_mass, data.added_com
        if given == 0.0:
            fitted = _with_added(evidence, j, np.zeros(4), lambda x: x)
            if fitted.x[0] > 0.0:
                words = f"{fitted.x[0]:.3f} kg hung in '{data.name}' at {_at(fitted.x[1:] / fitted.x[0])} m"
                yield _cause(fitted, f"{words}, and nothing was given", 4, count)
            continue
        first = given * np.concatenate([[1.0], place])
        fitted = _with_added(evidence, j, np.zeros(1), partial(_scaled, first))
        words = f"the added mass of '{data.name}' is {given * (1.0 + fitted.x[0]):.3f} kg"
        yield _cause(fitted, f"{words}, and {given:.3f} kg was given", 1, count)
        fitted = _with_added(evidence, j, np.zeros(3), partial(_shifted, first))
        words = f"the added mass of '{data.name}' hangs at {_at(place + fitted.x)} m"
        yield _cause(fitted, f"{words}, and {_at(place)} was given", 3, count)


def _scaled(first: Vector, x: Vector) -> Vector:
    return np.asarray(first * (1.0 + x[0]))


def _shifted(first: Vector, x: Vector) -> Vector:
    return np.concatenate([first[:1], first[1:] + first[0] * x])


def _at(place: Vector) -> str:
    return "({:.3f}, {:.3f}, {:.3f})".format(*place)


def _exchanged(evidence: Evidence) -> Iterator[Cause]:
    """Yield two sets whose masses are exchanged."""
    pairs = [
        (i, j)
        for i, j in combinations(range(len(evidence.sets)), 2)
        if not np.allclose(evidence.problem.added[i], evidence.problem.added[j])
    ]
    for i, j in pairs:
        order = list(range(len(evidence.sets)))
        order[i], order[j] = j, i
        problem = replace(evidence.problem, added=evidence.problem.added[order])
        near = [evidence.solution.outer, *starts(problem, None, None)]
        names = f"'{evidence.sets[i].name}' and '{evidence.sets[j].name}'"
        yield Cause(
            f"what was added in {names} is exchanged",
            _WEIGH,
            problem,
            minima(problem, near)[0],
            0,
            len(pairs),
        )


def _turned(evidence: Evidence) -> Iterator[Cause]:
    """Yield an IMU that is turned against the sensor.

    Gravity and motion in its frame are those of a sensor that is turned with it, to whose frame only the
    places of what was added were not.
    """
    plain = evidence.problem
    if not np.any(plain.added[:, MASS] > 0.0) or plain.rotation:
        return
    found = []
    for turn in Rotation.create_group("O"):
        outer = _rotate(evidence.solution.outer[None], turn)[0]
        cost = solve(replace(plain, added=_rotate(plain.added, turn)), [outer]).cost
        found.append((turn.magnitude() > 0.0, cost, turn.as_rotvec(), outer))
    # From none, and from the right angles that come next to it.
    tried = sorted(found, key=lambda one: one[:2])[: 1 + _TURNS]
    fits = [_fit_added(plain, partial(_by_turn, plain.added), start, outer) for _, _, start, outer in tried]
    lowest = min(one.solution.cost for one in fits)
    # Masses in one plane do not tell a sensor from its mirror image: the smaller turn is likelier.
    angle, fitted = min(
        (
            (float(np.degrees(Rotation.from_rotvec(one.x).magnitude())), one)
            for one in fits
            if one.solution.cost <= (1.0 + _AS_GOOD) * lowest
        ),
        key=lambda one: one[0],
    )
    yield _cause(
        fitted,
        f"the IMU is turned by {angle:.0f} degrees against the sensor's frame",
        3,
        1,
        "Give its rotation (R_sensor_accelerometer), or let the fit find it: 'estimate_rotation', with the "
        "limb at rest.",
    )


def _by_turn(parameters: Matrix, x: Vector) -> Matrix:
    return _rotate(parameters, Rotation.from_rotvec(x))


def _rotate(parameters: Matrix, turn: Rotation) -> Matrix:
    """Return inertial parameters, shape (n, p), of bodies that are turned."""
    R = turn.as_matrix()
    turned = parameters.copy()
    turned[:, MOMENT] = parameters[:, MOMENT] @ R.T
    if parameters.shape[1] >= INERTIA.stop:
        for one, given in zip(turned, parameters, strict=True):
            I = R @ inertia_matrix(given) @ R.T  # noqa: E741 - as in the equations
            one[INERTIA] = limb_parameters(0.0, one[MOMENT], I)[INERTIA]
    return np.asarray(turned)


class _Fitted(NamedTuple):
    x: Vector
    problem: Problem
    solution: Solution


def _cause(fitted: _Fitted, words: str, free: int, choices: int, cure: str = _WEIGH) -> Cause:
    return Cause(words, cure, fitted.problem, fitted.solution, free, choices)


def _with_added(evidence: Evidence, j: int, x: Vector, body: Callable[[Vector], Vector]) -> _Fitted:
    """Return the fit with another body in one set; ``body`` gives its mass and first moment, shape (4,)."""
    plain = evidence.problem

    def make(x: Vector) -> Matrix:
        mass, *moment = body(x)
        added = plain.added.copy()
        place = np.array(moment) / mass if mass != 0.0 else np.zeros(3)
        added[j] = inertial_parameters(mass, place, plain.moving)
        added[j, MOMENT] = moment
        return added

    return _fit_added(plain, make, x, evidence.solution.outer)


def _fit_added(plain: Problem, make: Callable[[Vector], Matrix], x: Vector, outer: Vector) -> _Fitted:
    """Return the fit of the problem with what was added as a function of x, by Gauss and Newton in x."""
    problem = replace(plain, added=make(x))
    solution = solve(problem, [outer])
    best = _Fitted(x, problem, solution)
    for _ in range(_STEPS):
        x, problem, solution = best
        changes = [(make(x + _DIFFERENCE * step) - make(x)) / _DIFFERENCE for step in np.eye(len(x))]
        slopes = [added_slope(problem, solution, change) for change in changes]
        free = projected(solution, np.stack(slopes, axis=1))
        rows = np.pad(solution.residual.ravel(), (0, len(free) - solution.residual.size))
        step = -np.linalg.lstsq(free, rows, rcond=None)[0]
        for share in (1.0, 0.3, 0.1):
            problem = replace(plain, added=make(x + share * step))
            tried = _Fitted(x + share * step, problem, solve(problem, [solution.outer]))
            if tried.solution.cost < best.solution.cost:
                best = tried
                break
        if best.x is x or np.max(np.abs(best.x - x)) < _SETTLED:
            break
    return best


CAUSES: tuple[Callable[[Evidence], Iterator[Cause]], ...] = (
    _steps_and_touches,
    _ends,
    _postures,
    _bending,
    _speed,
    _turned,
    _exchanged,
    _masses,
)
"""What may be wrong, each as it changes the problem."""
