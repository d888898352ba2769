"""The unknowns of the moment filter: their places in one vector, and how sure of them it starts.

| part | number | unit | meaning |
|---|---|---|---|
| a | P | 1 | scales against the starting map: one a channel, then cross-talk (`inp` to `out`) |
| o | K | body weights (times foot lengths for a torque) | offsets against the starting map, before scales |
| com | 2 | foot lengths | believed less true centre of mass, level frame |
| mass | 1 | 1 | believed mass over the true one, less 1 |
| acceleration | 3 | g | bias of the believed acceleration, level frame: IMU bias and tilt |
| delay | 1 | s | how much later a moment the reference describes than it is thought to |
| sole | 2 | foot lengths | how much larger com is for the first foot's load, and smaller for the second's |
| blur | 1 | squared samples | variance of the window that the reference averages its rates over |

A force is F = a (F0 + o). Scale and offset stand as a sensor has them: its zero drifts in its readings, and
says nothing of its scale. In F = a F0 + b a zero that drifts by d asks for b - a d, and a filter that holds
a and b for independent finds a smaller scale at every swing.

Units are chosen so that numbers are of order one, and float32 is enough for the C library.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array, in_a_row
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.setup import OnlineSetup

_UP = 2
"""The row of the vertical force in a wrench map."""

_STILL = 0.5
"""Share of ``com_known`` down to which the centre of mass is estimated while the robot does not walk."""

_UNSURE_MASS = 2.0
"""How many times less sure than at the start the mass is while it is estimated."""

_WIDEST_BLUR = 1.0
"""Squared samples that the reference is thought to be averaged over at most."""


class Unknowns:
    """The unknowns of one setup.

    Args:
        setup: The robot.
        config: Options of the filter.

    Attributes:
        channels: Number of channels, K.
        scales: Number of scales, P.
        size: Number of unknowns, N.
        scale, offset, com, acceleration, mass, delay, sole, blur: Places of the parts.
        map: Place of scales and offsets together, the first P + K.
        load: Places of what a load changes: the centre of mass (2) and the mass.
        diagonal: Whether there is one scale a channel.
        out, inp: Channel that each scale acts on, and on whose reading, shape (P,) each; the first K are the
            channels' own.
        unit: Newtons, or N m, of one offset of each channel, shape (K,).
        start: Mean to start from, shape (N,).
        std: Standard deviations to start from, shape (N,).
        walk: Variance of their random walks per second, shape (N,).
        age: Time in s, on the average, since the middle of the block that they were learnt from.
        change: Standard deviations of sudden changes of the reference, shape (N,).
        lower: Where the lower half of a matrix (N, N) lies, row by row.
        learnt: 1 where an unknown is estimated, 0 where it is only considered (Schmidt), shape (N,).
        sure: Variances from which down they are only considered as well, shape (N,).
        sure_still: The same for a robot that does not walk.
    """

    def __init__(self, setup: OnlineSetup, config: MomentFilterConfig) -> None:
        layout = setup.layout
        channels = layout.channels
        torque = ~(layout.wrench_map[:, :3] != 0.0).any(axis=(0, 1))
        lever = np.where(torque, setup.length, 1.0)
        own = list(range(channels))
        talks = list(_talks(layout)) if config.cross_talk > 0.0 else []
        self.out = np.array(own + [to for to, _ in talks])
        self.inp = np.array(own + [origin for _, origin in talks])
        self.diagonal = not talks

        self.channels, self.scales = channels, len(self.out)
        self.scale, self.offset, self.com, mass, self.acceleration, delay, self.sole, blur = in_a_row(
            self.scales, channels, 2, 1, 3, 1, 2, 1
        )
        self.mass, self.delay, self.blur, self.size = mass.start, delay.start, blur.start, blur.stop
        self.map = slice(0, self.offset.stop)
        self.load = [*range(self.com.start, self.com.stop), self.mass]
        self.unit: NDArray[np.float64] = setup.weight * lever

        self.lower = np.tril_indices(self.size)
        self.start: NDArray[np.float64] = np.zeros(self.size)
        self.start[:channels] = 1.0
        self.std: NDArray[np.float64] = np.zeros(self.size)
        ratio = lever[self.out] / lever[self.inp]
        self.std[self.scale] = config.cross_talk * ratio
        self.std[:channels] = config.scale_std
        self.std[self.offset] = config.offset_std
        self.std[self.com] = config.com_std / setup.length
        self.std[self.mass] = config.mass_std
        self.std[self.acceleration] = config.acceleration_std / setup.gravity
        self.std[self.delay] = config.delay_std
        self.std[self.sole] = config.sole_std / setup.length
        self.start[self.blur] = self.std[self.blur] = min((config.blur / setup.dt) ** 2, _WIDEST_BLUR)
        self.walk: NDArray[np.float64] = np.zeros(self.size)
        self.walk[:channels] = config.scale_drift**2 / 60.0
        self.walk[self.offset] = config.offset_drift**2 / 60.0
        self.age = (config.settle + config.every) * setup.dt
        self.change: NDArray[np.float64] = np.zeros(self.size)
        self.change[self.com] = config.com_change / setup.length
        self.change[self.mass] = config.mass_change
        self.learnt: NDArray[np.float64] = np.ones(self.size)
        self.learnt[self.mass] = float(config.learn_mass)
        # A vertical force that is off looks like a common scale: open, it takes what noisy columns shrink.
        self.learnt[self.acceleration.stop - 1] = 0.0
        self.sure: NDArray[np.float64] = np.zeros(self.size)
        self.sure[self.mass] = (_UNSURE_MASS * config.mass_std) ** 2
        self.sure[self.com] = (config.com_known / setup.length) ** 2
        self.sure_still = self.sure.copy()
        self.sure_still[self.com] *= _STILL**2

    def own_scales(self, mean: Array) -> Array:
        """Return the scales of the channels on their own readings, shape (K,)."""
        return mean[: self.channels]

    def tared(self, mean: Array, force: Array) -> Array:
        """Return F0 + o in N, shape (K,) or (n, K), of forces by the starting map."""
        return force + mean[self.offset] * self.unit

    def force(self, mean: Array, force: Array) -> Array:
        """Return corrected forces A (F0 + o) in N, shape (K,) or (n, K), of those by the starting map."""
        return self.scaled(mean, self.tared(mean, force))

    def scaled(self, mean: Array, tared: Array) -> Array:
        """Return A f in N, shape (K,) or (n, K), of forces without their offsets."""
        return mean[self.scale] * tared if self.diagonal else tared @ self.matrix(mean).T

    def offsets(self, mean: Array) -> Array:
        """Return b = A o in N, shape (K,), so that F = A F0 + b."""
        return self.scaled(mean, mean[self.offset] * self.unit)

    def by_scale(self, rows: Array, tared: Array) -> Array:
        """Return what scales do to rows that are linear in the channels' forces.

        Args:
            rows: What a newton on each channel does to m rows, shape (m, K).
            tared: Forces by the starting map without their offsets in N, shape (K,).

        Returns:
            Shape (m, P).
        """
        return rows[:, self.out] * tared[self.inp]

    def by_offset(self, rows: Array, mean: Array) -> Array:
        """Return what offsets do to such rows, shape (m, K)."""
        return rows @ self.matrix(mean) * self.unit

    def matrix(self, mean: Array) -> Array:
        """Return the scales as a matrix A, shape (K, K)."""
        A = np.zeros((self.channels, self.channels))
        A[self.out, self.inp] = mean[self.scale]
        return A


def _talks(layout: FeetLayout) -> Iterator[tuple[int, int]]:
    """Yield what cross-talk is looked for: channels, each with the vertical force of its six-axis sensor.

    A foot bears the robot's weight, next to which its other five loads are small, and so is what they add.
    """
    for foot, where in zip(layout.feet, layout.slices, strict=True):
        for sensor in foot.sensors:
            if sensor.six_axis:
                first = where.start + sensor.channels.start
                vertical = first + int(np.abs(sensor.wrench_map[_UP]).argmax())
                yield from ((first + axis, vertical) for axis in range(6) if first + axis != vertical)
