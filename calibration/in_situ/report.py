"""Outcome of a fit: the calibration and its statistics, or only the reason of a refusal."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from surefoot.calibration.arrays import of_unit_length
from surefoot.calibration.in_situ.check import check_within
from surefoot.calibration.in_situ.covariance import (
    DataShare,
    answer_of,
    answer_root,
    data_share,
    slope_doubts,
    slow_turn,
    unknowns_root,
)
from surefoot.calibration.in_situ.data import InSituSet, Matrix, Task, Vector
from surefoot.calibration.in_situ.estimate import Solved
from surefoot.calibration.in_situ.fit import (
    FitColumns,
    Hysteresis,
    ImuErrors,
    InSituFit,
    Limb,
    MakerErrors,
    SetFit,
    TemperatureEffect,
)
from surefoot.calibration.in_situ.hysteresis import Gains, gains_of
from surefoot.calibration.in_situ.judge import (
    check_answer,
    check_axes,
    check_limb,
    check_masses,
    check_scale,
    data_rank,
)
from surefoot.calibration.in_situ.model import AXES, MASS, MOMENT, STATIC, different_masses, inertia_matrix
from surefoot.calibration.in_situ.solver.maker import COMMON, mean_of, prior_of
from surefoot.calibration.in_situ.solver.problem import Problem
from surefoot.calibration.in_situ.solver.solve import Solution, solve
from surefoot.calibration.results import CalibrationRefused, Finding, FitResult, FitStats

_MAKER = 0.02  # deviation of a factory matrix that is kept, as a share of full scale: sheets state 1 to 2 %


def fit_of(solved: Solved) -> tuple[InSituFit, list[Finding]]:
    """Return the answer, and findings on it."""
    task, solution = solved.task, mean_of(solved.fits.members)
    problem = solution.problem
    columns = FitColumns.of(len(problem.noise))
    bends, findings = check_within(solved.sets, problem.sets, solved.hidden)
    findings += slow_turn(solved.sets, problem.sets)
    doubted = [] if task.limb is None else check_limb(task, *_limb_alone(solved, solution))
    # A wrong mass of the limb would bias all added masses.
    findings += doubted or check_masses(solution)
    known = data_share(solution)
    answer, doubts = answer_of(solution), slope_doubts(solution, solved.hidden)
    gains = gains_of(solved.sets, solution)
    if gains is not None:
        # Whether the load grew from zero is not known.
        doubts = (doubts[0], np.concatenate([doubts[1], solution.A * gains.stored[-1]], axis=1))
    places = (columns.matrix, columns.offset)
    roots = [_columns_of(answer, *pair) for pair in zip(places, doubts, strict=True)]
    roots.append(_members_root(solved, solution))
    if problem.maker is not None and task.options.factory_std is None:
        of_data = float(known.share[columns.limb][MASS])
        roots.append(_common_scale(answer, columns, COMMON * (1.0 - of_data), task.limb is not None))
    if bends:
        roots.append(bends * _bending_columns(answer, solution, task.limb is not None))
    root = np.concatenate(roots, axis=1)
    fit = _assemble(solved, solution, answer, root @ root.T, known, gains)
    scope, maker = _describe_scope(solved, fit)
    unsure = doubts[1] @ doubts[1].T if problem.hysteresis or solved.hidden else None
    fit = replace(fit, offset_doubt=unsure, scope=scope, maker=maker)
    heaviest = float(np.max(problem.added[:, MASS]))
    findings += check_scale(fit, heaviest, task.owner if problem.maker else "")
    if problem.maker is None:
        findings += check_axes(fit, solution)
    return fit, [*findings, *check_answer(fit, task)]


def _assemble(
    solved: Solved,
    solution: Solution,
    answer: Vector,
    covariance: Matrix,
    known: DataShare,
    gains: Gains | None,
) -> InSituFit:
    """Return the fit with the numbers of a solution."""
    problem, limb, predicted = solution.problem, solution.limb, solution.predicted
    k = len(solution.A)
    matrix, response = answer[FitColumns.of(k).matrix].reshape(AXES, k), solution.A
    if solved.task.mode == "keep":
        assert solved.task.factory is not None
        matrix, response = solved.task.factory, np.asarray(np.linalg.pinv(solved.task.factory))
    offset = answer[FitColumns.of(k).offset]
    offsets = np.array([part.middle.by(B) for part, B in zip(problem.sets, predicted, strict=True)])
    if gains is not None:
        stored = gains.stored @ solution.A.T
        offset, offsets = offset - stored[-1], offsets - stored
        if solved.task.mode != "keep":
            matrix, response = matrix / gains.matrix[:, None], response * gains.matrix
    stats, set_stats = _stats(solution, known)
    temperature = None
    if problem.temperature:
        gain = limb[problem.of_loads][: problem.gains] if problem.gains else None
        temperature = TemperatureEffect(solution.direct[:, 0], solved.reference or 0.0, gain)
    hysteresis = None
    if gains is not None:
        swing_gain = np.ones(AXES) if solved.task.mode == "keep" else gains.matrix
        hysteresis = Hysteresis(solution.shares, gains.amplitude, swing_gain)
    return InSituFit(
        matrix=matrix,
        offset=offset,
        response=response,
        limb=Limb(float(limb[MASS]), limb[MOMENT], inertia_matrix(limb) if problem.moving else None),
        covariance=covariance,
        noise=problem.noise,
        sets=tuple(
            SetFit(part.source.name, of_set, of_stats, part.affine_residual)
            for part, of_set, of_stats in zip(problem.sets, offsets, set_stats, strict=True)
        ),
        stats=stats,
        result=FitResult.PARTLY_DETERMINED if known.unseen else FitResult.DETERMINED,
        imu=ImuErrors(solved.sphere.bias, solved.sphere.scales, solution.rotation, solved.delay),
        temperature=temperature,
        hysteresis=hysteresis,
        data_share=known.share,
    )


def _columns_of(answer: Vector, place: slice, columns: Matrix) -> Matrix:
    """Return columns, shape (q, c), of one part of the answer as columns of all of it."""
    found = np.zeros((len(answer), columns.shape[1]))
    found[place] = columns
    return found


def _common_scale(answer: Vector, columns: FitColumns, doubt: float, weighed: bool) -> Matrix:
    """Return a column by which all gains, and the limb unless it was weighed, are off by one factor."""
    off = np.zeros_like(answer)
    off[columns.matrix] = doubt * answer[columns.matrix]
    if not weighed:
        off[columns.limb] = doubt * answer[columns.limb]
    return off[:, None]


def _bending_columns(answer: Vector, solution: Solution, weighed: bool) -> Matrix:
    """Return columns by which each axis, the last offset at its load, and the limb are unsure by all.

    Squares of gravity do not change the slope, but a limb that bends also has cubes, which do. A limb that
    was weighed is not affected.
    """
    columns = FitColumns.of(len(solution.A))
    load = solution.loads[-1] @ solution.problem.sets[-1].end.signals
    found = np.zeros((len(answer), 2 * AXES + STATIC))
    for axis, gain in enumerate(solution.A.T):
        found[columns.row(axis), axis] = answer[columns.row(axis)]
        found[columns.offset, AXES + axis] = load[axis] * gain
    if not weighed:
        mass, *moment = answer[columns.limb]
        found[columns.limb, 2 * AXES :] = np.diag([mass, *np.full(3, np.linalg.norm(moment))])
    return found


def _stats(solution: Solution, known: DataShare) -> tuple[FitStats, tuple[FitStats, ...]]:
    """Return the statistics of all sets together and of each."""
    parts = solution.problem.sets
    singular = np.linalg.svd(of_unit_length(solution.jacobian)[0], compute_uv=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0.0 else np.inf

    def count(samples: int, dropped: int, gated: int, square: float) -> FitStats:
        rms, unknowns = float(np.sqrt(square)), known.seen + known.unseen
        return FitStats(samples, dropped, gated, rms, known.seen, unknowns, condition)

    # Difference of each set's response from the common one, by its orthonormal signals, in counts.
    left = solution.problem.unwhiten(solution.residual)
    squares = [
        float(np.mean((part.residual - part.score @ one) ** 2)) for part, one in zip(parts, left, strict=True)
    ]
    samples = [part.samples for part in parts]
    gated = [int(np.sum(part.source.rejected)) for part in parts]
    dropped = [len(part.source.used) - n - out for part, n, out in zip(parts, samples, gated, strict=True)]
    whole = count(sum(samples), sum(dropped), sum(gated), float(np.average(squares, weights=samples)))
    return whole, tuple(map(count, samples, dropped, gated, squares))


def refuse_fit(sets: Sequence[InSituSet], refusals: tuple[CalibrationRefused, ...]) -> InSituFit:
    """Return a fit whose values are NaN, with the reasons."""
    k = sets[0].channels
    size = FitColumns.of(k).limb.stop
    nothing = FitStats(0, 0, 0, np.nan, 0, AXES * k + STATIC, np.inf)

    def unknown(*shape: int) -> Matrix:
        return np.full(shape, np.nan)

    return InSituFit(
        matrix=unknown(AXES, k),
        offset=unknown(k),
        response=unknown(k, AXES),
        limb=Limb(np.nan, unknown(3)),
        covariance=unknown(size, size),
        noise=unknown(k, k),
        sets=tuple(SetFit(data.name, unknown(k), nothing, np.nan) for data in sets),
        stats=nothing,
        result=FitResult.REFUSED,
        refusals=refusals,
    )


def _members_root(solved: Solved, solution: Solution) -> Matrix:
    """Return a root of the answer's covariance: of each member, between members, and of open errors."""
    whitening, roots, beside = solution.problem.whitening, [], solved.open_errors(solution)

    def unknowns(one: Solution) -> Vector:
        return np.concatenate([(whitening @ one.response).ravel(), one.outer])

    middle = unknowns(solution)
    for member in solved.fits.members:
        apart = (unknowns(member.solution) - middle)[:, None]
        roots += [np.sqrt(member.weight) * root for root in (unknowns_root(member.solution, beside), apart)]
    if solved.task.mode == "keep":
        roots.append(_doubt_maker(solved.task, solution))
    return answer_root(solution, beside, np.concatenate(roots, axis=1))


def _doubt_maker(task: Task, solution: Solution) -> Matrix:
    """Compute how deviations of the entries of a matrix that stays move all unknowns, shape (u, 36)."""
    problem = solution.problem
    prior = prior_of(task, problem.noise, _MAKER)
    assert prior is not None
    errors = np.diag(prior.std.ravel()).reshape(AXES, AXES, -1)
    changes = np.einsum("ka,abq->kbq", problem.whitening @ prior.response, errors)
    linear = len(changes) * problem.inputs
    moved = np.zeros((linear + problem.outer, changes.shape[2]))
    moved[:linear].reshape(len(changes), problem.inputs, -1)[:, :AXES] = changes
    of_sets = solution.jacobian[: solution.residual.size]
    rows = np.concatenate([of_sets, solution.jacobian[-len(problem.limb_root) or len(solution.jacobian) :]])
    moved[linear:] = -np.linalg.lstsq(rows[:, linear:], rows[:, :linear] @ moved[:linear], rcond=None)[0]
    return moved


def _describe_scope(solved: Solved, fit: InSituFit) -> tuple[str, MakerErrors | None]:
    """Return the scope in words, and the maker's errors."""
    task, base = solved.task, "bias, mass and centre of mass"
    count = different_masses(solved.fits.members[0].solution.problem.added[:, :STATIC])
    loads = "one load" if count == 1 else f"{count} loads"
    if task.factory is None or task.mode == "free":
        return f"{base}, and a matrix of its own ({loads})", None
    if task.mode == "keep":
        return f"{base}; matrix kept ({loads})", None
    prior, posterior = np.zeros((AXES, AXES)), np.zeros((AXES, AXES))
    for member in solved.fits.members:
        problem = member.solution.problem
        assert problem.maker is not None
        prior += member.weight * problem.maker.std**2
        errors = problem.maker.errors(problem.whitening, problem.inputs)
        root = unknowns_root(member.solution)[: errors.shape[1]]
        posterior += member.weight * np.sum((errors @ root) ** 2, axis=1).reshape(AXES, AXES)
    known = np.clip(1.0 - posterior / prior, 0.0, 1.0)
    maker = solved.fits.members[0].solution.problem.maker
    assert maker is not None
    scales = maker.std / maker.std[0, 0]
    moved = float(np.max(np.abs(task.factory @ fit.response - np.eye(AXES)) / scales))
    words = (
        f"{base}; matrix within {100.0 * moved:.2g} % of full scale of the {task.owner}, "
        f"{np.sum(known > 0.5)} of 36 entries by the readings ({loads})"
    )
    if task.options.factory_std:
        return words, MakerErrors(float(np.mean(task.options.factory_std)), known)
    share = float(np.exp(sum(one.weight * np.log(one.share) for one in solved.fits.members)))
    return words, MakerErrors(share, known)


def _limb_alone(
    solved: Solved, solution: Solution
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return the limb's mass and its deviation in kg by the readings alone, and with the factory matrix."""
    problem = solution.problem
    of_loads = problem.parameters - problem.of_loads.start
    free = replace(problem, maker=None, limb_root=problem.limb_root[len(problem.limb_root) - of_loads :])

    def weigh(one: Problem) -> tuple[float, float]:
        alone = solve(one, [solution.outer])
        beside = solved.open_errors(alone)
        root = answer_root(alone, beside, unknowns_root(alone, beside))
        mass = FitColumns.of(len(alone.A)).limb.start + MASS
        return float(alone.limb[MASS]), float(np.linalg.norm(root[mass]))

    by_data = None if data_rank(free, solution.limb).missing else weigh(free)
    if solved.task.factory is None:
        return by_data, None
    return by_data, weigh(replace(free, maker=prior_of(solved.task, problem.noise, _MAKER)))
