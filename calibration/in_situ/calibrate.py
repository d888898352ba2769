r"""In-situ calibration of a six-axis F/T sensor: gravity on a limb with known masses added.

The model is the in-situ paper's (Traversaro, Pucci and Nori, 2015), the fit is not: readings carry the noise,
so readings are what is fitted, :math:`r = C^{-1} (M_b + M_a^j) g + o_j(t) + e`, over the matrix, the limb's
inertial parameters and an offset for each set. The paper's own regression is in
:mod:`~surefoot.calibration.in_situ.paper_offset` and
:mod:`~surefoot.calibration.in_situ.paper_matrix`.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import ThreadpoolController

from surefoot.calibration.in_situ.answer_checks import (
    DataRank,
    check_axes,
    check_factory,
    check_masses,
    check_rotation,
    check_scale,
    data_rank,
    limb_warnings,
    with_factory_scale,
)
from surefoot.calibration.in_situ.causes import Evidence
from surefoot.calibration.in_situ.compress import CompressedSet, compress
from surefoot.calibration.in_situ.covariance import (
    fit_covariance,
    noise_level,
    pooled_noise,
    whitening,
    with_disagreement,
    with_rows,
)
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.factory import choose_shares, leaning_matrix, likely_shares
from surefoot.calibration.in_situ.fit import FitColumns, InSituFit
from surefoot.calibration.in_situ.held_out import with_nonlinear
from surefoot.calibration.in_situ.hypotheses import explained
from surefoot.calibration.in_situ.hysteresis import with_hysteresis
from surefoot.calibration.in_situ.information import data_share, slow_turn
from surefoot.calibration.in_situ.input_checks import (
    Contradiction,
    check_bending,
    check_sets,
    check_within,
)
from surefoot.calibration.in_situ.model import (
    AXES,
    MASS,
    MOMENT,
    STATIC,
    inertial_parameters,
    transform_basis,
)
from surefoot.calibration.in_situ.options import InSituOptions, KnownLimb
from surefoot.calibration.in_situ.outcome import outcome, refused, with_bending
from surefoot.calibration.in_situ.rest import errors_of_imu
from surefoot.calibration.in_situ.solve import (
    Problem,
    Solution,
    minima,
    solve,
    starts,
    transforms,
)
from surefoot.calibration.in_situ.temperature import about_one_temperature, check_gauges, drifting, with_gains
from surefoot.calibration.results import CalibrationRefused, FitResult, accepting

__all__ = ["calibrate_in_situ"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]
_Given = tuple[tuple[InSituSet, ...], Matrix | None, KnownLimb | None, InSituOptions]

_FEW_REJECTED = 0.01
"""Share of samples that may disagree with all others as chance has it."""

_EVEN_SHARE = 0.1
"""Share by which axes may first differ from a factory matrix."""


def calibrate_in_situ(
    sets: Sequence[InSituSet],
    *,
    factory_matrix: ArrayLike | None = None,
    limb: KnownLimb | None = None,
    options: InSituOptions | None = None,
    refuse: bool = True,
    accept: str = "",
) -> InSituFit:
    """Return the calibration of a six-axis F/T sensor where it is built in.

    The model is that of III in the in-situ paper, fitted in measurement space. Three sets with different
    added masses determine the matrix (Lemma 2). With a factory matrix fewer will do: what they do not show
    stays as the maker gave it.

    Args:
        sets: Readings and gravity, a set for each added mass.
        factory_matrix: The maker's C in N and N m per count, shape (6, k), to lean on.
        limb: What is known of the limb.
        options: How to fit.
        refuse: Whether to raise where the data do not determine the fit; otherwise a fit full of NaN is
            returned, with the reason in ``refusals``.
        accept: Why a refusal shall be passed; empty if none shall. The fit that comes out holds this reason
            and all refusals that were passed. What has no answer at all is refused nevertheless.

    Returns:
        The matrix, the offsets, the limb, and how sure they are.

    Raises:
        ValueError: If shapes do not belong together, no set is given, or ``accept`` is blank.
        CalibrationRefused: If the data do not determine the fit, or contradict themselves.
    """
    if accept and not accept.strip():
        raise ValueError(
            f"'accept' must say why a refusal may be passed, got {accept!r}; leave it empty if none may."
        )
    options = InSituOptions() if options is None else options
    factory = _checked_factory(sets, factory_matrix)
    # Matrices are small: threads would only wait for each other, on a busy machine for seconds.
    with _linear_algebra().limit(limits=1, user_api="blas"):

        def answer(given: tuple[InSituSet, ...], options: InSituOptions) -> InSituFit:
            return _answer((given, factory, limb, options), refuse, accept)

        if options.nonlinear is not None:
            return with_nonlinear(tuple(sets), options, answer, weighed=limb is not None)
        return answer(tuple(sets), options)


@cache
def _linear_algebra() -> ThreadpoolController:
    """Return what sets the number of threads of linear algebra; to look for its libraries takes a while."""
    return ThreadpoolController()


def _answer(given: _Given, refuse: bool, accept: str) -> InSituFit:
    """Return the fit, or what becomes of its refusal."""
    try:
        return _fit(*given)
    except np.linalg.LinAlgError:
        refusal = _explained(
            Contradiction(
                "The readings leave a matrix without an inverse: some axis of the sensor does not show in "
                "them.",
                "Check the channels, add masses at other places, or lean more on a factory matrix.",
            ),
            given,
        )
    except Contradiction as symptom:
        refusal = _explained(symptom, given)
    except CalibrationRefused as reason:
        refusal = reason
    if accept:
        fit = _past(refusal, given, accept)
        if fit is not None:
            return fit
        refusal = CalibrationRefused(
            refusal.reason, f"{refusal.cure} It cannot be accepted: there is no answer without that."
        )
    if refuse:
        raise refusal
    return refused(given[0], refusal)


def _past(refusal: CalibrationRefused, given: _Given, accept: str) -> InSituFit | None:
    """Return the fit past a refusal, which was the first, and all others; None if there is no answer."""
    with accepting() as passed:
        try:
            fit = _fit(*given)
        except (CalibrationRefused, np.linalg.LinAlgError):
            return None
    if not np.isfinite(fit.matrix).all():
        return None
    return replace(fit, result=FitResult.ACCEPTED, refusals=(refusal, *passed[1:]), accepted=accept)


def _checked_factory(sets: Sequence[InSituSet], factory_matrix: ArrayLike | None) -> Matrix | None:
    """Return the factory matrix as an array, or raise ValueError if it or the sets cannot be."""
    if not sets:
        raise ValueError("Give at least one set of readings.")
    channels = sorted({data.channels for data in sets})
    if len(channels) > 1:
        raise ValueError(f"All sets must have the same number of channels, got {channels}.")
    if factory_matrix is None:
        return None
    factory = np.asarray(factory_matrix, dtype=np.float64)
    if factory.shape != (AXES, channels[0]):
        raise ValueError(f"'factory_matrix' must have shape (6, {channels[0]}), got {factory.shape}.")
    if not np.all(np.isfinite(factory)) or np.linalg.matrix_rank(factory) < AXES:
        raise ValueError("'factory_matrix' must be finite and of rank 6, as all matrices of makers are.")
    return factory


def _fit(
    given: tuple[InSituSet, ...], factory: Matrix | None, known: KnownLimb | None, options: InSituOptions
) -> InSituFit:
    moving = any(data.moves for data in given)
    if options.estimate_rotation and moving:
        raise ValueError("'estimate_rotation' needs a limb at rest: leave the angular velocities out.")
    warnings = check_sets(given, options, leaning=factory is not None)
    sets, reference, left_out = about_one_temperature(given)
    warnings += left_out
    parts = compress(sets, options, moving, reference is not None)
    problem = _problem(sets, parts, factory, known, options, moving, reference is not None)
    first = starts(problem, factory, problem.limb if known is not None else None)
    rank = data_rank(problem, first[0])
    if rank.missing and factory is None:
        raise rank.refusal(problem)
    if rank.missing and options.drift:
        # Too few sets to separate a drift from the load.
        return _fit(given, factory, known, replace(options, drift=0))
    loops = options.hysteresis and not rank.missing
    if not loops:
        warnings += check_within(sets, parts, options)
    if factory is not None:
        free = replace(problem, prior_response=None)
        # Masses in one plane leave a rotation and its mirror image: the matrix knows which.
        by_data = min(minima(free, starts(free, None, None)), key=partial(_from_factory, problem))
        determined = not data_rank(free, by_data.limb).missing
        try:
            warnings += check_factory(factory, problem, by_data, determined=determined)
        except CalibrationRefused:
            if not rank.missing:  # Sets that contradict each other without the matrix say nothing of it.
                check_masses(free, by_data, pooled_noise(parts), options)
            raise
        known_alone = determined and not _without_priors(free, by_data, rank, options).missing
        problem, first = _leaning(problem, first, options, by_data if known_alone else None)
    found = minima(problem, first)
    check_rotation(found)
    solution = found[0]
    if reference is not None and not rank.missing:
        problem, solution = with_gains(problem, solution, options) or (problem, solution)
    if loops:
        problem, solution = with_hysteresis(sets, problem, solution, options) or (problem, solution)
        warnings += check_within(sets, problem.sets, options)
    if reference is not None and not rank.missing:
        warnings += check_gauges(problem, solution, options)
    if factory is not None and not rank.missing:
        rank = _without_priors(problem, solution, rank, options)
    if rank.missing:
        warnings += (rank.warning(),)
    bending, bends = check_bending(sets, problem.sets, options, loops=not loops)
    warnings += bends
    noise = pooled_noise(problem.sets)
    slow = slow_turn(sets, problem.sets)
    behind = slow if slow is not None or reference is None else drifting(parts)
    with _drift_first(behind):
        warnings += check_masses(problem, solution, noise, options)
    noisy = with_disagreement(problem, solution)
    covariance = fit_covariance(noisy, solution, noise, errors_of_imu(sets, problem, solution))
    of_data = data_share(noisy, solution, noise, options.axis_tolerance)
    if problem.prior_response is not None or len(problem.limb_root):
        warnings += of_data.warnings(FitColumns.of(len(noise)))
    matrix = None
    if factory is not None and rank.missing:
        matrix, of_rows = leaning_matrix(problem, solution, factory)
        covariance = with_rows(covariance, of_rows)
    fit = outcome(problem, solution, noise, covariance, rank, matrix, warnings)
    fit = replace(fit, data_share=of_data.share)
    if bending:
        load = transforms(problem, solution)[-1, :AXES] @ problem.sets[-1].end.signals
        fit = with_bending(fit, bending, load, weighed=known is not None)
    if reference is not None:
        fit = replace(fit, temperature_reference=reference)
    with _drift_first(behind):
        check_scale(fit, options)
        if not rank.missing:
            check_axes(fit, problem, solution, options)
    if slow is not None:
        fit = replace(fit, warnings=(*fit.warnings, str(slow)))
    if known is not None:
        alone = _limb_alone(sets, problem, solution)
        return replace(fit, warnings=fit.warnings + limb_warnings(known, fit, alone))
    if factory is None:
        return fit
    of_mass = float(of_data.share[fit.columns.limb][MASS])
    return with_factory_scale(fit, 0.0 if rank.missing else of_mass)


@contextmanager
def _drift_first(drift: CalibrationRefused | None) -> Iterator[None]:
    """Where a drift may be behind a refusal, say so before it."""
    try:
        yield
    except CalibrationRefused as refusal:
        if drift is None:
            raise
        # Causes are compared, the drift among them as the colour of the noise: a leap of a zero looks alike.
        cure = f"{drift.cure} If that is not it: {refusal.cure}"
        raise Contradiction(f"{drift.reason} {refusal.reason}", cure) from refusal


def _from_factory(problem: Problem, solution: Solution) -> float:
    """Return how far a solution's response is from the factory's."""
    assert problem.prior_response is not None
    return float(np.linalg.norm(problem.whitening @ (solution.A - problem.prior_response)))


def _without_priors(problem: Problem, solution: Solution, rank: DataRank, options: InSituOptions) -> DataRank:
    """Return what the data know beside a factory matrix, which may be less than their rank."""
    noise = pooled_noise(problem.sets)
    of_data = data_share(with_disagreement(problem, solution), solution, noise, options.axis_tolerance)
    if not of_data.unseen:
        return rank
    return DataRank(rank.found + rank.missing - of_data.unseen, of_data.unseen, of_data.left_open)


def _explained(symptom: Contradiction, given: _Given) -> CalibrationRefused:
    """Return a symptom with its likeliest cause."""
    sets, factory, _, options = given
    try:
        return explained(symptom, _evidence(*given), check_sets(sets, options, leaning=factory is not None))
    except np.linalg.LinAlgError:
        return symptom


def _evidence(
    given: tuple[InSituSet, ...], factory: Matrix | None, known: KnownLimb | None, options: InSituOptions
) -> Evidence:
    """Return what causes are judged by: the fit without hysteresis, of all samples where many disagree."""
    moving = any(data.moves for data in given)
    sets, reference, _ = about_one_temperature(given)
    parts = compress(sets, options, moving, reference is not None)
    if max(float(np.mean(part.rejected)) for part in parts) > _FEW_REJECTED:
        options = replace(options, robust=False)
        parts = compress(sets, options, moving, reference is not None)
    problem = _problem(sets, parts, None, known, options, moving, reference is not None)
    first = starts(problem, factory, problem.limb if known is not None else None)
    if factory is not None and data_rank(problem, first[0]).missing:
        problem = _problem(sets, parts, factory, known, options, moving, reference is not None)
        problem, first = _leaning(problem, first, options, None)
    return Evidence(sets, problem, minima(problem, first)[0], options)


def _problem(
    sets: tuple[InSituSet, ...],
    parts: tuple[CompressedSet, ...],
    factory: Matrix | None,
    known: KnownLimb | None,
    options: InSituOptions,
    moving: bool,
    temperature: bool,
) -> Problem:
    limb, root = _limb_rows(known, moving)
    return Problem(
        sets=parts,
        added=np.array([inertial_parameters(data.added_mass, data.added_com, moving) for data in sets]),
        whitening=whitening(parts),
        basis=transform_basis(moving),
        moving=moving,
        temperature=temperature,
        channel_lags=0,
        rotation=options.estimate_rotation,
        prior_response=None if factory is None else np.asarray(np.linalg.pinv(factory), dtype=np.float64),
        prior_shares=np.full(AXES, np.inf),
        limb=limb,
        limb_root=root,
        level=noise_level(parts),
    )


def _limb_rows(known: KnownLimb | None, moving: bool) -> tuple[Vector, Matrix]:
    """Return what is known of the limb's inertial parameters, (p,), and rows that weigh it, (q, p)."""
    count = len(transform_basis(moving))
    if known is None:
        return np.zeros(count), np.zeros((0, count))
    com = np.zeros(3) if known.com is None else known.com
    expected = inertial_parameters(known.mass, com, moving)
    rows = np.zeros((1 if known.com is None else STATIC, count))
    rows[MASS, MASS] = 1.0 / known.mass_std
    if known.com is not None:
        # The first moment is com m: a mass that is off does not move the centre.
        rows[MOMENT, MOMENT] = np.eye(3) / (known.mass * known.com_std)
        rows[MOMENT, MASS] = -com / (known.mass * known.com_std)
    return expected, rows


