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

_LIGHTEST = 1e-3
"""Mass in kg below a sensor from which on its inertia is worth computing."""

_UP = np.array([0.0, 0.0, 1.0])


class DistalMasses:
    """The masses beyond the sensors of one layout.

    Args:
        layout: The feet.
        gravity: Acceleration of free fall in m/s^2.
        dt: Time between samples in s.
        spans: Numbers of samples that accelerations will be asked over.

    Attributes:
        matter: Whether there are any.
    """

    def __init__(self, layout: FeetLayout, gravity: float, dt: float, *spans: int) -> None:
        parts = [
            (foot_index, where.start, sensor)
            for foot_index, (foot, where) in enumerate(zip(layout.feet, layout.slices, strict=True))
            for sensor in foot.sensors
        ]
        self._gravity = gravity
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
            motion: Flat references, shape (n, R).
            origin: Points that moments are taken about in m, shape (n, 3).

        Returns:
            Mean wrench of all feet about those points in N and N m, shape (6,).
        """
        position, _ = self._motion.soles(motion)
        arm = (position - origin[:, None]).mean(axis=0)
        wrenches, R = self._wrenches(motion)
        total = np.zeros(6)
        for foot, wrench, share in zip(self._foot_of, wrenches, self._share, strict=True):
            # A sensor lacks nothing along the axes of the sole that it does not measure.
            force, moment = (
                R[foot] @ (measured * (R[foot].T @ part))
                for measured, part in zip(share.reshape(2, 3), wrench.reshape(2, 3), strict=True)
            )
            total += np.concatenate([force, moment + np.cross(arm[foot], force)])
        return total

    def felt(self, motion: Array) -> Array:
        """Return what each channel reads of it while nothing touches its foot.

        Args:
            motion: Flat references of n samples in a row, shape (n, R).

        Returns:
            In N or N m, shape (K,).
        """
        wrenches, R = self._wrenches(motion)
        return np.sum(
            [
                (wrench.reshape(2, 3) @ R[foot]).ravel() @ felt
                for foot, wrench, felt in zip(self._foot_of, wrenches, self._felt, strict=True)
            ],
            axis=0,
        )

    def _wrenches(self, motion: Array) -> tuple[list[Array], Array]:
        """Return each part's wrench at its sole's origin in level axes, shape (6,) each.

        And the soles' rotations at the middle sample, shape (F, 3, 3).
        """
        com, acceleration = motion[:, self._motion.com], motion[:, self._motion.com_acceleration]
        position, R = self._motion.soles(motion)
        middle = R[len(R) // 2]
        # A level frame may move from sample to sample; distances to the centre of mass do not care.
        bend = np.tensordot(self._curves[len(motion)], position - com[:, None], 1)
        sole = bend + acceleration.mean(axis=0)
        parts = []
        for foot, mass, center in zip(self._foot_of, self._mass, self._com, strict=True):
            force = mass * (sole[foot] + self._gravity * (_UP - middle[foot] @ _UP))
            parts.append(np.concatenate([force, np.cross(middle[foot] @ center, force)]))
        return parts, middle


def _curvature(n: int) -> NDArray[np.float64]:
    """Return weights that take n samples in a row to the second derivative of a parabola through them."""
    k = np.arange(n) - (n - 1) / 2.0
    weights: NDArray[np.float64] = 2.0 * np.linalg.pinv(np.stack([np.ones(n), k, k**2], axis=1))[2]
    return weights
