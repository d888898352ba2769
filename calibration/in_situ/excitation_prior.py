"""What is known of a sensor, of its limb and of masses to hang before an excitation is planned."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration._setup import check_value
from surefoot.calibration.in_situ._linear import (
    AXES,
    GAINS,
    error_covariance,
    offset_covariance,
    refuse_refused,
)
from surefoot.calibration.in_situ._model import STATIC
from surefoot.calibration.in_situ.fit import InSituFit, Limb
from surefoot.calibration.in_situ.options import KnownLimb

__all__ = ["SHARED", "ExcitationPrior", "MassCandidate", "prior_from_factory", "prior_from_fit"]

Matrix = NDArray[np.float64]

SHARED = GAINS + STATIC
"""Unknowns that all sets share: D and the limb."""


class MassCandidate(NamedTuple):
    """A mass that can be hung on the limb.

    Attributes:
        mass: In kg; 0 for the bare limb.
        com: Its centre of mass in the sensor's frame in m.
        offset_covariance: What is known of the offset while it hangs, in counts^2, shape (k, k); None takes
            the prior's ``new_offset``.
    """

    mass: float
    com: tuple[float, float, float] | NDArray[np.float64] = (0.0, 0.0, 0.0)
    offset_covariance: Matrix | None = None


@dataclass(frozen=True, eq=False)
class ExcitationPrior:
    """What is known before a plan.

    Attributes:
        response: A in counts per N and N m, shape (k, 6).
        noise: Covariance of a sample in counts^2, shape (k, k).
        limb: The bare limb.
        covariance: Of (D row by row, m, m c), D the relative error of the response, shape (40, 40).
        new_offset: Covariance of a new set's offset in counts^2, shape (k, k).
    """

    response: Matrix
    noise: Matrix
    limb: Limb
    covariance: Matrix
    new_offset: Matrix


def prior_from_fit(
    fit: InSituFit, *, offset_force: float = 300.0, offset_torque: float = 5.0
) -> ExcitationPrior:
    """Take up where a calibration ended.

    Args:
        fit: The calibration, also one that leans on a factory matrix.
        offset_force: Standard deviation of a new set's offset along each axis in N.
        offset_torque: The same for torques in N m.

    Raises:
        ValueError: If the fit was refused or a deviation is not positive.
    """
    refuse_refused(fit, "A plan")
    shared = error_covariance(fit)[len(fit.offset) :, len(fit.offset) :]
    new = _checked_covariance(fit.response, offset_force, offset_torque)
    return ExcitationPrior(fit.response, fit.noise, fit.limb, shared, new)


def prior_from_factory(
    matrix: ArrayLike,
    limb: KnownLimb,
    *,
    gain_std: float = 0.2,
    cross_talk_std: float = 0.03,
    full_scale: tuple[float, float] = (1500.0, 35.0),
    noise_force: float = 0.1,
    noise_torque: float = 0.0025,
    offset_force: float = 300.0,
    offset_torque: float = 5.0,
) -> ExcitationPrior:
    """Begin from a maker's matrix and a guess of the limb, before any reading.

    Args:
        matrix: C in N and N m per count, shape (6, k).
        limb: What is thought of the limb; an unknown centre of mass counts as the sensor's origin.
        gain_std: How far each axis may be off, relative.
        cross_talk_std: What one axis may feel of another, in shares of the full scales.
        full_scale: Largest force in N and torque in N m.
        noise_force: Standard deviation of a sample in N.
        noise_torque: The same for torques in N m.
        offset_force: Standard deviation of a set's offset along each axis in N.
        offset_torque: The same for torques in N m.

    Raises:
        ValueError: If the matrix is not of rank 6 or a value has no meaning.
    """
    C = np.asarray(matrix, dtype=np.float64)
    if C.ndim != 2 or C.shape[0] != AXES or not np.isfinite(C).all() or np.linalg.matrix_rank(C) < AXES:
        raise ValueError(f"'matrix' must be finite, of rank 6 and of shape (6, k), got shape {C.shape}.")
    given = {"gain_std": gain_std, "noise_force": noise_force, "noise_torque": noise_torque}
    for name, value in given.items():
        check_value(name, value, positive=True)
    check_value("cross_talk_std", cross_talk_std, positive=False)
    size = np.repeat(full_scale, 3)
    std = np.where(np.eye(AXES, dtype=bool), gain_std, cross_talk_std * size[:, None] / size)
    com = np.zeros(3) if limb.com is None else np.asarray(limb.com)
    response = np.asarray(np.linalg.pinv(C), dtype=np.float64)
    # m c = m times c: a mass that is off moves it along c.
    root = np.zeros((STATIC, STATIC))
    root[:, 0] = limb.mass_std * np.concatenate([[1.0], com])
    root[1:, 1:] = limb.mass * (limb.com_std if limb.com is not None else 1.0) * np.eye(3)
    covariance = np.zeros((SHARED, SHARED))
    covariance[:GAINS, :GAINS] = np.diag(np.maximum(std, 1e-9).ravel() ** 2)
    covariance[GAINS:, GAINS:] = root @ root.T
    return ExcitationPrior(
        response,
        _checked_covariance(response, noise_force, noise_torque),
        Limb(limb.mass, limb.mass * com),
        covariance,
        _checked_covariance(response, offset_force, offset_torque),
    )


def _checked_covariance(response: Matrix, force: float, torque: float) -> Matrix:
    check_value("force", force, positive=True)
    check_value("torque", torque, positive=True)
    return offset_covariance(response, force, torque)
