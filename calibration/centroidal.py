r"""The ground force that the robot's own motion requires: the reference of the calibrators.

The Newton-Euler equations of the whole robot (CoP paper, Eqs. 6, 7), with the ground's forces f_i at p_i,

    M (c'' + g e_z) = sum f_i,    L' = sum (p_i - c) x f_i,

give, with the centre of mass c = (x, y, z) and the height p_z of the ground,

    Fz = M (z'' + g)                                   (9)
    px = x - [ (z - p_z) M x'' + L'_y ] / Fz           (10)
    py = y - [ (z - p_z) M y'' - L'_x ] / Fz           (11)

Han's earlier method assumes a quasi-static robot: Fz = M g and p = (x, y).

The equations contain the ground's forces only. Any other external force, such as a hand on the robot, is an
error of this reference. Leading axes of a series of samples are written as ``...``.
"""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import check_tail
from surefoot.calibration.cop import FORCE_THRESHOLD, cop_of_moments
from surefoot.calibration.reference import GRAVITY, Reference


class GroundReference(NamedTuple):
    """The expected ground reaction force."""

    vgrf: Array  # total vertical force in N, shape (...)
    cop: Array
    """Centre of pressure of both feet in the level frame in m, shape (..., 2), NaN if the force does not
    exceed the threshold."""
    moment: Array  # (Fz px, Fz py) in N m, shape (..., 2), defined even if the centre of pressure is not


def ground_height(reference: Reference) -> Array:
    """Return the height of level ground in m, shape (...): that of the lower sole."""
    check_tail(reference.position_sole, (2, 3), "position_sole")
    return reference.position_sole[..., 2].min(axis=-1)


def ground_reference(
    reference: Reference,
    mass: float,
    *,
    height: Array | None = None,
    quasi_static: bool = False,
    gravity: float = GRAVITY,
    threshold: float = FORCE_THRESHOLD,
) -> GroundReference:
    """Compute the vertical force and the centre of pressure that the robot's motion requires.

    Args:
        reference: The robot's state estimate. The fields used are ``com``, ``com_acceleration``,
            ``angular_momentum_rate`` and, without a height, ``position_sole``.
        mass: The robot's mass in kg.
        height: Height p_z of the ground in the level frame in m, shape (...); by default
            :func:`ground_height`.
        quasi_static: Whether to ignore accelerations: Fz = M g below the centre of mass.
        gravity: Acceleration of free fall in m/s^2.
        threshold: Vertical force in N at or below which the centre of pressure is NaN.

    Returns:
        The reference force, centre of pressure and moments.

    Raises:
        ValueError: If a field of the reference does not have its documented shape.
    """
    check_tail(reference.com, (3,), "com")
    check_tail(reference.com_acceleration, (3,), "com_acceleration")
    check_tail(reference.angular_momentum_rate, (3,), "angular_momentum_rate")
    com, acceleration, rate = reference.com, reference.com_acceleration, reference.angular_momentum_rate
    if quasi_static:
        fz = mass * gravity * np.ones_like(com[..., 2])
        moment = com[..., :2] * fz[..., None]
    else:
        fz = mass * (acceleration[..., 2] + gravity)  # Eq. 9
        lever = mass * (com[..., 2] - (ground_height(reference) if height is None else height))
        moment = np.stack(
            [
                com[..., 0] * fz - (lever * acceleration[..., 0] + rate[..., 1]),  # Eq. 10 times Fz
                com[..., 1] * fz - (lever * acceleration[..., 1] - rate[..., 0]),  # Eq. 11 times Fz
            ],
            axis=-1,
        )
    return GroundReference(fz, cop_of_moments(fz, moment, threshold), moment)
