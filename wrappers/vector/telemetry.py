"""What the computers of N robots measure and send: encoders, IMU and the tilt that they make of them.

The same equations as :mod:`surefoot.wrappers.telemetry` and :mod:`surefoot.wrappers.attitude`, written for
all robots at once, on a simpler clock: each control step one packet is measured at its end and arrives a
whole number of steps later, the link's mean delay. Jitter and the packets' own rate are left out.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY
from surefoot.sensors import Corruption, Encoders, Imu, Link, encoders, imu
from surefoot.sensors.corruption import Rng
from surefoot.sensors.select import batch_axes, select
from surefoot.wrappers.attitude import INTEGRAL_GAIN, LEAST_SQUARE, MOST_SQUARE, PROPORTIONAL_GAIN
from surefoot.wrappers.telemetry import TelemetryLayout, velocity_smoothing

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class BatchTelemetry:
    """Measures packets of N robots and hands them over late.

    Args:
        count: Number of robots N.
        joints: Number of joints J.
        imu_config: The IMUs.
        encoder_config: The encoders.
        link: The links; of its numbers, only the mean delay counts.
        dt: Duration of a control step in s.
        tilts: Whether tilt and joint velocities are worked out as well; else they are zero.

    Attributes:
        layout: Where each part lies in a packet.
        delay: By how many control steps packets come late.
        packet: The newest packets that have arrived, shape (N, C).
    """

    def __init__(
        self,
        count: int,
        joints: int,
        imu_config: Imu,
        encoder_config: Encoders,
        link: Link,
        dt: float,
        *,
        tilts: bool,
    ) -> None:
        self.layout = TelemetryLayout(joints)
        self.delay = round(link.delay / dt)
        self._count, self._dt, self._tilts = count, dt, tilts
        self._imu, self._encoders = imu(imu_config), encoders(encoder_config)
        self._smoothing = velocity_smoothing(encoder_config, dt)
        self._ring: Floats = np.zeros((self.delay + 1, count, self.layout.size))
        self._now = 0
        self._imu_state: Any = None
        self._encoder_state: Any = None
        self._attitude = BatchAttitude(count)

    @property
    def packet(self) -> Floats:
        """The newest packets that have arrived, shape (N, C); not to be changed."""
        packet: Floats = self._ring[(self._now + 1) % len(self._ring)]
        return packet

    def draw(self, mask: Mask, rng: Rng) -> None:
        """Draw fresh IMUs and encoders for some robots."""
        count, joints = self._count, self.layout.joint_position.stop
        self._imu_state = _drawn(self._imu, (count, 6), self._imu_state, mask, rng)
        self._encoder_state = _drawn(self._encoders, (count, joints), self._encoder_state, mask, rng)

    def measure(
        self, position: Floats, inertial: Floats, up: Floats, starting: Mask | None, rng: Rng
    ) -> None:
        """Measure one control step of all robots.

        Args:
            position: Joint positions at its end in rad, shape (N, J).
            inertial: Specific force in m/s^2 and angular velocity in rad/s at the IMUs, shape (N, 6).
            up: Unit vectors against gravity in the IMUs' axes, shape (N, 3).
            starting: Robots whose episode starts, shape (N,): packets before are of robots that stood there.
            rng: Where noise comes from.
        """
        if starting is not None:
            at_rest = np.concatenate([GRAVITY * up, np.zeros_like(up)], axis=1)
            inertial = np.where(starting[:, None], at_rest, inertial)
        dt, layout = self._dt, self.layout
        angle, self._encoder_state = self._encoders.apply(position, self._encoder_state, rng, dt)
        sample, self._imu_state = self._imu.apply(inertial, self._imu_state, rng, dt)
        before = self._ring[self._now]
        self._now = (self._now + 1) % len(self._ring)
        packet = self._ring[self._now]
        if self._tilts:
            self._work_out(packet, before.copy() if before is packet else before, angle, sample, starting)
        packet[:, layout.joint_position] = angle
        packet[:, layout.accelerometer] = sample[:, :3]
        packet[:, layout.gyroscope] = sample[:, 3:]
        if starting is not None:
            self._ring[:, starting] = packet[starting]

    def remeasure(self, mask: Mask, position: Floats, inertial: Floats, up: Floats, rng: Rng) -> None:
        """Measure robots whose episode starts within a step in which the others were measured already.

        Args:
            mask: These robots, shape (N,).
            position: As of :meth:`measure`.
            inertial: As of :meth:`measure`.
            up: As of :meth:`measure`.
            rng: Where noise comes from.
        """
        kept, states = self._ring[:, ~mask].copy(), (self._imu_state, self._encoder_state)
        attitude = self._attitude.up.copy(), self._attitude.bias.copy()
        now = self._now
        self.measure(position, inertial, up, mask, rng)
        self._now = now
        self._ring[:, ~mask] = kept
        self._attitude.up[~mask], self._attitude.bias[~mask] = (part[~mask] for part in attitude)
        axes = batch_axes(self._imu, 6), batch_axes(self._encoders, position.shape[1])
        fresh = (self._imu_state, self._encoder_state)
        self._imu_state, self._encoder_state = select(mask, fresh, states, axes)

    def _work_out(
        self, packet: Floats, before: Floats, angle: Floats, sample: Floats, starting: Mask | None
    ) -> None:
        layout = self.layout
        velocity = before[:, layout.joint_velocity]
        change = (angle - before[:, layout.joint_position]) / self._dt - velocity
        velocity = velocity + self._smoothing * change
        if starting is not None:
            velocity[starting] = 0.0
            self._attitude.begin_episode(starting)
        self._attitude.update(sample[:, 3:], sample[:, :3], self._dt)
        packet[:, layout.joint_velocity] = velocity
        packet[:, layout.tilt] = self._attitude.tilt


class BatchAttitude:
    """Which way is up for N robots, as :mod:`surefoot.wrappers.attitude` has it for one.

    Args:
        count: Number of robots N.

    Attributes:
        up: Unit vectors against gravity in the IMUs' axes, shape (N, 3).
        bias: Biases of the gyroscopes in rad/s, shape (N, 3).
    """

    def __init__(self, count: int) -> None:
        self.up: Floats = np.tile([0.0, 0.0, 1.0], (count, 1))
        self.bias: Floats = np.zeros((count, 3))

    @property
    def tilt(self) -> Floats:
        """Roll and pitch in rad, shape (N, 2)."""
        up = self.up
        pitch = -np.arcsin(np.minimum(np.maximum(up[:, 0], -1.0), 1.0))
        return np.stack([np.arctan2(up[:, 1], up[:, 2]), pitch], axis=1)

    def begin_episode(self, mask: Mask) -> None:
        """Start some robots upright."""
        self.up[mask], self.bias[mask] = (0.0, 0.0, 1.0), 0.0

    def update(self, gyroscope: Floats, accelerometer: Floats, dt: float) -> None:
        """Turn on by one sample, shape (N, 3) each."""
        spin = gyroscope - self.bias
        square = np.einsum("ni,ni->n", accelerometer, accelerometer)
        trusted = (square > LEAST_SQUARE) & (square < MOST_SQUARE)
        weight = np.where(trusted, 1.0 / np.sqrt(np.where(trusted, square, 1.0)), 0.0)
        error = cross(self.up, accelerometer * weight[:, None])
        self.bias += (INTEGRAL_GAIN * dt) * error
        turn = (PROPORTIONAL_GAIN * error - spin) * dt
        change = cross(turn, self.up)
        up = self.up + change + 0.5 * cross(turn, change)
        self.up = up / np.sqrt(np.einsum("ni,ni->n", up, up))[:, None]


def cross(left: Floats, right: Floats) -> Floats:
    """Cross product of vectors of three on the last axis; NumPy's own takes several times as long."""
    product: Floats = left[..., _NEXT] * right[..., _LAST] - left[..., _LAST] * right[..., _NEXT]
    return product


_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


def _drawn(device: Corruption[Any], shape: tuple[int, int], state: Any, mask: Mask, rng: Rng) -> Any:
    """Draw devices for all robots and give them to those in the mask."""
    fresh = device.init(shape, rng)
    return fresh if state is None or mask.all() else select(mask, fresh, state, batch_axes(device, shape[1]))
