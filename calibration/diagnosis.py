r"""Find the mistake that explains why data contradict themselves, among listed mistakes and an unknown one.

The data as they are and each listed mistake i, undone, are fitted. A fit has a log evidence and a size of its
residuals. The size is compared with that of sound data, which includes the model's own error: :math:`t_i` is
the probability that sound data leave residuals at least as large. Evidence divides the probability among the
listed alternatives, w_i = softmax(evidence). A mistake that is not on the list has prior probability p, and a
listed one mimics it with probability q so well that undoing it leaves residuals of sound data:

.. math::

    P_i = \frac{(1 - p)\, w_i t_i}{p q + (1 - p) \sum_j w_j t_j}, \qquad
    P_{unknown} = \frac{p q}{p q + (1 - p) \sum_j w_j t_j}.

A cause is therefore certain only if undoing it leaves residuals that sound data have. Both p and q are
measured by leaving one kind of mistake out of the list at a time (``benchmarks/spoilt_logs.py``).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr, softmax

CERTAIN = 0.9
"""Probability above which a cause is certain enough to refuse the data because of it."""

LIKELY = 0.5
"""Probability above which something is likelier than everything else together."""

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

    def sound(self, size: float) -> float:
        """Return the probability that sound data have residuals of at least this size."""
        return float(ndtr(-np.log(max(size, 1e-12) / self.size) / self.spread))


def _keep(data: Any) -> Any:
    return data


class Mistake(NamedTuple):
    """A mistake that data may contain."""

    kind: str  # for tables and tests
    cause: str  # the mistake, as a clause
    cure: str  # advice for the user, as a clause
    undo: Callable[[Any], Any] = _keep
    """Changes data to those without the mistake. By default they stay: the fit contains the mistake."""


class Tried(NamedTuple):
    """A fit of the data with one mistake undone."""

    mistake: Mistake
    evidence: float  # natural logarithm
    size: float  # of the residuals that are left, in the unit of :attr:`Experience.size`


class Cause(NamedTuple):
    """A mistake with the probability that it is the cause."""

    mistake: Mistake
    probability: float
    evidence: float
    size: float


@dataclass(frozen=True)
class Diagnosis:
    """The probabilities of all listed mistakes, of none and of an unknown one, which add up to one."""

    causes: tuple[Cause, ...]  # by falling probability
    none: float  # that the data are sound as they are
    unknown: float  # that they contain a mistake that is not listed

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


def diagnose(tried: Sequence[Tried], evidence: float, size: float, experience: Experience) -> Diagnosis:
    """Return the probability of each mistake that was tried.

    ``evidence`` and ``size`` belong to the data as they are. The caller subtracts the logarithm of the number
    of alternatives from the evidence of each. If errors of the model repeat, rows depend on each other, and
    the caller weights their evidence accordingly.
    """
    p, q = experience.unknown, experience.mimicked
    share = softmax(np.array([evidence, *(one.evidence for one in tried)]))
    fits = np.array([experience.sound(one) for one in (size, *(one.size for one in tried))])
    odds = (1.0 - p) * share * fits
    none, *listed = (odds / (p * q + odds.sum())).tolist()
    causes = [Cause(one.mistake, P, one.evidence, one.size) for one, P in zip(tried, listed, strict=True)]
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
