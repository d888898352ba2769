r"""In-situ calibration of a six-axis F/T sensor: gravity on a limb, with known masses added or without.

The model is the in-situ paper's (Traversaro, Pucci and Nori, 2015), the fit is not: readings carry the noise,
so the fit is of the readings,

.. math:: r = A_0 (1 + D) (M_b + M_a^j) g + o_j(t) + e,

over the errors D of a maker's matrix (or a response that nobody gave), the limb's inertial parameters and an
offset for each set, each with its prior. One set or a hundred, at rest or moving, the
way is the same: **data** that the accelerometer's own errors are taken off
(:mod:`~surefoot.calibration.in_situ.imu`), sets **compressed** to a few rows each
(:mod:`~surefoot.calibration.in_situ.solver.compress`), one **solution** for every likely size of the maker's
errors (:mod:`~surefoot.calibration.in_situ.maker`), findings that are **judged** in one
place (:mod:`~surefoot.calibration.results`), and the answer. The paper's own regression is in
:mod:`~surefoot.calibration.in_situ.paper`.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import ThreadpoolController

from surefoot.calibration.diagnosis import CERTAIN
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.causes.evidence import Evidence
from surefoot.calibration.in_situ.causes.ranking import find_causes, tell_causes
from surefoot.calibration.in_situ.check import check_sets
from surefoot.calibration.in_situ.data import (
    InSituOptions,
    InSituSet,
    KnownLimb,
    MatrixMode,
    Task,
    Vector,
    change_motion,
    shift,
)
from surefoot.calibration.in_situ.effects import (
    add_gains,
    centre_temperatures,
    fit_hysteresis,
    lag_loads,
    shows_loops,
    turns_slowly,
)
from surefoot.calibration.in_situ.factory import check_factory
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.calibration.in_situ.imu import fit_sphere, level, likeliest_delay, smooth
from surefoot.calibration.in_situ.judge import DOUBTS, check_masses, check_rotation, data_rank
from surefoot.calibration.in_situ.maker import AGED, KEPT, Leaning, lean, prior_of
from surefoot.calibration.in_situ.report import Solved, fit_of, refuse_fit
from surefoot.calibration.in_situ.solver.compress import compress
from surefoot.calibration.in_situ.solver.problem import Problem, problem_of, starts
from surefoot.calibration.in_situ.solver.solve import Solution, minima
from surefoot.calibration.results import CalibrationRefused, Finding, FitResult, decide

_DELAYS, _SETTLED = 6, 1e-4  # fits at most until the delay of an IMU has settled, and its last step in s


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
    added masses determine the matrix (Lemma 2). With a factory matrix one will do: entries that the
    readings do not show stay as the maker gave them.

    Args:
        sets: Readings and gravity, a set for each added mass.
        factory_matrix: The maker's C in N and N m per count, shape (6, k).
        limb: Known mass and place of the limb.
        matrix: ``"keep"`` leaves the factory matrix as it is and finds bias, mass and centre of mass;
            ``"update"`` changes it as far as the readings show that it is off; ``"free"`` fits a matrix of
            its own and uses the factory's for checks only.
        options: How to fit.
        refuse: Whether to raise where the data do not determine the fit; otherwise a fit full of NaN is
            returned, with the reason in ``refusals``.
        accept: Why a refusal shall be passed; empty if none shall. The fit that comes out holds this reason
            and all refusals that were passed. Data without any answer are refused nevertheless.

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
    factory = None if factory_matrix is None else np.asarray(factory_matrix, dtype=np.float64)
    task = Task(tuple(sets), factory, limb, options or InSituOptions(), matrix)
    # Matrices are small: threads would only wait for each other, on a busy machine for seconds.
    with _linear_algebra().limit(limits=1, user_api="blas"):
        fit = _answer(task, accept)
    if fit.result is FitResult.REFUSED and refuse:
        raise fit.refusals[0]
    return fit


@cache
def _linear_algebra() -> ThreadpoolController:
    """Find the libraries of linear algebra, which takes a while, to set their threads."""
    return ThreadpoolController()


def _answer(task: Task, accept: str) -> InSituFit:
    """Return the answer, or a fit of NaN with the reason why there is none."""
    try:
        findings = check_sets(task)
        if refused := decide(findings, accept).refused:
            return refuse_fit(task.sets, refused)
        solved, found = _solve(task)
        fit, said = fit_of(solved)
    except (CalibrationRefused, np.linalg.LinAlgError) as error:
        return refuse_fit(task.sets, (_explain_error(error, accept),))
    decision = decide(_name_causes(findings + found + said, solved, accept), accept)
    if decision.refused:
        return refuse_fit(task.sets, decision.refused)
    fit = replace(fit, warnings=decision.warnings, refusals=decision.passed)
    return replace(fit, result=FitResult.ACCEPTED, accepted=accept) if decision.passed else fit


def _explain_error(error: CalibrationRefused | np.linalg.LinAlgError, accept: str) -> CalibrationRefused:
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


def _solve(task: Task) -> tuple[Solved, list[Finding]]:
    """Return the solutions of a task with all that they are to explain, and findings."""
    sphere = fit_sphere(task.sets)
    sets, reference, said = centre_temperatures(level(task.sets, sphere))
    findings = sphere.findings + said
    delay, std = 0.0, 0.0
    for _ in range(_DELAYS):
        late = tuple(shift(data, delay) for data in sets)
        members, fits, found = _fit(task, late, warms=reference is not None)
        if not task.timed:
            break
        left = likeliest_delay(late, fits)
        then, std = max(delay + left.delay, 0.0), left.std
        worth = left.nats > 0.5 * np.log(sum(part.rows for part in fits[0].problem.sets))
        step = max(std, _SETTLED) if delay else limits.LATE
        if not worth or abs(then - delay) < step or then > limits.LATEST:
            break
        delay = then
    findings += found
    if delay:
        words = f"The IMU is late by {1e3 * delay:.1f} ms against the readings: it was shifted by that."
        findings.append(Finding("clock", words, value=delay, limit=limits.LATE, refuses=False))
    return Solved(task, late, sphere, delay, std, members, reference), findings


def _fit(
    task: Task, sets: tuple[InSituSet, ...], warms: bool
) -> tuple[list[Leaning], list[Solution], list[Finding]]:
    """Return the fits by the likely sizes of the maker's errors, those with loops, and findings.

    Loops of hysteresis are fitted also where they are not worth it, and not where few rows show them.
    """
    problem, first = _pose(task, sets, task.options, warms)
    if task.mode != "free":
        problem = replace(problem, maker=prior_of(task, problem.noise))
    rank = data_rank(problem, first[0])
    determined = not rank.missing
    if not determined and problem.maker is None:
        raise rank.refusal(problem)
    findings = _contradicting_factory(task, problem, determined=determined)
    members, said = _lean(task, problem, first)
    findings += said
    plain = members[0].solution
    chosen = add_gains(plain) if warms and determined else plain
    fits = [chosen]
    if task.options.hysteresis and task.timed:
        chosen, fits = fit_hysteresis(sets, chosen)
    if chosen is not plain:
        members, said = _lean(task, replace(chosen.problem, maker=problem.maker), [chosen.outer])
        findings += said
    if not determined:
        findings.append(Finding("rank", rank.warning(task.owner), refuses=False))
    return members, fits, findings


def _pose(
    task: Task, sets: tuple[InSituSet, ...], options: InSituOptions, warms: bool
) -> tuple[Problem, list[Vector]]:
    """Return the problem of sets, without a maker's prior, and outer unknowns to start from."""
    problem = problem_of(task, compress(sets, options, task.moving, warms), warms)
    return problem, starts(problem, task.factory, problem.limb if task.limb is not None else None)


