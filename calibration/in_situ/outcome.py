"""What a fit comes out with: the calibration and its statistics, or nothing but the reason of a refusal."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.covariance import DataShare, slope_doubt, weighted_inverse
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.fit import FitColumns, InSituFit, Limb
from surefoot.calibration.in_situ.model import (
    AXES,
    MASS,
    MOMENT,
    STATIC,
    inertia_matrix,
)
from surefoot.calibration.in_situ.solve import (
    Problem,
    Solution,
    loop_shares,
    of_unit_length,
    transforms,
)
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats

__all__ = ["outcome", "refused", "with_bending", "with_common_scale"]

Matrix = NDArray[np.float64]


def outcome(
    problem: Problem,
    solution: Solution,
    noise: Matrix,
    covariance: Matrix,
    known: DataShare,
) -> InSituFit:
    """Return the fit, without what is said of it."""
    parts, limb = problem.sets, solution.limb
    predicted = solution.response @ transforms(problem, solution)
    offsets = [part.middle.by(B) for part, B in zip(parts, predicted, strict=True)]
    stats, set_stats = _stats(problem, solution, known)
    return InSituFit(
        matrix=weighted_inverse(solution.A, noise),
        offset=parts[-1].end.by(predicted[-1]),
        offsets=np.array(offsets),
        response=solution.A,
        limb=Limb(float(limb[MASS]), limb[MOMENT], inertia_matrix(limb) if problem.moving else None),
        covariance=covariance,
        noise=noise,
        temperature_coefficient=solution.direct[:, 0] if problem.temperature else None,
        rotation=solution.rotation,
        result=FitResult.PARTLY_DETERMINED if known.unseen else FitResult.DETERMINED,
        refusals=(),
        warnings=(),
        stats=stats,
        set_stats=set_stats,
        affine_residual=np.array([part.affine_residual for part in parts]),
        set_names=tuple(part.name for part in parts),
        temperature_gain=solution.limb[problem.of_loads][: problem.gains] if problem.gains else None,
        hysteresis=loop_shares(problem, solution) if problem.hysteresis else None,
        channel_hysteresis=loop_shares(problem, solution) if problem.channel_lags else None,
        offset_doubt=slope_doubt(problem, solution, noise)[1]
        if problem.hysteresis or problem.channel_lags
        else None,
    )


def with_common_scale(fit: InSituFit, doubt: float, *, weighed: bool) -> InSituFit:
    """Return a fit all of whose gains may be off by one factor of a deviation, and what it weighs with them.

    Args:
        fit: The fit.
        doubt: The deviation.
        weighed: Whether the limb's mass was given.
    """
    covariance, columns = fit.covariance.copy(), fit.columns
    off = np.zeros(len(covariance))
    off[columns.matrix] = doubt * fit.matrix.ravel()
    if not weighed:
        off[columns.limb] = doubt * fit.limb.parameters[:STATIC]
    return replace(fit, covariance=covariance + np.outer(off, off))


def with_bending(fit: InSituFit, share: float, load: Matrix, *, weighed: bool) -> InSituFit:
    """Return a fit whose axes are each unsure by a share, for the squares of gravity in their readings.

    Squares move no slope, but what makes them has cubes as well, which do.

    Args:
        fit: The fit.
        share: Of the readings' spread.
        load: At which the last offset was found, shape (6,).
        weighed: Whether the limb's mass was given, which no axis moves.
    """
    covariance, columns = fit.covariance.copy(), fit.columns
    for axis, (row, gain) in enumerate(zip(fit.matrix, fit.response.T, strict=True)):
        place = columns.row(axis)
        covariance[place, place] += share**2 * np.outer(row, row)
        covariance[columns.offset, columns.offset] += (share * load[axis]) ** 2 * np.outer(gain, gain)
    if not weighed:
        moved = np.concatenate([[fit.limb.mass], np.full(3, np.linalg.norm(fit.limb.mass_com))])
        covariance[columns.limb, columns.limb] += np.diag((share * moved) ** 2)
    return replace(fit, covariance=covariance, bending=share)


def _stats(problem: Problem, solution: Solution, known: DataShare) -> tuple[FitStats, tuple[FitStats, ...]]:
    """Return the statistics of all sets together and of each."""
    singular = np.linalg.svd(of_unit_length(solution.jacobian)[0], compute_uv=False)
    whole = FitStats(
        samples=sum(part.samples for part in problem.sets),
        dropped=0,
        gated=0,
        residual_rms=0.0,
        rank=known.seen,
        unknowns=known.seen + known.unseen,
        condition=float(singular[0] / singular[-1]) if singular[-1] > 0.0 else np.inf,
    )
    # What each set's response leaves of the common one, by its orthonormal signals, in counts.
    left = problem.unwhitened(solution.residual)
    each = tuple(
        replace(
            whole,
            samples=part.samples,
            dropped=int(np.sum(~part.used & ~part.rejected)),
            gated=int(np.sum(part.rejected)),
            residual_rms=float(np.sqrt(np.mean((part.residual - part.score @ one) ** 2))),
        )
        for part, one in zip(problem.sets, left, strict=True)
    )
    whole = replace(
        whole,
        dropped=sum(stats.dropped for stats in each),
        gated=sum(stats.gated for stats in each),
        residual_rms=float(np.sqrt(sum(s.samples * s.residual_rms**2 for s in each) / whole.samples)),
    )
    return whole, each


def refused(sets: Sequence[InSituSet], refusals: tuple[CalibrationRefused, ...]) -> InSituFit:
    """Return a fit whose values are NaN, with the reasons."""

    def unknown(*shape: int) -> Matrix:
        return np.full(shape, np.nan)

    k, count = sets[0].channels, len(sets)
    size = FitColumns.of(k).limb.stop
    nothing = FitStats(0, 0, 0, np.nan, 0, AXES * k + STATIC, np.inf)
    return InSituFit(
        matrix=unknown(AXES, k),
        offset=unknown(k),
        offsets=unknown(count, k),
        response=unknown(k, AXES),
        limb=Limb(np.nan, unknown(3)),
        covariance=unknown(size, size),
        noise=unknown(k, k),
        temperature_coefficient=None,
        rotation=np.eye(3),
        result=FitResult.REFUSED,
        refusals=refusals,
        warnings=(),
        stats=nothing,
        set_stats=(nothing,) * count,
        affine_residual=unknown(count),
        set_names=tuple(data.name for data in sets),
    )
