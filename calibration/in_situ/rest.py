r"""What turning adds to a limb taken as at rest, and an accelerometer's bias: as far as they are open.

A slow sweep is no rest: with 12 deg/s a leg feels 2e-3 of its weight from turning. Its own inertia adds

.. math:: w = -(\dot\omega \times m c + \omega \times (\omega \times m c)), \;
    -(I \dot\omega + \omega \times I \omega),

and an accelerometer that sits at p, and not at the sensor's origin, feels
:math:`\dot\omega \times p + \omega \times (\omega \times p)` besides gravity. Gravity's own turning shows
:math:`\omega`, but for what is about its direction, and so the size of these errors; as they follow the sweep
in every set, no residual shows them. A limb is no point: what it has of inertia about its centre of mass is
nearly as large. They are no part of the fit but of its covariance: each moves the answer by a
vector, and the sum of these vectors' squares is added. So does what is open of the accelerometer's bias
(:mod:`~surefoot.calibration.in_situ.gravity`), which goes into the offset by the weight of what hangs there.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.covariance import OpenErrors
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.gravity import Sphere, felt_by_turning, with_turning
from surefoot.calibration.in_situ.model import (
    AXES,
    DIRECT,
    INERTIA,
    MASS,
    MOMENT,
    PAIRS,
    STATIC,
    compact_inertia,
    inertial_parameters,
    signals,
    transform_basis,
)
from surefoot.calibration.in_situ.solve import Problem, Solution

__all__ = ["errors_of_imu"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

_STILL: dict[str, Any] = {"angular_velocity": None, "angular_acceleration": None}

_REACH = 2.0
"""Distance of the accelerometer over that of the limb's centre of mass, along any axis: its deviation."""

_ROD = 1.0 / 3.0
"""Inertia of the limb about its centre of mass over that of a point there about the sensor: its deviation is
that of a rod that hangs from it. An added mass's is a compact body's: its shape and density are not known."""

_ROUND = np.array([1.0 if i == j else 0.5 for i, j in PAIRS])
"""Products of inertia are at most half as large."""

_COLUMNS = 1 + 3 + 6


def errors_of_imu(
    sets: Sequence[InSituSet], problem: Problem, solution: Solution, sphere: Sphere
) -> OpenErrors:
    """Return what turning and the accelerometer's bias may have added.

    The limb's inertia as a point comes first, then the accelerometer's place along each axis, then the
    entries of the inertia of limb and added mass about their centres: zero for sets without times, for
    postures that were held, and, but for the added mass's, for a limb whose motion was recorded. Then the
    bias along each axis.
    """
    limb = solution.limb[:STATIC]
    com = limb[MOMENT] / limb[MASS]
    reach = _REACH * float(np.linalg.norm(com))
    bare = inertial_parameters(float(limb[MASS]), com, True)
    basis = transform_basis(True)
    found = []
    for data, part in zip(sets, problem.sets, strict=True):
        moved, places = with_turning(replace(data, gravity=data.gravity @ solution.rotation.T))
        body = bare + inertial_parameters(data.added_mass, data.added_com, True)
        of_offset = np.zeros((AXES, _COLUMNS))
        if not moved.moves:
            found.append(np.zeros((part.uu.shape[0], len(problem.whitening), _COLUMNS)))
            continue
        unknown = float(not data.moves)
        felt = reach * felt_by_turning(
            replace(moved, **_STILL) if data.moves else moved, np.arange(len(places))
        )
        u = np.nan_to_num(signals(moved, moving=True))
        u[:, DIRECT] = 0.0
        inertia = unknown * limb[MASS] * com @ com * _ROD + compact_inertia(data.added_mass)
        # One after the other: all of a long set at once take more memory than the set.
        added = chain(
            (u @ np.einsum("p,pws->ws", unknown * body, basis).T,),
            (_weight_of(body, a) for a in np.moveaxis(felt, 2, 0)),
            (size * (u @ entry.T) for size, entry in zip(inertia * _ROUND, basis[INERTIA], strict=True)),
        )
        rows = np.stack([np.interp(part.index, places, one) for wrench in added for one in wrench.T], axis=1)
        rows *= part.source.weight[:, None]
        of_offset = (part.end.weights @ rows).reshape(-1, AXES).T
        seen = part.whiten @ (part.score.T @ part.colour.weigh(rows, part.spacing))
        found.append(
            np.moveaxis(seen.reshape(len(seen), -1, AXES) @ (problem.whitening @ solution.A).T, 1, 2)
        )
    of_bias = _weight_of(body, np.asarray(np.linalg.cholesky(sphere.covariance).T * sphere.scale)).T
    offset = solution.A @ np.concatenate([of_offset, of_bias], axis=1)
    rows = np.concatenate(found).reshape(-1, _COLUMNS)
    return OpenErrors(np.pad(rows, ((0, 0), (0, of_bias.shape[1]))), offset)


def _weight_of(body: Vector, gravity: Matrix) -> Matrix:
    """Return the wrench, shape (n, 6), of a body in gravity, (n, 3)."""
    return np.concatenate([body[MASS] * gravity, np.cross(body[MOMENT], gravity)], axis=1)
