"""What a foot's sensors feel of the masses beyond them, besides their weight at level rest.

A sole plate under load cells, or a whole foot below an ankle sensor, is accelerated by what passes through
the sensor. With m the mass beyond it, c its centre in the sole frame and a its acceleration, the sensor reads
the wrench of the ground less

    m (a + g e_z) - m g R e_z    at c,

where the second term is the weight at level rest, which counts as part of the offset.
"""

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array
from surefoot.calibration.front_end.motion import MotionColumns
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.reference import GRAVITY

_LIGHTEST = 1e-3
"""Mass in kg below a sensor from which on its inertia is worth computing."""

_UP = np.array([0.0, 0.0, 1.0])


class DistalMasses:
    """The masses beyond the sensors of one layout.

    Args:
        layout: The feet.
        dt: Time between samples in s.
        spans: Numbers of samples that accelerations will be asked over.

    Attributes:
        matter: Whether there are any.
    """

    def __init__(self, layout: FeetLayout, dt: float, *spans: int) -> None:
        parts = [
            (foot_index, where.start, sensor)
            for foot_index, (foot, where) in enumerate(zip(layout.feet, layout.slices, strict=True))
            for sensor in foot.sensors
        ]
        self.matter = any(sensor.mass_below > _LIGHTEST for *_, sensor in parts)
        self._motion = MotionColumns.of(len(layout.feet))
        self._foot_of = [foot for foot, _, _ in parts]
        self._felt = np.zeros((len(parts), 6, layout.channels))
        for row, (_, start, sensor) in zip(self._felt, parts, strict=True):
            where = slice(start + sensor.channels.start, start + sensor.channels.stop)
            row[:, where] = -np.linalg.pinv(sensor.wrench_map).T
        self._mass = np.array([sensor.mass_below for *_, sensor in parts])
        self._com = np.array([sensor.com_below_sole for *_, sensor in parts])
        self._share = np.array(
            [sensor.share * (sensor.wrench_map != 0.0).any(axis=1) for *_, sensor in parts]
        )
        self._curves = {n: _curvature(n) / dt**2 for n in set(spans)}

    def total(self, motion: Array, origin: Array) -> Array:
        """Sum up what the feet's wrenches lack, over n samples in a row.

        Args:
            motion: Flat references, shape (..., n, R).
            origin: Points that moments are taken about in m, shape (..., n, 3).

        Returns:
            Mean wrench of all feet about those points in N and N m, shape (..., 6).
        """
        position, _ = self._motion.soles(motion)
        wrench, middle = self._wrenches(motion)
        arm = (position - origin[..., None, :]).mean(axis=-3)
        parts = []
        for p, foot in enumerate(self._foot_of):
            # A sensor lacks nothing along the axes of the sole that it does not measure.
            turn = middle[..., foot, :, :]
            part = np.stack([wrench[p][..., :3], wrench[p][..., 3:]], axis=-1)
            part = turn @ ((turn.mT @ part) * self._share[p].reshape(2, 3).T)
            force, moment = part[..., 0], part[..., 1]
            parts.append(np.concatenate([force, moment + _cross(arm[..., foot, :], force)], axis=-1))
        return sum(parts[1:], parts[0])

    def felt(self, motion: Array) -> Array:
        """Return what each channel reads of it while nothing touches its foot.

        Args:
            motion: Flat references of n samples in a row, shape (..., n, R).

        Returns:
            In N or N m, shape (..., K).
        """
        wrenches, middle = self._wrenches(motion)
        parts = []
        for p, (foot, part) in enumerate(zip(self._foot_of, wrenches, strict=True)):
            turned = middle[..., foot, :, :].mT
            force, moment = turned @ part[..., :3, None], turned @ part[..., 3:, None]
            parts.append(np.concatenate([force, moment], axis=-2)[..., 0] @ self._felt[p])
        return sum(parts[1:], parts[0])

    def _wrenches(self, motion: Array) -> tuple[list[Array], Array]:
        """Return each part's wrench at its sole's origin in level axes, shape (..., 6) each.

        And the soles' rotations at the middle sample, shape (..., F, 3, 3).
        """
        com, acceleration = motion[..., self._motion.com], motion[..., self._motion.com_acceleration]
        position, R = self._motion.soles(motion)
        curve = self._curves[position.shape[-3]]
        # A level frame may move from sample to sample; distances to the centre of mass do not care.
        bend = ((position - com[..., None, :]) * curve[:, None, None]).sum(axis=-3)
        sole = bend + acceleration.mean(axis=-2)[..., None, :]
        middle = R[..., R.shape[-4] // 2, :, :, :]
        parts = []
        for p, foot in enumerate(self._foot_of):
            force = self._mass[p] * (sole[..., foot, :] + GRAVITY * (_UP - middle[..., foot, :, 2]))
            arm = (middle[..., foot, :, :] @ self._com[p][:, None])[..., 0]
            parts.append(np.concatenate([force, _cross(arm, force)], axis=-1))
        return parts, middle


def _curvature(n: int) -> NDArray[np.float64]:
    """Return weights that take n samples in a row to the second derivative of a parabola through them."""
    k = np.arange(n) - (n - 1) / 2.0
    weights: NDArray[np.float64] = 2.0 * np.linalg.pinv(np.stack([np.ones(n), k, k**2], axis=1))[2]
    return weights


def _cross(a: Array, b: Array) -> Array:
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )
