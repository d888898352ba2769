r"""What a limb that is taken as at rest adds by its turning, as far as nobody knows.

A slow sweep is no rest: with 12 deg/s a leg feels 2e-3 of its weight from turning. Its own inertia adds

.. math:: w = -(\dot\omega \times m c + \omega \times (\omega \times m c)), \;
    -(I \dot\omega + \omega \times I \omega),

and an accelerometer that sits at p, and not at the sensor's origin, feels
:math:`\dot\omega \times p + \omega \times (\omega \times p)` besides gravity. Gravity's own turning shows
:math:`\omega`, but for what is about its direction, and so the size of these errors; as they follow the sweep
in every set, no residual shows them. A limb is no point: what it has of inertia about its centre of mass is
nearly as large. They are no part of the fit but of its covariance: each moves the answer by a
vector, and the sum of these vectors' squares is added.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.input_checks import felt_by_turning, turning
from surefoot.calibration.in_situ.model import (
    AXES,
    DIRECT,
    INERTIA,
    MASS,
    MOMENT,
    PAIRS,
    STATIC,
    inertial_parameters,
    signals,
    transform_basis,
)
from surefoot.calibration.in_situ.solve import Problem, Solution

__all__ = ["rows_of_turning"]

Matrix = NDArray[np.float64]

_REACH = 2.0
"""Distance of the accelerometer over that of the limb's centre of mass, along any axis: its deviation."""


_ROUND = np.array([1.0 if i == j else 0.5 for i, j in PAIRS]) / 3.0
"""Deviation of each entry of the inertia about the limb's centre of mass, over that of a point there about
the sensor: for a rod that hangs from it a third. Products are at most half as large."""

_COLUMNS = 1 + 3 + 6

_THIN = 0.1
"""Time in s over which gravity is averaged first."""

_STEP, _ALIKE = 0.3, 0.5
"""Time in s between two looks at gravity, and the correlation of its changes from which on it turns
steadily."""


def rows_of_turning(sets: Sequence[InSituSet], problem: Problem, solution: Solution) -> Matrix:
    """Return by how much turning may move the rows of the sets, whitened, shape (rows, 10).

    The limb's inertia as a point comes first, then the accelerometer's place along each axis, then the
    entries of its inertia about its centre of mass. Zero for a limb whose motion was recorded, for sets
    without times, and for postures that were held.
    """
    limb = solution.limb[:STATIC]
    com = limb[MOMENT] / limb[MASS]
    reach = _REACH * float(np.linalg.norm(com))
    bare = inertial_parameters(float(limb[MASS]), com, True)
    basis = transform_basis(True)
    found = []
    for data, part in zip(sets, problem.sets, strict=True):
        thin, places = _thinned(replace(data, gravity=data.gravity @ solution.rotation.T))
        moved = turning(thin)
        if data.moves or not moved.moves or not _smooth(moved):
            found.append(np.zeros((part.uu.shape[0], len(problem.whitening), _COLUMNS)))
            continue
        body = bare + inertial_parameters(data.added_mass, data.added_com, True)
        u = signals(moved, moving=True)
        u[:, DIRECT] = 0.0
        felt = np.moveaxis(reach * felt_by_turning(moved, np.arange(len(u))), 2, 0)
        of_inertia = zip(limb[MASS] * com @ com * _ROUND, basis[INERTIA], strict=True)
        # One after the other: all of a long set at once take more memory than the set.
        added = chain(
            (u @ np.einsum("p,pws->ws", body, basis).T,),
            (np.concatenate([body[MASS] * a, np.cross(body[MOMENT], a)], axis=1) for a in felt),
            (size * (u @ entry.T) for size, entry in of_inertia),
        )
        rows = np.stack([np.interp(part.index, places, one) for wrench in added for one in wrench.T], axis=1)
        rows *= part.source.weight[:, None]
        seen = (part.score.T @ part.colour.weigh(rows, part.spacing)).reshape(len(part.uu), -1, AXES)
        found.append(np.moveaxis(seen @ (problem.whitening @ solution.A).T, 1, 2))
    return np.concatenate(found).reshape(-1, _COLUMNS)


def _thinned(data: InSituSet) -> tuple[InSituSet, NDArray[np.float64]]:
    """Return means of gravity over a fraction of a second, and their places in the set."""
    if data.moves or data.time is None or len(data.time) < 2:
        return data, np.arange(float(len(data.raw)))
    width = max(round(_THIN / float(np.median(np.diff(data.time)))), 1)
    columns = np.column_stack([np.arange(len(data.time)), data.time, data.gravity])
    columns = columns[: len(columns) // width * width].reshape(-1, width, 5).mean(axis=1)
    raw = np.zeros((len(columns), data.channels))
    return replace(data, raw=raw, time=columns[:, 1], gravity=columns[:, 2:], temperature=None), columns[:, 0]


def _smooth(data: InSituSet) -> bool:
    """Return whether gravity turns on from step to step, rather than from one posture at rest to the next."""
    assert data.time is not None
    stride = max(round(_STEP / float(np.median(np.diff(data.time)))), 1)
    steps = np.diff(data.gravity[::stride], axis=0)
    return bool(np.sum(steps[1:] * steps[:-1]) > _ALIKE * np.sum(steps**2))
