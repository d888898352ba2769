r"""Loads of the sensor, as a linear map of the IMU's signals.

With f = g - a at the sensor's origin, the angular velocity :math:`\omega` and acceleration
:math:`\dot\omega` of the limb, all in the sensor's frame, Newton and Euler give the wrench that the limb
exerts through the sensor,

.. math::
    F &= m f - \dot\omega \times m c - \omega \times (\omega \times m c), \\
    T &= m c \times f - I \dot\omega - \omega \times I \omega,

which at rest is M(m, c) g (in-situ paper, Eqs. 3-5). It is linear in the signals
:math:`u = (f, \dot\omega, \omega_i \omega_j)` and in the inertial parameters
:math:`\varphi = (m, m c, I)`: :math:`w = T(\varphi) u` with :math:`T(\varphi) = \sum_p \varphi_p T_p`.
At rest the first three signals and the first four parameters are left.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from surefoot.calibration.arrays import skew
from surefoot.calibration.in_situ.data import InSituSet, Matrix

AXES = 6  # components of a wrench
RELATIVE_ERRORS = AXES * AXES  # entries of D

MASS, MOMENT, INERTIA = 0, slice(1, 4), slice(4, 10)  # places of m, m c and I in the inertial parameters
STATIC, MOVING = MOMENT.stop, INERTIA.stop  # inertial parameters that show at rest, (m, m c), and in motion
DIRECT, TURNING, PRODUCTS = slice(0, 3), slice(3, 6), slice(6, 12)
"""Places of f, the angular acceleration and the products of angular velocities in the signals."""

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Order of the products of angular velocities, and of the inertia's entries."""

LEAST_LEVER = 0.1  # lever in m by which first moments are judged at least: masses may all hang at one place
ENOUGH_MASSES = 3  # different added masses that a matrix needs (in-situ paper, Lemma 2)
SPREAD_ROUNDING = 1e-9  # share of a spread at or below which another is rounding
_STEEL = 7850.0  # density of added masses in kg/m^3


def signals(data: InSituSet, moving: bool, stride: int = 1) -> Matrix:
    """Return u of each sample, or of one in ``stride``, shape (n, 3) at rest and (n, 12) moving."""
    gravity = data.gravity[::stride]
    if not moving:
        return gravity
    rate, acceleration = data.angular_velocity, data.angular_acceleration
    if rate is None or acceleration is None:
        still = np.zeros((len(gravity), PRODUCTS.stop - DIRECT.stop))
        return np.concatenate([gravity, still], axis=1)
    rate, acceleration = rate[::stride], acceleration[::stride]
    products = np.stack([rate[:, i] * rate[:, j] for i, j in PAIRS], axis=1)
    return np.concatenate([gravity, acceleration, products], axis=1)


@cache
def transform_basis(moving: bool) -> Matrix:
    """Return T_p, shape (4, 6, 3) at rest and (10, 6, 12) moving: T = sum_p phi_p T_p."""
    basis = np.zeros((MOVING, AXES, PRODUCTS.stop))
    force, torque = slice(0, 3), slice(3, 6)
    basis[MASS, force, DIRECT] = np.eye(3)
    for axis in range(3):
        first_moment, of_moment = np.eye(3)[axis], basis[MOMENT][axis]
        of_moment[torque, DIRECT] = skew(first_moment)
        of_moment[force, TURNING] = skew(first_moment)
        # w x (w x c) = w (w . c) - c |w|^2
        for product, pair in enumerate(PAIRS):
            outer = _symmetric(pair)
            of_moment[force, PRODUCTS.start + product] = -(
                outer @ first_moment - np.trace(outer) * first_moment
            )
    for of_entry, pair in zip(basis[INERTIA], PAIRS, strict=True):
        inertia = _symmetric(pair)
        of_entry[torque, TURNING] = -inertia
        # w x I w = sum of w_a w_b e_a x I e_b
        for product, (a, b) in enumerate(PAIRS):
            turned = np.cross(np.eye(3)[a], inertia[:, b])
            if a != b:
                turned = turned + np.cross(np.eye(3)[b], inertia[:, a])
            of_entry[torque, PRODUCTS.start + product] = -turned
    basis = basis if moving else basis[:STATIC, :, DIRECT]
    basis.setflags(write=False)
    return basis


