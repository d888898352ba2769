"""What a fit comes out with: the calibration and its statistics, or nothing but the reason of a refusal."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.beside import drifting, shows_loops
from surefoot.calibration.in_situ.check import check_bending
from surefoot.calibration.in_situ.compress import compress
from surefoot.calibration.in_situ.covariance import (
    DataShare,
    data_share,
    fit_covariance,
    pooled_noise,
    slope_doubt,
    slow_turn,
    unknowns_root,
    weighted_inverse,
)
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.fit import FitColumns, InSituFit, Limb
from surefoot.calibration.in_situ.gravity import errors_of_imu
from surefoot.calibration.in_situ.judge import (
    check_answer,
    check_axes,
    check_limb,
    check_masses,
    check_scale,
    data_rank,
)
from surefoot.calibration.in_situ.maker import (
    COMMON,
)
from surefoot.calibration.in_situ.model import (
    AXES,
    MASS,
    MOMENT,
    STATIC,
    inertia_matrix,
)
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.in_situ.solve import (
    Problem,
    Solution,
    loop_shares,
    of_unit_length,
    solve,
    transforms,
)
from surefoot.calibration.in_situ.task import Solved, Task
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats

__all__ = ["fit_of", "refused"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

_MAKER = 0.02
"""Deviation of a factory matrix that is kept, as a share of full scale: sheets state 1 to 2 %."""


def _outcome(
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


def _with_common_scale(fit: InSituFit, doubt: float, *, weighed: bool) -> InSituFit:
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


def _with_bending(fit: InSituFit, share: float, load: Matrix, *, weighed: bool) -> InSituFit:
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


def fit_of(task: Task, solved: Solved) -> InSituFit:
    """Return the answer; what is to be said of it goes to the findings."""
    options, findings, sets = task.options, solved.findings, solved.sets
    problem, solution = solved.problem, solved.solution
    timed = all(data.time is not None for data in sets)
    hidden = not (options.hysteresis and timed and shows_loops(problem))
    bending, bends = check_bending(sets, problem.sets, options, loops=hidden)
    findings += bends
    noise = pooled_noise(problem.sets)
    behind = _drift(solved)
    if behind is not None:
        findings.append(behind)
    doubted = [] if task.limb is None else check_limb(task.limb, *_limb_alone(task, solved), options)
    # A limb that is not as it was given draws all masses with it.
    findings += doubted or check_masses(problem, solution, noise, options)
    covariance = _covariance(task, solved, solution, noise)
    of_data = data_share(problem, solution, noise, options.axis_tolerance)
    if problem.maker is not None or len(problem.limb_root):
        findings += of_data.findings(FitColumns.of(len(noise)))
    fit = _outcome(problem, solution, noise, covariance, of_data)
    if problem.maker is not None and options.factory_std is None:
        known = float(of_data.share[fit.columns.limb][MASS])
        fit = _with_common_scale(fit, COMMON * (1.0 - known), weighed=task.limb is not None)
    fit = replace(
        fit,
        data_share=of_data.share,
        accelerometer_bias=solved.sphere.bias,
        accelerometer_scale=solved.sphere.scale,
        delay=solved.delay,
        temperature_reference=0.0 if solved.reference is None else solved.reference,
    )
    if task.mode == "keep":
        assert task.factory is not None
        fit = replace(fit, matrix=task.factory, response=np.asarray(np.linalg.pinv(task.factory)))
    fit = _with_shares(task, solved, fit)
    if bending:
        load = transforms(problem, solution)[-1, :AXES] @ problem.sets[-1].end.signals
        fit = _with_bending(fit, bending, load, weighed=task.limb is not None)
    findings += check_scale(fit, options, leaning=problem.maker is not None)
    if problem.maker is None:
        findings += check_axes(fit, problem, solution, options)
    findings += check_answer(fit, task.factory)
    return fit


def _drift(solved: Solved) -> Finding | None:
    """Return what may hide behind a drift, or None."""
    slow = slow_turn(solved.sets, solved.problem.sets)
    if slow is not None or solved.reference is None:
        return slow
    return drifting(compress(solved.sets, InSituOptions(), solved.problem.moving, True))


def _covariance(task: Task, solved: Solved, solution: Solution, noise: Matrix) -> Matrix:
    """Return the covariance of the answer: of each member, and of what lies between them."""
    problem = solved.problem

    def unknowns(one: Solution) -> Vector:
        return np.concatenate([(problem.whitening @ one.response).ravel(), one.outer])

    middle, roots = unknowns(solution), []
    for one in solved.members:
        root = unknowns_root(one.problem, one.solution)
        roots += [
            np.sqrt(one.weight) * root,
            np.sqrt(one.weight) * (unknowns(one.solution) - middle)[:, None],
        ]
    root = np.concatenate(roots, axis=1)
    if task.mode == "keep":
        root = np.concatenate([root, _kept_doubt(task, problem, solution, noise)], axis=1)
    beside = errors_of_imu(solved.sets, problem, solution, solved.sphere, solved.delay_std)
    return fit_covariance(problem, solution, noise, beside, root)


def _kept_doubt(task: Task, problem: Problem, solution: Solution, noise: Matrix) -> Matrix:
    """Return by how much deviations of a kept matrix's entries move all unknowns, shape (u, 36)."""
    prior = task.prior(noise, _MAKER)
    assert prior is not None
    errors = np.diag(prior.std.ravel()).reshape(AXES, AXES, -1)
    changes = np.einsum("ka,abq->kbq", problem.whitening @ prior.response, errors)
    linear = len(changes) * problem.inputs
    moved = np.zeros((linear + problem.outer, changes.shape[2]))
    moved[:linear].reshape(len(changes), problem.inputs, -1)[:, :AXES] = changes
    of_sets = solution.jacobian[: solution.residual.size]
    rows = np.concatenate([of_sets, solution.jacobian[-len(problem.limb_root) or len(solution.jacobian) :]])
    rest = rows[:, linear:]
    moved[linear:] = -np.linalg.lstsq(rest, rows[:, :linear] @ moved[:linear], rcond=None)[0]
    return moved


