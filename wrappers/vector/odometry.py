"""Which way is up and ahead for N robots: :mod:`surefoot.wrappers.odometry`, written for all at once."""

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY
from surefoot.wrappers.odometry import FREE_FALL, REST_TIME, SOLE_HEIGHT, SPIN_BIAS_TIME, TILT_TIME
from surefoot.wrappers.vector.telemetry import cross

Floats = NDArray[np.float64]


class BatchOdometry:
    """Turns the torsos of N robots on from one middle between packets to the next.

    Args:
        count: Number of robots N.
        period: Time between packets in s.

    Attributes:
        up: Unit vectors against gravity in the torsos' axes, shape (N, 3).
        force_bias: What the accelerometers show too much in m/s^2, shape (N, 3).
    """

    def __init__(self, count: int, period: float) -> None:
        self._period = period
        self._forward: Floats = np.zeros((count, 3))
        self._spin: Floats = np.zeros((count, 3))
        self._spin_bias: Floats = np.zeros((count, 3))
        self._middles: Floats = np.zeros(count)
        self.up: Floats = np.zeros((count, 3))
        self.force_bias: Floats = np.zeros((count, 3))
        self.begin_episode(np.ones(count, dtype=bool))

    def begin_episode(self, mask: NDArray[np.bool_]) -> None:
        """Start some robots with no knowledge, shape (N,)."""
        self._forward[mask] = (1.0, 0.0, 0.0)
        self.up[mask] = (0.0, 0.0, 1.0)
        for part in (self._spin, self._spin_bias, self.force_bias):
            part[mask] = 0.0
        self._middles[mask] = 0.0

    def take(self, index: NDArray[np.intp], other: "BatchOdometry") -> None:
        """Take some robots from another object, in which they stand alone."""
        self._forward[index], self._spin[index] = other._forward, other._spin
        self._spin_bias[index], self._middles[index] = other._spin_bias, other._middles
        self.up[index], self.force_bias[index] = other.up, other.force_bias

    def turn(self, spin: Floats, force: Floats, position_sole: Floats, up_sole: Floats) -> Floats:
        """Take in one middle between packets.

        Args:
            spin: Angular velocities in the torsos' axes in rad/s, shape (N, 3).
            force: Specific forces in the torsos' axes in m/s^2, shape (N, 3).
            position_sole: Places of the soles in the torsos' frames in m, shape (N, 2, 3).
            up_sole: Their z axes, shape (N, 2, 3).

        Returns:
            The rotations from the torsos' to the odometry axes, shape (N, 3, 3).
        """
        period = self._period
        self._middles += 1.0
        turned = (0.5 * (spin + self._spin) - self._spin_bias) * period
        self._spin = spin.copy()
        g = self._upright(position_sole, up_sole)
        up = self.up - cross(turned, self.up)
        self._spin_bias = self._spin_bias + (period / (TILT_TIME * SPIN_BIAS_TIME)) * cross(up, g)
        known = 1.0 / self._middles[:, None]
        up = up + np.maximum(known, period / TILT_TIME) * (g - up)
        self.up = up = _unit(up)

        ahead = self._forward - cross(turned, self._forward)
        ahead = ahead - np.einsum("ni,ni->n", ahead, up)[:, None] * up
        self._forward = ahead = _unit(ahead)

        R: Floats = np.stack([ahead, cross(up, ahead), up], axis=1)
        carried = np.einsum("ni,ni->n", force, force)[:, None] > FREE_FALL * FREE_FALL
        share = np.where(carried, np.maximum(known, period / REST_TIME), 0.0)
        self.force_bias = self.force_bias + share * (force - GRAVITY * up - self.force_bias)
        return R

    def _upright(self, position_sole: Floats, up_sole: Floats) -> Floats:
        """Return which way is up by the lower sole, or by both where they are level with each other."""
        above = np.einsum("ni,ni->n", position_sole[:, 0] - position_sole[:, 1], self.up) / SOLE_HEIGHT
        weight = 0.5 * np.minimum(np.maximum(1.0 - above, 0.0), 2.0)[:, None]
        right = up_sole[:, 1]
        upright: Floats = weight * (up_sole[:, 0] - right) + right
        return upright


def _unit(vector: Floats) -> Floats:
    unit: Floats = vector / np.sqrt(np.einsum("ni,ni->n", vector, vector))[:, None]
    return unit