def _leaning(
    problem: Problem, first: list[Vector], options: InSituOptions, alone: Solution | None
) -> tuple[Problem, list[Vector]]:
    """Return the problem with the weight that the factory matrix gets, and where to start from.

    ``alone`` is the solution without it, where the data determine one.
    """
    assert problem.prior_response is not None
    even = replace(problem, prior_shares=np.full(AXES, _EVEN_SHARE))
    found = minima(even, first)
    check_rotation(found)
    start = found[0].outer
    if options.factory_std is not None:
        shares = np.array(options.factory_std)
    elif alone is not None:
        shares = likely_shares(replace(problem, prior_response=None), alone, problem.prior_response)
    else:
        shares = choose_shares(problem, start)
    return replace(problem, prior_shares=shares), [start]


def _limb_alone(
    sets: Sequence[InSituSet], problem: Problem, solution: Solution
) -> tuple[float, float] | None:
    """Return the limb's mass and its deviation in kg by the readings; None if they do not determine it."""
    of_limb = len(problem.limb_root) - (problem.parameters - problem.of_loads.start)
    free = replace(problem, limb_root=problem.limb_root[of_limb:], prior_response=None)
    if data_rank(free, solution.limb).missing:
        return None
    alone = solve(free, [solution.outer])
    beside = errors_of_imu(sets, free, alone)
    covariance = fit_covariance(with_disagreement(free, alone), alone, pooled_noise(free.sets), beside)
    mass = FitColumns.of(len(alone.A)).limb.start + MASS
    return float(alone.limb[MASS]), float(np.sqrt(covariance[mass, mass]))