def _with_shares(task: Task, solved: Solved, fit: InSituFit) -> InSituFit:
    """Return the fit with what the readings know of the maker's errors, and what was found in words."""
    what = "bias, mass and centre of mass"
    sets = len(np.unique(np.round(solved.problem.added[:, :STATIC], 9), axis=0))
    tools = "one load" if sets == 1 else f"{sets} loads"
    if task.factory is None or task.mode == "free":
        return replace(fit, scope=f"{what}, and a matrix of its own ({tools})")
    if task.mode == "keep":
        return replace(fit, scope=f"{what}; matrix kept ({tools})")
    assert solved.problem.maker is not None
    prior, posterior = np.zeros((AXES, AXES)), np.zeros((AXES, AXES))
    for one in solved.members:
        assert one.problem.maker is not None
        prior += one.weight * one.problem.maker.std**2
        posterior += one.weight * _error_variance(one.problem, one.solution)
    known = np.clip(1.0 - posterior / prior, 0.0, 1.0)
    scales = solved.problem.maker.std / np.diag(solved.problem.maker.std)[0]
    D = task.factory @ fit.response - np.eye(AXES)
    moved = float(np.max(np.abs(D) / scales))
    share = float(np.exp(sum(one.weight * np.log(max(one.share, 1e-9)) for one in solved.members)))
    number = int(np.sum(known > 0.5))
    words = (
        f"{what}; matrix within {100.0 * moved:.2g} % of full scale of the factory's, {number} of 36 entries "
        f"by the readings ({tools})"
    )
    return replace(
        fit,
        scope=words,
        maker_known=known,
        maker_share=float(np.mean(task.options.factory_std)) if task.options.factory_std else share,
    )


def _error_variance(problem: Problem, solution: Solution) -> Matrix:
    """Return the posterior variances of the entries of D, shape (6, 6)."""
    assert problem.maker is not None
    root = unknowns_root(problem, solution)
    errors = problem.maker.errors(problem.whitening, problem.inputs)
    return np.asarray(np.sum((errors @ root[: errors.shape[1]]) ** 2, axis=1).reshape(AXES, AXES))


def _limb_alone(task: Task, solved: Solved) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return the limb's mass and its deviation in kg by the readings alone, and with the factory matrix."""
    problem, solution = solved.problem, solved.solution
    of_limb = len(problem.limb_root) - (problem.parameters - problem.of_loads.start)
    free = replace(problem, maker=None, limb_root=problem.limb_root[of_limb:])

    def weighed(one: Problem) -> tuple[float, float]:
        alone = solve(one, [solution.outer])
        beside = errors_of_imu(solved.sets, one, alone, solved.sphere, solved.delay_std)
        root = unknowns_root(one, alone)
        covariance = fit_covariance(one, alone, pooled_noise(one.sets), beside, root)
        mass = FitColumns.of(len(alone.A)).limb.start + MASS
        return float(alone.limb[MASS]), float(np.sqrt(covariance[mass, mass]))

    by_data = None if data_rank(free, solution.limb).missing else weighed(free)
    if task.factory is None:
        return by_data, None
    return by_data, weighed(replace(free, maker=task.prior(pooled_noise(problem.sets), _MAKER)))
