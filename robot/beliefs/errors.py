"""Errors in a robot's model of itself: mass, centre of mass, and the map of a calibrated start."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from surefoot.sensors.configuration import NotNegative, check_fields, from_mapping, require


@dataclass(frozen=True)
class BeliefErrors:
    """Sizes of the errors in a robot's model of itself, which are drawn when its beliefs are fresh.

    Attributes:
        mass: Relative error of the total mass. Its sign is drawn, and each link's mass is drawn with this
            relative spread besides.
        com: Distance in m by which the believed centre of mass of each body is off, in one direction that is
            drawn; in the zero pose that of the whole robot is off by the same.
        scale: Relative standard deviation of a scale of a calibrated start.
        offset: Standard deviation of an offset of a calibrated start in N.

    Raises:
        ValueError: If an error is negative or not finite, or mass or com is 1 or more.
    """

    mass: float = 0.005
    com: float = 0.003
    scale: NotNegative = 0.001
    offset: NotNegative = 0.02

    def __post_init__(self) -> None:
        """Raise ValueError if a field has no meaning."""
        for name in ("mass", "com"):
            require(0.0 <= getattr(self, name) < 1.0, self, name, "lie in 0 to 1")
        check_fields(self)


USUAL: Final = BeliefErrors()  # used where no errors are given

NO_ERRORS: Final = BeliefErrors(mass=0.0, com=0.0, scale=0.0, offset=0.0)
"""A robot that knows itself."""


def belief_errors(given: BeliefErrors | Mapping[str, Any]) -> BeliefErrors:
    """Return the errors that a wrapper was given, also as a mapping of some of the fields."""
    return given if isinstance(given, BeliefErrors) else from_mapping(BeliefErrors, given)
