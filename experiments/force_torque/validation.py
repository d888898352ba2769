r"""How good a calibrated six-axis sensor is: spheres, added masses and their places (in-situ paper, IV).

Turned about, a limb of weight m |g| draws the force f = m g, a sphere. A sensor that is off by a matrix draws
an ellipsoid instead, whose semi-axes show by how much and in how many directions (Table I). With the bare
limb taken off, the added mass (Table II) and its place (Table III) remain.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.fit import InSituFit, Limb
from surefoot.calibration.in_situ.model import STATIC, inertial_parameters, signals, transform_basis

_LEAST = 1e-3
"""Least singular value of the directions of gravity, against the largest, that still spans space."""


class Ellipsoid(NamedTuple):
    """The ellipsoid {centre + axes u : |u| = 1}."""

    centre: Floats  # shape (3,)
    axes: Floats  # a semi-axis a column, the longest first, shape (3, 3)

    @property
    def semi_axes(self) -> Floats:
        """Lengths of the semi-axes, the longest first, shape (3,)."""
        return np.asarray(np.linalg.norm(self.axes, axis=0))

    @property
    def ratio(self) -> float:
        """Longest over shortest semi-axis: one for a sphere."""
        return float(self.semi_axes[0] / self.semi_axes[2])


class AddedMassEstimate(NamedTuple):
    """Mass added to a limb, and its place."""

    mass: float  # in kg; may come out negative where nothing hangs
    position: Floats  # of its centre of mass in the sensor's frame in m, shape (3,); NaN if it is unknown


def force_ellipsoid(points: ArrayLike, gravity: ArrayLike) -> Ellipsoid:
    """Return the ellipsoid that points draw while gravity turns, points = K g + centre.

    Gravity gives the place of each point on the ellipsoid, so that a part of it suffices; its semi-axes are
    |g| times the singular values of K (in-situ paper, Lemma 1). Points are forces in N, or counts along three
    directions, (n, 3), with g in the same frame's axes in m/s^2, (n, 3). ValueError if fewer than four rows
    are finite, or gravity stays in a plane.

    >>> turned = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0]]) * 9.81
    >>> force_ellipsoid(2.0 * turned + 5.0, turned).semi_axes
    array([19.62, 19.62, 19.62])
    """
    points, gravity = _take_finite(points, gravity)
    if not spans_space(gravity):
        raise ValueError(
            "Gravity stays in a plane of the sensor's frame, and its ellipsoid has three axes; turn the "
            "limb about a second axis."
        )
    pull = gravity - gravity.mean(axis=0)
    K = np.linalg.lstsq(pull, points - points.mean(axis=0), rcond=None)[0].T
    size = float(np.sqrt(np.mean(np.sum(gravity**2, axis=1))))
    directions, lengths, _ = np.linalg.svd(K)
    return Ellipsoid(points.mean(axis=0) - K @ gravity.mean(axis=0), size * directions * lengths)


def spans_space(gravity: ArrayLike) -> bool:
    """Return whether gravity, shape (n, 3), turned out of one plane, so that it shows an ellipsoid."""
    g = np.asarray(gravity, dtype=np.float64)
    g = g[np.isfinite(g).all(axis=1)]
    spread = np.linalg.svd(g - g.mean(axis=0), compute_uv=False)
    return bool(len(spread) == 3 and spread[2] >= _LEAST * spread[0])


def added_mass(wrench: ArrayLike, gravity: ArrayLike, limb: Limb) -> AddedMassEstimate:
    """Return mass and place of the load added to a limb at rest (in-situ paper, Tables II and III).

    Least squares of w - M(limb) g = M(m, c) g in m, and of its torques in m c, of w = C (r - o), (n, 6), and
    g in the sensor's frame, (n, 3). A limb in motion is brought to rest by :func:`motion_wrench` first. The
    place is NaN if gravity has one direction only. ValueError if fewer than four rows are finite.
    """
    wrench, gravity = _take_finite(wrench, gravity)
    force = wrench[:, :3] - limb.mass * gravity
    torque = wrench[:, 3:] - np.cross(limb.mass_com, gravity)
    mass = float(np.sum(force * gravity) / np.sum(gravity**2))
    # The torque (m c) x g is linear in m c: normal equations of -[g]x, summed over the rows.
    squares = gravity.T @ gravity
    normal = np.trace(squares) * np.eye(3) - squares
    if mass == 0.0 or np.linalg.eigvalsh(normal)[0] < _LEAST**2 * np.trace(squares):
        return AddedMassEstimate(mass, np.full(3, np.nan))
    first_moment = np.linalg.solve(normal, np.cross(gravity, torque).sum(axis=0))
    return AddedMassEstimate(mass, np.asarray(first_moment / mass))


def offset_of_set(
    raw: ArrayLike, gravity: ArrayLike, response: ArrayLike, noise: ArrayLike | None = None
) -> Floats:
    """Return a sensor's offset in counts, (k,), from a set at rest that took no part in its calibration.

    Least squares of r = A M(m, c) g + o in o, m and m c: A in counts per N and N m, (k, 6), is known; the
    added mass and the limb are not. Counts are (n, k), g in the sensor's frame (n, 3), and the covariance of
    a sample's noise in counts^2 (k, k), by default that of channels that weigh alike. ValueError if fewer
    than four rows are finite.
    """
    r, g = _take_finite(raw, gravity)
    A = np.asarray(response, dtype=np.float64)
    parts = A @ (transform_basis(False) @ g.T)  # of a kg, and a kg m along each axis, (4, k, n)
    covariance = np.eye(len(A)) if noise is None else np.asarray(noise, dtype=np.float64)
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    columns = (white @ (parts - parts.mean(axis=2, keepdims=True))).reshape(STATIC, -1)
    found = np.linalg.lstsq(columns.T, (white @ (r - r.mean(axis=0)).T).ravel(), rcond=None)[0]
    return np.asarray(r.mean(axis=0) - found @ parts.mean(axis=2))


def predict_wrench(data: InSituSet, limb: Limb) -> Floats:
    """Compute the wrench of limb and added mass in N and N m (in-situ paper, Eq. 4), shape (n, 6).

    The added mass counts as compact, and the bare limb where its inertia is unknown.
    """
    body = limb.parameters
    if data.moves and limb.inertia is None:
        body = inertial_parameters(limb.mass, limb.com, True)
    body = body + inertial_parameters(data.added_mass, data.added_com, len(body) > STATIC)
    basis = transform_basis(data.moves)
    return np.asarray(signals(data, data.moves) @ np.einsum("p,pws->sw", body[: len(basis)], basis))


def motion_wrench(data: InSituSet, limb: Limb) -> Floats:
    """Return the part of :func:`predict_wrench` that comes of turning: zero at rest, shape (n, 6)."""
    still = replace(data, angular_velocity=None, angular_acceleration=None)
    return predict_wrench(data, limb) - predict_wrench(still, limb)


def as_seen(data: InSituSet, fit: InSituFit) -> InSituSet:
    """Return a set with gravity in the sensor's frame, and readings without the effect of temperature."""
    raw = data.raw if data.temperature is None else fit.at_reference(data.raw, data.temperature)
    return replace(data, raw=raw, gravity=data.gravity @ fit.imu.rotation.T)


