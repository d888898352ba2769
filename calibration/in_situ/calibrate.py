r"""In-situ calibration of a six-axis F/T sensor: gravity on a limb with known masses added.

The model is the in-situ paper's (Traversaro, Pucci and Nori, 2015), the fit is not: readings carry the noise,
so readings are what is fitted, :math:`r = C^{-1} (M_b + M_a^j) g + o_j(t) + e`, over the matrix, the limb's
inertial parameters and an offset a set. The paper's own regression is in
:mod:`~surefoot.calibration.in_situ.paper_offset` and
:mod:`~surefoot.calibration.in_situ.paper_matrix`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.in_situ.answer_checks import (
    DataRank,
    check_axes,
    check_factory,
    check_masses,
    check_rotation,
    check_scale,
    data_rank,
    doubts_of_limb,
    with_doubt_of_scale,
)
from surefoot.calibration.in_situ.compress import CompressedSet, compress
from surefoot.calibration.in_situ.covariance import (
    fit_covariance,
    inflation,
    persistence,
    pooled_noise,
    weighted_inverse,
    whitening,
    with_rows,
)
from surefoot.calibration.in_situ.data import InSituSet, about_one_temperature
from surefoot.calibration.in_situ.factory import choose_shares, information, leaning_matrix
from surefoot.calibration.in_situ.fit import InSituFit, Limb
from surefoot.calibration.in_situ.hysteresis import with_hysteresis
from surefoot.calibration.in_situ.input_checks import check_bending, check_sets, check_within
from surefoot.calibration.in_situ.model import STATIC, inertia_matrix, inertial_parameters, sensitivity
from surefoot.calibration.in_situ.options import InSituOptions, KnownLimb
from surefoot.calibration.in_situ.solve import (
    Problem,
    Solution,
    loop_shares,
    minima,
    of_unit_length,
    solve,
    starts,
    transforms,
)
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats

__all__ = ["calibrate_in_situ"]

Matrix = NDArray[np.float64]

_EVEN_SHARE = 0.1
"""Share by which axes are first let differ from a factory matrix."""


def calibrate_in_situ(
    sets: Sequence[InSituSet],
    *,
    factory_matrix: ArrayLike | None = None,
    limb: KnownLimb | None = None,
    options: InSituOptions | None = None,
    refuse: bool = True,
) -> InSituFit:
    """Calibrate a six-axis F/T sensor where it is built in (in-situ paper, III, in measurement space).

    Three sets with different added masses determine the matrix (Lemma 2). With a factory matrix fewer will
    do: what they do not show stays as the maker said.

    Args:
        sets: Readings and gravity, a set for each added mass.
        factory_matrix: The maker's C in N and N m per count, shape (6, k), to lean on.
        limb: What is known of the limb.
        options: How to fit.
        refuse: Whether to raise what the data cannot tell; otherwise the fit is returned, NaN, with the
            reason in ``refusals``.

    Returns:
        The matrix, the offsets, the limb, and how sure they are.

    Raises:
        ValueError: If shapes do not belong together or no set is given.
        CalibrationRefused: If the data cannot tell, or contradict themselves.
    """
    options = InSituOptions() if options is None else options
    factory = _checked_factory(sets, factory_matrix)
    try:
        return _fit(tuple(sets), factory, limb, options)
    except np.linalg.LinAlgError:
        refusal = CalibrationRefused(
            "The readings leave a matrix without an inverse: some axis of the sensor does not show in them.",
            "Check the channels, add masses at other places, or lean more on a factory matrix.",
        )
    except CalibrationRefused as reason:
        refusal = reason
    if refuse:
        raise refusal
    return _refused(sets, refusal)


def _checked_factory(sets: Sequence[InSituSet], factory_matrix: ArrayLike | None) -> Matrix | None:
    if not sets:
        raise ValueError("Give at least one set of readings.")
    channels = sorted({data.channels for data in sets})
    if len(channels) > 1:
        raise ValueError(f"All sets must have the same number of channels, got {channels}.")
    if factory_matrix is None:
        return None
    factory = np.asarray(factory_matrix, dtype=np.float64)
    if factory.shape != (6, channels[0]):
        raise ValueError(f"'factory_matrix' must have shape (6, {channels[0]}), got {factory.shape}.")
    if not np.all(np.isfinite(factory)) or np.linalg.matrix_rank(factory) < 6:
        raise ValueError("'factory_matrix' must be finite and of rank 6: no matrix of a maker is not.")
    return factory


def _fit(
    sets: tuple[InSituSet, ...], factory: Matrix | None, known: KnownLimb | None, options: InSituOptions
) -> InSituFit:
    moving = any(data.moves for data in sets)
    if options.estimate_rotation and moving:
        raise ValueError("'estimate_rotation' needs a limb at rest: leave the angular velocities out.")
    warnings = check_sets(sets, options, leaning=factory is not None)
    given = sets
    sets, reference, said = about_one_temperature(given)
    warnings += said
    parts = compress(sets, options, moving, reference is not None)
    problem = _problem(sets, parts, factory, known, options, moving, reference is not None)
    first = starts(problem, factory, problem.limb if known is not None else None)
    rank = data_rank(problem, first[0])
    if rank.missing and factory is None:
        raise rank.refusal(problem)
    if rank.missing and options.drift:
        # Too few sets to tell a drift from the load.
        return _fit(given, factory, known, replace(options, drift=0))
    warnings += check_within(sets, parts, options)
    if rank.missing:
        warnings += (rank.warning(),)
    if factory is not None:
        problem, first = _leaning(problem, first, options)
    found = minima(problem, first)
    check_rotation(found)
    solution = found[0]
    loops = options.hysteresis and not rank.missing and all(data.time is not None for data in sets)
    if loops:
        problem, solution = with_hysteresis(sets, problem, solution, options) or (problem, solution)
    check_bending(sets, problem.sets, options, loops=not loops)
    noise = pooled_noise(problem.sets)
    if factory is not None:
        check_factory(factory, problem, solution)
    check_masses(problem, solution, noise, options)
    rows = sum(part.uu.shape[0] for part in problem.sets) * len(noise)
    factor = inflation(problem, solution, rows - rank.found)
    covariance = fit_covariance(problem, solution, noise, factor)
    matrix = None
    if factory is not None and rank.missing:
        matrix, of_rows = leaning_matrix(problem, solution, factory)
        covariance = with_rows(covariance, of_rows)
    fit = _outcome(problem, solution, noise, covariance, rank, matrix, sets, warnings)
    if reference is not None:
        fit = replace(fit, temperature_reference=reference)
    check_scale(fit, options)
    if not rank.missing:
        check_axes(fit, problem, solution, options)
    if known is not None:
        fit = replace(
            fit, warnings=fit.warnings + doubts_of_limb(known, fit, _limb_alone(problem, solution, factor))
        )
    return with_doubt_of_scale(fit) if rank.missing and known is None else fit


def _limb_alone(problem: Problem, solution: Solution, factor: float) -> tuple[float, float] | None:
    """The limb's mass and its deviation in kg by the readings alone; None if they do not tell."""
    of_hysteresis = problem.limb_root[-6:] if problem.hysteresis else problem.limb_root[:0]
    free = replace(problem, limb_root=of_hysteresis, prior_response=None)
    if data_rank(free, solution.limb).missing:
        return None
    alone = solve(free, [solution.outer])
    place = alone.jacobian.shape[1] - free.outer
    unit, size = of_unit_length(alone.jacobian)
    covariance = np.linalg.pinv(unit.T @ unit, hermitian=True)
    return float(alone.limb[0]), float(np.sqrt(factor * covariance[place, place]) / size[place])


