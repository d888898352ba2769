r"""What the readings know by themselves, and what a factory matrix or a known limb knows.

The rows of the readings alone, :math:`J_d` of a fit's Jacobian, are already free of what is no matter of
the calibration: offsets, drift and loops of hysteresis have been projected out or weighted down. They leave
a quantity :math:`q = c^\top \theta` the variance :math:`V_q = c^\top (J_d^\top J_d)^{-1} c`, and all rows
together :math:`P_q`. So of all that is known of q, :math:`1 / P_q`, the data know the share :math:`P_q /
V_q`: one where no prior was needed, zero where the data say nothing.

A direction counts as seen if the data alone know it to a share of its size. The rank of a matrix would not
do: the faintest motion makes it full. What no answer holds, loops of hysteresis and the limb's inertia, which
slow motion hardly shows, takes part only by what it leaves of the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.covariance import output_derivatives
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.fit import FitColumns
from surefoot.calibration.in_situ.model import AXES, DIRECT, MASS, MOMENT, STATIC
from surefoot.calibration.in_situ.solve import Problem, Solution

__all__ = ["DataShare", "data_share", "slow_turn"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

_MOST = 0.9
"""Share of the information that the data give from which on the rest is not worth a word."""

_SLOW, _TURNED = 0.15, 0.02
"""A turn is slow if drift leaves less than the first share of its spread; one below the second share of
gravity's size is none."""

_UNKNOWN = 1e3
"""What nobody knows counts as known to so many times its size."""

_REACH = 0.1
"""Lever in m by which first moments are judged at least."""


@dataclass(frozen=True, eq=False)
class DataShare:
    """What the data know of a fit.

    Attributes:
        share: Of the information on each entry of the fit's covariance, shape (7 k + 4,), from 0 to 1.
        seen: Directions that the data alone know.
        unseen: Directions that they do not.
        left_open: What takes part in those, in words.
    """

    share: Vector
    seen: int
    unseen: int
    left_open: tuple[str, ...]

    def findings(self, columns: FitColumns) -> list[Finding]:
        """Return what leans on what was known beforehand, if much does."""
        known = {
            "the matrix": float(np.mean(self.share[columns.matrix])),
            "the limb's mass": float(self.share[columns.limb][MASS]),
            "its centre of mass": float(np.mean(self.share[columns.limb][MOMENT])),
        }
        if min(known.values()) > _MOST:
            return []
        listed = ", ".join(f"{share:.0%} of what is known of {name}" for name, share in known.items())
        reason = f"The readings alone give {listed}; the rest is what was known beforehand."
        return [Finding("share of the data", reason, value=min(known.values()), limit=_MOST, refuses=False)]


def data_share(problem: Problem, solution: Solution, noise: Matrix, tolerance: float) -> DataShare:
    """Return what the data know of a fit at its solution.

    Args:
        problem: With what was known beforehand.
        solution: Its solution.
        noise: Covariance of a sample, shape (k, k).
        tolerance: Deviation as a share of its size up to which a direction is seen.
    """
    channels, inputs = solution.response.shape
    of_data = sum(len(part.uu) for part in problem.sets) * channels
    scale = _sizes(problem, solution)
    J = solution.jacobian * scale
    data, prior = J[:of_data], J[of_data:]
    squares = data.T @ data
    asked = _asked(problem, channels, inputs, len(squares))
    values, vectors = np.linalg.eigh(_of_asked(squares, asked))
    weak = values < (1.0 / tolerance) ** 2
    taking = np.zeros(len(squares), dtype=np.bool_)
    taking[asked] = np.sum(vectors[:, weak] ** 2, axis=1) > 0.5 / max(int(np.sum(weak)), 1) ** 2
    to_output = output_derivatives(problem, solution, noise) * scale
    to_output[:, : channels * inputs] = to_output[:, : channels * inputs] @ np.kron(
        np.linalg.inv(problem.whitening), np.eye(inputs)
    )
    alone = _variance(squares, to_output)
    known = _variance(squares + prior.T @ prior, to_output)
    last = problem.sets[-1]
    own = np.zeros(len(known))
    own[FitColumns.of(channels).offset] = np.diag(noise) * last.end.variance
    share = np.clip((known + own) / np.maximum(alone + own, np.finfo(float).tiny), 0.0, 1.0)
    return DataShare(share, int(np.sum(~weak)), int(np.sum(weak)), _names(taking, channels, inputs))


