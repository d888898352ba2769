r"""Rank the possible causes of a contradiction between sets, including an unknown cause.

A cause adds signals to the readings (a jump, a contact, a limb that bends), changes the added masses (another
mass, another place, another limb), or interprets gravity differently (a delayed clock, repeated values, other
axes). The fit is repeated with each cause on the same compressed rows. Alternatives of one kind, such as the
set that contains a jump, have equal prior probabilities. Times and delays are unknowns of the fit. The
evidence for a cause with d additional unknowns that is the best of c alternatives follows Schwarz (1978).
With the likelihood L of n rows, which includes the priors of the fit, it is

.. math:: \log L - \tfrac{1}{2} d \log n - \log c.

This evidence is limited by the reduction of the residuals, because errors of the sensor model are repeated in
many rows. :mod:`surefoot.calibration.diagnosis` converts it to probabilities.
"""

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import orthonormal
from surefoot.calibration.diagnosis import Diagnosis, Experience, Mistake, Tried, diagnose
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.causes.events import try_bending, try_events
from surefoot.calibration.in_situ.causes.evidence import Cause, Evidence
from surefoot.calibration.in_situ.causes.masses import try_exchange, try_frame, try_masses
from surefoot.calibration.in_situ.causes.readings import try_reading, try_sensor
from surefoot.calibration.in_situ.model import AXES, LEAST_LEVER, STATIC
from surefoot.calibration.in_situ.solver.solve import Solution, deviance
from surefoot.calibration.results import Finding

_TINY = float(np.finfo(float).tiny)

EXPERIENCE = Experience(unknown=0.2, mimicked=0.2, size=0.003, spread=0.6)
"""Residuals of sound sets are 0.1 to 0.9 % of the spread, mostly hysteresis.

Measured by benchmarks/in_situ_spoilt.py.
"""

_BEST, _LEAST = 0.0025, 0.0005  # residuals of good sensors and of the best ones, as shares of the spread
_SURE = 30.0  # nats of evidence above which data certainly contain a mistake
_MAY_BE_SOUND = 0.05  # probability of such residuals in sound sets above which the sets may be sound

_CLOSER = 0.5  # largest share of the residuals that the closest mistake may leave to be reported

_MISTAKES = 20.0  # kinds of mistakes; each is rarer than sound data by this factor

_LAW = 100.0
"""Effective number of readings for an error of the sensor model, however many samples repeat it.
Hysteresis loops of two laws differ by a few numbers per axis. So do loops of one law at different swings."""


class Causes(NamedTuple):
    """Result of the search for the causes of a contradiction."""

    diagnosis: Diagnosis  # probabilities of all tested causes
    closest: Tried | None  # best mistake, unless its evidence is weak or half of the residuals remain
    moved: float
    """Relative change of contact loads by the likeliest cause. Zero if that cause has many unknowns, because
    it may then only imitate a hysteresis law that the fit does not model."""

    @classmethod
    def of(cls, tried: Sequence[Tried], evidence: float, size: float, experience: Experience) -> "Causes":
        """Compare the tested causes with each other and with the fit without any cause."""
        found = diagnose(tried, evidence, size, experience)
        closest = max(tried, key=lambda one: one.evidence, default=None)
        if closest and (closest.evidence - evidence < limits.CLEARER or closest.size > _CLOSER * size):
            closest = None
        return cls(found, closest, 0.0)


def find_causes(evidence: Evidence) -> Causes:
    """Test all known causes, and return the probabilities of each, of no cause, and of an unknown cause."""
    found = list[Cause]()
    for look in _KINDS:
        # With bad data the fit of some causes may be singular.
        with suppress(np.linalg.LinAlgError):
            found += look(evidence)
    rows = sum(part.rows for part in evidence.problem.sets)
    size, before = _measure_left(evidence, evidence.solution), deviance(evidence.solution)
    # If a sound sensor may have these residuals, a further reduction is not evidence of a mistake.
    least = _BEST if EXPERIENCE.sound(size) > _MAY_BE_SOUND else _LEAST
    best: dict[str, tuple[Tried, Cause]] = {}
    for one in found:
        left = _measure_left(evidence, one.solution)
        gain = 0.5 * (before - deviance(one.solution)) - penalise(one.free, rows, one.choices)
        better = np.log(max(size, least) / max(left, least))
        gain = min(gain, _LAW * float(better) - penalise(one.free, _LAW, one.choices)) - np.log(_MISTAKES)
        tried = Tried(Mistake("", one.words, _as_clause(one.cure)), gain, left)
        if one.words not in best or gain > best[one.words][0].evidence:
            best[one.words] = (tried, one)
    every = [tried for tried, _ in best.values()]
    if max((one.evidence for one in every), default=0.0) > _SURE:
        # The data contain a mistake. Residuals below those of good sensors then also help to identify it.
        every = [
            one._replace(
                evidence=one.evidence + _LAW * float(np.log(least / np.clip(one.size, _LEAST, least)))
            )
            for one in every
        ]
    causes = Causes.of(every, 0.0, size, EXPERIENCE)
    likely = None if causes.diagnosis.likely is None else best[causes.diagnosis.likely.mistake.cause][1]
    if likely is None or likely.free > STATIC:
        return causes
    return causes._replace(moved=_measure_move(evidence.solution, likely.solution))


