"""The sensors of N robots: one state for all, whatever gathers the robots.

Readings follow the control steps: a converter's conversions lie on the straight line between the loads at the
ends of two steps. Each robot draws from streams of its own, keyed by its seed: its feet's sensors draw what
they draw in :class:`~surefoot.wrappers.FootSensors` after a reset with that seed, whoever stands beside it.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Parameters
from surefoot.envs import RobotDrawing
from surefoot.sensors import Encoders, ForceTorque, Imu, Link, LoadCells, scaled
from surefoot.sensors.devices.load_cells import true_map
from surefoot.sensors.presets import resolve
from surefoot.sensors.randomness import Stream
from surefoot.sensors.select import batch_axes, select
from surefoot.sensors.transport.wire import check_wire
from surefoot.wrappers.foot_device import FootDevice, foot_corruption, foot_device
from surefoot.wrappers.foot_sensors import stream_key
from surefoot.wrappers.instruments import Instruments, usual_cells
from surefoot.wrappers.source import check_stream, wants_fresh
from surefoot.wrappers.telemetry import timely_link
from surefoot.wrappers.vector.telemetry import BatchTelemetry
from surefoot.wrappers.vector.truth_row import RowMeaning, read_rows

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

Seeds = int | Sequence[int | None] | None
"""One number for all robots, or one or none a robot."""


class Devices(NamedTuple):
    """What each robot is equipped with.

    Attributes:
        feet: What is under the feet.
        imu: The IMU.
        encoders: The joint encoders.
        link: The link to the host.
    """

    feet: FootDevice
    imu: Imu
    encoders: Encoders
    link: Link


class Readings(NamedTuple):
    """What N hosts have at one moment.

    Attributes:
        raw: The feet's readings in counts, shape (N, K).
        packet: The newest packets of telemetry that have arrived, shape (N, C); ``None`` where nobody
            listens.
        contacts: Feet planned to stand and to swing, 0 or 1, -1 without a plan, shape (N, 2 F).
    """

    raw: Floats
    packet: Floats | None
    contacts: Floats


class BatchSensors:
    """Feels N robots through load cells or ankle sensors, joint encoders and IMUs.

    Args:
        count: Number of robots N.
        drawing: The robot.
        meaning: What the rows of truth hold.
        devices: What each is equipped with.
        stream: Number of the random stream.
        fresh: Whether a robot that is reset gets fresh sensors.

    Attributes:
        instruments: What is under the feet of one robot.
        telemetry: The way of encoders and IMUs to the hosts.
        readings: What the hosts have now.
        stepped: What they had at the end of the last step: of a robot whose episode ended with it, the end
            of that episode.
        starting: Robots that were reset instead of stepped in the last step, shape (N,), or ``None``.
        started_within: Robots whose next episode started within it, shape (N,), or ``None``.
        sensors_fresh: Robots that got fresh sensors at the last of these or of resets, shape (N,).
        truth: What really happened at the end of the step.

    Raises:
        ValueError: If the sensors do not fit the robot.
    """

    def __init__(
        self,
        count: int,
        drawing: RobotDrawing,
        meaning: RowMeaning,
        devices: Devices,
        *,
        stream: int,
        fresh: bool,
    ) -> None:
        self.count, self.drawing, self.meaning = count, drawing, meaning
        check_wire(devices.feet, meaning.dt)
        self.instruments = Instruments((devices.feet,), drawing)
        self._devices = devices
        self._cells = isinstance(devices.feet, LoadCells)
        self._device = foot_corruption(devices.feet)
        self._axes = batch_axes(self._device, self.instruments.channels)
        self._first_steps = self.instruments.first_steps(meaning.dt)
        self._remembers = self.instruments.slowest > 0.0 or len(self._first_steps) > 1
        self.telemetry = BatchTelemetry(
            count,
            len(meaning.joints),
            devices.imu,
            devices.encoders,
            devices.link,
            meaning.dt,
            tilts=bool(meaning.state),
        )
        self.fresh, self._stream = fresh, stream
        self._listening = bool(meaning.state)
        self._rng, self._telemetry_rng = self._streams([None] * count)
        self._state: Any = None
        self._started = False
        self._key: Any = None
        self._everyone = np.ones(count, dtype=bool)
        self.averaged = False
        self.readings: Readings
        self.stepped: Readings
        self.starting: Mask | None = None
        self.started_within: Mask | None = None
        self.sensors_fresh: Mask = self._everyone
        self.truth: Any = None

    @property
    def state(self) -> Any:
        """State of what is under the feet; a value that later steps do not change."""
        return self._state

    def listen(self) -> None:
        """Measure telemetry from the next reset on, even if no observation shows it."""
        self._listening = True

    def set_rows(self, key: Any, averaged: bool) -> None:
        """Set how rows are to be read, which copies know once they were reset.

        Raises:
            ValueError: If rows hold means over a step and the IMU gives the value of an instant.
        """
        if averaged and not self._devices.imu.averaged:
            raise ValueError(
                "The IMU reads instants (Imu.averaged is False) and the rows hold means over a control step; "
                "wrap the copies in TruthRow(env, averaged=False)."
            )
        self._key, self.averaged = key, averaged

    def reset(
        self, rows: Floats, mask: Mask | None = None, seed: Seeds = None, choice: str | None = None
    ) -> None:
        """Read robots that were reset.

        Args:
            rows: One row of truth a robot, shape (N, R).
            mask: Robots that were reset, shape (N,); ``None`` for all.
            seed: What they were reset with.
            choice: ``"fresh"`` or ``"keep"``, if it was asked for.
        """
        mask = self._everyone if mask is None else mask
        each = seed_of_each(seed, self.count)
        seeded = mask & np.array([own is not None for own in each])
        if seeded.any():
            for stream, fresh in zip((self._rng, self._telemetry_rng), self._streams(each), strict=True):
                stream.take(fresh, seeded)
        self._begin(rows, mask, self.wanting(mask, seed, choice))
        self.stepped, self.starting, self.started_within = self.readings, None, None

    def wanting(self, mask: Mask, seed: Seeds, choice: str | None) -> Mask:
        """Return which robots get fresh sensors at a reset, shape (N,)."""
        each = seed_of_each(seed, self.count)
        drawn = self._state is not None
        wanted: Mask = mask & np.array([wants_fresh(choice, own, self.fresh, drawn) for own in each])
        return wanted

    def step(self, rows: Floats, starting: Mask | None = None) -> None:
        """Read all robots after a control step.

        Args:
            rows: One row of truth a robot, shape (N, R).
            starting: Robots that were reset instead of stepped, shape (N,), or ``None``.
        """
        force, before = self._look(rows), self._state
        # An instrument that remembers nothing has read the first moment already.
        again = starting is not None and (self.fresh or self._remembers)
        rng = self._rng.only(~starting) if again and starting is not None else self._rng
        raw, self._state = self._device.apply(force, before, rng, self.meaning.dt)
        self.starting, self.started_within, self.sensors_fresh = starting, None, self._everyone & False
        if starting is not None and self.fresh:
            self.sensors_fresh = starting
            before = self._drawn(starting, before)
        if again and starting is not None:
            raw = self._first_readings(force, starting, before, raw)
        if self._started:
            self.telemetry.measure(*self._felt(), starting, self._telemetry_rng)
        self._keep(raw, rows)
        self.stepped = self.readings

    def begin_episode(self, rows: Floats, mask: Mask) -> None:
        """Read robots whose next episode starts within the step that ended one; to be called after it.

        Args:
            rows: One row of truth a robot, shape (N, R); those of ``mask`` are of the new episode.
            mask: These robots, shape (N,).
        """
        stepped = self.stepped
        wanted = mask if self.fresh else mask & False
        self._begin(rows, mask, wanted)
        self.stepped, self.started_within = stepped, mask

    def true_parameters(self) -> Parameters:
        """Return the maps that undo the feet's errors now, shape (N, K): truth, to score against.

        Raises:
            ValueError: If there are six-axis sensors under the feet, whose cross-talk is in no such map.
        """
        device = self._devices.feet
        if isinstance(device, ForceTorque):
            raise ValueError("Six-axis sensors have cross-talk, which no scale and offset a channel undo.")
        scale, offset = true_map(device, self._state)
        return Parameters(scale, offset)

    @property
    def _shape(self) -> tuple[int, int]:
        return self.count, self.instruments.channels

    def _streams(self, seeds: Sequence[int | None]) -> tuple[Stream, Stream]:
        """Return the streams of the feet's sensors and of telemetry of robots with these seeds."""
        feet, telemetry = (
            Stream.of_each(stream_key(device, self._stream, seed) for seed in seeds)
            for device in (self.instruments.parts[0].name, "telemetry")
        )
        return feet, telemetry

    def _begin(self, rows: Floats, mask: Mask, wanted: Mask) -> None:
        """Read the robots in ``mask`` for the first time; those ``wanted`` with fresh sensors."""
        force = self._look(rows)
        state = self._drawn(wanted, self._state) if wanted.any() else self._state
        raw = self._first_readings(force, mask, state, None if mask.all() else self.readings.raw)
        telemetry_rng = self._telemetry_rng
        if self._listening:
            if self._started:
                self.telemetry.remeasure(mask, *self._felt(), telemetry_rng.only(mask))
            else:
                if not wanted.any():
                    # The feet's sensors were drawn before anybody listened.
                    self.telemetry.draw(self._everyone, telemetry_rng)
                self.telemetry.measure(*self._felt(), self._everyone, telemetry_rng)
                self._started = True
        self.sensors_fresh = wanted
        self._keep(raw, rows)

    def _look(self, rows: Floats) -> Floats:
        """Read the truth, and what the feet's sensors feel of it, as they take it."""
        self.truth = truth = read_rows(rows[:, : self.meaning.columns].copy(), self._key)
        if self._cells:
            force: Floats = truth.force_cell[:, None]
            return force
        return truth.wrench_ankle.reshape(self.count, -1)

    def _drawn(self, wanted: Mask, state: Any) -> Any:
        """Draw fresh sensors for the robots that want them; return the state of the feet's."""
        fresh = self._device.init(self._shape, self._rng if state is None else self._rng.only(wanted))
        if self._listening:
            self.telemetry.draw(wanted, self._telemetry_rng.only(wanted))
        return fresh if wanted.all() or state is None else select(wanted, fresh, state, self._axes)

    def _first_readings(self, force: Floats, mask: Mask, state: Any, raw: Floats | None) -> Floats:
        """Read the load of now until no reading of robots that start an episode is of another load.

        Args:
            force: What is felt now.
            mask: These robots, shape (N,).
            state: What their sensors were before.
            raw: The others' readings, shape (N, K); ``None`` without others.

        Returns:
            Readings of all.
        """
        if self._cells:
            # Nothing joins this moment to the one before.
            state = state._replace(previous=force[:, -1] + 0.0)
        first, rng = force, self._rng.only(mask)
        for dt in self._first_steps:
            first, state = self._device.apply(force, state, rng, dt)
        if raw is None:
            self._state = state
            return first
        self._state = select(mask, state, self._state, self._axes)
        return np.where(mask[:, None], first, raw)

    def _felt(self) -> tuple[Floats, Floats, Floats]:
        truth = self.truth
        return truth.joint_position, truth.inertial, truth.R_world_torso[:, 2]

    def _keep(self, raw: Floats, rows: Floats) -> None:
        packet = self.telemetry.packet.copy() if self._started else None
        self.readings = Readings(raw, packet, rows[:, self.meaning.columns :].copy())


def choose_devices(
    owner: str,
    drawing: RobotDrawing,
    feet: Any,
    imu: Any,
    encoders: Any,
    link: Any,
    severity: float,
    stream: int,
) -> Devices:
    """Return configurations of preset names, mappings or configurations.

    Raises:
        ValueError: If a name is unknown or a value is refused.
    """
    check_stream(owner, stream)
    device = usual_cells(drawing) if feet is None else foot_device(feet)
    chosen = timely_link(link)
    if severity != 1.0:
        device = scaled(device, severity)
    return Devices(device, resolve(imu, Imu), resolve(encoders, Encoders), chosen)


def seed_numbers(seed: Seeds) -> list[int]:
    """Return the numbers that a vector environment is seeded with; none without a seed."""
    if seed is None:
        return []
    if isinstance(seed, Sequence):
        return [int(number) for number in seed if number is not None]
    return [int(seed)]


def seed_of_each(seed: Seeds, count: int) -> list[int | None]:
    """Return what each of ``count`` robots is seeded with; one number counts up, as Gymnasium does."""
    if isinstance(seed, Sequence):
        return list(seed)
    return [None if seed is None else seed + robot for robot in range(count)]
