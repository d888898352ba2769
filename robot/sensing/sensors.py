"""The sensors of one robot over all its episodes: truth in, readings and packets of telemetry out.

Wrappers of one robot and of many are made of it, so that a seed gives a robot the same sensors anywhere.
"""

from collections.abc import Sequence
from os import PathLike
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Parameters
from surefoot.calibration.state import load_state, save_state
from surefoot.calibration.weights.known_map import is_file_of_map, read_map
from surefoot.robot.sensing.condition import Condition, channel_states
from surefoot.robot.sensing.equipment import Equipment
from surefoot.robot.sensing.instruments import InstrumentsState
from surefoot.robot.sensing.native import NativeSensing, native_sensing
from surefoot.robot.sensing.raw_view import RawView
from surefoot.robot.streams import wants_fresh
from surefoot.sensors.telemetry.computer import Telemetry
from surefoot.sensors.transport.link import Packets

_EMPTY = dict.fromkeys(("held", "charge", "window", "load", "due", "readings"))
"""Leaves of devices that are NaN or infinite where nothing has been read or sent yet."""


class HardwareState(NamedTuple):
    """State that stays as it is while the power is on, whatever happens to the robot.

    Attributes:
        instruments: The instruments under the feet.
        faults: Its faults, or ``()``; of faults by chance as well, which last for an episode.
        telemetry: IMU and encoders (:class:`~surefoot.sensors.telemetry.computer.Hardware`), or ``None``
            where nobody listens.
        severity: Factor of its errors, or ``None`` where it is the same for all robots.
    """

    instruments: InstrumentsState
    faults: Any
    telemetry: Any
    severity: float | None = None