def _variance(squares: Matrix, outputs: Matrix) -> Vector:
    """Return the variances of outputs, shape (q, p), by the information on the unknowns, shape (p, p)."""
    values, vectors = np.linalg.eigh(squares)
    return np.asarray((outputs @ vectors) ** 2 @ (1.0 / (np.maximum(values, 0.0) + 1.0 / _UNKNOWN**2)))


def _asked(problem: Problem, channels: int, inputs: int, count: int) -> NDArray[np.bool_]:
    """Return which unknowns an answer holds: neither loops nor the limb's inertia, shape (count,)."""
    asked = np.ones(count, dtype=np.bool_)
    response, limb = np.split(asked, [channels * inputs])
    response.reshape(channels, inputs)[:, inputs - problem.channel_lags :] = False
    limb[STATIC : problem.parameters] = False
    return asked


def _of_asked(squares: Matrix, asked: NDArray[np.bool_]) -> Matrix:
    """Return the information on what is asked, whatever the rest may be, shape (q, q)."""
    own = squares[np.ix_(~asked, ~asked)]
    across = squares[np.ix_(~asked, asked)]
    rest = np.linalg.solve(own + np.eye(len(own)) / _UNKNOWN**2, across)
    return np.asarray(squares[np.ix_(asked, asked)] - across.T @ rest)


def slow_turn(sets: Sequence[InSituSet], parts: Sequence[CompressedSet]) -> Finding | None:
    """Return along which direction gravity turned no faster than offsets drift, and the cure; or None.

    The spread that the weights against drift leave is held against the spread that there was.
    """
    seen, left, size = np.zeros((3, 3)), np.zeros((3, 3)), 0.0
    for data, part in zip(sets, parts, strict=True):
        gravity = data.gravity[part.used]
        centred = gravity - gravity.mean(axis=0)
        seen += centred.T @ centred
        size += float(np.sum(gravity**2))
        left += part.uu[:, DIRECT].T @ part.uu[:, DIRECT]
    values, vectors = np.linalg.eigh(seen)
    wide = values > (_TURNED**2) * size
    root = vectors[:, wide] / np.sqrt(values[wide])
    shares, turned = np.linalg.eigh(root.T @ left @ root)
    if not len(shares) or shares[0] > _SLOW**2:
        return None
    direction = root @ turned[:, 0]
    direction /= np.linalg.norm(direction)
    spread = float(np.sqrt(direction @ seen @ direction / size))
    x, y, z = direction
    rest = spread * float(np.sqrt(max(shares[0], 0.0)))
    return Finding(
        "slow turning",
        f"Along ({x:.2f}, {y:.2f}, {z:.2f}) gravity turned no faster than the sensor's offset drifts: of a "
        f"spread of {spread:.2f} of its size such a drift leaves {rest:.3f}.",
        "Go through these postures several times in a set, or come back to the first ones at its end.",
        rest,
        _SLOW * spread,
        refuses=False,
    )


def _sizes(problem: Problem, solution: Solution) -> Vector:
    """Return the sizes of the unknowns (W A row by row, phi, rotation)."""
    white = problem.whitening @ solution.response
    columns = np.sqrt(np.mean(white**2, axis=0))
    mass = abs(float(solution.limb[MASS]))
    reach = max(float(np.linalg.norm(solution.limb[MOMENT])) / max(mass, np.finfo(float).tiny), _REACH)
    limb = np.full(problem.outer, mass * reach**2)
    limb[MASS], limb[MOMENT] = mass, mass * reach
    limb[problem.of_loads] = 1.0
    limb[problem.parameters :] = 1.0
    return np.concatenate([np.tile(columns, len(white)), limb])


def _names(taking: NDArray[np.bool_], channels: int, inputs: int) -> tuple[str, ...]:
    response = taking[: channels * inputs].reshape(channels, inputs)
    limb = taking[channels * inputs :]
    named = {
        "the matrix": response[:, :AXES],
        "the limb's mass": limb[MASS],
        "its centre of mass": limb[MOMENT],
    }
    return tuple(name for name, parts in named.items() if parts.any())
