"""What an offline fit returns in addition to its value: statistics, findings of checks, and refusals."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum


class FitResult(StrEnum):
    """How much of the value the data determined."""

    DETERMINED = "determined"
    """Every unknown follows from the data."""

    PARTLY_DETERMINED = "partly determined"
    """Directions that the data do not excite keep their starting values. See the rank."""

    REFUSED = "refused"
    """The data do not determine it. The fit holds the reasons."""

    ACCEPTED = "accepted"
    """It would be refused, but the caller gave a reason to accept it. The fit holds both."""


class CalibrationRefused(ValueError):  # noqa: N818 - a refusal is not an error of the program
    """Raised if the data do not determine a fit.

    Attributes:
        reason: What is missing or wrong.
        cure: The remedy.

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
    """Statistics of a fit."""

    samples: int  # samples that were used
    dropped: int  # samples left out because a value was missing or not finite
    gated: int  # samples left out by the method's thresholds (too little force, too much motion)
    residual_rms: float  # root mean square of the residual, in the unit of the fitted data
    rank: int  # number of directions of the unknowns that the data determined
    unknowns: int  # number of unknowns
    condition: float
    """Condition number of the scaled least-squares matrix, infinite if it is rank deficient. For a fit with
    priors: largest over smallest posterior standard deviation of a direction."""


@dataclass(frozen=True)
class Finding:
    """Result of a check."""

    name: str  # name of the check
    reason: str  # the observation, in a sentence
    cure: str = ""  # advice for the user, empty if no action is needed
    value: float = float("nan")  # the value that was compared with the limit
    limit: float = float("nan")  # the limit
    refuses: bool = True  # whether the result is refused unless the caller accepts it with a reason
    contradicts: bool = False
    """Whether sets contradict each other or themselves, which can have many causes."""

    @property
    def refusal(self) -> CalibrationRefused:
        """The finding as an exception."""
        return CalibrationRefused(self.reason, self.cure)

    def with_cause(self, likeliest: str, cure: str) -> "Finding":
        """Return the finding with a sentence about its likeliest cause, and the cure of that cause."""
        return replace(self, reason=f"{self.reason} {likeliest}", cure=cure)


@dataclass(frozen=True)
class Decision:
    """Decision on findings: the refusals (``refused``, or ``passed`` if accepted), and the warnings."""

    refused: tuple[CalibrationRefused, ...]
    passed: tuple[CalibrationRefused, ...]
    warnings: tuple[str, ...]


def decide(findings: Sequence[Finding], accept: str) -> Decision:
    """Return the decision on findings. Findings refuse unless ``accept``, a reason to continue, is given."""
    unique = list(dict.fromkeys(findings))
    refusals = tuple(finding.refusal for finding in unique if finding.refuses)
    warnings = tuple(f"{finding.reason} {finding.cure}".rstrip() for finding in unique if not finding.refuses)
    return Decision(() if accept else refusals, refusals if accept else (), warnings)
