r"""What is wrong with sets that contradict each other: every cause that is known, by how much it explains.

Causes (:mod:`~surefoot.calibration.in_situ.causes`) are compared by Schwarz's criterion (1978), -2 log L +
d log n. Samples whose residuals hang together count as fewer than they are, n (1 - rho) / (1 + rho) by their
correlation from one to the next.
"""

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from surefoot.calibration.in_situ.added_causes import OF_ADDED
from surefoot.calibration.in_situ.causes import ON_READINGS, SLOWLY, Cause, Evidence
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.input_checks import TOO_FAST
from surefoot.calibration.results import CalibrationRefused

__all__ = ["Likely", "explained", "likeliest"]


class Likely(NamedTuple):
    """A cause and how likely it is beside the others."""

    cause: Cause
    share: float


def likeliest(evidence: Evidence) -> list[Likely]:
    """Return causes that explain something, the likeliest first."""
    nothing = Cause("", "", evidence.problem, evidence.solution, 0, 1)
    tried = [nothing]
    for look in (*ON_READINGS, *OF_ADDED):
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
        return CalibrationRefused(f"{symptom.reason} {fast[0]}", SLOWLY)
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
