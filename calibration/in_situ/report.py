"""Outcome of a fit: the calibration and its statistics, or only the reason of a refusal."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.check import check_bending
from surefoot.calibration.in_situ.compress import compress
from surefoot.calibration.in_situ.covariance import (
    DataShare,
    answer_of,
    answer_root,
    data_share,
    slope_doubts,
    slow_turn,
    unknowns_root,
)
from surefoot.calibration.in_situ.data import InSituOptions, InSituSet, Task
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.fit import FitColumns, InSituFit, Limb
from surefoot.calibration.in_situ.hysteresis import shows_loops
from surefoot.calibration.in_situ.imu import Sphere, errors_of_imu
from surefoot.calibration.in_situ.judge import (
    check_answer,
    check_axes,
    check_limb,
    check_masses,
    check_scale,
    data_rank,
)
from surefoot.calibration.in_situ.linear import of_unit_length
from surefoot.calibration.in_situ.maker import COMMON, Leaning, mean_of, prior_of
from surefoot.calibration.in_situ.model import AXES, MASS, MOMENT, STATIC, different_masses, inertia_matrix
from surefoot.calibration.in_situ.problem import Problem, pool_noise
from surefoot.calibration.in_situ.solve import Solution, loop_shares, solve, transforms
from surefoot.calibration.in_situ.temperature import find_drift
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

_MAKER = 0.02
"""Deviation of a factory matrix that is kept, as a share of full scale: sheets state 1 to 2 %."""


@dataclass(eq=False)
class Solved:
    """A solved task, on its way to the answer.

    Attributes:
        task: The input.
        sets: Its sets with a levelled gravity, in step with the readings.
        sphere: Errors of the accelerometer by gravity's length.
        delay: By which gravity was late in s.
        delay_std: Its deviation.
        members: The fits by the likely sizes of the maker's errors.
        determined: Whether the readings determine all without the maker.
        reference: Mean of the temperatures; None where they take no part.
        findings: Findings of the checks so far.
    """

    task: Task
    sets: tuple[InSituSet, ...]
    sphere: Sphere
    delay: float
    delay_std: float
    members: list[Leaning]
    determined: bool
    reference: float | None
    findings: list[Finding] = field(default_factory=list)

    @property
    def problem(self) -> Problem:
        """That of the likeliest size of the maker's errors."""
        return self.members[0].problem

    @property
    def solution(self) -> Solution:
        """The mean of the members' solutions."""
        return mean_of(self.members)


def fit_of(solved: Solved) -> InSituFit:
    """Return the answer; notes on it go to the findings."""
    task, findings, sets, members = solved.task, solved.findings, solved.sets, solved.members
    problem, solution = solved.problem, solved.solution
    noise = pool_noise(problem.sets)
    hidden = not (task.options.hysteresis and task.timed and shows_loops(problem))
    bends, said = check_bending(sets, problem.sets, loops=hidden)
    findings += said
    findings += _find_drift(solved)
    doubted = [] if task.limb is None else check_limb(task.limb, *_limb_alone(solved))
    # A limb that is not as it was given draws all masses with it.
    findings += doubted or check_masses(problem, solution, noise)
    known = data_share(problem, solution, noise)
    if problem.maker is not None or len(problem.limb_root):
        findings += known.findings(FitColumns.of(len(noise)))
    answer, doubts = answer_of(problem, solution, noise), None
    roots = [_members_root(solved, solution, noise)]
    if problem.lags:
        doubts = slope_doubts(problem, solution, noise)
        roots += _slope_columns(doubts, len(answer))
    if problem.maker is not None and task.options.factory_std is None:
        of_data = float(known.share[FitColumns.of(len(noise)).limb][MASS])
        roots.append(_common_scale(answer, len(noise), COMMON * (1.0 - of_data), task.limb is not None))
    if bends:
        load = transforms(problem, solution)[-1, :AXES] @ problem.sets[-1].end.signals
        roots.append(bends * _bending_columns(answer, solution, load, task.limb is not None))
    root = np.concatenate(roots, axis=1)
    fit = _assemble(solved, answer, root @ root.T, known)
    if doubts is not None:
        fit = replace(fit, offset_doubt=doubts[1] @ doubts[1].T)
    fit = replace(fit, bending=bends)
    if task.mode == "keep":
        assert task.factory is not None
        fit = replace(fit, matrix=task.factory, response=np.asarray(np.linalg.pinv(task.factory)))
    fit = _add_shares(solved, fit)
    findings += check_scale(fit, leaning=members[0].problem.maker is not None)
    if problem.maker is None:
        findings += check_axes(fit, problem, solution)
    findings += check_answer(fit, task.factory)
    return fit


