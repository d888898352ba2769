"""The sensors of one robot over all its episodes: truth in, readings and packets of telemetry out.

Wrappers of one robot and of many use it, so that a seed gives a robot the same sensors everywhere.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from os import PathLike
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import Parameters
from surefoot.calibration.state import load_state, save_state
from surefoot.calibration.weights.known_map import is_file_of_map, read_map
from surefoot.pickles import OfOneVersion
from surefoot.robot.sensing.condition import Condition, channel_states
from surefoot.robot.sensing.equipment import Equipment
from surefoot.robot.sensing.instruments import HardwareState
from surefoot.robot.sensing.native import SensingBackend, native_sensing, places_in
from surefoot.robot.sensing.python import PythonSensing
from surefoot.robot.sensing.raw_view import RawView
from surefoot.robot.streams import wants_fresh
from surefoot.sensors.telemetry.computer import Telemetry
from surefoot.sensors.transport.link import Packets

_EMPTY = dict.fromkeys(("held", "charge", "window", "load", "due", "readings"))
"""Fields of devices that are NaN or infinite before anything has been read or sent."""


class RobotSensors(OfOneVersion):
    """One robot's sensors, and the host's copies of their readings.

    Args:
        equipment: Its equipment.
        listening: Whether telemetry is sent.
        view: Its view, if the library also assembles the observation.

    Attributes:
        equipment: The same.
        conditions: The distribution of its condition. The severity is drawn with fresh sensors, random faults
            at each reset. A change takes effect at the next reset.
        listening: Whether telemetry is sent from the next reset on.
        clock: The host's time since the reset in s, shape (1,).
        sensors_fresh: Whether the last reset drew fresh sensors.
        held: The last reading of each channel that has arrived in counts, shape (K,).
        newest: Values of the newest packet that has arrived.
    """

    def __init__(self, equipment: Equipment, listening: bool, view: RawView | None = None) -> None:
        self.equipment, self.listening, self._view = equipment, listening, view
        self.conditions, self._instruments = equipment.conditions, equipment.instruments
        self.sensors_fresh, self.clock = True, np.zeros(1)
        self.held = equipment.instruments.zero_code.astype(np.float32)
        self.newest: Floats = np.zeros(equipment.packet.size)
        self._streams: dict[str, Any] = equipment.streams(None)
        self._telemetry: Telemetry | None = None
        self._backend: SensingBackend | None = None
        self._chosen_for: Any = None
        self._raw: Floats | None = None

    def reset(
        self,
        truth: Any,
        dt: float,
        seed: int | None = None,
        choice: str | None = None,
        observation: Any = None,
        gravity: Floats | None = None,
    ) -> dict[str, Any]:
        """Start an episode, with fresh or kept sensors.

        Args:
            truth: In which it starts.
            dt: Duration of a control step in s.
            seed: Of the reset.
            choice: ``"fresh"`` or ``"keep"``, if it was asked for.
            observation: The environment's observation, where there is a view.
            gravity: Acceleration of free fall in the world in this episode in m/s^2, shape (3,); ``None``
                for that of the drawing.

        Returns:
            The observation; empty without a view.
        """
        if seed is not None:
            self._streams = self.equipment.streams(seed)
        if self._telemetry is None or self._telemetry.dt != dt:
            self._telemetry = self.equipment.telemetry(dt, len(truth.time))
            self.newest[:] = 0.0
        self.sensors_fresh = wants_fresh(choice, seed, self.equipment.fresh, self._backend is not None)
        self.clock[0] = 0.0
        hardware = self._choose(truth, self._renew(self.sensors_fresh))
        # At the reset a robot hangs just above its footprints; packets before are of one that stood.
        fall = self.equipment.drawing.gravity_world if gravity is None else gravity
        at_rest = np.concatenate([-fall @ truth.R_world_torso[-1], np.zeros(3)])
        draws = hardware is not None and hardware.telemetry is None
        self._raw, seen = self.backend.begin(truth, at_rest, draws, observation)
        return seen

    def step(self, truth: Any, observation: Any = None) -> dict[str, Any]:
        """Read a control step.

        Returns:
            The observation, where there is a view of the environment's; else empty.
        """
        self.clock += self.telemetry.dt
        self._raw, seen = self.backend.step(truth, self.time, observation)
        return seen

    @property
    def backend(self) -> SensingBackend:
        """The reader of this episode."""
        if self._backend is None:
            raise RuntimeError("There are no sensors before the first reset(), which draws them.")
        return self._backend

    @property
    def time(self) -> float:
        """The host's time since the reset in s."""
        return self.clock.item()

    @property
    def packets(self) -> Packets:
        """Telemetry that arrived during the last step, in order, if :attr:`listening`."""
        return () if self._backend is None else self._backend.packets()

    def packet_rows(self) -> tuple[int, int] | None:
        """Return the address and number of rows of :attr:`packets` in C, valid until the next step."""
        return self.backend.packet_rows()

    def keep_in(self, held: NDArray[np.float32], newest: Floats, clock: Floats) -> None:
        """Use other arrays for :attr:`held`, :attr:`newest` and :attr:`clock`."""
        held[...], newest[...], clock[...] = self.held, self.newest, self.clock
        self.held, self.newest, self.clock = held, newest, clock
        if self._backend is not None:
            self._backend.keep_in(newest, held)

    @property
    def raw(self) -> Floats:
        """The feet's last reading in counts, in double precision, shape (K,); NaN: none arrived."""
        if self._raw is None:
            raise gym.error.ResetNeeded("There are no readings before the first reset().")
        return self._raw

    @property
    def ages(self) -> Floats | None:
        """The age of each channel's last reading in s, shape (K,); ``None`` if cells do not report it."""
        return self.backend.ages()

    @property
    def telemetry(self) -> Telemetry:
        """The layout of the packets (``telemetry.layout``) and their rate."""
        if self._telemetry is None:
            raise gym.error.ResetNeeded("There is no telemetry before the first reset().")
        return self._telemetry

    def true_parameters(self) -> Parameters:
        """Return the map that corrects the feet's present errors, shape (K,) each: truth, for scoring."""
        return self._instruments.true_map(self.backend.hardware())

    @property
    def condition(self) -> Condition:
        """How bad its sensors are in this episode."""
        return self._instruments.condition

    @property
    def differs(self) -> bool:
        """Whether its condition differs from other robots': drawn, or changed after construction."""
        return self.conditions.by_chance or self.conditions != self.equipment.conditions

    def true_condition(self) -> dict[str, NDArray[Any]]:
        """Return the condition, as truth for a critic: ``severity``, and ``fault`` (K,) of each channel.

        The fault of a channel is 0, or 1 plus the index of its kind in
        :data:`~surefoot.sensors.faults.channels.KINDS`.
        """
        severity, faults = self.condition
        states = channel_states(faults, self._instruments.channels)
        return {"severity": np.array(severity), "fault": states}

    def hardware(self) -> HardwareState:
        """Return the present hardware, telemetry included, in Python's form."""
        found, conditions = self.backend.hardware(), self.conditions
        if conditions.chances:
            found = found._replace(faults=())
        if conditions.lowest < conditions.highest:
            found = found._replace(severity=self.condition.severity)
        return found

    def exchange(self, hardware: HardwareState) -> None:
        """Replace the hardware."""
        backend = self.backend
        faults = backend.hardware().faults if self.conditions.chances else hardware.faults
        taken = hardware._replace(faults=faults, severity=None)
        if hardware.severity in (None, self.condition.severity):
            backend.take(taken)
            return
        # Another severity needs other instruments.
        self._instruments = self.equipment.fit(self.condition._replace(severity=hardware.severity))
        python = backend.python()
        python.instruments = self._instruments
        python.take(taken)
        self._backend = native_sensing(python)

    def take_map(self, path: str | PathLike[str]) -> None:
        """Replace the load cells by ones whose errors the map in a JSON file corrects."""
        kept, instruments = self.hardware(), self._instruments
        true, curves = read_map(path, instruments.layout.channel_names)
        if curves.any:
            raise ValueError(
                f"'{path}' has curves, and simulated cells have none; leave 'curves' out of it. Calibrators "
                "take them: FootCalibrator(initial=...), SelfCalibration(initial=...)."
            )
        self.exchange(instruments.with_map(kept, true))

    def notes(self) -> dict[str, str]:
        """Return a description of the robot and the sensors, which is saved with hardware."""
        read = "none" if self.backend.hardware().telemetry is None else "an IMU and encoders, which are read"
        return {**self.equipment.notes(), "telemetry": read}

    def _choose(self, truth: Any, hardware: HardwareState | None) -> HardwareState | None:
        """Choose the reader of an episode, the last one if nothing has changed; return the hardware it uses.

        Without hardware it continues with that of the last episode.
        """
        telemetry = self._telemetry if self.listening else None
        chosen_for = self._instruments, telemetry, truth.rows.shape[1]
        if chosen_for != self._chosen_for:
            hardware = hardware or self.backend.hardware()
            kept = self.newest, self.held
            python = PythonSensing(self._instruments, telemetry, self.telemetry.dt, kept, self._view)
            python.take(hardware)
            python.places = places_in(truth, self._instruments)
            self._backend, self._chosen_for = native_sensing(python), chosen_for
        elif hardware is not None:
            self.backend.take(hardware)
        self.backend.draw_from(self._streams)
        return hardware

    def _renew(self, fresh: bool) -> HardwareState | None:
        """Return the hardware at the start of an episode, without telemetry if that is drawn later.

        ``None`` if it is that of the last episode.
        """
        before, streams = self._instruments, self._streams
        condition = self.conditions.draw(before.condition, fresh, before.channels, streams["condition"])
        changed = condition != before.condition
        if changed:
            self._instruments = self.equipment.fit(condition)
        if not (fresh or changed or self.conditions.chances):
            return None
        if not fresh:
            return self.backend.hardware()._replace(faults=self._instruments.init_faults(streams))
        self.held[:] = self._instruments.zero_code
        return self._instruments.init(streams)


