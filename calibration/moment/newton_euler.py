"""The rows of Newton and Euler: what the whole robot's motion asks of the ground (CoP paper, Eqs. 6, 7)."""

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array, Constants, in_a_row, namespace_of
from surefoot.calibration.front_end.motion import MotionColumns
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.distal import DistalMasses
from surefoot.calibration.moment.rows import Block, Rows
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.setup import OnlineSetup

_LEAST_LOAD = 0.1
"""Load in body weights that a centre of pressure is computed with at least, for moments to be taken about."""

_FX, _FY, _FZ, _MX, _MY, _MZ = range(6)


class NewtonEuler:
    """Writes the rows of one setup.

    Args:
        setup: The robot.
        config: Options of the filter.
        unknowns: The unknowns.

    Attributes:
        kinds: Rows of one group of samples: 3 for (Fz, Mx, My), or all 6.
        vertical: Which of them is the vertical force.
    """

    def __init__(self, setup: OnlineSetup, config: MomentFilterConfig, unknowns: Unknowns) -> None:
        layout = setup.layout
        self.unknowns, self.config = unknowns, config
        self._feet, self._channels = len(layout.feet), layout.channels
        self._motion = MotionColumns.of(self._feet)
        self._weight, self._length, self._dt = setup.weight, setup.length, setup.dt
        self._groups = config.every // config.average
        # A row helps only if every foot sees it.
        wrench_map = layout.wrench_map
        self._six_axes = bool((wrench_map != 0.0).any(axis=2).all())
        self._seen = list(range(6)) if self._six_axes else [_FZ, _MX, _MY]
        self.kinds, self.vertical = len(self._seen), self._seen.index(_FZ)
        self._moment_x, self._moment_y = self._seen.index(_MX), self._seen.index(_MY)
        noise = np.repeat([config.force_noise, config.cop_noise / setup.length], 3)[self._seen]
        scale = np.repeat([1.0 / setup.weight, 1.0 / (setup.weight * setup.length)], 3)[self._seen]
        self._distal = DistalMasses(layout, setup.dt, config.every, config.span)
        side = np.where(layout.foot_of_channel[unknowns.out] == 0, 1.0, -1.0) * (self._feet > 1)
        shift_x, shift_y = _shifts(self._seen)
        bias_force, bias_moment = _acceleration_columns(self._seen)
        self._constants = Constants(
            force_map=wrench_map[:, :3],
            torque_map=wrench_map[:, 3:],
            scale=scale,
            variance=noise**2 / config.average,
            cross=_CROSS,
            bias_force=bias_force,
            bias_moment=bias_moment,
            shift_x=shift_x,
            shift_y=shift_y,
            identity=np.eye(self.kinds),
            unit=unknowns.unit,
            side=side,
        )

    def rows(
        self,
        mean: Array,
        block: Block,
        noise: Array,
        spare: Array | None = None,
        spare_std: Array | None = None,
        loaded: Array | None = None,
    ) -> tuple[Rows, Array]:
        """Write what the motion asks of the ground, about the estimated centre of pressure.

        Args:
            mean: The unknowns as they are estimated, shape (..., N).
            block: The samples.
            noise: By how many times rows' variances are larger than assumed, shape (..., kinds).
            spare: How forces of lost channels are made of the others', shape (..., K, K), or ``None``.
            spare_std: Standard deviation of such forces in N, 0 for the others, shape (..., K).
            loaded: Which robots carry a load (bool), shape (...), or ``None`` for none: they shake, and their
                columns hold no ripple, which would meet itself in the residuals.

        Returns:
            (every / average) times ``kinds`` rows, and what a newton on each channel does to them, by the
            channel's own place, shape (..., m, K).
        """
        xp, config, unknowns, K = namespace_of(mean), self.config, self.unknowns, self._channels
        own = self._constants.like(mean)
        batch, n, settle, middle = tuple(mean.shape[:-1]), config.every, config.settle, config.middle
        force, use = block.force[..., middle, :], block.use[..., middle] * block.stand[..., middle]
        for shift in (-settle, -1, 1, settle):
            use = use * block.use[..., settle + shift : settle + shift + n]
        motion = block.motion[..., middle, :]
        com, acceleration = motion[..., self._motion.com], motion[..., self._motion.com_acceleration]
        rate = motion[..., self._motion.angular_momentum_rate]
        position, R = self._motion.soles(motion)
        ground = xp.min(position[..., 2], axis=-1)
        origin = xp.concat([com[..., :2], ground[..., None]], axis=-1)

        # Level wrenches about the point below the centre of mass, by channel, summed over the feet.
        f = R @ own.force_map
        skew = xp.reshape((position - origin[..., None, :]) @ own.cross, (*batch, n, self._feet, 3, 3))
        wrench = xp.concat([f, R @ own.torque_map + skew @ f], axis=-2)
        wrench = wrench[..., 0, :, :] if self._feet == 1 else wrench[..., 0, :, :] + wrench[..., 1, :, :]
        rows = places = wrench[..., self._seen, :] * own.scale[:, None]
        if spare is not None:
            rows = places @ spare[..., None, :, :]

        height = (com[..., 2] - ground) / self._length
        asked = self._asked(acceleration, rate, height)
        if loaded is not None:
            smooth = xp.where(loaded[..., None, None], self._smooth(block.force), force)
            ripple = unknowns.scaled(mean[..., None, :], force - smooth)
            asked, force = asked - (rows @ ripple[..., None])[..., 0], smooth
        speed = rows * self._change(mean, block.force)[..., None, :]
        late = xp.sum(speed, axis=-1, keepdims=True)
        tared = unknowns.tared(mean[..., None, :], force, own.unit)
        features = [unknowns.by_scale(rows, tared), rows, late, asked[..., None], speed]
        if spare is not None:
            features.append(places)
        means, some = self._average(xp.concat(features, axis=-1), use)
        of_scale, of_rows, of_delay, of_motion, of_speed, of_places = in_a_row(unknowns.scales, K, 1, 1, K, K)
        by_scale, asked = means[..., of_scale], means[..., of_motion][..., 0]
        by_offset = unknowns.by_offset(means[..., of_rows], mean[..., None, :], own.unit)
        if self._distal.matter:
            lacking = self._distal.total(motion, origin)
            asked = asked - (lacking[..., self._seen] * own.scale)[..., None, :]

        height = xp.mean(xp.reshape(height, (*batch, self._groups, -1)), axis=-1)
        given = (by_scale @ mean[..., None, unknowns.scale, None])[..., 0]
        apart = (by_scale @ (mean[..., unknowns.scale] * own.side)[..., None, :, None])[..., 0]
        errors, vertical = self._error_columns(given, apart, height, means[..., of_delay])
        # The forces are products of scales and tared readings: H x counts what the offsets do twice.
        asked = asked + (by_offset @ mean[..., None, unknowns.offset, None])[..., 0]
        to_cop = self._to_cop(given)
        H = to_cop @ xp.concat([by_scale, by_offset, errors], axis=-1)
        H = xp.concat([H[..., : unknowns.delay - 1], vertical, H[..., unknowns.delay - 1 :]], axis=-1)
        y = (to_cop @ asked[..., None])[..., 0]
        variance = own.variance * noise[..., None, :] + 0.0 * y
        jitter = to_cop @ means[..., of_speed]
        variance = variance + config.timing_noise**2 / config.average * xp.sum(jitter * jitter, axis=-1)
        places = to_cop @ means[..., of_rows if spare is None else of_places]
        if spare is not None and spare_std is not None:
            unsure = places * spare_std[..., None, None, :]
            variance = variance + xp.sum(unsure * unsure, axis=-1)
        there = xp.astype(some, mean.dtype)[..., None] + 0.0 * y
        count = (*batch, self._groups * self.kinds)
        written = Rows(
            xp.reshape(H, (*count, unknowns.size)), xp.reshape(y, count), xp.reshape(variance, count)
        )
        return written.keep(xp.reshape(there, count)), xp.reshape(places, (*count, K))

    def readings(self, block: Block) -> Array:
        """Return the mean forces by the starting map that belong to each row of :meth:`rows`, (..., m, K)."""
        xp = namespace_of(block.force)
        force, batch = block.force[..., self.config.middle, :], tuple(block.force.shape[:-2])
        force = xp.reshape(force, (*batch, self._groups, self.config.average, self._channels))
        force = xp.mean(force, axis=-2)[..., None, :]
        force = xp.concat([force] * self.kinds, axis=-2)
        return xp.reshape(force, (*batch, self._groups * self.kinds, self._channels))

    def _asked(self, acceleration: Array, rate: Array, height: Array) -> Array:
        """Return the right-hand sides: the wrench that the motion asks for, below the centre of mass."""
        xp = namespace_of(rate)
        specific, spin = acceleration / GRAVITY, rate / (self._weight * self._length)
        x, y = specific[..., 0], specific[..., 1]
        parts = [specific[..., 2] + 1.0, spin[..., 0] - height * y, spin[..., 1] + height * x]
        if self._six_axes:
            parts = [x, y, *parts, spin[..., 2]]
        return xp.stack(parts, axis=-1)

    def _change(self, mean: Array, force: Array) -> Array:
        """Return how fast the calibrated forces change in N/s, without what no reference could follow."""
        unit, settle = self._constants.like(mean).unit, self.config.settle
        calibrated = self.unknowns.force(mean[..., None, :], force, unit)
        ahead, behind = calibrated[..., 2 * settle :, :], calibrated[..., : -2 * settle, :]
        return (ahead - behind) / (2 * settle * self._dt)

    def _smooth(self, force: Array) -> Array:
        """Return the means of forces over as many samples to either side as half of ``settle``."""
        first, near = self.config.settle, self.config.settle // 2
        shifts = range(first - near, first + near + 1)
        smooth = sum(force[..., shift : shift + self.config.every, :] for shift in shifts)
        return smooth / len(shifts)

    def _average(self, features: Array, use: Array) -> tuple[Array, Array]:
        """Return means over the samples of each group that may be used, and which groups have any."""
        xp, groups = namespace_of(features), self._groups
        batch, tail = tuple(use.shape[:-1]), tuple(features.shape[-2:])
        weight = xp.reshape(use, (*batch, groups, -1))
        count = xp.sum(weight, axis=-1)
        some = count > 0.5
        weight = weight / xp.where(some, count, 1.0)[..., None]
        flat = xp.reshape(features, (*batch, groups, self.config.average, tail[0] * tail[1]))
        return xp.reshape(weight[..., None, :] @ flat, (*batch, groups, *tail)), some

    def _to_cop(self, wrench: Array) -> Array:
        """Return matrices that take moments to the centre of pressure of an estimated wrench."""
        xp, own = namespace_of(wrench), self._constants.like(wrench)
        load = wrench[..., self.vertical, None, None]
        load = xp.where(load > _LEAST_LOAD, load, _LEAST_LOAD)
        x = -wrench[..., self._moment_y, None, None] / load
        y = wrench[..., self._moment_x, None, None] / load
        return own.identity + x * own.shift_x + y * own.shift_y

    def _error_columns(self, given: Array, apart: Array, height: Array, late: Array) -> tuple[Array, Array]:
        """Return the columns of the reference's own errors, without and with that of the vertical bias alone.

        A column with the noise of the right-hand side in it would find what explains the noise. So those of
        the mass and of the centre of mass hold the wrench that the feet give and not the one asked for; and
        that of the vertical bias is not to be moved to the centre of pressure: the way there has the noise of
        the believed centre of mass in it, and changes the column by less than a tenth of a millimetre.

        Returns:
            Centre of mass, mass, forward and sideward bias, delay and soles, shape (..., groups, kinds, 8);
            and the vertical bias, shape (..., groups, kinds, 1).
        """
        xp, own = namespace_of(given), self._constants.like(given)
        acceleration = own.bias_force + height[..., None, None] * own.bias_moment
        level, vertical = acceleration[..., :2], acceleration[..., 2:]
        errors = [self._moved(given), given[..., None], level, late, self._moved(apart)]
        return xp.concat(errors, axis=-1), vertical

    def _moved(self, wrench: Array) -> Array:
        """Return the moments d x f that a point off by d sees besides, by d, shape (..., kinds, 2)."""
        xp, fz = namespace_of(wrench), wrench[..., self.vertical]
        zero = xp.zeros_like(fz)
        rows = [[zero, zero], [zero, fz], [-fz, zero]]
        if self._six_axes:
            rows = [[zero, zero], [zero, zero], *rows, [wrench[..., _FY], -wrench[..., _FX]]]
        return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


_CROSS: NDArray[np.float64] = np.zeros((3, 9))
"""Takes a vector v to the flat matrix of v x."""
_CROSS[0, 5], _CROSS[0, 7] = -1.0, 1.0
_CROSS[1, 2], _CROSS[1, 6] = 1.0, -1.0
_CROSS[2, 1], _CROSS[2, 3] = -1.0, 1.0


def _acceleration_columns(seen: list[int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the columns of a biased acceleration: as forces, and as moments per height."""
    force, moment = np.zeros((2, 6, 3))
    force[:_MX] = np.eye(3)
    moment[_MX, 1], moment[_MY, 0] = -1.0, 1.0
    return force[seen], moment[seen]


def _shifts(seen: list[int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what takes moments to a point ahead by one, and to the left by one: t - d x f."""
    ahead, left = np.zeros((2, 6, 6))
    ahead[_MY, _FZ], ahead[_MZ, _FY] = 1.0, -1.0
    left[_MX, _FZ], left[_MZ, _FX] = -1.0, 1.0
    return ahead[np.ix_(seen, seen)], left[np.ix_(seen, seen)]
