r"""Errors of an IMU that gravity shows: bias and scale by gravity's length, and a clock that is late.

.. math:: |S (g_i - b) + K_i p| = \rho, \qquad K = [\dot\omega]_\times + [\omega]_\times [\omega]_\times,

where :math:`K p` is the acceleration by rotation at the arm p from the point that the limb turns about.
Without a gyroscope, gravity's own rotation shows it. A bias would shift the offset by the limb's mass times
the bias: it is subtracted first. Noise along the length looks like a limb that bends. For a limb at rest it
is subtracted too, but the acceleration by rotation stays, since the sensor feels it. Bias, scale and arm are
those of largest posterior probability; scales S of the axes are one unless the rest would be unlikely.
Their remaining errors, and the acceleration of a sweep that was treated as rest, move the answer by a vector
each; the squares of all are part of its covariance (:func:`errors_of_imu`).

Gravity that was read late by d makes :math:`r = A T u(t + d) + o`, to first order a column :math:`A T \dot u`
of readings more, which is looked for beside all else that a fit explains. Where a sensor has hysteresis its
readings lag as well: the effect of a late IMU cancels part of a loop, and the rest looks like a narrow one.
The two differ after each turn of the limb, where a delay acts at once and a loop grows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from surefoot.calibration.arrays import MAD_TO_STD
from surefoot.calibration.diagnosis import CLEARER
from surefoot.calibration.imu.static import savitzky_golay
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.covariance import OpenErrors, disagreement
from surefoot.calibration.in_situ.data import InSituSet, Matrix, Vector
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
from surefoot.calibration.in_situ.solver.solve import Solution
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.results import Finding

_BIAS = 0.15
"""Deviation of a bias beforehand in m/s^2: sheets of MEMS sensors state 20 to 50 mg (BMI088, MPU-6050), and
most were calibrated."""

_LENGTH = 0.05
"""Deviation of gravity's length beforehand: a scale to 0.5 % (MPU-6050: 3 %, BMI088: 0.5 %), places on
Earth 0.02."""

_AXIS = 0.03  # deviation of the ratio of two axes' scales (MPU-6050: 3 %)

_RATIOS = np.array([[-1.0, 1.0, 0.0], [-1.0, -1.0, 2.0]]).T / np.sqrt([2.0, 6.0])
"""Changes of the axes' scales, orthonormal, that leave their mean, shape (3, 2): that is the length's."""

_ARM = 1.0  # deviation in m of the arm from the point that a limb turns about: a leg's length
_SAMPLES = 8000  # samples of all sets that are looked at
_LEAST = 1e-4  # deviation of the length in m/s^2 at least: data without noise have none
_GATE = 3.0  # deviations beyond which a sample pulls no harder

_ROUNDS = 12

_THIN = 0.1  # time in s over which gravity is averaged before its turning is taken

_SWEPT, _FEWEST = 3.0, 5
"""Time in s, and rows at least, over which the turning of gravity is taken, free of noise before. By a noisy
turning too little of the length is explained, and a bias takes the rest: with noise of 0.1 m/s^2 a sample
0.09 m/s^2, three deviations, where 2 s of gravity as it was read are taken."""

_PER_OCTAVE = 3  # bands an octave in which a signal is told from noise. A limb's sweeps end within an octave.
_STEP, _ALIKE = 0.3, 0.5
"""Time in s between two looks at gravity, and the correlation of its changes from which on it turns
steadily, rather than from one posture at rest to the next."""


@dataclass(frozen=True, eq=False)
class Sphere:
    """An accelerometer's errors by its readings of gravity."""

    bias: Vector  # b in m/s^2, shape (3,)
    covariance: Matrix  # of the bias, shape (3, 3)
    arm: Vector  # p in m, shape (3,)
    length: float  # rho in m/s^2
    axes: Vector
    """By which readings are multiplied first, of mean one, shape (3,): ones unless the length shows that axes
    differ."""
    scale: float  # by which they are multiplied last: one unless the length cannot be gravity's

    @property
    def scales(self) -> Vector | float:
        """By which readings are multiplied: one number, or one an axis where they differ, shape (3,)."""
        return self.scale * self.axes if np.ptp(self.axes) > 0.0 else self.scale

    @property
    def findings(self) -> list[Finding]:
        """Report corrections that are more than chance."""
        words = []
        off = 100.0 * (1.0 / np.atleast_1d(self.scales) - 1.0)
        if np.any(off != 0.0):
            shown = ", ".join(f"{value:+.1f}" for value in off)
            words.append(f"its scale is off by {shown if len(off) == 1 else f'({shown})'} %")
        std = np.sqrt(np.diag(self.covariance))
        if np.any(np.abs(self.bias) > np.maximum(limits.ACCELEROMETER * std, _LENGTH)):
            shown = ", ".join(f"{value:.2f}" for value in self.bias)
            words.append(f"it has a bias of about ({shown}) m/s^2")
        if not words:
            return []
        reason = f"The accelerometer was corrected by the length of gravity: {' and '.join(words)}."
        return [Finding("accelerometer", reason, refuses=False)]


