"""The rows of one block of samples: Newton and Euler for the whole robot, and the tare of feet in the air.

Rows are in body weights and in body weights times foot lengths; columns are the unknowns of
:class:`~surefoot.calibration.moment.unknowns.Unknowns`. Private to the moment filter.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration._constants import Constants, namespace_of
from surefoot.calibration._setup import OnlineSetup
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.distal import DistalMasses
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.reference import GRAVITY

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""

_CLIP = 30.0
"""Largest squared normalised residual that counts."""

_LEAST_LOAD = 0.1
"""Load in body weights that a centre of pressure is computed with at least, for moments to be taken about."""


class Block(NamedTuple):
    """Some samples in a row, oldest first; any leading batch dimensions ``...``; n samples, F feet.

    The first and the last ``settle`` samples are only looked at, those between are learnt from.

    Attributes:
        force: Forces by the starting map in N, shape (..., n, K).
        motion: Flat references, shape (..., n, R).
        swing: Feet surely in the air (0 or 1), shape (..., n, F).
        use: Samples that may be learnt from (0 or 1), shape (..., n).
        stand: Samples at which a foot surely stands (0 or 1), shape (..., n): only then does a motion ask for
            a force of the ground.
    """

    force: Array
    motion: Array
    swing: Array
    use: Array
    stand: Array


class Rows(NamedTuple):
    """Linear equations H x = y + e; a row of zeros with y = 0 says nothing.

    Attributes:
        H: Shape (..., m, N).
        y: Shape (..., m).
        variance: Of e, positive, shape (..., m).
    """

    H: Array
    y: Array
    variance: Array

    def keep(self, share: Array) -> "Rows":
        """Keep rows (1) or leave them out (0), shape (..., m), or (..., 1) for all alike."""
        return Rows(self.H * share[..., None], self.y * share, self.variance)

    def beside(self, other: "Rows") -> "Rows":
        """Put the rows of another kind behind these."""
        xp = namespace_of(self.y)
        return Rows(
            xp.concat([self.H, other.H], axis=-2),
            xp.concat([self.y, other.y], axis=-1),
            xp.concat([self.variance, other.variance], axis=-1),
        )


class Misfit(NamedTuple):
    """What m rows leave unexplained.

    Attributes:
        residual: y - H x, shape (..., m).
        variance: What it may be: the diagonal of H S H' + R, shape (..., m).
        there: Rows that say anything (0 or 1), shape (..., m).
        mean: The mean squared normalised residual, each clipped, shape (...).
    """

    residual: Array
    variance: Array
    there: Array
    mean: Array

    @classmethod
    def of(cls, rows: Rows, mean: Array, covariance: Array) -> "Misfit":
        """Hold rows against unknowns with a covariance, shapes (..., N) and (..., N, N)."""
        xp = namespace_of(mean)
        residual = rows.y - (rows.H @ mean[..., None])[..., 0]
        variance = xp.sum((rows.H @ covariance) * rows.H, axis=-1) + rows.variance
        there = xp.astype(xp.any(rows.H != 0.0, axis=-1), mean.dtype)
        return cls(residual, variance, there, _mean_square(residual, variance, there, axis=-1))

    def mean_with(self, change: Array) -> Array:
        """Compute the mean for residuals that hypotheses change, shape (..., m, H) to (..., H)."""
        residual, variance, there = (part[..., None] for part in self[:3])
        return _mean_square(residual + change, variance, there, axis=-2)


def _mean_square(residual: Array, variance: Array, there: Array, axis: int) -> Array:
    xp = namespace_of(residual)
    count = xp.sum(there, axis=axis)
    square = xp.clip(residual * residual / variance, 0.0, _CLIP) * there
    return xp.sum(square, axis=axis) / xp.where(count > 0.5, count, 1.0)


class MomentRows:
    """Writes the rows of blocks for one setup.

    Args:
        setup: What the method was told about the robot.
        config: Options of the filter.
        unknowns: The unknowns.

    Attributes:
        kinds: Newton-Euler rows of one group of samples: 3 for (Fz, Mx, My), or all 6.
        vertical: Which of them is the vertical force.
        compares: Whether any foot has several instruments to hold against each other.
    """

    def __init__(self, setup: OnlineSetup, config: MomentFilterConfig, unknowns: Unknowns) -> None:
        layout = setup.layout
        self.unknowns, self.config = unknowns, config
        self._feet, self._channels = len(layout.feet), layout.channels
        self._soles = 15 + 3 * self._feet
        self._weight, self._length, self._dt = setup.weight, setup.length, setup.dt
        self._groups = config.every // config.average
        self._middle = slice(config.settle, config.settle + config.every)
        # A row helps only if no foot is blind to it.
        wrench_map = layout.wrench_map
        self._six_axes = bool((wrench_map != 0.0).any(axis=2).all())
        self._seen = list(range(6)) if self._six_axes else [2, 3, 4]
        self.kinds, self.vertical = len(self._seen), self._seen.index(2)
        noise = np.repeat([config.force_noise, config.cop_noise / setup.length], 3)[self._seen]
        scale = np.repeat([1.0 / setup.weight, 1.0 / (setup.weight * setup.length)], 3)[self._seen]
        self._distal = DistalMasses(layout, setup.dt, config.every, config.every + 2 * config.settle)
        self._constants = Constants(
            wrench_map[:, :3],
            wrench_map[:, 3:],
            scale,
            noise**2 / config.average,
            _CROSS,
            _acceleration_columns(self._seen),
            _shifts(self._seen),
            np.eye(self.kinds),
        )
        parity = _parity(layout) * np.repeat([1.0, 1.0 / setup.length], 3)[None, :, None] / setup.weight
        parity = parity.reshape(-1, self._channels)
        parity = parity[(parity != 0.0).any(axis=1)]
        self.compares = len(parity) > 0
        others = np.eye(self._channels, unknowns.size - unknowns.gains) * unknowns.unit[:, None]
        self._parity_constants = Constants(parity, parity @ others)
        tare_offsets = np.eye(self._channels, unknowns.size, unknowns.gains)
        self._tare_constants = Constants(
            np.eye(self._feet)[:, layout.foot_of_channel],
            unknowns.gather.T / unknowns.unit[:, None],
            tare_offsets,
            unknowns.unit,
        )

    def _motion(self, motion: Array) -> tuple[Array, ...]:
        """Take a flat reference apart: com, acceleration, rate of momentum, soles and their rotations."""
        xp, batch = namespace_of(motion), tuple(motion.shape[:-1])
        position = xp.reshape(motion[..., 15 : self._soles], (*batch, self._feet, 3))
        R = xp.reshape(motion[..., self._soles :], (*batch, self._feet, 3, 3))
        return motion[..., :3], motion[..., 3:6], motion[..., 6:9], position, R

    def total(
        self,
        mean: Array,
        block: Block,
        noise: Array,
        spare: Array | None = None,
        spare_std: Array | None = None,
    ) -> tuple[Rows, Array]:
        """Write what the motion asks of the ground, about the estimated centre of pressure.

        Args:
            mean: The unknowns as they are estimated, shape (..., N).
            block: The samples.
            noise: By how many times rows' variances are larger than stated, shape (..., kinds).
            spare: How forces of lost channels are made of the others', shape (..., K, K), or ``None``.
            spare_std: Standard deviation of such forces in N, 0 for the others, shape (..., K).

        Returns:
            (every / average) times ``kinds`` rows, and what a newton on each channel does to them, by the
            channel's own place, shape (..., m, K).
        """
        xp, config, unknowns = namespace_of(mean), self.config, self.unknowns
        force_map, torque_map, scale, base, cross, *_ = self._constants.like(mean)
        batch, n, settle, middle = tuple(mean.shape[:-1]), config.every, config.settle, self._middle
        force, use = block.force[..., middle, :], block.use[..., middle] * block.stand[..., middle]
        for shift in (-settle, -1, 1, settle):
            use = use * block.use[..., settle + shift : settle + shift + n]
        com, acceleration, rate, position, R = self._motion(block.motion[..., middle, :])
        ground = xp.min(position[..., 2], axis=-1)
        origin = xp.concat([com[..., :2], ground[..., None]], axis=-1)

        # Level wrenches about the point below the centre of mass, by channel, summed over the feet.
        f = R @ force_map
        skew = xp.reshape((position - origin[..., None, :]) @ cross, (*batch, n, self._feet, 3, 3))
        wrench = xp.concat([f, R @ torque_map + skew @ f], axis=-2)
        wrench = wrench[..., 0, :, :] if self._feet == 1 else wrench[..., 0, :, :] + wrench[..., 1, :, :]
        rows = places = wrench[..., self._seen, :] * scale[:, None]
        if spare is not None:
            rows = places @ spare[..., None, :, :]

        height = (com[..., 2] - ground) / self._length
        asked = self._asked(acceleration, rate, height)
        speed = rows * self._change(mean, block.force)[..., None, :]
        readings = force if unknowns.diagonal else force[..., unknowns.inp]
        gains = rows if unknowns.diagonal else rows[..., unknowns.out]
        late = xp.sum(speed, axis=-1, keepdims=True)
        unit = self._tare_constants.like(mean)[3]
        features = [gains * readings[..., None, :], rows * unit, late, asked[..., None], speed]
        if spare is not None:
            features.append(places)
        means, some = self._average(xp.concat(features, axis=-1), use)
        known = unknowns.gains + self._channels
        asked = means[..., known + 1]
        if self._distal.matter:
            lacking = self._distal.total(com, acceleration, position, R, origin)
            asked = asked - (lacking[..., self._seen] * scale)[..., None, :]

        height = xp.mean(xp.reshape(height, (*batch, self._groups, -1)), axis=-1)
        given = (means[..., :known] @ mean[..., None, :known, None])[..., 0]
        errors = self._error_columns(asked, given, height, means[..., known])
        H = xp.concat([means[..., :known], errors], axis=-1)
        shift = self._to_cop(given)
        H, y = shift @ H, (shift @ asked[..., None])[..., 0]
        variance = base * noise[..., None, :] + 0.0 * y
        jitter = shift @ means[..., known + 2 : known + 2 + self._channels]
        variance = variance + config.timing_noise**2 / config.average * xp.sum(jitter * jitter, axis=-1)
        places = H[..., unknowns.gains : known] / unit
        if spare is not None and spare_std is not None:
            places = shift @ means[..., known + 2 + self._channels :]
            unsure = places * spare_std[..., None, None, :]
            variance = variance + xp.sum(unsure * unsure, axis=-1)
        there = xp.astype(some, mean.dtype)[..., None] + 0.0 * y
        count = (*batch, self._groups * self.kinds)
        rows = Rows(xp.reshape(H, (*count, unknowns.size)), xp.reshape(y, count), xp.reshape(variance, count))
        return rows.keep(xp.reshape(there, count)), xp.reshape(places, (*count, self._channels))

    def readings(self, block: Block) -> Array:
        """Mean forces by the starting map that belong to each row of :meth:`total`, shape (..., m, K)."""
        xp = namespace_of(block.force)
        force, batch = block.force[..., self._middle, :], tuple(block.force.shape[:-2])
        force = xp.reshape(force, (*batch, self._groups, self.config.average, self._channels))
        force = xp.mean(force, axis=-2)[..., None, :]
        force = xp.concat([force] * self.kinds, axis=-2)
        return xp.reshape(force, (*batch, self._groups * self.kinds, self._channels))

    def _asked(self, acceleration: Array, rate: Array, height: Array) -> Array:
        """Write the right-hand sides: the wrench that the motion asks for, below the centre of mass."""
        xp = namespace_of(rate)
        specific, spin = acceleration / GRAVITY, rate / (self._weight * self._length)
        x, y = specific[..., 0], specific[..., 1]
        parts = [specific[..., 2] + 1.0, spin[..., 0] - height * y, spin[..., 1] + height * x]
        if self._six_axes:
            parts = [x, y, *parts, spin[..., 2]]
        return xp.stack(parts, axis=-1)

    def _change(self, mean: Array, force: Array) -> Array:
        """How fast the calibrated forces change in N/s, without what no reference could follow."""
        unit, settle = self._tare_constants.like(mean)[3], self.config.settle
        calibrated = self.unknowns.force(mean[..., None, :], force, unit)
        ahead, behind = calibrated[..., 2 * settle :, :], calibrated[..., : -2 * settle, :]
        return (ahead - behind) / (2 * settle * self._dt)

    def _average(self, features: Array, use: Array) -> tuple[Array, Array]:
        """Average over the samples of each group that may be used; and tell which groups have any."""
        xp, groups = namespace_of(features), self._groups
        batch, tail = tuple(use.shape[:-1]), tuple(features.shape[-2:])
        weight = xp.reshape(use, (*batch, groups, -1))
        count = xp.sum(weight, axis=-1)
        some = count > 0.5
        weight = weight / xp.where(some, count, 1.0)[..., None]
        flat = xp.reshape(features, (*batch, groups, self.config.average, tail[0] * tail[1]))
        return xp.reshape(weight[..., None, :] @ flat, (*batch, groups, *tail)), some

    def _to_cop(self, wrench: Array) -> Array:
        """Write the matrices that take moments to the centre of pressure of an estimated wrench."""
        xp = namespace_of(wrench)
        *_, shifts, identity = self._constants.like(wrench)
        load = wrench[..., self.vertical, None, None]
        load = xp.where(load > _LEAST_LOAD, load, _LEAST_LOAD)
        x = -wrench[..., self.vertical + 2, None, None] / load
        y = wrench[..., self.vertical + 1, None, None] / load
        return identity + x * shifts[0] + y * shifts[1]

    def _error_columns(self, asked: Array, given: Array, height: Array, late: Array) -> Array:
        """Write the columns of the reference's own errors, shape (..., groups, kinds, 7).

        That of the mass is the wrench that the feet give and not the one asked for: a column with the noise
        of the right-hand side in it would find a mass that explains the noise.
        """
        xp = namespace_of(asked)
        bias = self._constants.like(asked)[5]
        zero, fz = xp.zeros_like(height), asked[..., self.vertical]
        # A point that is off by d sees the moment d x f besides.
        com = [[zero, zero], [zero, fz], [-fz, zero]]
        if self._six_axes:
            com = [[zero, zero], [zero, zero], *com, [asked[..., 1], -asked[..., 0]]]
        com_columns = xp.stack([xp.stack(row, axis=-1) for row in com], axis=-2)
        acceleration = bias[0] + height[..., None, None] * bias[1]
        return xp.concat([com_columns, given[..., None], acceleration, late[..., None]], axis=-1)

    def hanging(self, block: Block) -> tuple[Array, Array]:
        """Average readings while feet surely hang, with ``settle`` samples to spare on either side.

        Returns:
            Samples of each foot that count, shape (..., F), and the mean reading of each channel over its
            foot's, shape (..., K).
        """
        xp, settle, every = namespace_of(block.force), self.config.settle, self.config.every
        by_channel = self._tare_constants.like(block.force)[0]
        sure = block.swing[..., :every, :]
        for shift in range(1, 2 * settle + 1):
            sure = sure * block.swing[..., shift : shift + every, :]
        sure = sure * block.use[..., self._middle][..., None]
        count = xp.sum(sure, axis=-2)
        total = xp.sum((sure @ by_channel) * block.force[..., self._middle, :], axis=-2)
        number = count @ by_channel
        return count, total / xp.where(number > 0.5, number, 1.0)

    def load(self, reading: Array, spare: Array | None = None) -> Array:
        """Write the vertical force of each foot for a mean reading, about a level sole.

        Returns:
            Columns of the gains and offsets, in body weights, shape (..., F, P + K).
        """
        xp, unknowns = namespace_of(reading), self.unknowns
        up, unit = self._constants.like(reading)[0][:, 2, :], self._tare_constants.like(reading)[3]
        if spare is not None:
            up = up @ spare
        readings = reading if unknowns.diagonal else reading[..., unknowns.inp]
        gains = (up if unknowns.diagonal else up[..., unknowns.out]) * readings[..., None, :]
        return xp.concat([gains, up * unit + 0.0 * gains[..., :1]], axis=-1) / self._weight

    def tare(self, block: Block, count: Array, reading: Array) -> Rows:
        """Write that feet in the air read nothing but what is beyond their sensors.

        Args:
            block: The samples.
            count: Samples of each foot that count, shape (..., F).
            reading: Mean reading of each channel over them, shape (..., K).

        Returns:
            One row a channel.
        """
        xp, unknowns = namespace_of(reading), self.unknowns
        by_channel, gather, offsets, unit = self._tare_constants.like(reading)
        number = count @ by_channel
        readings = reading if unknowns.diagonal else reading[..., unknowns.inp]
        gains = gather * readings[..., None, :]
        rest = xp.zeros_like(offsets[:, unknowns.gains :]) + 0.0 * gains[..., :1]
        H = xp.concat([gains, rest], axis=-1) + offsets
        y = 0.0 * reading
        if self._distal.matter:
            com, acceleration, _, position, R = self._motion(block.motion)
            y = self._distal.felt(com, acceleration, position, R) / unit
        few = xp.where(number > 1.0, number, 1.0)
        variance = self.config.swing_noise**2 * _SWING_SAMPLES / few
        return Rows(H, y, variance).keep(xp.astype(number > 0.5, reading.dtype))

    def parity(self, block: Block) -> Rows:
        """Write that the instruments of one foot tell the same wrench.

        Args:
            block: The samples.

        Returns:
            For each axis that two instruments of a foot see, one row for each half of the block.
        """
        xp, unknowns, settle = namespace_of(block.force), self.unknowns, self.config.settle
        parity, tail = self._parity_constants.like(block.force)
        half = self.config.every // 2
        y = 0.0 * (block.force[..., 0, :] @ parity.mT)
        if self._distal.matter:
            com, acceleration, _, position, R = self._motion(block.motion)
            y = self._distal.felt(com, acceleration, position, R) @ parity.mT
        parts = []
        for start in (settle, settle + half):
            part = slice(start, start + half)
            reading = xp.mean(block.force[..., part, :], axis=-2)
            readings = reading if unknowns.diagonal else reading[..., unknowns.inp]
            gains = (parity if unknowns.diagonal else parity[..., unknowns.out]) * readings[..., None, :]
            H = xp.concat([gains, tail + 0.0 * gains[..., :1]], axis=-1)
            known = xp.astype(xp.all(block.use[..., part] > 0.5, axis=-1), gains.dtype)[..., None]
            variance = self.config.parity_noise**2 + 0.0 * y
            parts.append(Rows(H, y, variance).keep(known))
        return parts[0].beside(parts[1])


_SWING_SAMPLES = 16.0
"""Samples that ``swing_noise`` is stated for."""

_CROSS: NDArray[np.float64] = np.zeros((3, 9))
"""Takes a vector v to the flat matrix of v x."""
_CROSS[0, 5], _CROSS[0, 7] = -1.0, 1.0
_CROSS[1, 2], _CROSS[1, 6] = 1.0, -1.0
_CROSS[2, 1], _CROSS[2, 3] = -1.0, 1.0


def _parity(layout: FeetLayout) -> NDArray[np.float64]:
    """What each further instrument of a foot tells less what the first does, shape (pairs, 6, K)."""
    pairs = []
    for foot, where in zip(layout.feet, layout.slices, strict=True):
        first, *others = foot.sensors
        for other in others:
            both = (first.wrench_map != 0.0).any(axis=1) & (other.wrench_map != 0.0).any(axis=1)
            difference = np.zeros((6, layout.channels))
            for sensor, sign in ((first, -1.0), (other, 1.0)):
                columns = np.arange(where.start, where.stop)[sensor.channels]
                difference[:, columns] = sign * sensor.wrench_map * both[:, None]
            pairs.append(difference)
    return np.array(pairs).reshape(-1, 6, layout.channels)


def _acceleration_columns(seen: list[int]) -> NDArray[np.float64]:
    """Columns of a biased acceleration: as forces, and per height of the centre of mass as moments."""
    full = np.zeros((2, 6, 3))
    full[0, :3] = np.eye(3)
    full[1, 3, 1], full[1, 4, 0] = -1.0, 1.0
    return full[:, seen]


def _shifts(seen: list[int]) -> NDArray[np.float64]:
    """Matrices that take moments to a point ahead by one, and to the left by one: t - d x f."""
    full = np.zeros((2, 6, 6))
    full[0, 4, 2], full[0, 5, 1] = 1.0, -1.0
    full[1, 3, 2], full[1, 5, 0] = -1.0, 1.0
    return full[np.ix_([0, 1], seen, seen)]
