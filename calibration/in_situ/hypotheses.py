r"""What is wrong with sets that contradict each other: every cause that is known, by how much it explains.

Causes (:mod:`~surefoot.calibration.in_situ.causes`) are compared by Schwarz's criterion (1978), -2 log L +
d log n, each with the colour of the noise that it leaves. Rows that still hang together count as fewer than
they are, n (1 - rho) / (1 + rho) by the correlation of whitened residuals from one to the next.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.spatial.transform import Rotation

from surefoot.calibration.in_situ.causes import ON_READINGS, Cause, Evidence
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.judge import added_slope, projected
from surefoot.calibration.in_situ.model import (
    INERTIA,
    MASS,
    MOMENT,
    inertia_matrix,
    inertial_parameters,
    limb_parameters,
)
from surefoot.calibration.in_situ.solve import Problem, Solution, minima, solve
from surefoot.calibration.in_situ.starts import starts

__all__ = ["Likely", "deviance", "likeliest", "name_cause", "whitened"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


class Likely(NamedTuple):
    """A cause and how likely it is beside the others."""

    cause: Cause
    share: float


def likeliest(evidence: Evidence) -> list[Likely]:
    """Return causes that explain something, the likeliest first."""
    tried = [Cause("", "", evidence.problem, evidence.solution, 0, 1)]
    for look in (*ON_READINGS, *OF_ADDED):
        # What is garbage with one cause left out may have no answer with another.
        with suppress(np.linalg.LinAlgError):
            tried += look(evidence)
    scores = _scores(tried)
    weights = np.exp(-0.5 * (scores - scores.min()))
    weights /= weights.sum()
    order = np.argsort(scores)
    return [Likely(tried[i], float(weights[i])) for i in order[: list(order).index(0)]]


def _scores(tried: Sequence[Cause]) -> Vector:
    """Return Schwarz's criterion of causes, the first of which is none, shape (c,)."""
    left = [whitened(cause.problem, cause.solution) for cause in tried]
    values = [deviance(cause.problem.sets, one) for cause, one in zip(tried, left, strict=True)]
    share = _independent(left[int(np.argmin(values))])
    rows = sum(map(len, left[0]))
    # Twice the logarithm of the number of alternatives is what the best of them gains by chance.
    return np.array(
        [
            share * value + cause.free * np.log(share * rows) + 2.0 * np.log(cause.choices)
            for value, cause in zip(values, tried, strict=True)
        ]
    )


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


def name_cause(symptom: Finding, evidence: Evidence, drift: Finding | None) -> Finding:
    """Return a symptom with what likeliest lies behind it; the symptom itself if no cause explains it.

    Args:
        symptom: Sets that contradict each other or themselves.
        evidence: What causes are judged by.
        drift: What may hide behind a drift, or None.
    """
    if drift is not None:
        symptom = symptom.with_cause(drift.reason, drift.cure)
    found = likeliest(evidence)
    if not found:
        return symptom
    shares: dict[str, float] = {}
    for cause, share in found:
        shares[cause.words] = shares.get(cause.words, 0.0) + share
    named = [f"{words} ({_percent(share)})" for words, share in list(shares.items())[:2]]
    cure = found[0].cause.cure
    if drift is not None:
        cure += f" If that is not it: {symptom.cure}"
    return symptom.with_cause(f"Likeliest: {'; then '.join(named)}.", cure)


def _percent(share: float) -> str:
    return "> 99 %" if share > 0.99 else "< 1 %" if share < 0.01 else f"{share:.0%}".replace("%", " %")


def _independent(left: Sequence[Matrix]) -> float:
    """Return the share of rows that are worth an independent one, by the correlation of neighbours."""
    before, after = (np.concatenate([one[cut] for one in left]) for cut in (slice(-1), slice(1, None)))
    size = float(np.sqrt(np.sum(before**2) * np.sum(after**2)))
    rho = float(np.sum(before * after)) / size if size > 0.0 else 0.0
    return float(np.clip((1.0 - rho) / (1.0 + rho), 1e-3, 1.0))


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

_WEIGH = "Weigh what was added and measure where it hung, or leave the set out."


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
        fitted = _with_added(evidence, j, np.zeros(1), partial(_scale, first))
        words = f"the added mass of '{data.name}' is {given * (1.0 + fitted.x[0]):.3f} kg"
        yield _cause(fitted, f"{words}, and {given:.3f} kg was given", 1, count)
        fitted = _with_added(evidence, j, np.zeros(3), partial(_shift, first))
        words = f"the added mass of '{data.name}' hangs at {_at(place + fitted.x)} m"
        yield _cause(fitted, f"{words}, and {_at(place)} was given", 3, count)


def _scale(first: Vector, x: Vector) -> Vector:
    return np.asarray(first * (1.0 + x[0]))


def _shift(first: Vector, x: Vector) -> Vector:
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


OF_ADDED: tuple[Callable[[Evidence], Iterator[Cause]], ...] = (_turned, _exchanged, _masses)
"""What may be wrong with it."""
