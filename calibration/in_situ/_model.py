r"""What hangs on the sensor, as a linear map of what the IMU saw; private.

With f = g - a at the sensor's origin, the angular velocity :math:`\omega` and acceleration
:math:`\dot\omega` of the limb, all in the sensor's frame, Newton and Euler give the wrench that the limb
exerts through the sensor,

.. math::
    F &= m f - \dot\omega \times m c - \omega \times (\omega \times m c), \\
    T &= m c \times f - I \dot\omega - \omega \times I \omega,

which at rest is M(m, c) g (in-situ paper, Eqs. 3-5). It is linear in the signals
:math:`u = (f, \dot\omega, \omega_i \omega_j)` and in the inertial parameters
:math:`\varphi = (m, m c, I)`: :math:`w = T(\varphi) u` with :math:`T(\varphi) = \sum_p \varphi_p D_p`.
At rest the first three signals and the first four parameters are left.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration._vectors import skew
from surefoot.calibration.in_situ.dataset import InSituSet

__all__ = ["PAIRS", "STATIC", "inertial_parameters", "sensitivity", "signals"]

Matrix = NDArray[np.float64]

STATIC = 4
"""Inertial parameters that show at rest: (m, m c)."""

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Order of the products of angular velocities, and of the inertia's entries."""


def signals(data: InSituSet, moving: bool) -> Matrix:
    """Compute u of each sample, shape (n, 3) at rest and (n, 12) moving."""
    if not moving:
        return data.gravity
    rate, acceleration = data.angular_velocity, data.angular_acceleration
    if rate is None or acceleration is None:
        return np.concatenate([data.gravity, np.zeros((len(data.gravity), 9))], axis=1)
    products = np.stack([rate[:, i] * rate[:, j] for i, j in PAIRS], axis=1)
    return np.concatenate([data.gravity, acceleration, products], axis=1)


@cache
def sensitivity(moving: bool) -> Matrix:
    """D, shape (4, 6, 3) at rest and (10, 6, 12) moving: T = sum_p phi_p D_p."""
    D = np.zeros((10, 6, 12))
    D[0, :3, :3] = np.eye(3)
    for axis in range(3):
        first_moment = np.eye(3)[axis]
        D[1 + axis, 3:, :3] = skew(first_moment)
        D[1 + axis, :3, 3:6] = skew(first_moment)
        # w x (w x c) = w (w . c) - c |w|^2
        for signal, (i, j) in enumerate(PAIRS):
            outer = np.zeros((3, 3))
            outer[i, j] = outer[j, i] = 1.0
            D[1 + axis, :3, 6 + signal] = -(outer @ first_moment - np.trace(outer) * first_moment)
    for entry, (i, j) in enumerate(PAIRS):
        inertia = np.zeros((3, 3))
        inertia[i, j] = inertia[j, i] = 1.0
        D[4 + entry, 3:, 3:6] = -inertia
        # w x I w = sum of w_a w_b e_a x I e_b
        for signal, (a, b) in enumerate(PAIRS):
            turned = np.cross(np.eye(3)[a], inertia[:, b])
            if a != b:
                turned = turned + np.cross(np.eye(3)[b], inertia[:, a])
            D[4 + entry, 3:, 6 + signal] = -turned
    D = D if moving else D[:STATIC, :, :3]
    D.setflags(write=False)
    return D


def inertial_parameters(mass: float, com: NDArray[np.float64], moving: bool) -> NDArray[np.float64]:
    """Compute phi of a compact body: (m, m c), and moving its inertia about the origin, (4,) or (10,)."""
    static = np.concatenate([[mass], mass * com])
    if not moving:
        return static
    inertia = mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.concatenate([static, [inertia[i, j] for i, j in PAIRS]])


def inertia_matrix(parameters: NDArray[np.float64]) -> Matrix:
    """Build I of phi's last six entries, shape (3, 3)."""
    inertia = np.zeros((3, 3))
    for value, (i, j) in zip(parameters[STATIC:], PAIRS, strict=True):
        inertia[i, j] = inertia[j, i] = value
    return inertia
