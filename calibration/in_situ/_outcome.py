"""What an in-situ calibration hands back, put together; private."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ._covariance import weighted_inverse
from surefoot.calibration.in_situ._model import STATIC, inertia_matrix
from surefoot.calibration.in_situ._rank import DataRank
from surefoot.calibration.in_situ._solve import Problem, Solution, loop_shares, of_unit_length, transforms
from surefoot.calibration.in_situ.dataset import InSituSet
from surefoot.calibration.in_situ.fit import InSituFit, Limb
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats

__all__ = ["outcome", "refused"]

Matrix = NDArray[np.float64]


def outcome(
    problem: Problem,
    solution: Solution,
    noise: Matrix,
    covariance: Matrix,
    rank: DataRank,
    matrix: Matrix | None,
    sets: tuple[InSituSet, ...],
    warnings: tuple[str, ...],
) -> InSituFit:
    """Put a fit together.

    Args:
        problem: What was solved.
        solution: What came out.
        noise: Covariance of a sample, shape (k, k).
        covariance: As the fit's.
        rank: What the data determine.
        matrix: C where it leans on a factory matrix, shape (6, k); None for the inverse of the response.
        sets: What was fitted.
        warnings: What to know.
    """
    if matrix is None:
        matrix = weighted_inverse(solution.response[:, :6], noise)
    else:
        response = np.concatenate([np.linalg.pinv(matrix), solution.response[:, 6:]], axis=1)
        solution = replace(solution, response=response)
    parts = problem.sets
    predicted = solution.response @ transforms(problem, solution.limb, solution.rotation)
    offsets = [part.offset(B, part.middle) for part, B in zip(parts, predicted, strict=True)]
    singular = np.linalg.svd(of_unit_length(solution.jacobian)[0], compute_uv=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0.0 else np.inf
    unknowns = rank.found + rank.missing
    set_stats = tuple(
        FitStats(
            samples=part.samples,
            dropped=int(np.sum(~part.used & ~part.rejected)),
            gated=int(np.sum(part.rejected)),
            residual_rms=float(np.sqrt(np.mean((part.residual - part.score @ left) ** 2))),
            rank=rank.found,
            unknowns=unknowns,
            condition=condition,
        )
        for part, left in zip(parts, _left_in_counts(problem, solution), strict=True)
    )
    samples = sum(stats.samples for stats in set_stats)
    return InSituFit(
        matrix=matrix,
        offset=parts[-1].offset(predicted[-1], parts[-1].end),
        offsets=np.array(offsets),
        response=solution.response[:, :6],
        limb=Limb(
            mass=float(solution.limb[0]),
            mass_com=solution.limb[1:STATIC],
            inertia=inertia_matrix(solution.limb[:10]) if problem.moving else None,
        ),
        covariance=covariance,
        noise=noise,
        temperature_coefficient=solution.response[:, 6] if problem.temperature else None,
        rotation=solution.rotation,
        result=FitResult.PARTLY_DETERMINED if rank.missing else FitResult.DETERMINED,
        refusals=(),
        warnings=warnings,
        stats=FitStats(
            samples=samples,
            dropped=sum(stats.dropped for stats in set_stats),
            gated=sum(stats.gated for stats in set_stats),
            residual_rms=float(np.sqrt(sum(s.samples * s.residual_rms**2 for s in set_stats) / samples)),
            rank=rank.found,
            unknowns=unknowns,
            condition=condition,
        ),
        set_stats=set_stats,
        affine_residual=np.array([part.affine_residual for part in parts]),
        set_names=tuple(data.name for data in sets),
        hysteresis=loop_shares(problem, solution) if problem.hysteresis else None,
        channel_hysteresis=loop_shares(problem, solution) if problem.channel_lags else None,
    )


def _left_in_counts(problem: Problem, solution: Solution) -> Matrix:
    """What each set's response leaves of the common one, by its orthonormal signals, shape (J, s, k)."""
    return np.asarray(solution.residual @ np.linalg.inv(problem.whitening).T)


def refused(sets: Sequence[InSituSet], refusal: CalibrationRefused) -> InSituFit:
    """Say no: a fit whose values are NaN, with the reason."""
    k, count = sets[0].channels, len(sets)
    nothing = FitStats(0, 0, 0, np.nan, 0, 6 * k + STATIC, np.inf)
    return InSituFit(
        matrix=np.full((6, k), np.nan),
        offset=np.full(k, np.nan),
        offsets=np.full((count, k), np.nan),
        response=np.full((k, 6), np.nan),
        limb=Limb(np.nan, np.full(3, np.nan)),
        covariance=np.full((7 * k + STATIC, 7 * k + STATIC), np.nan),
        noise=np.full((k, k), np.nan),
        temperature_coefficient=None,
        rotation=np.eye(3),
        result=FitResult.REFUSED,
        refusals=(refusal,),
        warnings=(),
        stats=nothing,
        set_stats=(nothing,) * count,
        affine_residual=np.full(count, np.nan),
        set_names=tuple(data.name for data in sets),
    )
