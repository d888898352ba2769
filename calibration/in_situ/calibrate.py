r"""In-situ calibration of a six-axis F/T sensor: gravity on a limb, with known masses added or without.

The model is the in-situ paper's (Traversaro, Pucci and Nori, 2015), the fit is not: readings carry the noise,
so readings are what is fitted,

.. math:: r = A_0 (1 + D) (M_b + M_a^j) g + o_j(t) + e,

over the errors D of a maker's matrix (or a response that nobody gave), the limb's inertial parameters and an
offset for each set, each with what is known of it beforehand. One set or a hundred, at rest or moving, the
way is the same: **data** that the accelerometer's own errors are taken off
(:mod:`~surefoot.calibration.in_situ.gravity`, :mod:`~surefoot.calibration.in_situ.gravity`), sets
**compressed** to a few rows each (:mod:`~surefoot.calibration.in_situ.compress`), one **solution** for every
likely size of the maker's errors (:mod:`~surefoot.calibration.in_situ.maker`), findings that are **judged**
in one place (:mod:`~surefoot.calibration.in_situ.findings`), and the answer. The paper's own regression is in
:mod:`~surefoot.calibration.in_situ.paper_offset` and :mod:`~surefoot.calibration.in_situ.paper_matrix`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import ThreadpoolController

from surefoot.calibration.in_situ.beside import (
    about_one_temperature,
    check_gauges,
    drifting,
    with_gains,
    with_hysteresis,
)
from surefoot.calibration.in_situ.causes import Evidence
from surefoot.calibration.in_situ.check import check_bending, check_gravity, check_sets, check_within
from surefoot.calibration.in_situ.compress import CompressedSet, compress
from surefoot.calibration.in_situ.covariance import (
    data_share,
    fit_covariance,
    pooled_noise,
    slow_turn,
    unknowns_root,
    whitening,
    with_disagreement,
)
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.findings import Finding, decide
from surefoot.calibration.in_situ.fit import FitColumns, InSituFit
from surefoot.calibration.in_situ.gravity import Sphere, fit_sphere, level, synchronise
from surefoot.calibration.in_situ.hypotheses import explained
from surefoot.calibration.in_situ.judge import (
    check_answer,
    check_axes,
    check_factory,
    check_limb,
    check_masses,
    check_rotation,
    check_scale,
    data_rank,
)
from surefoot.calibration.in_situ.maker import COMMON, KEPT, Leaning, full_scale, lean, maker_prior, mean_of
from surefoot.calibration.in_situ.model import (
    AXES,
    MASS,
    MOMENT,
    STATIC,
    inertial_parameters,
    transform_basis,
)
from surefoot.calibration.in_situ.options import InSituOptions, KnownLimb
from surefoot.calibration.in_situ.outcome import outcome, refused, with_bending, with_common_scale
from surefoot.calibration.in_situ.rest import errors_of_imu
from surefoot.calibration.in_situ.solve import (
    Maker,
    Problem,
    Solution,
    expand,
    minima,
    solve,
    starts,
    transforms,
)
from surefoot.calibration.results import CalibrationRefused, FitResult

__all__ = ["MatrixMode", "calibrate_in_situ"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

MatrixMode = Literal["keep", "update", "free"]
"""What becomes of a factory matrix."""

_MAKER, _AGED = 0.02, 0.1
"""Deviation of a factory matrix that is kept, as a share of full scale (sheets state 1 to 2 %), and of one by
which causes are judged (sensors in robots were off by 5 to 20 %)."""

_DRIFTS = ("slow turning", "drift by temperature")
"""Findings of what may hide behind a drift."""

_FEW_REJECTED = 0.01
"""Share of samples that may disagree with all others as chance has it."""


@dataclass(frozen=True, eq=False)
class _Task:
    """What a calibration is given."""

    sets: tuple[InSituSet, ...]
    factory: Matrix | None
    limb: KnownLimb | None
    options: InSituOptions
    mode: MatrixMode

    @property
    def moving(self) -> bool:
        """Whether a limb's motion was recorded."""
        return any(data.moves for data in self.sets)

    def prior(self, noise: Matrix, share: float | tuple[float, ...] | None = None) -> Maker | None:
        """Return the factory matrix as a prior; None where there is none.

        Args:
            noise: Covariance of a sample, shape (k, k).
            share: By which it may be off; as stated, or one, by default.
        """
        if self.factory is None:
            return None
        given = self.options.factory_std or share or 1.0
        return maker_prior(self.factory, given, full_scale(self.factory, noise, self.options.full_scale))