def _problem(
    sets: tuple[InSituSet, ...],
    parts: tuple[CompressedSet, ...],
    factory: Matrix | None,
    known: KnownLimb | None,
    options: InSituOptions,
    moving: bool,
    temperature: bool,
) -> Problem:
    W = whitening(parts)
    if factory is not None or known is not None:
        # What hangs together in time must not overrule what is known beforehand.
        W = W / np.sqrt(persistence(parts, W))
    limb, root = _limb_rows(known, moving)
    return Problem(
        sets=parts,
        added=np.array([inertial_parameters(data.added_mass, data.added_com, moving) for data in sets]),
        whitening=W,
        basis=sensitivity(moving),
        moving=moving,
        temperature=temperature,
        channel_lags=0,
        rotation=options.estimate_rotation,
        prior_response=None if factory is None else np.asarray(np.linalg.pinv(factory), dtype=np.float64),
        prior_information=np.zeros(6),
        limb=limb,
        limb_root=root,
    )


def _limb_rows(known: KnownLimb | None, moving: bool) -> tuple[NDArray[np.float64], Matrix]:
    """What is known of the limb's inertial parameters, (p,), and rows that weigh it, (q, p)."""
    count = len(inertial_parameters(1.0, np.zeros(3), moving))
    if known is None:
        return np.zeros(count), np.zeros((0, count))
    com = np.zeros(3) if known.com is None else known.com
    expected = inertial_parameters(known.mass, com, moving)
    rows = np.zeros((1 if known.com is None else STATIC, count))
    rows[0, 0] = 1.0 / known.mass_std
    for axis in range(1, len(rows)):
        # The first moment is com m: a mass that is off does not move the centre.
        rows[axis, axis] = 1.0 / (known.mass * known.com_std)
        rows[axis, 0] = -com[axis - 1] / (known.mass * known.com_std)
    return expected, rows


def _leaning(
    problem: Problem, first: list[NDArray[np.float64]], options: InSituOptions
) -> tuple[Problem, list[NDArray[np.float64]]]:
    """Choose how much to lean on the factory matrix, and where to start from."""
    assert problem.prior_response is not None
    response, W = problem.prior_response, problem.whitening
    even = replace(problem, prior_information=information(response, W, np.full(6, _EVEN_SHARE)))
    found = minima(even, first)
    check_rotation(found)
    start = found[0].outer
    shares = choose_shares(problem, start) if options.factory_std is None else np.array(options.factory_std)
    return replace(problem, prior_information=information(response, W, shares)), [start]


def _outcome(
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


def _refused(sets: Sequence[InSituSet], refusal: CalibrationRefused) -> InSituFit:
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