def _assemble(solved: Solved, answer: Vector, covariance: Matrix, known: DataShare) -> InSituFit:
    """Return the fit, without its notes."""
    problem, solution = solved.problem, solved.solution
    parts, limb, k = problem.sets, solution.limb, len(solution.A)
    predicted = solution.response @ transforms(problem, solution)
    stats, set_stats = _stats(problem, solution, known)
    columns, shares = FitColumns.of(k), loop_shares(problem, solution)
    return InSituFit(
        matrix=answer[columns.matrix].reshape(AXES, k),
        offset=answer[columns.offset],
        offsets=np.array([part.middle.by(B) for part, B in zip(parts, predicted, strict=True)]),
        response=solution.A,
        limb=Limb(float(limb[MASS]), limb[MOMENT], inertia_matrix(limb) if problem.moving else None),
        covariance=covariance,
        noise=pool_noise(parts),
        temperature_coefficient=solution.direct[:, 0] if problem.temperature else None,
        rotation=solution.rotation,
        result=FitResult.PARTLY_DETERMINED if known.unseen else FitResult.DETERMINED,
        refusals=(),
        warnings=(),
        stats=stats,
        set_stats=set_stats,
        affine_residual=np.array([part.affine_residual for part in parts]),
        set_names=tuple(part.name for part in parts),
        temperature_reference=solved.reference or 0.0,
        temperature_gain=limb[problem.of_loads][: problem.gains] if problem.gains else None,
        hysteresis=shares if problem.lags and not problem.channel_lags else None,
        channel_hysteresis=shares if problem.channel_lags else None,
        data_share=known.share,
        accelerometer_bias=solved.sphere.bias,
        accelerometer_scale=solved.sphere.scale,
        delay=solved.delay,
    )


def _slope_columns(doubts: tuple[Matrix, Matrix], rows: int) -> list[Matrix]:
    """Pad the doubts of one slope, of the matrix and of the offset, to columns of shape (rows, a)."""
    of_matrix, of_offset = doubts
    first = len(of_matrix)
    after = rows - first - len(of_offset)
    return [np.pad(of_matrix, ((0, rows - first), (0, 0))), np.pad(of_offset, ((first, after), (0, 0)))]


def _common_scale(answer: Vector, channels: int, doubt: float, weighed: bool) -> Matrix:
    """Return a column by which all gains, and the limb unless it was weighed, are off by one factor."""
    columns, off = FitColumns.of(channels), np.zeros_like(answer)
    off[columns.matrix] = doubt * answer[columns.matrix]
    if not weighed:
        off[columns.limb] = doubt * answer[columns.limb]
    return off[:, None]


def _bending_columns(answer: Vector, solution: Solution, load: Vector, weighed: bool) -> Matrix:
    """Return columns by which each axis, the last offset at its load, (6,), and the limb are unsure by all.

    Squares of gravity move no slope, but a limb that bends has cubes as well, which do. A limb that was
    weighed is moved by no axis.
    """
    columns = FitColumns.of(len(solution.A))
    found = np.zeros((len(answer), 2 * AXES + STATIC))
    for axis, gain in enumerate(solution.A.T):
        found[columns.row(axis), axis] = answer[columns.row(axis)]
        found[columns.offset, AXES + axis] = load[axis] * gain
    if not weighed:
        mass, *moment = answer[columns.limb]
        found[columns.limb, 2 * AXES :] = np.diag([mass, *np.full(3, np.linalg.norm(moment))])
    return found


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
    # Difference of each set's response from the common one, by its orthonormal signals, in counts.
    left = problem.unwhiten(solution.residual)
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


def refuse_fit(sets: Sequence[InSituSet], refusals: tuple[CalibrationRefused, ...]) -> InSituFit:
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


