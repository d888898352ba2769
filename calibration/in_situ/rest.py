r"""What turning adds to a limb taken as at rest, and its accelerometer's bias: as far as they are open.

A slow sweep is no rest: with 12 deg/s a leg feels 2e-3 of its weight from turning. Its own inertia adds

.. math:: w = -(\dot\omega \times m c + \omega \times (\omega \times m c)), \;
    -(I \dot\omega + \omega \times I \omega),

and an accelerometer that sits at p, and not at the sensor's origin, feels
:math:`\dot\omega \times p + \omega \times (\omega \times p)` besides gravity. Gravity's own turning shows
:math:`\omega`, but for what is about its direction, and so the size of these errors; as they follow the sweep
in every set, no residual shows them. A limb is no point: what it has of inertia about its centre of mass is
nearly as large. They are no part of the fit but of its covariance: each moves the answer by a
vector, and the sum of these vectors' squares is added.

The accelerometer has a **bias**, which goes into the offset by the weight of what hangs there. It was found
from the length of gravity, in this motion or another: as far as that length, in all sets or in one, still
shows one, and as far as turning would be taken for one, it is open.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.compress import triangle
from surefoot.calibration.in_situ.covariance import OpenErrors
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
    compact_inertia,
    inertial_parameters,
    signals,
    transform_basis,
)
from surefoot.calibration.in_situ.solve import Problem, Solution
from surefoot.calibration.reference import GRAVITY

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

_UNSEEN = 1e-2
"""Share of a row that is no bias in any direction, so that one that gravity does not show stays small."""

_THIN = 0.1
"""Time in s over which gravity is averaged first."""

_STEP, _ALIKE = 0.3, 0.5
"""Time in s between two looks at gravity, and the correlation of its changes from which on it turns
steadily."""


def errors_of_imu(sets: Sequence[InSituSet], problem: Problem, solution: Solution) -> OpenErrors:
    """Return what turning and the accelerometer's bias may have added.

    The limb's inertia as a point comes first, then the accelerometer's place along each axis, then the
    entries of the inertia of limb and added mass about their centres: zero for sets without times, for
    postures that were held, and, but for the added mass's, for a limb whose motion was recorded. Then biases.
    """
    limb = solution.limb[:STATIC]
    com = limb[MOMENT] / limb[MASS]
    reach = _REACH * float(np.linalg.norm(com))
    bare = inertial_parameters(float(limb[MASS]), com, True)
    basis = transform_basis(True)
    found, lengths = [], []
    for data, part in zip(sets, problem.sets, strict=True):
        thin, places = _thinned(replace(data, gravity=data.gravity @ solution.rotation.T))
        moved = thin if data.moves else turning(thin)
        body = bare + inertial_parameters(data.added_mass, data.added_com, True)
        turns = moved.moves and (data.moves or _smooth(moved))
        unknown = float(not data.moves)
        of_offset = np.zeros((AXES, _COLUMNS))
        felt = reach * felt_by_turning(
            moved if turns and not data.moves else replace(thin, **_STILL), np.arange(len(thin.raw))
        )
        if not data.moves:
            lengths.append(_of_length(thin.gravity, felt))
        if not turns:
            found.append(np.zeros((part.uu.shape[0], len(problem.whitening), _COLUMNS)))
            continue
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
        seen = (part.score.T @ part.colour.weigh(rows, part.spacing)).reshape(len(part.uu), -1, AXES)
        found.append(np.moveaxis(seen @ (problem.whitening @ solution.A).T, 1, 2))
    of_bias = _weight_of(body, _biases(lengths)).T
    offset = solution.A @ np.concatenate([of_offset, of_bias], axis=1)
    rows = np.concatenate(found).reshape(-1, _COLUMNS)
    return OpenErrors(np.pad(rows, ((0, 0), (0, of_bias.shape[1]))), offset)


def _weight_of(body: Vector, gravity: Matrix) -> Matrix:
    """Return the wrench, shape (n, 6), of a body in gravity, (n, 3)."""
    return np.concatenate([body[MASS] * gravity, np.cross(body[MOMENT], gravity)], axis=1)


def _of_length(gravity: Matrix, felt: Matrix) -> Matrix:
    """Return a root of the squares of gravity's directions, their length's error and that by turning.

    Args:
        gravity: Shape (n, 3).
        felt: By an accelerometer along each axis, shape (n, 3, 3).

    Returns:
        Shape (7, 7): three directions, the length's error and that by turning.
    """
    size = np.linalg.norm(gravity, axis=1, keepdims=True)
    towards = gravity / np.maximum(size, np.finfo(float).tiny)
    columns = np.hstack([towards, size - GRAVITY, np.einsum("ni,nij->nj", towards, felt)])
    return triangle(columns[np.isfinite(columns).all(axis=1)])


def _biases(lengths: Sequence[Matrix]) -> Matrix:
    """Return biases in m/s^2, shape (q, 3), each of which may be there: by all sets, by each, by turning."""
    if not lengths:
        return np.zeros((0, 3))
    of_all = _bias(triangle(np.concatenate(lengths)))
    of_each = np.array([_bias(one)[0] for one in lengths])
    apart = (of_each - of_each.mean(axis=0)) / np.sqrt(max(len(lengths) - 1, 1))
    return np.concatenate([of_all, apart])


def _bias(root: Matrix) -> Matrix:
    """Return the bias that gravity's length shows and those that turning would show, shape (4, 3)."""
    towards, off = root[:, :3], root[:, 3:]
    unseen = np.eye(3) * _UNSEEN * np.linalg.norm(towards)
    columns = np.concatenate([towards, unseen])
    return np.asarray(np.linalg.lstsq(columns, np.pad(off, ((0, 3), (0, 0))), rcond=None)[0].T)


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