def _take_finite(values: ArrayLike, gravity: ArrayLike) -> tuple[Floats, Floats]:
    """Return the rows in which both are finite."""
    values, gravity = np.asarray(values, dtype=np.float64), np.asarray(gravity, dtype=np.float64)
    there = np.isfinite(values).all(axis=1) & np.isfinite(gravity).all(axis=1)
    if there.sum() < 4:
        raise ValueError(f"Only {there.sum()} rows are finite, and four are the least.")
    return values[there], gravity[there]


def cramer_rao(sets: Sequence[InSituSet], response: Floats, limb: Limb, noise: Floats) -> Floats:
    """Return the bound on the covariance of (A row by row, m, m c, the offsets of the J sets).

    In the square of the unknowns' units, (6 k + 4 + J k, 6 k + 4 + J k), by the true A in counts per N and N
    m, (k, 6), the true limb, and the noise of a sample in counts^2, (k, k); gravity and added masses of the
    sets must be exact. ValueError if the sets leave an unknown open.
    """
    k = len(response)
    first = 6 * k + STATIC
    weight, basis = np.linalg.inv(noise), transform_basis(False)
    information = np.zeros((first + len(sets) * k, first + len(sets) * k))
    for j, data in enumerate(sets):
        slopes = np.zeros((4, k, len(information)))
        body = limb.parameters[:STATIC] + inertial_parameters(data.added_mass, data.added_com, False)
        M = np.einsum("p,pws->ws", body, basis)
        for axis in range(3):
            # d(A M e) / dA, and A (dM / dphi) e, for gravity along one axis.
            slopes[axis, :, : 6 * k] = np.kron(np.eye(k), M[:, axis])
            slopes[axis, :, 6 * k : first] = response @ basis[:, :, axis].T
        slopes[3, :, first + j * k : first + (j + 1) * k] = np.eye(k)
        u = np.column_stack([data.gravity, np.ones(len(data.gravity))])
        information += np.einsum("cd,ckp,kl,dlq->pq", u.T @ u, slopes, weight, slopes, optimize=True)
    scale = np.sqrt(np.diag(information))
    unit = information / np.outer(scale, scale) if np.all(scale > 0.0) else np.zeros((1, 1))
    if np.linalg.cond(unit) > 1e14:
        raise ValueError("The sets leave some unknown open, so that there is no bound on it; add sets.")
    return np.asarray(np.linalg.inv(unit) / np.outer(scale, scale))


def offset_bounds(bound: Floats, response: Floats, sets: int) -> Floats:
    """Return the bound of each of J sets' offset as a wrench, C P C', in N^2 and (N m)^2, shape (J, 6, 6).

    ``bound`` is that of :func:`cramer_rao` by the true A, ``response``, (k, 6).
    """
    k = len(response)
    C = np.linalg.pinv(response)
    first = 6 * k + STATIC
    places = [slice(first + j * k, first + (j + 1) * k) for j in range(sets)]
    return np.array([C @ bound[place, place] @ C.T for place in places])


def normalise_error(fit: InSituFit, response: Floats, offset: Floats, limb: Limb) -> float:
    """Return the squared error of (C, the last offset, limb) by the covariance of the fit (NEES).

    By the true A in counts per N and N m, (k, 6), the true last offset in counts, (k,), and the true limb: a
    draw of chi-square with ``len(fit.covariance)`` degrees of freedom, if the fit knows itself.
    """
    error = np.concatenate(
        [
            (fit.matrix - np.linalg.pinv(response)).ravel(),
            fit.offset - offset,
            [fit.limb.mass - limb.mass],
            fit.limb.mass_com - limb.mass_com,
        ]
    )
    scale = np.sqrt(np.diag(fit.covariance))
    unit = fit.covariance / np.outer(scale, scale)
    return float(error / scale @ np.linalg.solve(unit, error / scale))
