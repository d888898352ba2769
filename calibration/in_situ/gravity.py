r"""Gravity as the accelerometer shows it: its bias, its scale and its noise, by its length alone.

.. math:: |g_i - b + K_i p| = \rho, \qquad K = [\dot\omega]_\times + [\omega]_\times [\omega]_\times,

where :math:`K p` is what turning adds at the arm p from the point that the limb turns about; while nobody
gave the motion, gravity's own turning shows it. A bias goes into the offset by the weight of what hangs
there: it is taken off before all else. Noise along the length reads as a limb that bends: of a limb at rest
it is taken off, but for what turning adds, which the sensor feels. What stays open of the bias is part of the
offsets' covariance.

All three are what is likeliest beside what is known of such sensors; data that do not show a bias leave it
near zero, and unsure.

A slow sweep is no rest: what turning adds, of a limb with inertia of its own and of an accelerometer that
sits anywhere, follows the sweep in every set, and no residual shows it. These errors move the answer by a
vector each, and the squares of all are part of its covariance (:func:`errors_of_imu`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import MAD_TO_STD
from surefoot.calibration.imu.static import savitzky_golay
from surefoot.calibration.in_situ.covariance import OpenErrors
from surefoot.calibration.in_situ.data import InSituSet
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

__all__ = [
    "Sphere",
    "errors_of_imu",
    "felt_by_turning",
    "fit_sphere",
    "level",
    "turning",
    "with_turning",
]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


_BIAS = 0.15
"""Deviation of a bias beforehand in m/s^2: sheets of MEMS sensors state 20 to 50 mg (BMI088, MPU-6050), and
most were calibrated."""

_LENGTH = 0.05
"""Deviation of gravity's length beforehand: a scale to 0.5 % (MPU-6050: 3 %, BMI088: 0.5 %), places on
Earth 0.02."""

_EARTH = 0.006
"""Share by which the length of gravity may be off without a fault of the scale: 9.780 to 9.832 m/s^2."""

_ARM = 1.0
"""Deviation in m of the arm from the point that a limb turns about: a leg's length."""

_SAMPLES = 8000
"""Samples of all sets that are looked at."""

_BLOCK = 3.0
"""Time in s beyond which errors of the length hang together no more."""

_LEAST = 1e-4
"""Deviation of the length in m/s^2 at least: data without noise have none."""

_GATE = 3.0
"""Deviations beyond which a sample pulls no harder."""

_ROUNDS = 12

_SIGMAS = 3.0
"""Deviations from which on a bias or a scale is worth a word."""

_THIN = 0.1
"""Time in s over which gravity is averaged before its turning is taken."""

_SMOOTHED, _SWEPT, _FEWEST = 0.3, 2.0, 5
"""Time in s, the second for slow sweeps, and rows at least, over which the turning of gravity is taken. By a
noisy turning too little of the length is explained, and a bias takes the rest."""

_STEP, _ALIKE = 0.3, 0.5
"""Time in s between two looks at gravity, and the correlation of its changes from which on it turns
steadily, rather than from one posture at rest to the next."""


@dataclass(frozen=True, eq=False)
class Sphere:
    """What an accelerometer's readings of gravity show of it.

    Attributes:
        bias: b in m/s^2, shape (3,).
        covariance: Of the bias, shape (3, 3).
        arm: p in m, shape (3,).
        length: rho in m/s^2.
        length_std: Its deviation.
        scale: By which readings are multiplied: one unless the length cannot be gravity's.
        noise: Of a sample along its length in m/s^2.
        spread: All that the length leaves, rms in m/s^2.
    """

    bias: Vector
    covariance: Matrix
    arm: Vector
    length: float
    length_std: float
    scale: float
    noise: float
    spread: float

    def describe(self) -> tuple[str, ...]:
        """Return in words what was corrected, if it is more than chance."""
        words = []
        if self.scale != 1.0:
            words.append(f"its scale is off by {100.0 * (1.0 / self.scale - 1.0):+.1f} %")
        std = np.sqrt(np.diag(self.covariance))
        if np.any(np.abs(self.bias) > np.maximum(_SIGMAS * std, _LENGTH)):
            shown = ", ".join(f"{value:.2f}" for value in self.bias)
            words.append(f"it has a bias of about ({shown}) m/s^2")
        if not words:
            return ()
        return (f"The accelerometer was corrected by the length of gravity: {' and '.join(words)}.",)