def fit_sphere(sets: Sequence[InSituSet]) -> Sphere:
    """Return the likeliest bias, scale and noise of the accelerometer by all sets together."""
    gravity, turned = [], []
    for one in sets:
        data, _ = add_turning(one)
        rows = np.flatnonzero(np.isfinite(data.gravity).all(axis=1))
        rows = rows[:: max(len(rows) * len(sets) // _SAMPLES, 1)]
        felt = _measure_turning(data, rows)
        whole = np.isfinite(felt).all(axis=(1, 2))
        gravity.append(data.gravity[rows[whole]])
        turned.append(felt[whole])
    g, K = np.concatenate(gravity), np.concatenate(turned)
    (plain, penalty), (by_axis, lower) = _fit_length(g, K, _RATIOS[:, :0]), _fit_length(g, K, _RATIOS)
    # How much better the length is explained does not count: what is left hangs together in time.
    return by_axis if penalty - lower > CLEARER else plain


def _fit_length(g: Matrix, K: NDArray[np.float64], ratios: Matrix) -> tuple[Sphere, float]:
    """Return the likeliest errors, with ratios of the axes' scales, (3, q), and their prior's nats."""
    root = 1.0 / np.array([_BIAS, _BIAS, _BIAS, _LENGTH, _ARM, _ARM, _ARM, *[_AXIS] * ratios.shape[1]])
    before = np.zeros(len(root))
    before[3] = GRAVITY
    x = before.copy()
    x[3] = float(np.median(np.linalg.norm(g, axis=1)))
    for _ in range(_ROUNDS):
        axes = 1.0 + ratios @ x[7:]
        v = axes * (g - x[:3]) + K @ x[4:7]
        size = np.linalg.norm(v, axis=1)
        off = size - x[3]
        towards = v / np.maximum(size, np.finfo(float).tiny)[:, None]
        noise = max(float(MAD_TO_STD * np.median(np.abs(off))), _LEAST)
        weight = 1.0 / np.maximum(1.0, np.abs(off) / (_GATE * noise))
        variance = max(float(np.average(off**2, weights=weight)), _LEAST**2)
        by_axis = (towards * (g - x[:3])) @ ratios
        turning = np.einsum("na,nab->nb", towards, K)
        slopes = np.column_stack([-axes * towards, -np.ones(len(g)), turning, by_axis])
        H = (slopes.T * weight) @ slopes / variance + np.diag(root**2)
        x = x - np.linalg.solve(H, (slopes.T * weight) @ off / variance + root**2 * (x - before))
    covariance = np.linalg.inv(H)
    length, std = float(x[3]), float(np.sqrt(covariance[3, 3]))
    earthly = abs(length / GRAVITY - 1.0) <= limits.EARTH + limits.ACCELEROMETER * std / GRAVITY
    found = Sphere(
        bias=x[:3],
        covariance=covariance[:3, :3],
        arm=x[4:7],
        length=length,
        axes=1.0 + ratios @ x[7:],
        # Where axes differ, so does their mean.
        scale=1.0 if earthly and not ratios.size else GRAVITY / length,
    )
    return found, 0.5 * float(np.sum((root * (x - before)) ** 2))


def level(sets: Sequence[InSituSet], sphere: Sphere) -> tuple[InSituSet, ...]:
    """Return sets with gravity less its bias and its noise along its length.

    The acceleration by rotation is no noise: the sensor feels it as well. What else the length shows of a
    limb whose motion was recorded is an acceleration as far as it hangs together in time.
    """
    found = []
    for data in sets:
        g = (data.gravity - sphere.bias) * sphere.axes
        moved, places = add_turning(data)
        felt = _measure_turning(moved, np.arange(len(places))) @ sphere.arm
        added = np.stack([np.interp(np.arange(len(g)), places, one) for one in felt.T], axis=1)
        size = np.linalg.norm(g + added, axis=1)
        length = np.full_like(size, sphere.length)
        if data.moves:
            length = length + smooth(size - length) if data.time is not None else size
        g = (g + added) * (length / np.where(size > 0.0, size, np.nan))[:, None] - added
        found.append(replace(data, gravity=g * sphere.scale))
    return tuple(found)


def smooth(off: Vector) -> Vector:
    """Return the part of a signal beside white noise by Wiener's filter, shape (n,)."""
    whole = np.isfinite(off)
    modes = dct(off[whole], norm="ortho")
    # Bands of modes, of which the upper half is white noise.
    band = np.floor(_PER_OCTAVE * np.log2(np.arange(len(modes)) / _FEWEST + 1.0)).astype(int)
    power = (np.bincount(band, modes**2) / np.maximum(np.bincount(band), 1))[band]
    noise = np.mean(modes[len(modes) // 2 :] ** 2)
    share = np.maximum(1.0 - noise / np.maximum(power, np.finfo(float).tiny), 0.0)
    smooth = np.full_like(off, np.nan)
    smooth[whole] = idct(share * modes, norm="ortho")
    return smooth


def add_turning(data: InSituSet) -> tuple[InSituSet, NDArray[np.float64]]:
    """Return means of gravity over a fraction of a second with the motion it shows, and their places.

    That is no turning about its own direction. A set whose motion was recorded is returned itself; one that
    went from posture to posture, or that gaps or few samples hide, has no turning.
    """
    if data.moves or data.time is None or len(data.time) < 2:
        return data, np.arange(float(len(data.raw)))
    width = max(round(_THIN / float(np.median(np.diff(data.time)))), 1)
    columns = np.column_stack([np.arange(len(data.time)), data.time, data.gravity])
    columns = columns[: len(columns) // width * width].reshape(-1, width, 5).mean(axis=1)
    g, raw = columns[:, 2:], np.zeros((len(columns), data.channels))
    thin = replace(data, raw=raw, time=columns[:, 1], gravity=g, temperature=None)
    dt = float(np.median(np.diff(columns[:, 1]))) if len(columns) > 1 else np.inf
    window = max(_FEWEST, 2 * round(0.5 * _SWEPT / dt) + 1)
    if len(columns) <= 2 * window or not np.isfinite(g).all() or not _steady(g, dt):
        return thin, columns[:, 0]
    quiet = np.stack([smooth(one) for one in g.T], axis=1)
    change = savitzky_golay(quiet, window=window, derivative=1, dt=dt)
    spin = -np.cross(g, change) / np.maximum(np.sum(g**2, axis=1, keepdims=True), np.finfo(float).tiny)
    rate = savitzky_golay(spin, window=window, derivative=1, dt=dt)
    return replace(thin, angular_velocity=spin, angular_acceleration=rate), columns[:, 0]


def _steady(gravity: Matrix, dt: float) -> bool:
    steps = np.diff(gravity[:: max(round(_STEP / dt), 1)], axis=0)
    return bool(np.sum(steps[1:] * steps[:-1]) > _ALIKE * np.sum(steps**2))


def _measure_turning(data: InSituSet, rows: NDArray[np.int_]) -> NDArray[np.float64]:
    """Return [dw]x + [w]x [w]x, shape (n, 3, 3): the acceleration at an arm from the point of rotation."""
    if data.angular_velocity is None or data.angular_acceleration is None:
        return np.zeros((len(rows), 3, 3))
    spin, rate = data.angular_velocity[rows], data.angular_acceleration[rows]
    eye = np.eye(3)
    turn = np.stack([np.cross(rate, axis) + np.cross(spin, np.cross(spin, axis)) for axis in eye], axis=2)
    return np.asarray(turn)


_REACH = 2.0
"""Distance of the accelerometer over that of the limb's centre of mass, along any axis: its deviation."""

_ROD = 1.0 / 3.0
"""Inertia of the limb about its centre of mass over that of a point there about the sensor: its deviation is
that of a rod that hangs from it. An added mass's is a compact body's: its shape and density are not known."""

_ROUND = np.array([1.0 if i == j else 0.5 for i, j in PAIRS])  # products of inertia are at most half as large
_COLUMNS = 1 + 3 + 6 + 1


def errors_of_imu(
    sets: Sequence[InSituSet], solution: Solution, sphere: Sphere, delay_std: float
) -> OpenErrors:
    """Collect the errors that turning, a delay and the accelerometer's bias may have added.

    The limb's inertia as a point comes first, then the accelerometer's place along each axis, then the
    entries of the inertia of limb and added mass about their centres: zero for sets without times, for
    postures that were held, and, but for the added mass's, for a limb whose motion was recorded. Then the
    delay, and the bias along each axis.
    """
    problem, limb = solution.problem, solution.limb[:STATIC]
    com = limb[MOMENT] / limb[MASS]
    reach = _REACH * float(np.linalg.norm(com))
    bare = inertial_parameters(float(limb[MASS]), com, True)
    basis, found = transform_basis(True), []
    white = (problem.whitening @ solution.A).T
    for data, part in zip(sets, problem.sets, strict=True):
        moved, places = add_turning(replace(data, gravity=data.gravity @ solution.rotation.T))
        body = bare + inertial_parameters(data.added_mass, data.added_com, True)
        of_offset = np.zeros((AXES, _COLUMNS))
        if not moved.moves:
            found.append(np.zeros((part.uu.shape[0], len(problem.whitening), _COLUMNS)))
            continue
        unknown = float(not data.moves)
        felt = unknown * reach * _measure_turning(moved, np.arange(len(places)))
        u = np.nan_to_num(signals(moved, moving=True))
        u[:, DIRECT] = 0.0
        # Without times nothing is known of a delay, and its deviation is zero.
        change = np.gradient(moved.gravity, 1.0 if moved.time is None else moved.time, axis=0)
        inertia = unknown * limb[MASS] * com @ com * _ROD + compact_inertia(data.added_mass)
        # One after the other: all of a long set at once take more memory than the set.
        added = chain(
            (u @ np.einsum("p,pws->ws", unknown * body, basis).T,),
            (_weight_of(body, a) for a in np.moveaxis(felt, 2, 0)),
            (size * (u @ entry.T) for size, entry in zip(inertia * _ROUND, basis[INERTIA], strict=True)),
            (delay_std * _weight_of(body, change),),
        )
        rows = np.stack(
            [np.interp(part.source.places, places, one) for wrench in added for one in wrench.T], axis=1
        )
        rows *= part.source.weight[:, None]
        of_offset = (part.end.weights @ rows).reshape(-1, AXES).T
        seen = part.whiten @ (part.score.T @ part.weigh(rows))
        found.append(np.moveaxis(seen.reshape(len(seen), -1, AXES) @ white, 1, 2))
    of_bias = _weight_of(body, np.asarray(np.linalg.cholesky(sphere.covariance).T * sphere.scale)).T
    offset = solution.A @ np.concatenate([of_offset, of_bias], axis=1)
    rows = np.concatenate(found).reshape(-1, _COLUMNS)
    return OpenErrors(np.pad(rows, ((0, 0), (0, of_bias.shape[1]))), offset)


def _weight_of(body: Vector, gravity: Matrix) -> Matrix:
    """Return the wrench, shape (n, 6), of a body in gravity, (n, 3)."""
    return np.concatenate([body[MASS] * gravity, np.cross(body[MOMENT], gravity)], axis=1)


_LAW = 0.1
"""Share of the delay that loops look like by which a law of hysteresis other than the fit's may feign one:
thresholds of ratio 3 in the place of 2 feign a tenth."""


class DelayLeft(NamedTuple):
    """By how much gravity is late in s beside all that a fit explains, negative if early; its deviation."""

    delay: float
    std: float

    @property
    def nats(self) -> float:
        """Log-likelihood that the delay gains."""
        return 0.5 * (self.delay / self.std) ** 2


def delay_left(sets: Sequence[InSituSet], solution: Solution) -> DelayLeft:
    """Return the delay that would be likeliest beside a fit, with all of its unknowns free to follow.

    Delays and loops cancel each other in part, so the fit must have loops where the sensor may have some.
    """
    problem = solution.problem
    between, along, square, like, whole = [], 0.0, 1e-300, 0.0, 1e-300
    for data, part, B in zip(sets, problem.sets, solution.predicted, strict=True):
        source = part.source
        at = np.interp(source.places, np.arange(len(data.raw)), np.asarray(data.time))
        rate = np.gradient(source.signals[:, problem.motion], at, axis=0) @ B[:, problem.motion].T
        loops = source.signals[:, problem.of_lags] @ B[:, problem.of_lags].T
        late, loops = np.hsplit(part.centre(np.column_stack([rate, loops])), 2)
        seen = part.score.T @ late
        between.append(part.whiten @ seen @ problem.whitening.T)
        power = np.sqrt(part.power)[:, None]
        within, left, late, loops = (
            dct(one, norm="ortho", axis=0) / power @ problem.whitening.T
            for one in (late - part.score @ seen, part.residual, late, loops)
        )
        along, square = along + float(np.sum(within * left)), square + float(np.sum(within**2))
        like, whole = like + float(np.sum(late * loops)), whole + float(np.sum(late**2))
    # Sets that contradict each other say little of a clock.
    believed = 1.0 / disagreement(solution)[:, None]
    free = solution.project(np.stack(between).reshape(-1, 1))[: solution.residual.size]
    free = free.reshape(solution.residual.shape) * believed
    along -= float(np.sum(free * solution.residual * believed))
    square += float(np.sum(free**2))
    return DelayLeft(along / square, float(np.hypot(square**-0.5, _LAW * like / whole)))
