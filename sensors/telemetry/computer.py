"""The measurements that the robot's own computer sends: encoders, IMU and the tilt that it makes of them.

A packet is one flat vector, parts of which :class:`TelemetryLayout` names. It is measured between two
substeps of the simulation, leaves at once and reaches the host late.
"""

from collections.abc import Mapping
from math import ceil
from typing import Any, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors import Corruption, Encoders, Imu, Link, encoders, imu
from surefoot.sensors.configuration import require
from surefoot.sensors.corruption import Rng
from surefoot.sensors.devices.imu import ImuState
from surefoot.sensors.presets import resolve
from surefoot.sensors.telemetry.attitude import UPRIGHT, Attitude, update
from surefoot.sensors.transport.link import JITTER_BOUND, Packets, receive, send

VELOCITY_TIME_CONSTANT = 0.02
"""Time constant in s of the low-pass filter on differences of encoder readings."""

PACKETS_BEFORE_START = 12
"""How many packets the robot has at least sent at rest before an episode begins; more over a late link."""

LONGEST_DELAY = 0.3  # mean delay in s of the latest link that telemetry can come over

MEASURED = ("joint_position", "joint_velocity", "tilt", "gyroscope")
"""Parts of a state that telemetry has, where the environment names them."""


def timely_link(link: str | Mapping[str, Any] | Link) -> Link:
    """Make a link of a preset's name, a mapping or a link; ValueError if telemetry comes too late by it."""
    chosen = resolve(link, Link, "link")
    require(
        chosen.delay <= LONGEST_DELAY,
        chosen,
        "delay",
        f"be at most {LONGEST_DELAY} s, which is as late as telemetry is of use here",
    )
    return chosen


def velocity_smoothing(config: Encoders, period: float) -> float:
    """Return the share that the filter takes of a difference of encoder readings ``period`` s apart."""
    exact = config.resolution == 0.0 and config.noise_std == 0.0
    return 1.0 if exact else period / (period + VELOCITY_TIME_CONSTANT)


class TelemetryLayout:
    """Where each part lies in a packet.

    Args:
        joints: Number of joints J.
    """

    def __init__(self, joints: int) -> None:
        self.joint_position = slice(0, joints)
        self.joint_velocity = slice(joints, 2 * joints)
        self.tilt = slice(2 * joints, 2 * joints + 2)
        self.gyroscope = slice(2 * joints + 2, 2 * joints + 5)
        self.accelerometer = slice(2 * joints + 5, 2 * joints + 8)
        self.size = 2 * joints + 8


class Hardware(NamedTuple):
    """The constants of an IMU and encoders, whatever the robot does."""

    imu: ImuState  # state of the IMU
    encoders: Any  # state of the encoders


class Computer(NamedTuple):
    """The sensors and the results of the robot's computer."""

    hardware: Hardware  # states of its sensors
    attitude: Attitude  # the computer's belief of its tilt
    position: Floats  # the last encoder readings in rad, shape (J,)
    velocity: Floats  # their filtered differences in rad/s, shape (J,)


class TelemetryState(NamedTuple):
    """The robot's side of the link."""

    computer: Computer  # sensors and computer
    inertial: Floats  # sum of the IMU's true values since the last packet, shape (6,)
    substeps: int  # how many are in that sum
    due: float  # time to the next packet in s
    number: int  # number of the next packet
    under_way: Packets  # packets that have not arrived