def stack_equations(
    basis: Matrix, parts: Sequence[tuple[Matrix, Matrix]], added: Sequence[Matrix] | Matrix
) -> tuple[Matrix, Matrix]:
    """Return regressors by (C row by row, phi_b) and targets of C r - T_b u = T_a u (paper, Eqs. 21-24).

    Of T_p, (p, 6, s), and of each set its signals and readings less their offset, (n_j, s) and (n_j, k), and
    the inertial parameters that were added, (p,).
    """
    rows, targets = [], []
    for (u, r), body in zip(parts, added, strict=True):
        moved = basis @ u.T
        rows.append(np.hstack([np.kron(np.eye(AXES), r), -moved.reshape(len(basis), -1).T]))
        targets.append(np.einsum("p,pws->ws", body, moved).ravel())
    return np.concatenate(rows), np.concatenate(targets)


def signal_rotation(R: Matrix, moving: bool) -> Matrix:
    """Return how signals in one frame are made of those in another, by its rotation R: (3, 3) or (12, 12)."""
    return block_diag(R, R, _product_rotation(R, R)) if moving else R


def signal_rotation_slope(axis: Matrix, moving: bool) -> Matrix:
    """Return the slope of :func:`signal_rotation` by a turn about an axis, at none."""
    K, eye = skew(axis), np.eye(3)
    return block_diag(K, K, _product_rotation(K, eye) + _product_rotation(eye, K)) if moving else K


def _product_rotation(X: Matrix, Y: Matrix) -> Matrix:
    """Return how products (X a)_i (Y a)_j are made of those of a, shape (6, 6)."""
    first, second = np.array(PAIRS).T
    direct = X[first][:, first] * Y[second][:, second]
    crossed = X[first][:, second] * Y[second][:, first]
    return np.asarray(np.where(first == second, direct, direct + crossed))


def _symmetric(pair: tuple[int, int], value: float = 1.0) -> Matrix:
    """Return a 3 x 3 matrix with one value at a place and at its mirror image."""
    matrix = np.zeros((3, 3))
    matrix[pair] = matrix[pair[::-1]] = value
    return matrix


def inertial_parameters(mass: float, com: NDArray[np.float64], moving: bool) -> NDArray[np.float64]:
    """Return phi of a compact body: (m, m c), and moving its inertia about the origin, (4,) or (10,)."""
    own = compact_inertia(mass)
    inertia = mass * (com @ com * np.eye(3) - np.outer(com, com)) + own * np.eye(3) if moving else None
    return limb_parameters(mass, mass * com, inertia)


def compact_inertia(mass: float) -> float:
    """Return the moment of inertia about its centre of a cube of steel in kg m^2."""
    return float(mass * np.cbrt(mass / _STEEL) ** 2 / 6.0)


def limb_parameters(
    mass: float, moment: NDArray[np.float64], inertia: Matrix | None = None
) -> NDArray[np.float64]:
    """Return phi of (m, m c) and, if it is given, I, shape (4,) or (10,)."""
    entries = [] if inertia is None else [inertia[pair] for pair in PAIRS]
    return np.concatenate([[mass], moment, entries])


def different_masses(added: Matrix) -> int:
    """Return how many of the added bodies differ in mass or first moment, by (m, m c), shape (J, 4)."""
    return len(np.unique(np.round(added, 9), axis=0))


def inertia_matrix(parameters: NDArray[np.float64]) -> Matrix:
    """Return I of phi, shape (10,), as a matrix of shape (3, 3)."""
    return np.asarray(
        sum(_symmetric(pair, value) for pair, value in zip(PAIRS, parameters[INERTIA], strict=True))
    )