@dataclass(eq=False)
class _Solved:
    """A solved task, on its way to the answer."""

    sets: tuple[InSituSet, ...]
    sphere: Sphere
    delay: float
    members: list[Leaning]
    determined: bool
    findings: list[Finding] = field(default_factory=list)
    reference: float | None = None

    @property
    def problem(self) -> Problem:
        """That of the likeliest size of the maker's errors."""
        return self.members[0].problem

    @property
    def solution(self) -> Solution:
        """The mean of the members' solutions."""
        return mean_of(self.members)


def calibrate_in_situ(
    sets: Sequence[InSituSet],
    *,
    factory_matrix: ArrayLike | None = None,
    limb: KnownLimb | None = None,
    matrix: MatrixMode = "update",
    options: InSituOptions | None = None,
    refuse: bool = True,
    accept: str = "",
) -> InSituFit:
    """Return the calibration of a six-axis F/T sensor where it is built in.

    The model is that of III in the in-situ paper, fitted in measurement space. Three sets with different
    added masses determine the matrix (Lemma 2). With a factory matrix one will do: what the readings do not
    show stays as the maker gave it.

    Args:
        sets: Readings and gravity, a set for each added mass.
        factory_matrix: The maker's C in N and N m per count, shape (6, k).
        limb: What is known of the limb.
        matrix: ``"keep"`` leaves the factory matrix as it is and finds bias, mass and centre of mass;
            ``"update"`` changes it as far as the readings show that it is off; ``"free"`` fits a matrix of
            its own and uses the factory's for checks only.
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
    task = _task(sets, factory_matrix, limb, options or InSituOptions(), matrix)
    # Matrices are small: threads would only wait for each other, on a busy machine for seconds.
    with _linear_algebra().limit(limits=1, user_api="blas"):
        fit = _answer(task, accept)
    if fit.result is FitResult.REFUSED and refuse:
        raise fit.refusals[0]
    return fit


@cache
def _linear_algebra() -> ThreadpoolController:
    """Return what sets the number of threads of linear algebra; to look for its libraries takes a while."""
    return ThreadpoolController()


def _task(
    sets: Sequence[InSituSet],
    factory_matrix: ArrayLike | None,
    limb: KnownLimb | None,
    options: InSituOptions,
    mode: MatrixMode,
) -> _Task:
    """Return what was given, or raise ValueError if it cannot be."""
    if not sets:
        raise ValueError("Give at least one set of readings.")
    channels = sorted({data.channels for data in sets})
    if len(channels) > 1:
        raise ValueError(f"All sets must have the same number of channels, got {channels}.")
    if mode not in ("keep", "update", "free"):
        raise ValueError(f"'matrix' must be 'keep', 'update' or 'free', got {mode!r}.")
    factory = None
    if factory_matrix is not None:
        factory = np.asarray(factory_matrix, dtype=np.float64)
        if factory.shape != (AXES, channels[0]):
            raise ValueError(f"'factory_matrix' must have shape (6, {channels[0]}), got {factory.shape}.")
        if not np.all(np.isfinite(factory)) or np.linalg.matrix_rank(factory) < AXES:
            raise ValueError("'factory_matrix' must be finite and of rank 6, as all matrices of makers are.")
    elif mode == "keep":
        raise ValueError("'matrix' is 'keep', and there is none to keep: give 'factory_matrix'.")
    task = _Task(tuple(sets), factory, limb, options, mode)
    if options.estimate_rotation and task.moving:
        raise ValueError("'estimate_rotation' needs a limb at rest: leave the angular velocities out.")
    return task


def _answer(task: _Task, accept: str) -> InSituFit:
    """Return the answer, or a fit of NaN with the reason why there is none."""
    try:
        door = check_sets(task.sets, task.options, leaning=task.factory is not None)
        first = decide(door, accept)
        if first.refused:
            return refused(task.sets, first.refused)
        solved = _solved(task, door)
        fit = _fit(task, solved)
    except (CalibrationRefused, np.linalg.LinAlgError) as error:
        return refused(task.sets, (_without_answer(error, accept),))
    findings = solved.findings
    drift = next((one for one in findings if one.name in _DRIFTS), None)
    worst = next((one for one in findings if one.refuses and (one.contradicts or drift)), None)
    if worst is not None:
        findings[findings.index(worst)] = _explained(worst, task, solved, drift)
    decision = decide(findings, accept)
    if decision.refused:
        return refused(task.sets, decision.refused)
    fit = replace(fit, warnings=decision.warnings, refusals=decision.passed)
    return replace(fit, result=FitResult.ACCEPTED, accepted=accept) if decision.passed else fit


def _without_answer(error: CalibrationRefused | np.linalg.LinAlgError, accept: str) -> CalibrationRefused:
    if not isinstance(error, CalibrationRefused):
        error = CalibrationRefused(
            "The readings leave a matrix without an inverse: some axis of the sensor does not show in them.",
            "Check the channels, add masses at other places, or give a factory matrix.",
        )
    if not accept:
        return error
    return CalibrationRefused(
        error.reason, f"{error.cure} It cannot be accepted: there is no answer without that."
    )


def _solved(task: _Task, findings: list[Finding]) -> _Solved:
    """Return the solutions of a task with all that they are to explain; findings go on."""
    options = task.options
    sphere = fit_sphere(task.sets)
    findings += check_gravity(task.sets, sphere)
    sets, reference, left_out = about_one_temperature(level(task.sets, sphere))
    findings += [Finding("temperature", words, refuses=False) for words in left_out]
    sets, delay, told = synchronise(sets, task.moving)
    findings += told
    parts = compress(sets, options, task.moving, reference is not None)
    problem = _problem(sets, parts, task, reference is not None)
    if task.mode != "free":
        problem = replace(problem, maker=task.prior(pooled_noise(parts)))
    first = starts(problem, task.factory, problem.limb if task.limb is not None else None)
    rank = data_rank(problem, first[0])
    if rank.missing and problem.maker is None:
        raise rank.refusal(problem)
    findings += _contradicting_factory(task, problem, first, determined=not rank.missing)
    stated = options.factory_std is not None
    members = _lean(task, problem, first, stated, findings)
    chosen = members[0].problem, members[0].solution
    if reference is not None and not rank.missing:
        chosen = with_gains(*chosen, options) or chosen
    if options.hysteresis:
        chosen = with_hysteresis(sets, *chosen, options) or chosen
    if chosen[0] is not members[0].problem:
        members = _lean(task, replace(chosen[0], maker=problem.maker), [chosen[1].outer], stated, findings)
    solved = _Solved(sets, sphere, delay, members, not rank.missing, findings, reference)
    findings += check_within(sets, solved.problem.sets, options)
    if reference is not None and not rank.missing:
        words = check_gauges(members[0].problem, members[0].solution, options)
        findings += [Finding("temperature", one, refuses=False) for one in words]
    if rank.missing:
        findings.append(Finding("rank", rank.warning(), refuses=False))
    return solved


def _lean(
    task: _Task, problem: Problem, first: list[Vector], stated: bool, findings: list[Finding]
) -> list[Leaning]:
    """Return the fits by the likely sizes of the maker's errors."""
    if task.mode == "keep":
        assert problem.maker is not None
        held = replace(problem, maker=problem.maker._replace(std=KEPT * problem.maker.std))
        return lean(with_disagreement(held, minima(problem, first)[0]), first, stated=True)
    found = minima(problem, first)
    findings += check_rotation(found)
    return lean(with_disagreement(problem, found[0]), [found[0].outer], stated)