def fit_sphere(sets: Sequence[InSituSet]) -> Sphere:
    """Return the likeliest bias, scale and noise of the accelerometer by all sets together."""
    gravity, turned, blocks = [], [], []
    for one in sets:
        data, _ = with_turning(one)
        rows = np.flatnonzero(np.isfinite(data.gravity).all(axis=1))
        rows = rows[:: max(len(rows) * len(sets) // _SAMPLES, 1)]
        felt = felt_by_turning(data, rows)
        whole = np.isfinite(felt).all(axis=(1, 2))
        gravity.append(data.gravity[rows[whole]])
        turned.append(felt[whole])
        blocks.append(_block(data, rows[whole]))
    g, K = np.concatenate(gravity), np.concatenate(turned)
    root = np.concatenate([np.full(3, 1.0 / _BIAS), [1.0 / _LENGTH], np.full(3, 1.0 / _ARM)])
    before = np.zeros(7)
    before[3] = GRAVITY
    x = before.copy()
    x[3] = float(np.median(np.linalg.norm(g, axis=1)))
    for _ in range(_ROUNDS):
        v = g - x[:3] + K @ x[4:]
        size = np.linalg.norm(v, axis=1)
        off = size - x[3]
        towards = v / np.maximum(size, np.finfo(float).tiny)[:, None]
        noise = max(float(MAD_TO_STD * np.median(np.abs(off))), _LEAST)
        weight = 1.0 / np.maximum(1.0, np.abs(off) / (_GATE * noise))
        variance = max(float(np.average(off**2, weights=weight)), _LEAST**2) * _long_run(off, blocks)
        slopes = np.column_stack([-towards, -np.ones(len(g)), np.einsum("na,nab->nb", towards, K)])
        H = (slopes.T * weight) @ slopes / variance + np.diag(root**2)
        x = x - np.linalg.solve(H, (slopes.T * weight) @ off / variance + root**2 * (x - before))
    covariance = np.linalg.inv(H)
    length, std = float(x[3]), float(np.sqrt(covariance[3, 3]))
    earthly = abs(length / GRAVITY - 1.0) <= _EARTH + _SIGMAS * std / GRAVITY
    return Sphere(
        bias=x[:3],
        covariance=covariance[:3, :3],
        arm=x[4:],
        length=length,
        length_std=std,
        scale=1.0 if earthly else GRAVITY / length,
        noise=noise,
        spread=float(np.std(off)),
    )


def level(sets: Sequence[InSituSet], sphere: Sphere) -> tuple[InSituSet, ...]:
    """Return sets with gravity less its bias, of its own length where the limb is at rest.

    What turning adds is no noise: the sensor feels it as well.
    """
    found = []
    for data in sets:
        g = data.gravity - sphere.bias
        if not data.moves:
            moved, places = with_turning(data)
            felt = felt_by_turning(moved, np.arange(len(places))) @ sphere.arm
            added = np.stack([np.interp(np.arange(len(g)), places, one) for one in felt.T], axis=1)
            size = np.linalg.norm(g + added, axis=1, keepdims=True)
            g = (g + added) * sphere.length / np.where(size > 0.0, size, np.nan) - added
        found.append(replace(data, gravity=g * sphere.scale))
    return tuple(found)


def _block(data: InSituSet, rows: NDArray[np.int_]) -> int:
    """Return how many of some rows hang together at most."""
    if data.time is None or len(rows) < 2:
        return 1
    return max(round(_BLOCK / float(np.median(np.diff(data.time[rows])))), 1)


def _long_run(off: Vector, blocks: Sequence[int]) -> float:
    """Return the variance of means of blocks over that of independent samples, at least one."""
    width = max(blocks)
    count = len(off) // width
    if width < 2 or count < 8:
        return 1.0
    means = off[: count * width].reshape(count, width).mean(axis=1)
    return max(1.0, width * float(np.var(means)) / max(float(np.var(off)), np.finfo(float).tiny))


def turning(data: InSituSet, smoothed: float = _SMOOTHED) -> InSituSet:
    """Return a set that was taken to be at rest with the motion that gravity shows: none about its direction.

    Where gaps or few samples hide it, the set itself is returned.
    """
    if data.time is None or len(data.time) < 2:
        return data
    dt = float(np.median(np.diff(data.time)))
    window = max(_FEWEST, 2 * round(0.5 * smoothed / dt) + 1)
    if len(data.time) <= 2 * window or not np.isfinite(data.gravity).all():
        return data
    g = data.gravity
    change = savitzky_golay(g, window=window, derivative=1, dt=dt)
    spin = -np.cross(g, change) / np.maximum(np.sum(g**2, axis=1, keepdims=True), np.finfo(float).tiny)
    rate = savitzky_golay(spin, window=window, derivative=1, dt=dt)
    return replace(data, angular_velocity=spin, angular_acceleration=rate)


def with_turning(data: InSituSet) -> tuple[InSituSet, NDArray[np.float64]]:
    """Return means of gravity over a fraction of a second with its own turning, and their places in the set.

    A set whose motion was recorded is returned itself; one that went from posture to posture has no turning.
    """
    if data.moves or data.time is None or len(data.time) < 2:
        return data, np.arange(float(len(data.raw)))
    width = max(round(_THIN / float(np.median(np.diff(data.time)))), 1)
    columns = np.column_stack([np.arange(len(data.time)), data.time, data.gravity])
    columns = columns[: len(columns) // width * width].reshape(-1, width, 5).mean(axis=1)
    raw = np.zeros((len(columns), data.channels))
    thin = replace(data, raw=raw, time=columns[:, 1], gravity=columns[:, 2:], temperature=None)
    moved = turning(thin, _SWEPT)
    return moved if moved.moves and _steady(thin) else thin, columns[:, 0]


def _steady(data: InSituSet) -> bool:
    assert data.time is not None
    stride = max(round(_STEP / float(np.median(np.diff(data.time)))), 1)
    steps = np.diff(data.gravity[::stride], axis=0)
    return bool(np.sum(steps[1:] * steps[:-1]) > _ALIKE * np.sum(steps**2))


def felt_by_turning(data: InSituSet, rows: NDArray[np.int_]) -> NDArray[np.float64]:
    """Return [dw]x + [w]x [w]x, shape (n, 3, 3): the acceleration at an arm from what a limb turns about."""
    if data.angular_velocity is None or data.angular_acceleration is None:
        return np.zeros((len(rows), 3, 3))
    spin, rate = data.angular_velocity[rows], data.angular_acceleration[rows]
    eye = np.eye(3)
    turn = np.stack([np.cross(rate, axis) + np.cross(spin, np.cross(spin, axis)) for axis in eye], axis=2)
    return np.asarray(turn)


_STILL: dict[str, Any] = {"angular_velocity": None, "angular_acceleration": None}

_REACH = 2.0
"""Distance of the accelerometer over that of the limb's centre of mass, along any axis: its deviation."""

_ROD = 1.0 / 3.0
"""Inertia of the limb about its centre of mass over that of a point there about the sensor: its deviation is
that of a rod that hangs from it. An added mass's is a compact body's: its shape and density are not known."""

_ROUND = np.array([1.0 if i == j else 0.5 for i, j in PAIRS])
"""Products of inertia are at most half as large."""

_COLUMNS = 1 + 3 + 6 + 1


def errors_of_imu(
    sets: Sequence[InSituSet], problem: Problem, solution: Solution, sphere: Sphere, delay_std: float
) -> OpenErrors:
    """Return what turning, a delay and the accelerometer's bias may have added.

    The limb's inertia as a point comes first, then the accelerometer's place along each axis, then the
    entries of the inertia of limb and added mass about their centres: zero for sets without times, for
    postures that were held, and, but for the added mass's, for a limb whose motion was recorded. Then the
    delay, and the bias along each axis.
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
            (delay_std * _weight_of(body, np.gradient(moved.gravity, np.asarray(moved.time), axis=0)),),
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
