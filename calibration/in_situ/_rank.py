"""Which unknowns of an in-situ calibration the data determine at all; private."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ._model import STATIC
from surefoot.calibration.in_situ._solve import Problem, expand, of_unit_length
from surefoot.calibration.results import CalibrationRefused

__all__ = ["DataRank", "data_rank"]

_RELATIVE = 1e-7
"""A direction is unseen if its singular value, for columns of unit length, is this share of the largest."""

_TAKES_PART = 1e-3
"""An unknown takes part in the unseen directions if its share of their square is above this."""

_CURES = {
    "its inertia": "Swing the limb faster about all axes, or leave the angular velocities out.",
    "the temperature's coefficients": "Leave the temperature out, or let it change within a set.",
}
"""For what masses at other places would not help."""

_PLACES = (
    "Put the masses at places that do not lie on one line, and change how much is added; or give a factory "
    "matrix to lean on."
)


@dataclass(frozen=True)
class DataRank:
    """What the data, and what is known of the limb, determine without a factory matrix.

    Attributes:
        found: Number of directions that they determine.
        missing: Number that they leave open.
        open_unknowns: What takes part in those, in words.
    """

    found: int
    missing: int
    open_unknowns: tuple[str, ...]

    def refusal(self, problem: Problem) -> CalibrationRefused:
        """Say what is missing and what would bring it (in-situ paper, Lemma 2)."""
        masses = len(np.unique(np.round(problem.added[:, :STATIC], 9), axis=0))
        unknowns = self.found + self.missing
        if masses < 3:
            return CalibrationRefused(
                f"Different added masses: {masses}, and three are needed to tell a matrix (Lemma 2); "
                f"{self.found} of {unknowns} unknowns follow from {len(problem.sets)} set(s).",
                "Add sets with other masses at other places, or give a factory matrix to lean on.",
            )
        cures = [cure for name, cure in _CURES.items() if name in self.open_unknowns]
        return CalibrationRefused(
            f"The {masses} different added masses determine {self.found} of {unknowns} unknowns; what stays "
            f"open: {', '.join(self.open_unknowns)}.",
            (cures or [_PLACES])[0],
        )

    def warning(self) -> str:
        """Say what leans on the factory matrix."""
        return (
            f"The data determine {self.found} of {self.found + self.missing} unknowns; the rest of "
            f"{', '.join(self.open_unknowns)} leans on the factory matrix."
        )


def data_rank(problem: Problem, limb: NDArray[np.float64]) -> DataRank:
    """Find the rank of the fit's Jacobian at a limb, without the factory matrix."""
    outer = np.concatenate([limb[: problem.parameters], np.full(3 * problem.rotation, 0.1)])
    J = expand(replace(problem, prior_response=None), outer).jacobian
    _, singular, right = np.linalg.svd(of_unit_length(J)[0], full_matrices=True)
    found = int(np.sum(singular > _RELATIVE * singular[0]))
    share = np.sum(right[found:] ** 2, axis=0)
    part = share > _TAKES_PART
    channels = len(problem.whitening)
    matrix = part[: channels * problem.inputs].reshape(channels, problem.inputs)
    rest = part[channels * problem.inputs :]
    named = {
        "the matrix": bool(matrix[:, :6].any()),
        "the temperature's coefficients": bool(matrix[:, 6:].any()),
        "the limb's mass": bool(rest[0]),
        "its centre of mass": bool(rest[1:STATIC].any()),
        "its inertia": problem.moving and bool(rest[STATIC:10].any()),
        "the hysteresis": bool(rest[10 if problem.moving else STATIC : problem.parameters].any()),
        "the accelerometer's rotation": bool(rest[problem.parameters :].any()),
    }
    return DataRank(found, J.shape[1] - found, tuple(name for name, taking in named.items() if taking))