def _as_clause(sentence: str) -> str:
    return sentence[0].lower() + sentence[1:].removesuffix(".")


def _measure_left(evidence: Evidence, solution: Solution) -> float:
    """Return the residual of a solution without white noise, as a share of the spread of forces and torques.

    A slope within a set is attributed to offset drift. Without times, noise cannot be separated from other
    residuals within a set, so only disagreement between sets counts.
    """
    to_wrench, timed = np.linalg.pinv(solution.A).T, evidence.timed
    left, spread, samples = np.zeros(AXES), np.zeros(AXES), 0.0
    for part, B in zip(solution.problem.sets, solution.predicted, strict=True):
        weight, u, read = np.split(part.source.columns, [1, 1 + part.source.inputs], axis=1)
        ramp = np.linspace(-1.0, 1.0, part.rows)[:, None] * weight if timed else weight[:, :0]
        basis, _ = orthonormal(np.hstack([weight, ramp]))
        rest = (read - u @ B.T) @ to_wrench
        rest = rest - basis @ (basis.T @ rest)
        left += np.sum(rest**2, axis=0)
        left -= np.sum(np.diff(rest, axis=0) ** 2, axis=0) / 2.0 if timed else 0.0
        level = (read - weight @ (weight.T @ read) / np.sum(weight**2)) @ to_wrench
        spread = np.maximum(spread, np.sum(level**2, axis=0) / np.sum(weight**2))
        samples += float(np.sum(weight**2))
    if not timed:
        left -= sum(np.sum((part.residual @ to_wrench) ** 2, axis=0) for part in evidence.problem.sets)
    share = np.sum(left.reshape(2, 3), axis=1) / np.maximum(np.sum(spread.reshape(2, 3), axis=1), _TINY)
    return float(np.sqrt(np.mean(np.maximum(share, 0.0)) / samples))


def _measure_move(one: Solution, other: Solution) -> float:
    """Return the relative difference of two fits in contact loads, with torques over the limb's lever arm."""
    mass, *moment = one.limb[:STATIC]
    lever = max(float(np.linalg.norm(moment)) / max(abs(mass), _TINY), LEAST_LEVER)
    size = np.repeat([1.0, lever], 3)
    apart = (np.linalg.pinv(one.A) @ other.A - np.eye(AXES)) / size[:, None] * size
    return float(np.linalg.norm(apart) / np.sqrt(AXES))


def penalise(free: int, rows: float, choices: int) -> float:
    """Return the nats that the best of several alternatives with free unknowns gains by chance."""
    return float(0.5 * free * np.log(rows) + np.log(choices))


def tell_causes(symptom: Finding, causes: Causes, instead: str = "") -> Finding:
    """Add the likeliest cause to a symptom, and the remedy ``instead`` in case that cause is wrong.

    If data contain a mistake but no cause is likely, report that, and the closest cause if there is one.
    """
    diagnosis, closest = causes.diagnosis, causes.closest
    if diagnosis.none > 0.5 or not diagnosis.causes:
        return symptom
    if diagnosis.likely:
        cure = f"{diagnosis.cure} If that is not it: {instead}" if instead else diagnosis.cure
        return symptom.with_cause(diagnosis.sentence(), cure)
    if closest is None:
        return symptom.with_cause(diagnosis.sentence(), symptom.cure)
    words = (
        f"{diagnosis.sentence()} The closest of them: {closest.mistake.cause}, which leaves "
        f"{closest.size:.2g} of the readings' spread."
    )
    return symptom.with_cause(words, f"{symptom.cure} Or {closest.mistake.cure}.".lstrip())


_KINDS = (try_events, try_bending, try_reading, try_frame, try_exchange, try_masses, try_sensor)