def _contradicting_factory(
    task: _Task, problem: Problem, first: list[Vector], *, determined: bool
) -> list[Finding]:
    """Return what the readings say of a factory matrix, by a fit without it where they determine one."""
    if task.factory is None:
        return []
    free, response = replace(problem, maker=None), np.asarray(np.linalg.pinv(task.factory))
    # Masses in one plane leave a rotation and its mirror image: the matrix knows which.
    by_data = min(
        minima(free, starts(free, None, None)),
        key=lambda one: float(np.sum((problem.whitening @ (one.A - response)) ** 2)),
    )
    prior = task.prior(pooled_noise(problem.sets))
    found = check_factory(task.factory, replace(problem, maker=prior), by_data, determined=determined)
    if any(one.refuses for one in found) and determined:
        # Sets that contradict each other without the matrix say nothing of it.
        doubted = check_masses(free, by_data, pooled_noise(problem.sets), task.options)
        found = doubted + found if any(one.refuses for one in doubted) else found
    return found


def _fit(task: _Task, solved: _Solved) -> InSituFit:
    """Return the answer; what is to be said of it goes to the findings."""
    options, findings, sets = task.options, solved.findings, solved.sets
    problem, solution = solved.problem, solved.solution
    bending, bends = check_bending(sets, problem.sets, options, loops=not options.hysteresis)
    findings += bends
    noise = pooled_noise(problem.sets)
    behind = _drift(solved)
    if behind is not None:
        findings.append(behind)
    doubted = [] if task.limb is None else check_limb(task.limb, *_limb_alone(task, solved), options)
    # A limb that is not as it was given draws all masses with it.
    # By the noise within sets: what was raised for what sets disagree hides it.
    plain = replace(problem, sets=tuple(replace(one, raised=1.0) for one in problem.sets))
    findings += doubted or check_masses(
        plain, expand(plain, solution.outer, solution.response), noise, options
    )
    covariance = _covariance(task, solved, solution, noise)
    of_data = data_share(problem, solution, noise, options.axis_tolerance)
    if problem.maker is not None or len(problem.limb_root):
        findings += of_data.findings(FitColumns.of(len(noise)))
    fit = outcome(problem, solution, noise, covariance, of_data)
    if problem.maker is not None and options.factory_std is None:
        known = float(of_data.share[fit.columns.limb][MASS])
        fit = with_common_scale(fit, COMMON * (1.0 - known), weighed=task.limb is not None)
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
        fit = with_bending(fit, bending, load, weighed=task.limb is not None)
    findings += check_scale(fit, options, leaning=problem.maker is not None)
    if problem.maker is None:
        findings += check_axes(fit, problem, solution, options)
    findings += check_answer(fit, task.factory)
    return fit


