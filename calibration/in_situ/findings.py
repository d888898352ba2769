"""Findings of checks, as values; one place decides which refuse (:func:`decide`)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from surefoot.calibration.results import CalibrationRefused


@dataclass(frozen=True)
class Finding:
    """Result of a check.

    Attributes:
        name: Of the check.
        reason: The observation, in a sentence.
        cure: Advice for the user; empty if nothing need be done.
        value: That was held against a limit.
        limit: The limit.
        refuses: Whether an answer must not be given without a reason of the caller's.
        contradicts: Whether sets contradict each other or themselves, for which there may be many causes.
    """

    name: str
    reason: str
    cure: str = ""
    value: float = float("nan")
    limit: float = float("nan")
    refuses: bool = True
    contradicts: bool = False

    @property
    def refusal(self) -> CalibrationRefused:
        """The finding as an error to raise."""
        return CalibrationRefused(self.reason, self.cure)

    def with_cause(self, likeliest: str, cure: str) -> "Finding":
        """Add the likeliest cause, in words, and its cure."""
        return replace(self, reason=f"{self.reason} {likeliest}", cure=cure)


@dataclass(frozen=True)
class Decision:
    """Verdict on findings: ``refused`` without a reason, ``passed`` with one, and warnings."""

    refused: tuple[CalibrationRefused, ...]
    passed: tuple[CalibrationRefused, ...]
    warnings: tuple[str, ...]


def decide(findings: Sequence[Finding], accept: str) -> Decision:
    """Return the decision on findings: one that refuses does so unless a reason to go on was given."""
    once = list(dict.fromkeys(findings))
    refusals = tuple(one.refusal for one in once if one.refuses)
    warnings = tuple(f"{one.reason} {one.cure}".rstrip() for one in once if not one.refuses)
    return Decision(() if accept else refusals, refusals if accept else (), warnings)