def _lean(task: Task, problem: Problem, first: list[Vector]) -> tuple[list[Leaning], list[Finding]]:
    """Return the fits by the likely sizes of the maker's errors, and findings."""
    if task.mode == "keep":
        assert problem.maker is not None
        held = replace(problem, maker=problem.maker._replace(std=KEPT * problem.maker.std))
        return lean(held, first, stated=True), []
    found = minima(problem, first)
    members = lean(problem, [found[0].outer], stated=task.options.factory_std is not None)
    return members, check_rotation(found)


def _contradicting_factory(task: Task, problem: Problem, *, determined: bool) -> list[Finding]:
    """Check a factory matrix against the readings, by a fit without it where they determine one."""
    if task.factory is None:
        return []
    free, response = replace(problem, maker=None), np.asarray(np.linalg.pinv(task.factory))
    # Masses in one plane leave a rotation and its mirror image: the matrix knows which.
    by_data = min(
        minima(free, starts(free, None, None)),
        key=lambda one: float(np.sum((problem.whitening @ (one.A - response)) ** 2)),
    )
    with_maker = replace(problem, maker=prior_of(task, problem.noise))
    found = check_factory(task, with_maker, by_data, determined=determined)
    if any(one.refuses for one in found) and determined:
        # Sets that contradict each other without the matrix say nothing of it.
        doubted = check_masses(by_data)
        found = doubted + found if any(one.refuses for one in doubted) else found
    return found


