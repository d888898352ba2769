"""What a calibration is given, and what it has become on its way to the answer."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.covariance import (
    whitening,
)
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.gravity import Sphere
from surefoot.calibration.in_situ.maker import (
    Leaning,
    full_scale,
    maker_prior,
    mean_of,
)
from surefoot.calibration.in_situ.model import (
    MASS,
    MOMENT,
    STATIC,
    inertial_parameters,
    transform_basis,
)
from surefoot.calibration.in_situ.options import InSituOptions, KnownLimb
from surefoot.calibration.in_situ.solve import Maker, Problem, Solution

__all__ = ["MatrixMode", "Solved", "Task", "problem_of"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


MatrixMode = Literal["keep", "update", "free"]
"""What becomes of a factory matrix."""


@dataclass(frozen=True, eq=False)
class Task:
    """What a calibration is given."""

    sets: tuple[InSituSet, ...]
    factory: Matrix | None
    limb: KnownLimb | None
    options: InSituOptions
    mode: MatrixMode

    @property
    def moving(self) -> bool:
        """Whether a limb's motion was recorded."""
        return any(data.moves for data in self.sets)

    def prior(self, noise: Matrix, share: float | tuple[float, ...] | None = None) -> Maker | None:
        """Return the factory matrix as a prior; None where there is none.

        Args:
            noise: Covariance of a sample, shape (k, k).
            share: By which it may be off; as stated, or one, by default.
        """
        if self.factory is None:
            return None
        given = self.options.factory_std or share or 1.0
        return maker_prior(self.factory, given, full_scale(self.factory, noise, self.options.full_scale))


@dataclass(eq=False)
class Solved:
    """A solved task, on its way to the answer."""

    sets: tuple[InSituSet, ...]
    sphere: Sphere
    delay: float
    delay_std: float
    members: list[Leaning]
    determined: bool
    findings: list[Finding] = field(default_factory=list)
    reference: float | None = None

    @property
    def problem(self) -> Problem:
        """That of the likeliest size of the maker's errors."""
        return self.members[0].problem

    @property
    def solution(self) -> Solution:
        """The mean of the members' solutions."""
        return mean_of(self.members)


def problem_of(
    sets: tuple[InSituSet, ...],
    parts: tuple[CompressedSet, ...],
    task: Task,
    temperature: bool,
) -> Problem:
    """Return the least-squares problem of compressed sets, without a maker's prior."""
    limb, root = _limb_rows(task.limb, task.moving)
    return Problem(
        sets=parts,
        added=np.array([inertial_parameters(one.added_mass, one.added_com, task.moving) for one in sets]),
        whitening=whitening(parts),
        basis=transform_basis(task.moving),
        moving=task.moving,
        temperature=temperature,
        channel_lags=0,
        rotation=task.options.estimate_rotation,
        maker=None,
        limb=limb,
        limb_root=root,
    )


def _limb_rows(known: KnownLimb | None, moving: bool) -> tuple[Vector, Matrix]:
    """Return what is known of the limb's inertial parameters, (p,), and rows that weigh it, (q, p)."""
    count = len(transform_basis(moving))
    if known is None:
        return np.zeros(count), np.zeros((0, count))
    com = np.zeros(3) if known.com is None else known.com
    expected = inertial_parameters(known.mass, com, moving)
    rows = np.zeros((1 if known.com is None else STATIC, count))
    rows[MASS, MASS] = 1.0 / known.mass_std
    if known.com is not None:
        # The first moment is com m: a mass that is off does not move the centre.
        rows[MOMENT, MOMENT] = np.eye(3) / (known.mass * known.com_std)
        rows[MOMENT, MASS] = -com / (known.mass * known.com_std)
    return expected, rows
