"""Find the cause of a contradiction between sets, or within one.

A mistake adds signals to the readings (a jump, a contact, a limb that bends), changes the added masses
(another mass, another place, another limb), or reads gravity otherwise (a delayed clock, repeated values,
other axes). The fit is repeated with each on the same compressed rows; :mod:`surefoot.calibration.diagnosis`
compares them.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from surefoot.calibration.diagnosis import CERTAIN, Diagnosis, Mistake, investigate
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.causes.events import bending, events
from surefoot.calibration.in_situ.causes.posed import EXPERIENCE, Posed, fit_posed
from surefoot.calibration.in_situ.causes.readings import clocks, sensors
from surefoot.calibration.in_situ.causes.setup import exchange, frames, masses
from surefoot.calibration.in_situ.data import InSituSet, Task, change_motion
from surefoot.calibration.in_situ.estimate import pose
from surefoot.calibration.in_situ.hysteresis import lag_loads, shows_loops, turns_slowly
from surefoot.calibration.in_situ.imu import smooth
from surefoot.calibration.in_situ.judge import DOUBTS, data_rank
from surefoot.calibration.in_situ.model import AXES, LEAST_LEVER, STATIC
from surefoot.calibration.in_situ.solver.maker import AGED, prior_of
from surefoot.calibration.in_situ.solver.solve import Solution, minima
from surefoot.calibration.results import Finding

Table = Callable[[Posed, Solution], Iterator[Mistake]]
TABLE: tuple[Table, ...] = (events, bending, clocks, frames, exchange, masses, sensors)
"""Functions that yield mistakes for a problem and its solution."""


def explain(findings: list[Finding], task: Task, sets: tuple[InSituSet, ...], accept: str) -> list[Finding]:
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
    with suppress(np.linalg.LinAlgError):
        posed, plain = pose_without_causes(task, sets)
        mistakes = (mistake for table in TABLE for mistake in _mistakes(table, posed, plain))
        found = investigate(posed, mistakes, fit_posed, EXPERIENCE, posed.rows)
        symptom = found.explain(symptom, drift.cure if drift else "")
        # Without times hysteresis that nobody sees looks like many a cause.
        clear = task.timed and found.none < 1.0 - CERTAIN and _change_of_loads(plain, found) > limits.MOVED
        symptom = replace(symptom, refuses=worst.refuses or bool(worst.contradicts and clear))
        if found.likely and refused and not accept and worst.name not in DOUBTS:
            follow = (*DOUBTS, "added masses")
            findings = [one for one in findings if one is worst or one.name not in follow]
    return [symptom if one is worst else one for one in findings if one is worst or one is not drift]


def _mistakes(table: Table, posed: Posed, plain: Solution) -> Iterator[Mistake]:
    """Yield the mistakes of a table; with bad data the search for their sizes may be singular."""
    with suppress(np.linalg.LinAlgError):
        yield from table(posed, plain)


def pose_without_causes(task: Task, sets: tuple[InSituSet, ...]) -> tuple[Posed, Solution]:
    """Return the problem that causes are compared with, and its solution.

    It has hysteresis if the sets have times, because that resembles a short delay, and all samples if many
    disagree with the others.
    """
    sets = tuple(map(_quieten, sets))
    warms = all(data.temperature is not None for data in sets)
    problem, first = pose(task, sets, task.options, warms)
    if max(float(np.mean(part.source.rejected)) for part in problem.sets) > limits.FEW_REJECTED:
        problem, first = pose(task, sets, replace(task.options, robust=False), warms)
    if data_rank(problem, first[0]).missing:
        problem = replace(problem, maker=prior_of(task, problem.noise, AGED))
    plain = minima(problem, first)[0]
    starts = [plain.outer]
    if task.options.hysteresis and task.timed and shows_loops(problem):
        plain = lag_loads(sets, plain)
        # Loops that imitate a mistake lead the search without it astray.
        added = len(plain.outer) - len(starts[0])
        starts = [plain.outer, np.insert(starts[0], problem.parameters, np.zeros(added))]
    response = None if task.factory is None else np.asarray(np.linalg.pinv(task.factory))
    return Posed(sets, plain.problem, tuple(starts), response), plain


def _quieten(data: InSituSet) -> InSituSet:
    """Return a set with gravity and motion free of noise, which would hide behind any filter or delay."""
    if data.time is None or not np.isfinite(data.gravity).all() or not turns_slowly(data.gravity):
        return data
    return change_motion(data, lambda values: np.stack([smooth(one) for one in values.T], axis=1))


def _change_of_loads(plain: Solution, found: Diagnosis) -> float:
    """Return the relative change of contact loads by the likeliest cause, torques over the limb's lever arm.

    Zero if that cause has many unknowns: it may then only imitate a law of hysteresis that the fit does not
    model.
    """
    if found.likely is None or found.likely.mistake.free > STATIC:
        return 0.0
    mass, *moment = plain.limb[:STATIC]
    lever = max(float(np.linalg.norm(moment)) / max(abs(mass), np.finfo(float).tiny), LEAST_LEVER)
    size = np.repeat([1.0, lever], 3)
    apart = (np.linalg.pinv(plain.A) @ found.likely.solution.A - np.eye(AXES)) / size[:, None] * size
    return float(np.linalg.norm(apart) / np.sqrt(AXES))