def _name_causes(findings: list[Finding], solved: Solved, accept: str) -> list[Finding]:
    """Return findings, the worst contradiction with its likeliest cause.

    Where it is found, what follows from it is left out, unless the answer is accepted.
    """
    drift = next((one for one in findings if one.name == "slow turning"), None)
    refused = any(one.refuses for one in findings)
    # A drift may be why a fit is refused that nothing contradicts.
    doubted = (one for one in findings if one.refuses == refused and (one.contradicts or (drift and refused)))
    worst = next(doubted, drift)
    if worst is None or (worst is drift and not refused):
        return findings
    symptom = worst.with_cause(drift.reason, drift.cure) if drift and worst is not drift else worst
    # A delay that is longer than those of sound logs is one of the causes.
    late = solved.delay > limits.VERY_LATE
    sets = level(solved.task.sets, solved.sphere) if late else solved.sets
    with suppress(np.linalg.LinAlgError):
        causes = find_causes(_gather_evidence(solved.task, sets))
        symptom = tell_causes(symptom, causes, drift.cure if drift else "")
        # Without times hysteresis that nobody sees looks like many a cause.
        clear = solved.task.timed and causes.diagnosis.none < 1.0 - CERTAIN and causes.moved > limits.MOVED
        symptom = replace(symptom, refuses=worst.refuses or bool(worst.contradicts and clear))
        if causes.diagnosis.likely and refused and not accept and worst.name not in DOUBTS:
            follow = (*DOUBTS, "added masses")
            findings = [one for one in findings if one is worst or one.name not in follow]
    return [symptom if one is worst else one for one in findings if one is worst or one is not drift]


def _gather_evidence(task: Task, sets: tuple[InSituSet, ...]) -> Evidence:
    """Fit with loops of loads at most, with all samples where many disagree, to judge causes by."""
    sets = tuple(map(_quieten, sets))
    warms = all(data.temperature is not None for data in sets)
    problem, first = _pose(task, sets, task.options, warms)
    if max(float(np.mean(part.source.rejected)) for part in problem.sets) > limits.FEW_REJECTED:
        problem, first = _pose(task, sets, replace(task.options, robust=False), warms)
    if data_rank(problem, first[0]).missing:
        problem = replace(problem, maker=prior_of(task, problem.noise, AGED))
    plain = minima(problem, first)[0]
    if task.options.hysteresis and task.timed and shows_loops(problem):
        plain = lag_loads(sets, plain)
    return Evidence(sets, plain, None if task.factory is None else np.asarray(np.linalg.pinv(task.factory)))


def _quieten(data: InSituSet) -> InSituSet:
    """Return a set with gravity and motion free of noise, which would hide behind any filter or delay."""
    if data.time is None or not np.isfinite(data.gravity).all() or not turns_slowly(data.gravity):
        return data
    return change_motion(data, lambda values: np.stack([smooth(one) for one in values.T], axis=1))