class Telemetry:
    """Builds packets of the truth of control steps and delivers them late.

    Args:
        joints: Number of joints J.
        imu_config: The IMU.
        encoder_config: The encoders.
        link: The link to the host.
        dt: Duration of a control step in s.
        substeps: Rows of truth in a control step.

    Attributes:
        before_start: How many packets have been sent at rest before time 0.

    Raises:
        ValueError: If the link sends more than one packet a substep.
    """

    def __init__(
        self, joints: int, imu_config: Imu, encoder_config: Encoders, link: Link, dt: float, substeps: int
    ) -> None:
        self.layout = TelemetryLayout(joints)
        self.link = link
        self.dt = dt
        self.substep = dt / substeps
        self.period = dt if link.rate is None else 1.0 / link.rate
        self.averaged = imu_config.averaged
        # Two packets in one substep would leave an averaging IMU nothing to average.
        fastest = substeps / dt
        require(
            link.rate is None or link.rate <= fastest * (1.0 + 1e-9),
            link,
            "rate",
            f"be at most {fastest:g} per second, one packet a substep of the simulation",
        )
        # Some packets have come when the episode begins.
        latest = link.delay + JITTER_BOUND * link.jitter
        self.before_start = max(PACKETS_BEFORE_START, ceil(latest / self.period) + 4)
        self._imu: Corruption[ImuState] = imu(imu_config)
        self._encoders: Corruption[Any] = encoders(encoder_config)
        self.smoothing = velocity_smoothing(encoder_config, self.period)

    def init(
        self, position: Floats, inertial: Floats, rng: Rng, hardware: Hardware | None = None
    ) -> tuple[Packets, TelemetryState]:
        """Switch the robot on at rest, some packets before time 0; without hardware new one is drawn.

        Joint positions in rad, (J,); specific force in m/s^2 and angular velocity in rad/s at the IMU, (6,).
        Returns the packets that have arrived by time 0, at least one, and the state.
        """
        if hardware is None:
            hardware = Hardware(self._imu.init((6,), rng), self._encoders.init(position.shape, rng))
        reading, encoder_state = self._encoders.apply(position, hardware.encoders, rng, self.period)
        hardware = hardware._replace(encoders=encoder_state)
        computer = Computer(hardware, UPRIGHT, reading, np.zeros_like(reading))
        under_way: Packets = ()
        for number in range(self.before_start):
            time = (number + 1 - self.before_start) * self.period
            values, computer = self._measure(position, inertial, computer, rng)
            under_way = send(values, number, time, under_way, self.link, rng)
        arrived, under_way = receive(under_way, 0.0)
        return arrived, TelemetryState(computer, np.zeros(6), 0, self.period, self.before_start, under_way)

    def advance(
        self, position: Floats, inertial: Floats, time: float, state: TelemetryState, rng: Rng
    ) -> tuple[Packets, TelemetryState]:
        """Measure a control step that ends at a time of the host in s: packets that have arrived, the state.

        Joint positions at the ends of its S substeps in rad, (S, J), and specific force in m/s^2 and angular
        velocity in rad/s at the IMU, (S, 6).
        """
        computer, total, count, due, number, under_way = state
        start, row, rows = time - self.dt, 0, len(position)
        while due <= self.dt + 1e-9:
            # The row at whose time the packet is due, or the first after it.
            last = min(max(int(due / self.substep - 1e-6), row), rows - 1)
            if self.averaged:
                felt = np.add.reduce(inertial[row : last + 1])
                felt = (felt + total) / (count + last + 1 - row)
            else:
                felt = inertial[last]
            total, count = _NOTHING, 0
            values, computer = self._measure(position[last], felt, computer, rng)
            under_way = send(values, number, start + due, under_way, self.link, rng)
            number, row, due = number + 1, last + 1, due + self.period
        if row < rows and self.averaged:
            total, count = total + np.add.reduce(inertial[row:]), count + rows - row
        arrived, under_way = receive(under_way, time)
        return arrived, TelemetryState(computer, total, count, due - self.dt, number, under_way)

    def hardware(self, state: TelemetryState) -> Hardware:
        """Return the present state of IMU and encoders."""
        return state.computer.hardware

    def with_hardware(self, state: TelemetryState, hardware: Hardware) -> TelemetryState:
        """Return a state that goes on with another IMU and other encoders."""
        return state._replace(computer=state.computer._replace(hardware=hardware))

    def _measure(
        self, position: Floats, inertial: Floats, computer: Computer, rng: Rng
    ) -> tuple[Floats, Computer]:
        """Read the sensors once and fill a packet."""
        (imu_state, encoder_state), attitude, before, velocity = computer
        period = self.period
        angle, encoder_state = self._encoders.apply(position, encoder_state, rng, period)
        sample, imu_state = self._imu.apply(inertial, imu_state, rng, period)
        fx, fy, fz, wx, wy, wz = sample.tolist()
        attitude = update(attitude, (wx, wy, wz), (fx, fy, fz), period)
        # After a simulation that blew up the filter begins anew.
        velocity = np.where(np.isnan(velocity), 0.0, velocity)
        velocity = velocity + self.smoothing * ((angle - before) / period - velocity)
        inertial_part = (attitude.roll, attitude.pitch, wx, wy, wz, fx, fy, fz)
        values = np.concatenate((angle, velocity, inertial_part))
        return values, Computer(Hardware(imu_state, encoder_state), attitude, angle, velocity)


_NOTHING: Floats = np.zeros(6)
