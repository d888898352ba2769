r"""A polynomial on top of a linear map, for a sensor that is not linear.

The linear map is as it was, and what is added to it is (arXiv 2312.09846; there for the whole map)

.. math:: w = C (r - o) + K \varphi(z), \qquad z = S (r - o) - c,

with all products of two, or of two and three, of the six components of z in :math:`\varphi`: z is the wrench
by the linear map, about its mean and in units of its spread. Off each product its own best affine map over
the calibrated readings is taken, so that C and o stay the best affine answer.

Beyond the calibrated readings a polynomial is a guess. Within the ellipsoid in the shape of their covariance
that holds them all it counts as it is. Outside it is that of the point where the way to the mean meets the
border, less and less, and from :data:`FADED` times the border's distance on nothing is added.
"""

from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.in_situ.model import AXES
from surefoot.calibration.in_situ.options import DEGREES

__all__ = ["FADED", "NonlinearMap", "Products", "count_of_products"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

FADED = 1.25
"""Distance from the mean, over that of the border, from which on nothing is added."""

_THIN = 1e-3
"""The thinnest axis of the ellipsoid over its longest, at least."""


@cache
def _factors(degree: int) -> tuple[list[int], ...]:
    """Return which components make each product, those of fewer first."""
    return tuple(
        list(which)
        for count in range(2, degree + 1)
        for which in combinations_with_replacement(range(AXES), count)
    )


def count_of_products(degree: int) -> int:
    """Return the number of products of two to ``degree`` components: 0, 21 and 77 for 1, 2 and 3."""
    return len(_factors(degree))


@dataclass(frozen=True, eq=False)
class Products:
    r"""Products of a reading's components, each without its best affine map over the calibrated readings.

    Attributes:
        scale: S per count, shape (6, k).
        centre: c, shape (6,).
        affine: What is taken off each of q products: a constant and six slopes, shape (7, q).
        ellipsoid: E, shape (6, 6): calibrated readings have :math:`|E z| \le 1`.
    """

    scale: Matrix
    centre: Vector
    affine: Matrix
    ellipsoid: Matrix

    @classmethod
    def of(cls, above: Matrix, matrix: Matrix, degree: int) -> Self:
        """Return those of calibrated readings.

        Args:
            above: The readings less their offset, r - o, shape (n, k).
            matrix: C, shape (6, k).
            degree: Components of a product at most.
        """
        size = np.std(above @ matrix.T, axis=0)
        scale = matrix / np.where(size > 0.0, size, 1.0)[:, None]
        centre = np.mean(above @ scale.T, axis=0)
        z = above @ scale.T - centre
        affine = np.linalg.lstsq(_with_one(z), _products(z, _factors(degree)), rcond=None)[0]
        return cls(scale, centre, np.asarray(affine, dtype=np.float64), enclosing(z))

    def components(self, above: ArrayLike) -> Matrix:
        """Return z of readings less their offset, shape (..., 6)."""
        return np.asarray(np.asarray(above, dtype=np.float64) @ self.scale.T - self.centre)

    def of_components(self, z: Matrix) -> Matrix:
        """Return the products as far as components, shape (..., 6), are within the range, shape (..., q)."""
        distance = np.linalg.norm(z @ self.ellipsoid.T, axis=-1, keepdims=True)
        inside = z / np.maximum(distance, 1.0)
        share = np.clip((FADED - distance) / (FADED - 1.0), 0.0, 1.0)
        degree = next(d for d in DEGREES if count_of_products(d) == self.affine.shape[1])
        return np.asarray(share * (_products(inside, _factors(degree)) - _with_one(inside) @ self.affine))


def _products(z: Matrix, factors: tuple[list[int], ...]) -> Matrix:
    return np.stack([np.prod(z[..., which], axis=-1) for which in factors], axis=-1)


def _with_one(z: Matrix) -> Matrix:
    return np.concatenate([np.ones((*z.shape[:-1], 1)), z], axis=-1)


def enclosing(z: Matrix) -> Matrix:
    """Return E of the ellipsoid in the shape of the covariance of z, shape (n, 6), that holds all of it."""
    values, vectors = np.linalg.eigh(np.cov(z, rowvar=False))
    root = (vectors / np.sqrt(np.maximum(values, _THIN**2 * values[-1]))).T
    return np.asarray(root / np.max(np.linalg.norm(z @ root.T, axis=1)))


@dataclass(frozen=True, eq=False)
class NonlinearMap:
    """What is added to the wrench of a linear map, and what that is worth.

    Attributes:
        products: Of the components of a reading.
        coefficients: K in N and N m, shape (6, q); zero for an axis that stays linear.
        degrees: Of each axis's polynomial, shape (6,); 1 where it stays linear.
        held_out_rms: Root mean square of what the linear map, and of what both together, left of the wrench
            of stretches and sets that took no part, in N and N m, shape (2, 6).
        held_out_worst: The largest of these errors, shape (2, 6).
    """

    products: Products
    coefficients: Matrix
    degrees: tuple[int, ...]
    held_out_rms: Matrix
    held_out_worst: Matrix

    def wrench(self, above: ArrayLike) -> Matrix:
        """Return what is added in N and N m, shape (..., 6), for readings less their offset, (..., k)."""
        z = self.products.components(above)
        return np.asarray(self.products.of_components(z) @ self.coefficients.T)