def _find_drift(solved: Solved) -> list[Finding]:
    """Find a cause that may hide behind a drift."""
    slow = slow_turn(solved.sets, solved.problem.sets)
    if slow is None and solved.reference is not None:
        slow = find_drift(compress(solved.sets, InSituOptions(), solved.problem.moving, True))
    return [] if slow is None else [slow]


def _members_root(solved: Solved, solution: Solution, noise: Matrix) -> Matrix:
    """Return a root of the answer's covariance: of each member, between members, and of the IMU."""
    problem, roots = solved.problem, []

    def unknowns(one: Solution) -> Vector:
        return np.concatenate([(problem.whitening @ one.response).ravel(), one.outer])

    middle = unknowns(solution)
    for one in solved.members:
        apart = (unknowns(one.solution) - middle)[:, None]
        roots += [np.sqrt(one.weight) * unknowns_root(one.problem, one.solution), np.sqrt(one.weight) * apart]
    if solved.task.mode == "keep":
        roots.append(_doubt_maker(solved.task, problem, solution, noise))
    beside = errors_of_imu(solved.sets, problem, solution, solved.sphere, solved.delay_std)
    return answer_root(problem, solution, noise, beside, np.concatenate(roots, axis=1))


def _doubt_maker(task: Task, problem: Problem, solution: Solution, noise: Matrix) -> Matrix:
    """Compute how deviations of the entries of a matrix that stays move all unknowns, shape (u, 36)."""
    prior = prior_of(task, noise, _MAKER)
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


def _add_shares(solved: Solved, fit: InSituFit) -> InSituFit:
    """Add the share of the maker's errors that the readings know, and the scope in words."""
    task, base = solved.task, "bias, mass and centre of mass"
    sets = different_masses(solved.problem.added[:, :STATIC])
    tools = "one load" if sets == 1 else f"{sets} loads"
    if task.factory is None or task.mode == "free":
        return replace(fit, scope=f"{base}, and a matrix of its own ({tools})")
    if task.mode == "keep":
        return replace(fit, scope=f"{base}; matrix kept ({tools})")
    assert solved.problem.maker is not None
    prior, posterior = np.zeros((AXES, AXES)), np.zeros((AXES, AXES))
    for one in solved.members:
        assert one.problem.maker is not None
        prior += one.weight * one.problem.maker.std**2
        errors = one.problem.maker.errors(one.problem.whitening, one.problem.inputs)
        root = unknowns_root(one.problem, one.solution)[: errors.shape[1]]
        posterior += one.weight * np.sum((errors @ root) ** 2, axis=1).reshape(AXES, AXES)
    known = np.clip(1.0 - posterior / prior, 0.0, 1.0)
    scales = solved.problem.maker.std / np.diag(solved.problem.maker.std)[0]
    moved = float(np.max(np.abs(task.factory @ fit.response - np.eye(AXES)) / scales))
    share = float(np.exp(sum(one.weight * np.log(max(one.share, 1e-9)) for one in solved.members)))
    words = (
        f"{base}; matrix within {100.0 * moved:.2g} % of full scale of the factory's, "
        f"{np.sum(known > 0.5)} of 36 entries by the readings ({tools})"
    )
    stated = task.options.factory_std
    return replace(
        fit, scope=words, maker_known=known, maker_share=float(np.mean(stated)) if stated else share
    )


def _limb_alone(solved: Solved) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return the limb's mass and its deviation in kg by the readings alone, and with the factory matrix."""
    problem, solution = solved.problem, solved.solution
    of_limb = len(problem.limb_root) - (problem.parameters - problem.of_loads.start)
    free = replace(problem, maker=None, limb_root=problem.limb_root[of_limb:])
    noise = pool_noise(problem.sets)

    def weigh(one: Problem) -> tuple[float, float]:
        alone = solve(one, [solution.outer])
        beside = errors_of_imu(solved.sets, one, alone, solved.sphere, solved.delay_std)
        root = answer_root(one, alone, noise, beside, unknowns_root(one, alone))
        mass = FitColumns.of(len(alone.A)).limb.start + MASS
        return float(alone.limb[MASS]), float(np.linalg.norm(root[mass]))

    by_data = None if data_rank(free, solution.limb).missing else weigh(free)
    if solved.task.factory is None:
        return by_data, None
    return by_data, weigh(replace(free, maker=prior_of(solved.task, noise, _MAKER)))
