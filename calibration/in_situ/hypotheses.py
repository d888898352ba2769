r"""What is wrong with sets that contradict each other: every cause that is known, by how much it explains.

Causes (:mod:`~surefoot.calibration.in_situ.causes`) are compared by Schwarz's criterion (1978), -2 log L +
d log n, each with the colour of the noise that it leaves. Rows that still hang together count as fewer than
they are, n (1 - rho) / (1 + rho) by the correlation of whitened residuals from one to the next.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from surefoot.calibration.in_situ.added_causes import OF_ADDED
from surefoot.calibration.in_situ.causes import ON_READINGS, Cause, Evidence, speed
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.solve import Problem, Solution

__all__ = ["Likely", "deviance", "explained", "likeliest", "whitened"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


class Likely(NamedTuple):
    """A cause and how likely it is beside the others."""

    cause: Cause
    share: float


def likeliest(evidence: Evidence) -> list[Likely]:
    """Return causes that explain something, the likeliest first.

    A limb that turns is felt at any speed: where that shows, it is beside every other cause, or it would be
    taken for one that is smaller in the readings and worse for the answer, as a turned IMU.
    """
    tried = [Cause("", "", evidence.problem, evidence.solution, 0, 1), *speed(evidence)]
    felt = tried[int(np.argmin(_scores(tried)))]
    beside = replace(evidence, problem=felt.problem, solution=felt.solution)
    for look in (*ON_READINGS, *OF_ADDED):
        # What is garbage with one cause left out may have no answer with another.
        with suppress(np.linalg.LinAlgError):
            tried += [cause._replace(free=cause.free + felt.free) for cause in look(beside)]
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


def explained(symptom: Finding, evidence: Evidence, drift: Finding | None) -> Finding:
    """Return a symptom with what likeliest lies behind it; the symptom itself if no cause explains it.

    Args:
        symptom: Sets that contradict each other or themselves.
        evidence: What causes are judged by.
        drift: What may hide behind a drift, or None.
    """
    if drift is not None:
        symptom = symptom.explained(drift.reason, drift.cure)
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
    return symptom.explained(f"Likeliest: {'; then '.join(named)}.", cure)


def _percent(share: float) -> str:
    return "> 99 %" if share > 0.99 else "< 1 %" if share < 0.01 else f"{share:.0%}".replace("%", " %")


def _independent(left: Sequence[Matrix]) -> float:
    """Return the share of rows that are worth an independent one, by the correlation of neighbours."""
    before, after = (np.concatenate([one[cut] for one in left]) for cut in (slice(-1), slice(1, None)))
    size = float(np.sqrt(np.sum(before**2) * np.sum(after**2)))
    rho = float(np.sum(before * after)) / size if size > 0.0 else 0.0
    return float(np.clip((1.0 - rho) / (1.0 + rho), 1e-3, 1.0))