def _drift(solved: _Solved) -> Finding | None:
    """Return what may hide behind a drift, or None."""
    slow = slow_turn(solved.sets, solved.problem.sets)
    if slow is not None or solved.reference is None:
        return slow
    return drifting(compress(solved.sets, InSituOptions(), solved.problem.moving, True))


def _covariance(task: _Task, solved: _Solved, solution: Solution, noise: Matrix) -> Matrix:
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
    beside = errors_of_imu(solved.sets, problem, solution, solved.sphere)
    return fit_covariance(problem, solution, noise, beside, root)


def _kept_doubt(task: _Task, problem: Problem, solution: Solution, noise: Matrix) -> Matrix:
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


def _with_shares(task: _Task, solved: _Solved, fit: InSituFit) -> InSituFit:
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


def _limb_alone(
    task: _Task, solved: _Solved
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return the limb's mass and its deviation in kg by the readings alone, and with the factory matrix."""
    problem, solution = solved.problem, solved.solution
    of_limb = len(problem.limb_root) - (problem.parameters - problem.of_loads.start)
    free = replace(problem, maker=None, limb_root=problem.limb_root[of_limb:])

    def weighed(one: Problem) -> tuple[float, float]:
        alone = solve(one, [solution.outer])
        beside = errors_of_imu(solved.sets, one, alone, solved.sphere)
        root = unknowns_root(one, alone)
        covariance = fit_covariance(one, alone, pooled_noise(one.sets), beside, root)
        mass = FitColumns.of(len(alone.A)).limb.start + MASS
        return float(alone.limb[MASS]), float(np.sqrt(covariance[mass, mass]))

    by_data = None if data_rank(free, solution.limb).missing else weighed(free)
    if task.factory is None:
        return by_data, None
    return by_data, weighed(replace(free, maker=task.prior(pooled_noise(problem.sets), _MAKER)))


def _explained(symptom: Finding, task: _Task, solved: _Solved, drift: Finding | None) -> Finding:
    """Return a symptom with its likeliest cause."""
    try:
        return explained(symptom, _evidence(task, solved.sets), drift)
    except np.linalg.LinAlgError:
        return symptom


def _evidence(task: _Task, sets: tuple[InSituSet, ...]) -> Evidence:
    """Return what causes are judged by: the fit without hysteresis, of all samples where many disagree."""
    options = task.options
    with_temperature = all(data.temperature is not None for data in sets)
    parts = compress(sets, options, task.moving, with_temperature)
    if max(float(np.mean(part.rejected)) for part in parts) > _FEW_REJECTED:
        options = replace(options, robust=False)
        parts = compress(sets, options, task.moving, with_temperature)
    problem = _problem(sets, parts, task, with_temperature)
    first = starts(problem, task.factory, problem.limb if task.limb is not None else None)
    if data_rank(problem, first[0]).missing:
        problem = replace(problem, maker=task.prior(pooled_noise(parts), _AGED))
    return Evidence(sets, problem, minima(problem, first)[0], options)


def _problem(
    sets: tuple[InSituSet, ...],
    parts: tuple[CompressedSet, ...],
    task: _Task,
    temperature: bool,
) -> Problem:
    limb, root = _limb_rows(task.limb, task.moving)
    return Problem(
        sets=parts,
        added=np.array([inertial_parameters(one.added_mass, one.added_com, task.moving) for one in sets]),
        whitening=whitening(parts),
        basis=transform_basis(task.moving),
        moving=task.moving,
        temperature=temperature,
        channel_lags=0,
        rotation=task.options.estimate_rotation,
        maker=None,
        limb=limb,
        limb_root=root,
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
