"""The result of an offline fit besides its value, and the error if there is none."""

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["CalibrationRefused", "FitResult", "FitStats"]


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
    """How a fit came out.

    Attributes:
        samples: Samples that were used.
        dropped: Samples left out because a value was missing or not finite.
        gated: Samples left out by the method's own gates (too little force, too much motion).
        residual_rms: Root mean square of the residual, in the unit of the fitted data.
        rank: Number of unknown directions that the data determined.
        unknowns: Number of unknowns.
        condition: Condition number of the scaled least-squares matrix, infinite where the rank is short; for
            a fit with priors, the ratio of the least to the most certain direction's deviation.
    """

    samples: int
    dropped: int
    gated: int
    residual_rms: float
    rank: int
    unknowns: int
    condition: float
