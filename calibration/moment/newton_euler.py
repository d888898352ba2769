"""The rows of Newton and Euler: what the whole robot's motion asks of the ground (CoP paper, Eqs. 6, 7)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array, in_a_row
from surefoot.calibration.front_end.motion import MotionColumns
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.distal import DistalMasses
from surefoot.calibration.moment.rows import Block, Rows
from surefoot.calibration.moment.unknowns import Unknowns
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
        self._gravity = setup.gravity
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
        self._distal = DistalMasses(layout, setup.gravity, setup.dt, config.every, config.span)
        self._side = np.where(layout.foot_of_channel[unknowns.out] == 0, 1.0, -1.0) * (self._feet > 1)
        self._shift_x, self._shift_y = _shifts(self._seen)
        self._bias_force, self._bias_moment = _acceleration_columns(self._seen)
        self._force_map = wrench_map[:, :3]
        self._torque_map = wrench_map[:, 3:]
        self._variance = noise**2 / config.average

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
            mean: The unknowns as they are estimated, shape (N,).
            block: The samples.
            noise: By how many times rows' variances are larger than assumed, shape (kinds,).
            spare: How forces of lost channels are made of the others', shape (K, K), or ``None``.
            spare_std: Standard deviation of such forces in N, 0 for the others, shape (K,).

        Returns:
            (every / average) times ``kinds`` rows, and what a newton on each channel does to them, by the
            channel's own place, shape (m, K).
        """
        config, unknowns = self.config, self.unknowns
        motion = block.motion[config.middle]
        com, acceleration = motion[:, self._motion.com], motion[:, self._motion.com_acceleration]
        rate = motion[:, self._motion.angular_momentum_rate]
        position, R = self._motion.soles(motion)
        ground = position[:, :, 2].min(axis=1)
        origin, height = np.column_stack([com[:, :2], ground]), (com[:, 2] - ground) / self._length

        # Of every sample: level wrenches about the point below the centre of mass, by channel, both feet's.
        f = R @ self._force_map
        arm = (position - origin[:, None])[..., None]
        wrench = np.concatenate([f, R @ self._torque_map + np.cross(arm, f, axis=2)], axis=2).sum(axis=1)
        places = wrench[:, self._seen] * self._scale[:, None]
        rows = places if spare is None else places @ spare
        blur = float(np.clip(mean[unknowns.blur], 0.0, 0.5 * self._passes))
        force, bend = self._blurred(block.force, blur)
        tared = unknowns.tared(mean, force)
        speed = rows * self._change(mean, block.force)[:, None]
        features = [
            rows[:, :, unknowns.out] * tared[:, None, unknowns.inp],
            rows,
            speed.sum(axis=2, keepdims=True),
            rows @ unknowns.scaled(mean, bend)[:, :, None],
            self._asked(acceleration, rate, height)[:, :, None],
            speed,
            places,
        ]
        lacking = np.zeros(self.kinds)
        if self._distal.matter:
            lacking = self._distal.total(motion, origin)[self._seen] * self._scale
        written, by_place = [], []
        groups = self._average(np.concatenate(features, axis=2), height, self._used(block))
        for means, high, any_used in zip(*groups, strict=True):
            group, own = self._group(mean, means, high, blur, lacking)
            variance = self._variance * noise + group.variance
            if spare_std is not None:
                variance = variance + ((own * spare_std) ** 2).sum(axis=1)
            group = group._replace(variance=variance)
            written.append(group if any_used else group.none())
            by_place.append(own)
        return Rows(*(np.concatenate(part) for part in zip(*written, strict=True))), np.concatenate(by_place)

    def _group(
        self, mean: Array, means: Array, height: float, blur: float, lacking: Array
    ) -> tuple[Rows, Array]:
        """Write the rows of one group of samples.

        Args:
            mean: The unknowns, shape (N,).
            means: What its samples have on the average, shape (kinds, features); see :class:`_Columns`.
            height: Mean height of the centre of mass in foot lengths.
            blur: Variance of the window that forces were averaged with.
            lacking: What the feet's wrenches lack of the ground's, shape (kinds,).

        Returns:
            The rows, with the variance that times of reading alone make, and what a newton on each channel
            does to them, shape (kinds, K).
        """
        unknowns, K, config = self.unknowns, self._channels, self.config
        of = _Columns(*in_a_row(unknowns.scales, K, 1, 1, 1, K, K))
        by_scale, by_offset = means[:, of.scale], unknowns.by_offset(means[:, of.channel], mean)
        given = by_scale @ mean[unknowns.scale]
        apart = by_scale @ (mean[unknowns.scale] * self._side)
        # In the order of the unknowns: scales, offsets, com, mass, acceleration, delay, sole, blur.
        columns = np.hstack(
            [
                by_scale,
                by_offset,
                self._moved(given),
                given[:, None],
                self._bias_force + height * self._bias_moment,
                means[:, of.delay],
                self._moved(apart),
                means[:, of.blur],
            ]
        )
        # The forces are products of scales and tared readings: H x counts what the offsets do twice.
        asked = means[:, of.asked.start] - lacking + by_offset @ mean[unknowns.offset]
        asked = asked + means[:, of.blur.start] * blur
        to_cop = self._to_cop(given)
        H = to_cop @ columns
        # The way to the centre of pressure has the noise of the believed centre of mass in it, and would
        # change this column by less than a tenth of a millimetre.
        vertical_bias = unknowns.acceleration.stop - 1
        H[:, vertical_bias] = columns[:, vertical_bias]
        jitter = to_cop @ means[:, of.speed]
        late = config.timing_noise**2 / config.average * (jitter * jitter).sum(axis=1)
        return Rows(H, to_cop @ asked, late), to_cop @ means[:, of.place]

    def readings(self, block: Block) -> Array:
        """Return the mean forces by the starting map that belong to each row of :meth:`rows`, (m, K)."""
        force = block.force[self.config.middle].reshape(self._groups, self.config.average, self._channels)
        return force.mean(axis=1).repeat(self.kinds, axis=0)

    def _used(self, block: Block) -> Array:
        """Return samples of the block's middle that can be learnt from (bool), shape (every,).

        All within ``settle`` of them must be good, and a foot must stand.
        """
        every, settle = self.config.every, self.config.settle
        near = [block.use[first : first + every] > 0.5 for first in range(2 * settle + 1)]
        return np.all(near, axis=0) & (block.stand[self.config.middle] > 0.5)

    def _asked(self, acceleration: Array, rate: Array, height: Array) -> Array:
        """Return the right-hand sides: the wrench that the motion asks for, below the centre of mass."""
        (x, y, z), spin = acceleration.T / self._gravity, rate.T / (self._weight * self._length)
        wrench = [x, y, z + 1.0, spin[0] - height * y, spin[1] + height * x, spin[2]]
        return np.column_stack([wrench[row] for row in self._seen])

    def _change(self, mean: Array, force: Array) -> Array:
        """Return how fast the calibrated forces change in N/s, without what no reference could follow."""
        settle = self.config.settle
        calibrated = self.unknowns.force(mean, force)
        return (calibrated[2 * settle :] - calibrated[: -2 * settle]) / (2 * settle * self._dt)

    def _blurred(self, force: Array, blur: float) -> tuple[Array, Array]:
        """Average forces as the reference averages its rates.

        Args:
            force: Forces of a block, shape (span, K).
            blur: Variance of the window in squared samples, up to half the number of passes.

        Returns:
            Forces of the block's middle, and what they change with that variance, shape (every, K) each.
        """
        margin = self.config.settle - self._passes
        force = force[margin : len(force) - margin]
        for _ in range(self._passes):
            bend = force[2:] - 2.0 * force[1:-1] + force[:-2]
            force = force[1:-1] + blur / (2 * self._passes) * bend
        return force, 0.5 * bend

    def _average(self, features: Array, height: Array, used: Array) -> tuple[Array, Array, Array]:
        """Return means of features over the samples of each group that may be used, and of all heights.

        And whether there are any such samples, shape (groups,).
        """
        weight = used.reshape(self._groups, -1).astype(np.float64)
        count = weight.sum(axis=1)
        weight = weight / np.maximum(count, 1.0)[:, None]
        by_group = features.reshape(self._groups, self.config.average, *features.shape[1:])
        means = np.einsum("gs,gskw->gkw", weight, by_group)
        return means, height.reshape(self._groups, -1).mean(axis=1), count > 0.5

    def _to_cop(self, wrench: Array) -> Array:
        """Return the matrix that takes moments to the centre of pressure of an estimated wrench."""
        load = max(wrench[self.vertical], _LEAST_LOAD)
        x, y = -wrench[self._moment_y] / load, wrench[self._moment_x] / load
        return np.eye(self.kinds) + x * self._shift_x + y * self._shift_y

    def _moved(self, wrench: Array) -> Array:
        """Return the moments d x f that a point off by d sees besides, by d, shape (kinds, 2).

        A column with the noise of the right-hand side in it would find what explains the noise, so that this
        is of the wrench that the feet give and not of the one asked for.
        """
        moved = np.zeros((self.kinds, 2))
        moved[self._moment_x, 1], moved[self._moment_y, 0] = wrench[self.vertical], -wrench[self.vertical]
        if self._six_axes:
            moved[_MZ] = wrench[_FY], -wrench[_FX]
        return moved


class _Columns(NamedTuple):
    """The places of what is averaged over a group of samples, each for all kinds of rows.

    What scales do, a newton on each channel (lost ones being made of the others), the delay, the blur, what
    is asked, how fast each channel's part changes, and a newton on each channel by its own place.
    """

    scale: slice
    channel: slice
    delay: slice
    blur: slice
    asked: slice
    speed: slice
    place: slice


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