class RobotSensors:
    """One robot's sensors, and the host's copies of their readings.

    Args:
        equipment: Its equipment.
        listening: Whether telemetry is sent.
        view: Its view, if the library is to put the observation together as well.

    Attributes:
        equipment: The same.
        conditions: The distribution of its condition: its severity with fresh sensors, faults by chance at
            each reset. They may be changed, for the next one.
        listening: Whether telemetry is sent from the next reset on.
        clock: The host's time since the reset in s, shape (1,).
        sensing: The library's reader, if it has read the last step.
        sensors_fresh: Whether the last reset drew fresh sensors.
        held: The last reading of each channel that has arrived in counts, shape (K,).
        newest: Values of the newest packet that has arrived.
    """

    def __init__(self, equipment: Equipment, listening: bool, view: RawView | None = None) -> None:
        self.equipment, self.listening, self._view = equipment, listening, view
        self.conditions, self._fitted = equipment.conditions, equipment.fitted
        self.sensors_fresh, self.clock = True, np.zeros(1)
        self.held = equipment.instruments.zero_code.astype(np.float32)
        self.newest: NDArray[np.float64] = np.zeros(equipment.packet.size)
        self._streams: dict[str, Any] = equipment.streams(None)
        self._hardware: HardwareState | None = None
        self._telemetry: Telemetry | None = None
        self._telemetry_state: Any = None
        self.sensing: NativeSensing | None = None
        self._sends = listening
        self._raw: NDArray[np.float64] | None = None
        self._packets: Packets = ()

    def reset(
        self,
        truth: Any,
        dt: float,
        seed: int | None = None,
        choice: str | None = None,
        observation: Any = None,
    ) -> dict[str, Any] | None:
        """Start an episode, with fresh or kept sensors.

        Args:
            truth: In which it starts.
            dt: Duration of a control step in s.
            seed: Of the reset.
            choice: ``"fresh"`` or ``"keep"``, if it was asked for.
            observation: The environment's observation, where there is a view.

        Returns:
            The observation; ``None`` where the view is left to the caller.
        """
        if seed is not None:
            self._streams = self.equipment.streams(seed)
        if self._telemetry is None or self._telemetry.dt != dt or self._sends != self.listening:
            self._leave_library()
            self._sends = self.listening
        if self._telemetry is None or self._telemetry.dt != dt:
            self._telemetry = self.equipment.telemetry(dt, len(truth.time))
            self.newest[:] = 0.0
        self.sensors_fresh = wants_fresh(choice, seed, self.equipment.fresh, self._hardware is not None)
        self.clock[0], draws = 0.0, self.sensors_fresh or self._telemetry_state is None
        self._renew(self.sensors_fresh)
        # At the reset a robot hangs just above its footprints; packets before are of one that stood.
        at_rest = np.concatenate([self.equipment.drawing.gravity * truth.R_world_torso[-1][2], np.zeros(3)])
        sensing = self._by_library(truth)
        read = None if sensing is None else sensing.begin(truth, at_rest, draws, observation)
        if read is not None:
            self._raw, seen = read
            return seen
        self._leave_library()
        self._begin(truth, at_rest, draws)
        return None

    def step(self, truth: Any, observation: Any = None) -> dict[str, Any] | None:
        """Read a control step.

        Args:
            truth: The step.
            observation: The environment's observation, where there is a view.

        Returns:
            The observation; ``None`` where the view is left to the caller.
        """
        self.clock += self.telemetry.dt
        sensing = self.sensing or self._by_library(truth)
        read = None if sensing is None else sensing.step(truth, self.time, observation)
        if read is not None:
            self._raw, seen = read
            return seen
        self._leave_library()
        self._read(truth, self.telemetry.dt)
        if self._telemetry_state is not None:
            self._packets, self._telemetry_state = self.telemetry.advance(
                truth.joint_position,
                truth.inertial,
                self.time,
                self._telemetry_state,
                self._streams["telemetry"],
            )
        self._note()
        return None

    @property
    def time(self) -> float:
        """The host's time since the reset in s."""
        return self.clock.item()

    @property
    def packets(self) -> Packets:
        """Telemetry that arrived during the last step, in order; only while somebody listens."""
        return self._packets if self.sensing is None else self.sensing.packets()

    def packet_rows(self) -> tuple[int, int] | None:
        """Return where the library has rows of :attr:`packets`, until the next step, and how many."""
        return None if self.sensing is None else self.sensing.packet_rows()

    def keep_in(
        self, held: NDArray[np.float32], newest: NDArray[np.float64], clock: NDArray[np.float64]
    ) -> None:
        """Keep :attr:`held`, :attr:`newest` and :attr:`clock` in other arrays from here on."""
        self._leave_library()
        held[...], newest[...], clock[...] = self.held, self.newest, self.clock
        self.held, self.newest, self.clock = held, newest, clock

    @property
    def raw(self) -> NDArray[np.float64]:
        """The feet's last reading in counts, in double precision, shape (K,); NaN: none arrived."""
        if self._raw is None:
            raise gym.error.ResetNeeded("There are no readings before the first reset().")
        return self._raw

    @property
    def telemetry(self) -> Telemetry:
        """The layout of the packets (``telemetry.layout``) and their rate."""
        if self._telemetry is None:
            raise gym.error.ResetNeeded("There is no telemetry before the first reset().")
        return self._telemetry

    def true_parameters(self) -> Parameters:
        """Return the map that undoes the feet's errors now, shape (K,) each: truth, to score against."""
        return self._fitted.instruments.true_map(self._devices.instruments)

    @property
    def condition(self) -> Condition:
        """How bad its sensors are in this episode."""
        return self._fitted.condition

    @property
    def differs(self) -> bool:
        """Whether its condition is its own: drawn, or set since it was equipped."""
        return self.conditions.by_chance or self.conditions != self.equipment.conditions

    def true_condition(self) -> dict[str, NDArray[Any]]:
        """Return the condition, as truth for a critic: ``severity``, and ``fault`` (K,) of each channel.

        A channel's is 0, or 1 plus the place of its fault in :data:`~surefoot.sensors.faults.channels.KINDS`.
        """
        severity, faults = self.condition
        states = channel_states(faults, self._fitted.instruments.channels)
        return {"severity": np.array(severity), "fault": states}

    def hardware(self) -> HardwareState:
        """Return the present hardware, telemetry's part included, as the Python has it."""
        found, conditions = self._devices, self.conditions
        if conditions.chances:
            found = found._replace(faults=())
        if conditions.lowest < conditions.highest:
            found = found._replace(severity=self.condition.severity)
        if self._telemetry_state is None:
            return found
        return found._replace(telemetry=self.telemetry.hardware(self._telemetry_state))

    def exchange(self, hardware: HardwareState) -> None:
        """Go on with other hardware."""
        self._leave_library()
        if hardware.severity is not None:
            self._fitted = self.equipment.fit(self.condition._replace(severity=hardware.severity))
        faults = self._devices.faults if self.conditions.chances else hardware.faults
        self._hardware = hardware._replace(faults=faults, severity=None)
        if self._telemetry_state is not None:
            self._telemetry_state = self.telemetry.with_hardware(self._telemetry_state, hardware.telemetry)

    def take_map(self, path: str | PathLike[str]) -> None:
        """Go on with load cells that the map in a JSON file undoes."""
        kept, instruments = self.hardware(), self._fitted.instruments
        true, curves = read_map(path, instruments.layout.channel_names)
        if curves.any:
            raise ValueError(
                f"'{path}' has curves, and simulated cells have none; leave 'curves' out of it. Calibrators "
                "take them: FootCalibrator(initial=...), SelfCalibration(initial=...)."
            )
        self.exchange(kept._replace(instruments=instruments.with_map(kept.instruments, true)))

    def notes(self) -> dict[str, str]:
        """Name the robot and the sensors that saved hardware belongs to."""
        read = "none" if self._telemetry_state is None else "an IMU and encoders, which are read"
        return {**self.equipment.notes(), "telemetry": read}

    @property
    def _devices(self) -> HardwareState:
        """The instruments under the feet and their faults, as the Python has them."""
        if self._hardware is None:
            raise RuntimeError("There are no sensors before the first reset(), which draws them.")
        return self._hardware if self.sensing is None else HardwareState(*self.sensing.python(), None)

    def _by_library(self, truth: Any) -> NativeSensing | None:
        """Let the library read from here on; ``None`` where it cannot, and Python does."""
        if self.sensing is None:
            hardware, telemetry = self._devices, self.telemetry
            self.sensing = native_sensing(
                truth,
                self._fitted.instruments,
                self._fitted.native,
                telemetry if self._sends else None,
                self._telemetry_state,
                telemetry.dt,
                (self.newest, self.held),
                self._view,
            )
            if self.sensing is not None:
                self._telemetry_state = self.sensing.telemetry_state
                self.sensing.take(*hardware[:2])
        if self.sensing is not None:
            self.sensing.draw_from(self._streams)
        return self.sensing

    def _leave_library(self) -> None:
        """Let Python read from here on."""
        if self.sensing is not None:
            self._packets, self._hardware, self.sensing = self.packets, self._devices, None

    def __getstate__(self) -> dict[str, Any]:
        # The library's records and rows stay behind.
        if self.sensing is None:
            return vars(self)
        return {**vars(self), "_packets": self.packets, "_hardware": self._devices, "sensing": None}

    def _renew(self, fresh: bool) -> None:
        """Draw the hardware of an episode's start; sensors of the telemetry are drawn as that begins."""
        before, streams, equipment = self._fitted, self._streams, self.equipment
        condition = self.conditions.draw(
            before.condition, fresh, before.instruments.channels, streams["condition"]
        )
        changed = condition != before.condition
        if changed:
            self._leave_library()
            self._fitted = equipment.fit(condition)
        instruments, broken = self._fitted.instruments, self._fitted.broken
        if not (fresh or changed or self.conditions.chances):
            return
        faults = () if broken is None else broken.init((instruments.channels,), streams["faults"])
        drawn = instruments.init(streams) if fresh else self._devices.instruments
        self._hardware = HardwareState(drawn, faults, None)
        if self.sensing is not None:
            self.sensing.take(*self._hardware[:2])
        if fresh:
            self.held[:] = instruments.zero_code

    def _begin(self, truth: Any, at_rest: NDArray[np.float64], draws: bool) -> None:
        """Read every chip and the link under the first load, in Python."""
        instruments, kept = self._fitted.instruments, None if draws else self.hardware().telemetry
        with_load = instruments.with_load(truth, self._devices.instruments)
        self._hardware = self._devices._replace(instruments=with_load)
        for dt in instruments.first_steps(self.telemetry.dt):
            self._read(truth, dt)
        if self._sends:
            self._packets, self._telemetry_state = self.telemetry.init(
                truth.joint_position[-1].copy(), at_rest, self._streams["telemetry"], kept
            )
        self._note()

    def _read(self, truth: Any, dt: float) -> None:
        hardware, fitted = self._devices, self._fitted
        self._raw, state = fitted.instruments.read(truth, hardware.instruments, self._streams, dt)
        hardware = hardware._replace(instruments=state)
        if fitted.broken is not None:
            self._raw, faults = fitted.broken.apply(self._raw, hardware.faults, self._streams["faults"], dt)
            hardware = hardware._replace(faults=faults)
        self._hardware = hardware

    def _note(self) -> None:
        """Keep the readings that have arrived."""
        arrived = ~np.isnan(self.raw)
        self.held[arrived] = self.raw[arrived]
        if self.packets:
            self.newest[:] = self.packets[-1].values


def save_hardware(path: str | PathLike[str], robots: Sequence[RobotSensors]) -> None:
    """Write the hardware's lasting state of robots to an ``.npz``.

    Raises:
        RuntimeError: If nothing was drawn yet.
    """
    save_state(path, _together(robots), _EMPTY, **robots[0].notes())


def load_hardware(path: str | PathLike[str], robots: Sequence[RobotSensors]) -> None:
    """Go on with the hardware of a file that :func:`save_hardware` wrote for as many robots.

    Or with load cells that the map of a ``.json`` undoes, which ``surefoot calibrate weights`` wrote.

    Raises:
        RuntimeError: If nothing was drawn yet.
        ValueError: If the file is of another robot, or of other sensors, or its map has curves.
    """
    if is_file_of_map(path):
        for robot in robots:
            robot.take_map(path)
        return
    found = load_state(path, _together(robots), _EMPTY, **robots[0].notes())
    for robot, hardware in zip(robots, (found,) if len(robots) == 1 else found, strict=True):
        robot.exchange(hardware)


def _together(robots: Sequence[RobotSensors]) -> Any:
    """Return the hardware of one robot as it is, and of many side by side."""
    found = tuple(robot.hardware() for robot in robots)
    return found[0] if len(found) == 1 else found
