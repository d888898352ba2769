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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration._constants import Constants, namespace_of
from surefoot.calibration._vectors import skew
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.reference import GRAVITY

__all__ = [
    "AXES",
    "GAINS",
    "PAIRS",
    "STATIC",
    "LinearSensor",
    "inertia_matrix",
    "inertial_parameters",
    "offset_covariance",
    "sensitivity",
    "signals",
]

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""

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


AXES = 6
"""Components of a wrench."""

GAINS = AXES * AXES
"""Entries of D."""

_NOISE_FLOOR = 1e-6
"""Noise counts as at least this share of what the limb's weight does to a channel: a simulation may have
none."""


class LinearSensor:
    """Rows of readings by the unknowns (D row by row, the limb's m and m c).

    Args:
        response: A in counts per N and N m, shape (k, 6).
        noise: Covariance of a sample in counts^2, shape (k, k).
        parameters: Inertial parameters of what hangs on the sensor: (4,), or (10,) with its inertia.

    Attributes:
        whitening: W, shape (k, k).
        response: A, shape (k, 6).
        inertia: Whether the limb's inertia is known, so that it may move.
    """

    def __init__(self, response: Matrix, noise: Matrix, parameters: NDArray[np.float64]) -> None:
        self.response = response
        self.inertia = len(parameters) > STATIC
        weight = np.einsum("p,pws->ws", parameters[:STATIC], sensitivity(False)) * GRAVITY
        floor = _NOISE_FLOOR * np.linalg.norm(response @ weight, axis=1)
        self.whitening = np.linalg.inv(np.linalg.cholesky(noise + np.diag(floor**2)))
        self._maps = [
            Constants(
                np.einsum("p,pws->ws", parameters[: len(basis)], basis),
                np.moveaxis(basis[:STATIC], 0, 1).copy(),
                self.whitening @ response,
            )
            for basis in (sensitivity(False), sensitivity(True))[: 1 + self.inertia]
        ]

    def wrench(self, signals: Array) -> Array:
        """Compute w = T u, shape (..., 6), from u, (..., 3) at rest and (..., 12) moving."""
        transform, _, _ = self._constants(signals)
        return (transform @ signals[..., None])[..., 0]

    def rows(self, signals: Array) -> Array:
        """Build whitened rows by (D, m, m c), shape (..., k, 40)."""
        xp = namespace_of(signals)
        _, basis, whitened = self._constants(signals)
        w = self.wrench(signals)
        gains = whitened[..., :, None] * w[..., None, None, :]
        gains = xp.reshape(gains, (*w.shape[:-1], whitened.shape[0], GAINS))
        # (6, 4, s) by u: what a kilogram and a kilogram metre add to the wrench.
        limb = (basis @ signals[..., None, :, None])[..., 0]
        return xp.concat([gains, whitened @ limb], axis=-1)

    def _constants(self, signals: Array) -> tuple[Array, ...]:
        return self._maps[int(signals.shape[-1] > 3)].like(signals)


def offset_covariance(response: Matrix, force: float, torque: float) -> Matrix:
    """Covariance in counts^2 of an offset that shows as a force and a torque on each axis, shape (k, k).

    Args:
        response: A in counts per N and N m, shape (k, 6).
        force: Standard deviation along each axis in N.
        torque: The same for torques in N m.
    """
    image = response * np.repeat([force, torque], 3)
    inside = image @ image.T
    # What redundant channels read beyond any wrench moves as much as the rest, on average.
    beyond = np.linalg.svd(response, full_matrices=True)[0][:, AXES:]
    return np.asarray(inside + beyond @ beyond.T * np.trace(inside) / AXES)
