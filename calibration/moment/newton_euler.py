"""The rows of Newton and Euler: what the whole robot's motion asks of the ground (CoP paper, Eqs. 6, 7)."""

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array, in_a_row
from surefoot.calibration.front_end.motion import MotionColumns
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.distal import DistalMasses
from surefoot.calibration.moment.rows import Block, Rows
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.setup import OnlineSetup

_LEAST_LOAD = 0.1
"""Load in body weights that a centre of pressure is computed with at least, for moments to be taken about."""

PASSES = 4
"""How often a window of three samples is laid over forces at most, to average them as the reference does."""

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
        self._passes = min(PASSES, config.settle)
        # A row helps only if every foot sees it.
        wrench_map = layout.wrench_map
        self._six_axes = bool((wrench_map != 0.0).any(axis=2).all())
        self._seen = list(range(6)) if self._six_axes else [_FZ, _MX, _MY]
        self.kinds, self.vertical = len(self._seen), self._seen.index(_FZ)
        self._moment_x, self._moment_y = self._seen.index(_MX), self._seen.index(_MY)
        noise = np.repeat([config.force_noise, config.cop_noise / setup.length], 3)[self._seen]
        self._scale = np.repeat([1.0 / setup.weight, 1.0 / (setup.weight * setup.length)], 3)[self._seen]
        self._distal = DistalMasses(layout, setup.dt, config.every, config.span)
        self._side = np.where(layout.foot_of_channel[unknowns.out] == 0, 1.0, -1.0) * (self._feet > 1)
        self._shift_x, self._shift_y = _shifts(self._seen)
        self._bias_force, self._bias_moment = _acceleration_columns(self._seen)
        self._force_map = wrench_map[:, :3]
        self._torque_map = wrench_map[:, 3:]
        self._variance = noise**2 / config.average
        self._identity = np.eye(self.kinds)

    def rows(
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
            noise: By how many times rows' variances are larger than assumed, shape (..., kinds).
            spare: How forces of lost channels are made of the others', shape (..., K, K), or ``None``.
            spare_std: Standard deviation of such forces in N, 0 for the others, shape (..., K).

        Returns:
            (every / average) times ``kinds`` rows, and what a newton on each channel does to them, by the
            channel's own place, shape (..., m, K).
        """
        config, unknowns, K = self.config, self.unknowns, self._channels
        batch, n, settle, middle = mean.shape[:-1], config.every, config.settle, config.middle
        blur = np.clip(mean[..., unknowns.blur], 0.0, 0.5 * self._passes)
        force, blurred = self._blurred(block.force, blur)
        use = block.stand[..., middle]
        for first in range(2 * settle + 1):
            use = use * block.use[..., first : first + n]
        motion = block.motion[..., middle, :]
        com, acceleration = motion[..., self._motion.com], motion[..., self._motion.com_acceleration]
        rate = motion[..., self._motion.angular_momentum_rate]
        position, R = self._motion.soles(motion)
        ground = position[..., 2].min(axis=-1)
        origin = np.concatenate([com[..., :2], ground[..., None]], axis=-1)

        # Level wrenches about the point below the centre of mass, by channel, summed over the feet.
        f = R @ self._force_map
        skew = ((position - origin[..., None, :]) @ _CROSS).reshape(*batch, n, self._feet, 3, 3)
        wrench = np.concatenate([f, R @ self._torque_map + skew @ f], axis=-2)
        wrench = wrench[..., 0, :, :] if self._feet == 1 else wrench[..., 0, :, :] + wrench[..., 1, :, :]
        rows = places = wrench[..., self._seen, :] * self._scale[:, None]
        if spare is not None:
            rows = places @ spare[..., None, :, :]

        height = (com[..., 2] - ground) / self._length
        asked = self._asked(acceleration, rate, height)
        speed = rows * self._change(mean, block.force)[..., None, :]
        late = speed.sum(axis=-1, keepdims=True)
        tared = unknowns.tared(mean[..., None, :], force)
        of_blur = rows @ unknowns.scaled(mean[..., None, :], blurred)[..., None]
        features = [unknowns.by_scale(rows, tared), rows, late, of_blur, asked[..., None], speed]
        if spare is not None:
            features.append(places)
        means, some = self._average(np.concatenate(features, axis=-1), use)
        of_scale, of_rows, of_delay, blur_at, of_motion, of_speed, of_places = in_a_row(
            unknowns.scales, K, 1, 1, 1, K, K
        )
        by_scale, of_blur, asked = means[..., of_scale], means[..., blur_at], means[..., of_motion][..., 0]
        by_offset = unknowns.by_offset(means[..., of_rows], mean[..., None, :])
        if self._distal.matter:
            lacking = self._distal.total(motion, origin)
            asked = asked - (lacking[..., self._seen] * self._scale)[..., None, :]

        height = height.reshape(*batch, self._groups, -1).mean(axis=-1)
        given = (by_scale @ mean[..., None, unknowns.scale, None])[..., 0]
        apart = (by_scale @ (mean[..., unknowns.scale] * self._side)[..., None, :, None])[..., 0]
        errors, vertical = self._error_columns(given, apart, height, means[..., of_delay])
        # The forces are products of scales and tared readings: H x counts what the offsets do twice.
        asked = asked + (by_offset @ mean[..., None, unknowns.offset, None])[..., 0]
        asked = asked + of_blur[..., 0] * blur[..., None, None]
        to_cop = self._to_cop(given)
        H = to_cop @ np.concatenate([by_scale, by_offset, errors, of_blur], axis=-1)
        H = np.concatenate([H[..., : unknowns.delay - 1], vertical, H[..., unknowns.delay - 1 :]], axis=-1)
        y = (to_cop @ asked[..., None])[..., 0]
        variance = self._variance * noise[..., None, :] + 0.0 * y
        jitter = to_cop @ means[..., of_speed]
        variance = variance + config.timing_noise**2 / config.average * (jitter * jitter).sum(axis=-1)
        places = to_cop @ means[..., of_rows if spare is None else of_places]
        if spare is not None and spare_std is not None:
            unsure = places * spare_std[..., None, None, :]
            variance = variance + (unsure * unsure).sum(axis=-1)
        there = some[..., None] + 0.0 * y
        count = (*batch, self._groups * self.kinds)
        written = Rows(H.reshape(*count, unknowns.size), y.reshape(count), variance.reshape(count))
        return written.keep(there.reshape(count)), places.reshape(*count, K)

    def readings(self, block: Block) -> Array:
        """Return the mean forces by the starting map that belong to each row of :meth:`rows`, (..., m, K)."""
        force, batch = block.force[..., self.config.middle, :], block.force.shape[:-2]
        force = force.reshape(*batch, self._groups, self.config.average, self._channels)
        force = force.mean(axis=-2)[..., None, :]
        force = np.concatenate([force] * self.kinds, axis=-2)
        return force.reshape(*batch, self._groups * self.kinds, self._channels)

    def _asked(self, acceleration: Array, rate: Array, height: Array) -> Array:
        """Return the right-hand sides: the wrench that the motion asks for, below the centre of mass."""
        specific, spin = acceleration / GRAVITY, rate / (self._weight * self._length)
        x, y = specific[..., 0], specific[..., 1]
        parts = [specific[..., 2] + 1.0, spin[..., 0] - height * y, spin[..., 1] + height * x]
        if self._six_axes:
            parts = [x, y, *parts, spin[..., 2]]
        return np.stack(parts, axis=-1)

    def _change(self, mean: Array, force: Array) -> Array:
        """Return how fast the calibrated forces change in N/s, without what no reference could follow."""
        settle = self.config.settle
        calibrated = self.unknowns.force(mean[..., None, :], force)
        ahead, behind = calibrated[..., 2 * settle :, :], calibrated[..., : -2 * settle, :]
        return (ahead - behind) / (2 * settle * self._dt)

    def _blurred(self, force: Array, blur: Array) -> tuple[Array, Array]:
        """Average forces as the reference averages its rates.

        Args:
            force: Forces of a block, shape (..., span, K).
            blur: Variance of the window in squared samples, up to half the number of passes, shape (...).

        Returns:
            Forces of the block's middle, and what they change with that variance, shape (..., every, K) each.
        """
        weight = blur[..., None, None] / (2 * self._passes)
        margin = self.config.settle - self._passes
        force = force[..., margin : force.shape[-2] - margin, :]
        for _ in range(self._passes):
            before, force = force, force[..., 1:-1, :]
            bend = before[..., 2:, :] - 2.0 * force + before[..., :-2, :]
            force = force + weight * bend
        return force, 0.5 * bend

    def _average(self, features: Array, use: Array) -> tuple[Array, Array]:
        """Return means over the samples of each group that may be used, and which groups have any."""
        groups = self._groups
        batch, tail = use.shape[:-1], features.shape[-2:]
        weight = use.reshape(*batch, groups, -1)
        count = weight.sum(axis=-1)
        some = count > 0.5
        weight = weight / np.where(some, count, 1.0)[..., None]
        flat = features.reshape(*batch, groups, self.config.average, tail[0] * tail[1])
        return (weight[..., None, :] @ flat).reshape(*batch, groups, *tail), some

    def _to_cop(self, wrench: Array) -> Array:
        """Return matrices that take moments to the centre of pressure of an estimated wrench."""
        load = wrench[..., self.vertical, None, None]
        load = np.where(load > _LEAST_LOAD, load, _LEAST_LOAD)
        x = -wrench[..., self._moment_y, None, None] / load
        y = wrench[..., self._moment_x, None, None] / load
        return self._identity + x * self._shift_x + y * self._shift_y

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
        acceleration = self._bias_force + height[..., None, None] * self._bias_moment
        level, vertical = acceleration[..., :2], acceleration[..., 2:]
        errors = [self._moved(given), given[..., None], level, late, self._moved(apart)]
        return np.concatenate(errors, axis=-1), vertical

    def _moved(self, wrench: Array) -> Array:
        """Return the moments d x f that a point off by d sees besides, by d, shape (..., kinds, 2)."""
        fz = wrench[..., self.vertical]
        zero = np.zeros_like(fz)
        rows = [[zero, zero], [zero, fz], [-fz, zero]]
        if self._six_axes:
            rows = [[zero, zero], [zero, zero], *rows, [wrench[..., _FY], -wrench[..., _FX]]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


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
