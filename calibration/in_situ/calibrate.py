r"""In-situ calibration of a six-axis F/T sensor: gravity on a limb, with known masses added or without.

The model is the in-situ paper's (Traversaro, Pucci and Nori, 2015), the fit is not: readings carry the noise,
so the fit is of the readings,

.. math:: r = A_0 (1 + D) (M_b + M_a^j) g + o_j(t) + e,

over the errors D of a maker's matrix (or a response that nobody gave), the limb's inertial parameters and an
offset for each set, each with its prior. The steps are data, checks
(:mod:`~surefoot.calibration.in_situ.check`), the fit (:mod:`~surefoot.calibration.in_situ.estimate`), the
answer with its covariance (:mod:`~surefoot.calibration.in_situ.report`), and causes of contradictions
(:mod:`~surefoot.calibration.in_situ.causes`). Checks return findings, and one function decides which of them
refuse (:mod:`~surefoot.calibration.results`). The paper's own regression is in
:mod:`~surefoot.calibration.in_situ.paper`.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import ThreadpoolController

from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.causes.diagnose import explain
from surefoot.calibration.in_situ.causes.matrix import check_factory
from surefoot.calibration.in_situ.check import check_sets
from surefoot.calibration.in_situ.data import InSituOptions, InSituSet, KnownLimb, MatrixMode, Task
from surefoot.calibration.in_situ.estimate import solve_task
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.calibration.in_situ.imu import level
from surefoot.calibration.in_situ.report import fit_of, refuse_fit
from surefoot.calibration.results import CalibrationRefused, FitResult, decide


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
        solved, found = solve_task(task)
        findings += [*found, *check_factory(task, solved.fits.plain, solved.fits.determined)]
        fit, found = fit_of(solved)
    except (CalibrationRefused, np.linalg.LinAlgError) as error:
        return refuse_fit(task.sets, (_explain_error(error, accept),))
    # A delay that is longer than those of sound logs is one of the causes.
    late = solved.delay > limits.VERY_LATE
    sets = level(task.sets, solved.sphere) if late else solved.sets
    decision = decide(explain([*findings, *found], task, sets, accept), accept)
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
