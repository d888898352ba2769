"""Which feet of N robots surely stood, or surely swung: :mod:`surefoot.wrappers.contacts` for all at once."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Reference
from surefoot.wrappers.contacts import (
    CONTACT_MARGIN,
    COS_FLAT,
    DOWN,
    LARGEST_FORCE_BIAS,
    LEAN_TIME,
    LEANING,
    LIFTED,
    LOWEST,
    planned_window,
)
from surefoot.wrappers.odometry import FREE_FALL

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class BatchPlan:
    """Finds it for some samples ago, by what was planned.

    Args:
        count: Number of robots N.
        lag: How many samples ago.
    """

    def __init__(self, count: int, lag: int) -> None:
        self._needed, kept = planned_window(lag)
        none = np.zeros((count, 4), dtype=np.int64)
        self._runs = deque([none], maxlen=kept)

    def begin_episode(self, mask: Mask) -> None:
        """Start some robots without a plan, shape (N,)."""
        for runs in self._runs:
            runs[mask] = 0

    def at(self, planned: Mask) -> tuple[Mask, Mask]:
        """Take in what is planned now, and return what surely held then.

        Args:
            planned: Feet planned to stand and feet planned to swing, shape (N, 4).

        Returns:
            Feet that surely stood and feet that surely swung, shape (N, 2) each.
        """
        self._runs.append((self._runs[-1] + 1) * planned)
        sure = self._runs[0] >= self._needed
        return sure[:, :2], sure[:, 2:]


class BatchKinematics:
    """Finds it by where the feet were.

    Args:
        count: Number of robots N.
    """

    def __init__(self, count: int) -> None:
        self._runs = np.zeros((count, 4), dtype=np.int64)

    def begin_episode(self, mask: Mask) -> None:
        """Start some robots without a past, shape (N,)."""
        self._runs[mask] = 0

    def at(self, reference: Reference) -> tuple[Mask, Mask]:
        """Take in the robots' beliefs of one moment, and return what their feet surely did then.

        Args:
            reference: The beliefs, of samples that follow each other.

        Returns:
            Feet that surely stood and feet that surely swung then, shape (N, 2) each.
        """
        height = reference.position_sole[..., 2]
        above = height - np.minimum(height[:, :1], height[:, 1:])
        force = reference.accelerometer
        # NaN, where nothing is known, compares as false.
        carried = (np.einsum("ni,ni->n", force, force) > FREE_FALL * FREE_FALL)[:, None]
        flat = reference.R_level_sole[..., 2, 2] > COS_FLAT
        seen = np.concatenate([carried & (above < DOWN) & flat, carried & (above > LIFTED)], axis=1)
        self._runs = (self._runs + 1) * seen
        sure = self._runs > CONTACT_MARGIN
        return sure[:, :2], sure[:, 2:]


class BatchUpright:
    """Finds whether robots stand, walk or run, so that their feet carry all of them.

    Args:
        count: Number of robots N.
        dt: Time between samples in s.

    Attributes:
        fell: Robots that were upright until the last moment, and no longer at it, shape (N,).
    """

    def __init__(self, count: int, dt: float) -> None:
        self._share = dt / (dt + LEAN_TIME)
        self._mean: Floats = np.zeros((count, 3))
        self._highest: Floats = np.zeros(count)
        self._upright: Mask = np.zeros(count, dtype=bool)
        self.fell = self._upright

    def begin_episode(self, mask: Mask) -> None:
        """Start some robots without a past, shape (N,)."""
        self._mean[mask], self._highest[mask], self._upright[mask] = 0.0, 0.0, False

    def at(self, reference: Reference, force_bias: Floats) -> Mask:
        """Take in the robots' beliefs of one moment, and return whether they were upright then.

        Args:
            reference: The beliefs, of samples that follow each other; NaN, where nothing is known, passes.
            force_bias: What they take for errors of their accelerometers in m/s^2, shape (N, 3).

        Returns:
            Robots that are upright, shape (N,).
        """
        acceleration = reference.com_acceleration
        known = acceleration[:, 0] == acceleration[:, 0]
        height = reference.com[:, 2] - reference.position_sole[..., 2].min(axis=1)
        change = self._share * (acceleration - self._mean)
        self._mean = np.where(known[:, None], self._mean + change, self._mean)
        self._highest = np.where(known, np.maximum(self._highest, height), self._highest)
        upright: Mask = (
            (np.einsum("ni,ni->n", self._mean, self._mean) < LEANING * LEANING)
            & (np.einsum("ni,ni->n", force_bias, force_bias) < LARGEST_FORCE_BIAS * LARGEST_FORCE_BIAS)
            & (height > LOWEST * self._highest)
        )
        self.fell = self._upright & ~upright & known
        self._upright = np.where(known, upright, self._upright)
        upright |= ~known
        return upright
