r"""Find the mistake that explains why data contradict themselves, among listed mistakes and an unknown one.

A domain supplies a table of mistakes, each with a function that undoes it in the data, and one fit, which
returns a log evidence and the size of the residuals. :func:`investigate` fits the data as they are and with
each mistake undone. The size is compared with that of sound data, which includes the model's own error:
:math:`t_i` is the probability that sound data leave residuals at least as large. Evidence divides the
probability among the listed alternatives, w_i = softmax(evidence). A mistake that is not on the list has
prior probability p, and a listed one mimics it with probability q so well that undoing it leaves residuals of
sound data:

.. math::

    P_i = \frac{(1 - p)\, w_i t_i}{p q + (1 - p) \sum_j w_j t_j}, \qquad
    P_{unknown} = \frac{p q}{p q + (1 - p) \sum_j w_j t_j}.

A cause is therefore certain only if undoing it leaves residuals that sound data have. Both p and q are
measured by leaving one kind of mistake out of the list at a time (``tests/spoilt/_spoilt_logs.py``).

The best of c alternatives with d unknowns of their own, fitted to n rows, gains :math:`\frac d2 \log n + \log
c` by chance (Schwarz, 1978), which is taken off its evidence. Errors of the model repeat in many rows. Where
rows do not count for less because of that, evidence is limited by the reduction of the residuals over an
effective number of readings.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp, ndtr, softmax

from surefoot.calibration.results import Finding

CERTAIN = 0.9
"""Probability above which a cause is certain enough to refuse the data because of it."""

LIKELY = 0.5
"""Probability above which something is likelier than everything else together."""

CLEARER = 10.0  # nats of evidence that a mistake must gain to be called the closest: 1 in 22,000 by chance
_CLOSER = 0.5  # largest share of the residuals that the closest mistake may leave to be reported
_FINER = 0.3  # share of the effective readings that count where residuals are below those of good instruments
_MAY_BE_SOUND = 0.05  # probability of such residuals in sound data above which the data may be sound
_SHOWN = 0.999  # largest probability that a sentence states


@dataclass(frozen=True)
class Experience:
    """What is known about data of one type before they are seen."""

    unknown: float
    """Prior probability p that data which contradict themselves contain a mistake that is not listed."""

    mimicked: float
    """Probability q that undoing a listed mistake in such data leaves residuals like those of sound data."""

    size: float
    """Median size of the residuals of sound data."""

    spread: float
    """Standard deviation of the logarithm of that size among sound data."""

    kinds: float = 1.0
    """Kinds of mistakes, by which each is rarer than sound data."""

    readings: float = np.inf
    """Effective number of readings for an error of the model, however many rows repeat it."""

    good: float = 0.0
    """Residuals of good instruments: while data may be sound, a further reduction is no evidence."""

    best: float = 0.0
    """The same of the best instruments, for data that are not sound."""

    def sound(self, size: float) -> float:
        """Return the probability that sound data have residuals of at least this size."""
        return float(ndtr(-np.log(max(size, 1e-12) / self.size) / self.spread))


def _keep(data: Any) -> Any:
    return data


class Mistake(NamedTuple):
    """A mistake that data may contain."""

    kind: str  # for tables and tests
    cause: str | Callable[[Any], str]
    """The mistake as a clause, or a function that returns it by the solution of the data without it: empty if
    no such mistake is possible, such as a negative mass."""
    cure: str  # advice for the user, as a clause
    undo: Callable[[Any], Any] = _keep
    """Changes data to those without the mistake. By default they stay: the fit contains the mistake."""
    free: int = 0  # unknowns that the data have in addition without it, such as the time of a jump
    choices: int = 1  # number of equally likely alternatives of this kind


class Fitted(NamedTuple):
    """How well data fit their model."""

    evidence: float  # natural logarithm
    size: float  # of the residuals, in the unit of :attr:`Experience.size`
    solution: Any = None  # the fit itself


class Tried(NamedTuple):
    """A fit of the data with one mistake undone."""

    mistake: Mistake
    evidence: float  # natural logarithm, less what such a mistake gains by chance
    size: float  # of the residuals that are left, in the unit of :attr:`Experience.size`
    solution: Any = None


class Cause(NamedTuple):
    """A mistake with the probability that it is the cause."""

    mistake: Mistake
    probability: float
    evidence: float
    size: float
    solution: Any = None


@dataclass(frozen=True)
class Diagnosis:
    """The probabilities of all listed mistakes, of none and of an unknown one, which add up to one."""

    causes: tuple[Cause, ...]  # by falling probability
    none: float  # that the data are sound as they are
    unknown: float  # that they contain a mistake that is not listed
    closest: Cause | None = None
    """The mistake with most evidence, unless it has little, or leaves half of the residuals."""

    @property
    def likely(self) -> Cause | None:
        """The likeliest cause, or ``None`` if the two likeliest together are less likely than the rest.

        Two mistakes with the same effect share their probability, and the message names both.
        """
        if not self.causes or sum(one.probability for one in self.causes[:2]) <= LIKELY:
            return None
        return self.causes[0] if self.causes[0].probability > max(self.none, self.unknown) else None

    @property
    def is_certain(self) -> bool:
        """Whether one cause is certain."""
        return bool(self.causes) and self.causes[0].probability > CERTAIN

    def sentence(self) -> str:
        """Name the likeliest cause with its probability, or say that the cause is unknown."""
        likely = self.likely
        if likely is None:
            return f"None of the {len(self.causes)} mistakes that were tried explains it."
        second = max(self.causes[1:], key=lambda one: one.probability, default=None)
        rest = f"unknown {percent(self.unknown)}"
        if second is not None and second.probability > self.unknown:
            rest += f", next {percent(second.probability)}: {second.mistake.cause}"
        odds = f"probability {percent(likely.probability)}, {rest}"
        return f"The likeliest cause: {likely.mistake.cause} ({odds})."

    @property
    def cure(self) -> str:
        """The cure of the likeliest cause as a sentence, or empty text."""
        return sentence(self.likely.mistake.cure) if self.likely else ""

    def explain(self, symptom: Finding, instead: str = "") -> Finding:
        """Add the likeliest cause to a symptom, and the remedy ``instead`` in case that cause is wrong.

        If data contain a mistake but no cause is likely, say that, and name the closest if there is one.
        """
        if self.none > LIKELY or not self.causes:
            return symptom
        if self.likely:
            cure = f"{self.cure} If that is not it: {instead}" if instead else self.cure
            return symptom.with_cause(self.sentence(), cure)
        if self.closest is None:
            return symptom.with_cause(self.sentence(), symptom.cure)
        words = (
            f"{self.sentence()} The closest of them: {self.closest.mistake.cause}, which leaves "
            f"{self.closest.size:.2g} of the readings' spread."
        )
        return symptom.with_cause(words, f"{symptom.cure} Or {self.closest.mistake.cure}.".lstrip())


def investigate(
    data: Any,
    mistakes: Iterable[Mistake],
    fit: Callable[[Any], Fitted],
    experience: Experience,
    rows: float,
) -> Diagnosis:
    """Fit data as they are and with each mistake undone, and return the probability of each.

    Of mistakes with the same cause the likeliest counts. One whose fit is singular is left out.

    Args:
        data: The data.
        mistakes: The mistakes to try.
        fit: Fits data, as they are or with a mistake undone.
        experience: What is known about such data.
        rows: Number of rows that the fit has.
    """
    plain = fit(data)
    least = experience.good if experience.sound(plain.size) > _MAY_BE_SOUND else experience.best
    best: dict[str, Tried] = {}
    for mistake in mistakes:
        with suppress(np.linalg.LinAlgError):
            undone = fit(mistake.undo(data))
            cause = mistake.cause if isinstance(mistake.cause, str) else mistake.cause(undone.solution)
            gain = _gain(mistake, plain, undone, experience, rows, least)
            if cause and (cause not in best or gain > best[cause].evidence):
                best[cause] = Tried(mistake._replace(cause=cause), gain, undone.size, undone.solution)
    tried = list(best.values())
    if tried and np.isfinite(experience.readings):
        # If the data contain a mistake, residuals below those of good instruments tell which.
        gains = np.array([one.evidence for one in tried])
        left = np.clip([one.size for one in tried], experience.best, least)
        finer = gains + _FINER * experience.readings * np.log(least / left)
        evidence = logsumexp(gains) + finer - logsumexp(finer)
        tried = [one._replace(evidence=float(e)) for one, e in zip(tried, evidence, strict=True)]
    found = diagnose(tried, 0.0, plain.size, experience)
    closest = max(found.causes, key=lambda one: one.evidence, default=None)
    if closest and (closest.evidence < CLEARER or closest.size > _CLOSER * plain.size):
        closest = None
    return replace(found, closest=closest)


def _gain(
    mistake: Mistake, plain: Fitted, undone: Fitted, experience: Experience, rows: float, least: float
) -> float:
    """Return the evidence that a mistake gains over the data as they are."""

    def by_chance(count: float) -> float:
        return float(0.5 * mistake.free * np.log(count) + np.log(mistake.choices))

    gain = undone.evidence - plain.evidence - by_chance(rows)
    if np.isfinite(experience.readings):
        better = float(np.log(max(plain.size, least) / max(undone.size, least)))
        gain = min(gain, experience.readings * better - by_chance(experience.readings))
    return gain - float(np.log(experience.kinds))


def diagnose(tried: Sequence[Tried], evidence: float, size: float, experience: Experience) -> Diagnosis:
    """Return the probability of each mistake that was tried.

    ``evidence`` and ``size`` belong to the data as they are. The caller subtracts from the evidence of each
    mistake what it gains by chance. If errors of the model repeat, rows depend on each other, and the caller
    weights their evidence accordingly.
    """
    p, q = experience.unknown, experience.mimicked
    share = softmax(np.array([evidence, *(one.evidence for one in tried)]))
    fits = np.array([experience.sound(one) for one in (size, *(one.size for one in tried))])
    odds = (1.0 - p) * share * fits
    none, *listed = (odds / (p * q + odds.sum())).tolist()
    causes = [
        Cause(one.mistake, P, one.evidence, one.size, one.solution)
        for one, P in zip(tried, listed, strict=True)
    ]
    # Where no listed mistake is left with any probability, evidence decides which is closest.
    causes.sort(key=lambda one: (-one.probability, -one.evidence))
    return Diagnosis(tuple(causes), none, 1.0 - none - sum(listed))


def sentence(clause: str) -> str:
    """Return a clause as a sentence."""
    return f"{clause[0].upper()}{clause[1:]}."


def percent(probability: float) -> str:
    """Return a probability in per cent for a message."""
    if probability > _SHOWN:
        return f"more than {100.0 * _SHOWN:.1f} %"
    if probability < 1.0 - _SHOWN:
        return f"less than {100.0 * (1.0 - _SHOWN):.1f} %"
    return f"{100.0 * probability:.2g} %" if probability < 0.995 else f"{100.0 * probability:.1f} %"
