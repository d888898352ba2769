"""The result of an offline fit besides its value: findings of checks, and the error if there is none."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum


class FitResult(StrEnum):
    """How much of the value the data determined."""

    DETERMINED = "determined"
    """Every unknown follows from the data."""

    PARTLY_DETERMINED = "partly determined"
    """Directions that the data do not excite were left where they started; see the rank."""

    REFUSED = "refused"
    """The data do not determine it; the reasons are with the fit."""

    ACCEPTED = "accepted"
    """It was refused, and was made all the same as somebody gave a reason; both are with the fit."""


class CalibrationRefused(ValueError):  # noqa: N818 - a refusal is not an error of the program
    """Raised by a fit that the data do not determine.

    Attributes:
        reason: The missing data.
        cure: The cure.

    >>> raise CalibrationRefused("Only one load was seen.", "Add a reading without load.")
    Traceback (most recent call last):
    ...
    surefoot.calibration.results.CalibrationRefused: Only one load was seen. Add a reading without load.
    """

    def __init__(self, reason: str, cure: str) -> None:
        self.reason = reason
        self.cure = cure
        super().__init__(reason, cure)

    def __str__(self) -> str:
        return f"{self.reason} {self.cure}"


@dataclass(frozen=True)
class FitStats:
    """How a fit came out."""

    samples: int  # samples that were used
    dropped: int  # samples left out because a value was missing or not finite
    gated: int  # samples left out by the method's own gates (too little force, too much motion)
    residual_rms: float  # root mean square of the residual, in the unit of the fitted data
    rank: int  # number of unknown directions that the data determined
    unknowns: int  # number of unknowns
    condition: float
    """Condition number of the scaled least-squares matrix, infinite where the rank is short; for a fit with
    priors, the ratio of the least to the most certain direction's deviation."""


@dataclass(frozen=True)
class Finding:
    """Result of a check."""

    name: str  # of the check
    reason: str  # the observation, in a sentence
    cure: str = ""  # advice for the user; empty if nothing need be done
    value: float = float("nan")  # that was held against a limit
    limit: float = float("nan")  # the limit
    refuses: bool = True  # whether an answer must not be given without a reason of the caller's
    contradicts: bool = False
    """Whether sets contradict each other or themselves, for which there may be many causes."""

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