class SensorsFace(ABC):
    """The common part of wrappers of sensors, of one robot or of many."""

    @property
    @abstractmethod
    def _robots(self) -> Sequence[RobotSensors]: ...

    def _gather(self) -> None:  # noqa: B027
        """React to replaced records of robots; not needed for one robot."""

    def save(self, path: str | PathLike[str]) -> None:
        """Write the lasting state of the hardware, its scales and offsets, to an ``.npz``.

        Raises:
            RuntimeError: If there has been no reset yet.
        """
        save_state(path, self._hardware(), _EMPTY, **self._robots[0].notes())

    def load(self, path: str | PathLike[str]) -> None:
        """Load hardware that :meth:`save` wrote for the same number of robots, or a map for all robots.

        With a ``.json`` of ``surefoot calibrate weights`` load cells get the errors that its map corrects.

        Raises:
            RuntimeError: If the environment has not been reset.
            ValueError: If the file belongs to other robots or sensors, or its map has curves.
        """
        robots = self._robots
        if is_file_of_map(path):
            for robot in robots:
                robot.take_map(path)
        else:
            found = load_state(path, self._hardware(), _EMPTY, **robots[0].notes())
            for robot, hardware in zip(robots, (found,) if len(robots) == 1 else found, strict=True):
                robot.exchange(hardware)
        self._gather()

    def _hardware(self) -> Any:
        """Return the hardware of one robot, or a tuple of that of many."""
        found = tuple(robot.hardware() for robot in self._robots)
        return found[0] if len(found) == 1 else found
