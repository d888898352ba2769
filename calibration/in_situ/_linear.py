r"""A calibrated six-axis sensor, linear in its small errors; private.

About a calibration (A, o) and a limb :math:`\varphi`, with relative errors D of the response,
:math:`\delta o` of the offset and :math:`\delta\varphi` of the limb, a reading in the air is to first order

.. math:: r = A (1 + D)\, T(\varphi + \delta\varphi)\, u + o + \delta o + e
            \approx A w + o + A D w + A\, T(\delta\varphi)\, u + \delta o + e, \qquad w = T(\varphi)\, u,

with the signals u of :mod:`surefoot.calibration.in_situ._model` (at rest gravity alone). Readings are
whitened by their noise, :math:`W \Sigma W' = 1`, so that rows are independent and of variance one. For k > 6
channels D moves A within the space that it spans.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration._constants import Constants, namespace_of
from surefoot.calibration.in_situ._model import STATIC, sensitivity
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.results import FitResult

__all__ = ["AXES", "GAINS", "LinearSensor", "error_covariance", "offset_covariance", "refuse_refused"]

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""

Matrix = NDArray[np.float64]

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


def error_covariance(fit: InSituFit) -> Matrix:
    r"""Covariance of (offset, D row by row, m, m c) by a fit, shape (k + 40, k + 40).

    From that of the matrix: :math:`C' = (1 + D)^{-1} C` gives :math:`D = -\delta C A`.
    """
    channels = len(fit.offset)
    first = AXES * channels
    turn = np.zeros((channels + GAINS + STATIC, first + channels + STATIC))
    turn[:channels, first : first + channels] = np.eye(channels)
    turn[channels : channels + GAINS, :first] = -np.kron(np.eye(AXES), fit.response.T)
    turn[channels + GAINS :, first + channels :] = np.eye(STATIC)
    return np.asarray(turn @ fit.covariance @ turn.T)


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


def refuse_refused(fit: InSituFit, what: str) -> None:
    """Refuse to begin from a fit that has no numbers.

    Raises:
        ValueError: If the fit was refused.
    """
    if fit.result is FitResult.REFUSED:
        reason = str(fit.refusals[0]) if fit.refusals else ""
        raise ValueError(f"{what} needs a calibration, and this fit was refused. {reason}".rstrip())
