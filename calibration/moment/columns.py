"""The unknowns of the moment filter by name, and how sure of them it starts.

| part | number | unit | meaning |
|---|---|---|---|
| scale | K | 1 | a, against the starting map |
| offset | K | W (W m for a torque) | b, offsets of the start |
| drift | K | W (W m) | u, drift of the zeros since, as a force |
| talk | T | 1, m, 1/m | share of a load of a six-axis sensor that another axis of it shows |
| com | 2 | m | d, believed less true centre of mass, in axes that head as the feet do |
| mass | 1 | 1 | m, error of the believed mass |
| delay | 1 | s | how late the robot's clock is |
| momentum | C | W s, W m s | P_z, H_x, H_y, and P_x, P_y, H_z of six-axis sensors |
| wrench | C | W, W m | w, the outside wrench, at the same point |
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import in_a_row
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.setup import OnlineSetup

VERTICAL, SHEAR = 3, 6
"""Components that load cells see, (P_z, H_x, H_y), and those of six-axis sensors."""

AXES = 6  # channels of a six-axis sensor

TALKING = 2, 3, 4
"""Axes of a six-axis sensor that the others show: the vertical force and the torques about the level axes,
which are large shares of their full scales under a robot. Shear and yaw torque are not."""

TALK_ARM = 0.03
"""Full scale of a torque by that of a force in m, which cross-talk is a share of: 0.02 to 0.04 of sensors in
feet (ATI Mini45, iCub's FTSens)."""

WIDE = 5.0
"""Stated standard deviations of the prior that the filter runs on: more than the worst severity."""

SMALLEST_DRIFT = 1e-6
"""Standard deviation of a zero's drift in W that counts as none: less than a step of any converter."""


class Columns(NamedTuple):
    """Where the unknowns stand."""

    scale: slice
    offset: slice
    drift: slice
    talk: slice
    com: slice
    mass: slice
    delay: slice
    momentum: slice
    wrench: slice

    @classmethod
    def of(cls, layout: FeetLayout) -> "Columns":
        """Return the unknowns of a robot with these feet."""
        K, C = layout.channels, SHEAR if sees_shear(layout) else VERTICAL
        return cls(*in_a_row(K, K, K, len(find_talks(layout)[0]), 2, 1, 1, C, C))

    @property
    def size(self) -> int:
        """Number of unknowns, N."""
        return int(self.wrench.stop)

    @property
    def components(self) -> int:
        """Number of components of momentum, C."""
        return int(self.wrench.stop - self.wrench.start)

    @property
    def map(self) -> slice:
        """Scales, offsets and drift together, which stand first: the part that is published."""
        return slice(0, self.drift.stop)


class Spread(NamedTuple):
    """Variances that are stated of unknowns at the start."""

    scale: NDArray[np.float64]  # of scales, shape (K,)
    offset: NDArray[np.float64]  # of offsets, shape (K,)
    talk: NDArray[np.float64]  # of cross-talk, shape (T,)
    com: NDArray[np.float64]  # of the centre of mass in m^2, shape (2,)
    unit: NDArray[np.float64]  # units of an offset: 1, or the foot length in m for a torque, shape (K,)
    walk: NDArray[np.float64]
    """Variances that scales (first) and zeros drift by at the stated rate, in 1/s and W^2/s, shape (2, K)."""

    @classmethod
    def of(cls, setup: OnlineSetup, config: Moment) -> "Spread":
        """Return those of a robot."""
        torque = ~(setup.layout.wrench_map[:, :3] != 0.0).any(axis=(0, 1))
        unit = np.where(torque, setup.length, 1.0)
        scale = np.full(setup.layout.channels, config.scale_std**2)
        full_scale, (to, origin) = np.where(torque, TALK_ARM, 1.0), find_talks(setup.layout)
        talk = (config.cross_talk * full_scale[to] / full_scale[origin]) ** 2
        walk = np.stack([np.full_like(unit, config.scale_drift), config.offset_drift * unit]) ** 2 / 60.0
        return cls(scale, (config.offset_std * unit) ** 2, talk, np.full(2, config.com_std**2), unit, walk)


def sees_shear(layout: FeetLayout) -> bool:
    """Return whether a foot's channels see forces along the sole."""
    return bool((layout.wrench_map[:, :2] != 0.0).any())


def find_talks(layout: FeetLayout) -> NDArray[np.int64]:
    """Return the channels that may show another one's load, and the channels of these loads, shape (2, T)."""
    pairs = [
        (start + sensor.channels.start + axis, start + sensor.channels.start + origin)
        for foot, start in zip(layout.feet, (part.start for part in layout.slices), strict=True)
        for sensor in foot.sensors
        if sensor.six_axis
        for origin in TALKING
        for axis in range(AXES)
        if axis != origin
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2).T


def first_mean(columns: Columns) -> NDArray[np.float64]:
    """Return the mean to start from, shape (N,): the starting map."""
    mean = np.zeros(columns.size)
    mean[columns.scale] = 1.0
    return mean


def first_variance(
    columns: Columns, spread: Spread, config: Moment, wide: float = WIDE
) -> NDArray[np.float64]:
    """Return the variances at the start, shape (N,), of which a wrench's are its mode's.

    Args:
        columns: The unknowns.
        spread: Stated variances.
        config: Options.
        wide: Factor on stated standard deviations of scales and offsets; that which the filter runs on.
    """
    variance = np.zeros(columns.size)
    variance[columns.scale] = wide**2 * spread.scale
    variance[columns.offset] = wide**2 * spread.offset
    variance[columns.drift] = SMALLEST_DRIFT**2
    variance[columns.talk] = spread.talk
    variance[columns.com] = spread.com
    variance[columns.mass] = config.mass_std**2
    variance[columns.delay] = config.delay_std**2
    return variance
