"""The instruments under one robot's feet: load cells, six-axis sensors in the ankles, or both.

Channels are ordered foot by foot: (left cells, left ankle, right cells, right ankle). The weight of a level
foot below its ankle sensor counts as part of that sensor's offset, as it does for a calibrator.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import FeetLayout, FootLayout, Parameters
from surefoot.envs import RobotDrawing
from surefoot.robot.sensing.condition import AS_STATED, Condition
from surefoot.robot.sensing.device import FootDevice, first_steps
from surefoot.sensors import ForceTorque, LoadCells, channel_faults, force_torque, load_cells, scaled, sized
from surefoot.sensors.corruption import Corruption, Rng
from surefoot.sensors.devices.force_torque import ForceTorqueState
from surefoot.sensors.devices.load_cells import LoadCellState, true_map, with_true_map
from surefoot.sensors.devices.native_device import native_here
from surefoot.sensors.devices.native_kinds import CELLS, FAULTS, FORCE_TORQUE, Broken
from surefoot.sensors.faults.channels import FaultState
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.sensors.stages.shear import mix
from surefoot.sensors.transport.wire import check_wire

USUAL_LENGTH = 0.2
"""Length in m that scales errors of moments for a foot without a length, such as a sphere; chosen."""

PEAK: Final = 1.5
"""Load of a foot in body weights: the whole robot, and half as much again when it lands; chosen."""


class HardwareState(NamedTuple):
    """State that hardware keeps while the power is on, whatever happens to the robot."""

    cells: Any = ()  # state of the load cells, or ``()``
    ankles: Any = ()  # state of the six-axis sensors, or ``()``
    faults: Any = ()  # state of the faults of channels, also of random ones, which last for an episode
    telemetry: Any = None
    """IMU and encoders (:class:`~surefoot.sensors.telemetry.computer.Hardware`), or ``None`` where nobody
    listens."""
    severity: float | None = None  # factor of its errors, or ``None`` where it is the same for all robots


class CellsUnderFeet:
    """Four load cells under each sole, or one per foot, which measures the force along its sole's z axis.

    One is enough for a foot with a point contact, such as a quadruped's. Its force acts at that point.

    Attributes:
        name: Field of their state in :class:`HardwareState`.
        kind: Their kind in the library.
        device: The model of their errors.

    Raises:
        ValueError: If a foot has no positions for cells, or the number of cells does not match.
    """

    name: Final = "cells"
    kind: Final = CELLS

    def __init__(self, config: LoadCells, drawing: RobotDrawing, dt: float) -> None:
        places, below, feet = drawing.position_cell_sole, drawing.below_cells, len(drawing.feet)
        self._one_a_foot = config.channels == feet
        if not self._one_a_foot and (places is None or below is None):
            raise ValueError(
                f"{drawing.flaw} Or choose six-axis sensors in the ankles, such as "
                "FootSensors(env, 'icub-ftsens'), or one load cell a foot, "
                f"FootSensors(env, LoadCells(channels={feet}, polarity=(1,)))."
            )
        if config.channels not in (feet, 4 * feet):
            raise ValueError(
                f"The robot has room for {4 * feet} cells, four a foot, or for {feet}, one a foot, but "
                f"LoadCells.channels is {config.channels}."
            )
        self.config, self.channels = config, config.channels
        self.nominal = Parameters(config.nominal_scale, config.nominal_offset)
        self.slope, self.zero_code = config.slope, config.zero_code
        self.age = config.nominal_age + (0.5 * dt if config.averaged and config.rate is None else 0.0)
        low, high = (np.full(self.channels, end) for end in config.code_range)
        self.code_range = low, high
        self.feet = tuple(self._foot(name, i, drawing) for i, name in enumerate(drawing.sides))
        self.device: Corruption[LoadCellState] = load_cells(config)

    def with_load(self, truth: Any, state: LoadCellState) -> LoadCellState:
        """Return the state under the present load, without a memory of the last episode."""
        load = self.load(truth)[-1]
        load = mix(load, state.shear) if self.config.shear_std else load
        return state._replace(charge=load * (state.period - state.due))

    def load(self, truth: Any) -> Floats:
        """Return the true loads in each substep in N, shape (S, K), or (S, 3 K) with shear."""
        vertical = self._vertical(truth)
        if not self.config.shear_std:
            return vertical
        across = (truth.wrench_sole[..., i] for i in (0, 1)) if self._one_a_foot else (truth.shear_cell,)
        return np.concatenate([vertical, *across], axis=-1)

    def _vertical(self, truth: Any) -> Floats:
        """Return the vertical loads, shape (S, K)."""
        load: Floats = truth.wrench_sole[..., 2] if self._one_a_foot else truth.force_cell
        return load

    def force(self, truth: Any) -> Floats:
        """Return the true forces of a control step in N, shape (K,): means for cells that average."""
        instant = self.config.rate is None and not self.config.averaged
        load = self._vertical(truth)
        force: Floats = load[-1] + 0.0 if instant else load.mean(axis=0)
        return force

    def cell_map(self, truth: Any) -> tuple[Floats, Floats] | None:
        """Return the linear map from rows of truth to the loads of :meth:`load`: factors, and N to add.

        ``None`` if the library cannot read these loads: single cells in a simulation of plates.
        """
        if not self._one_a_foot:
            found: tuple[Floats, Floats] = truth.layout.cell_map
            if not self.config.shear_std:
                return found
            across = truth.layout.shear_map
            return np.hstack([found[0], across]), np.append(found[1], np.zeros(across.shape[1]))
        if not truth.columns.sensed.soles:
            return None
        parts = [np.kron(np.eye(self.channels), np.eye(6)[:, [i]]) for i in (2, 0, 1)]
        factors = np.hstack(parts)[:, : self.config.loads]
        return factors, np.zeros(self.config.loads)

    def _foot(self, name: str, foot: int, drawing: RobotDrawing) -> FootLayout:
        """Describe one foot."""
        places, below, touching = drawing.position_cell_sole, drawing.below_cells, drawing.touching[foot]
        if not self._one_a_foot and places is not None and below is not None:
            hanging = {"mass_below": float(below.mass[foot]), "com_below_sole": below.com_sole[foot]}
            return FootLayout.load_cells(name, places[foot], **hanging)
        lowest = touching[np.argmin(touching[:, 2] - touching[:, 3])]
        x, y = touching[:, :2].mean(axis=0) if drawing.flaw == "" else lowest[:2]
        return FootLayout(name, np.array([[0.0], [0.0], [1.0], [y], [-x], [0.0]]), ("fz",))

    def true_map(self, state: LoadCellState) -> Parameters:
        """Return the map that corrects their present errors."""
        return Parameters(*true_map(self.config, state))


class SensorsInAnkles:
    """A six-axis sensor in each ankle, read once a control step of ``dt`` s.

    Attributes:
        name: Field of their state in :class:`HardwareState`.
        kind: Their kind in the library.
        device: The model of their errors.

    Raises:
        ValueError: If the number of sensors is not that of the feet.
    """

    name: Final = "ankles"
    kind: Final = FORCE_TORQUE

    def __init__(self, config: ForceTorque, drawing: RobotDrawing, dt: float) -> None:
        below = drawing.below_ankle
        if config.sensors != len(drawing.feet):
            raise ValueError(
                f"The robot has {len(drawing.feet)} ankles, but ForceTorque.sensors is {config.sensors}."
            )
        self.config = config
        self.channels = config.channels
        self.nominal = Parameters(config.nominal_scale, np.zeros(config.channels))
        self.slope, self.zero_code = config.slope, config.zero_code
        self.age = config.nominal_age + (0.5 * dt if config.averaged else 0.0)
        self.code_range = config.code_range
        self.feet = tuple(
            FootLayout.force_torque(
                name,
                position_sensor_sole=below.position_sensor_sole[i],
                R_sole_sensor=below.R_sole_sensor[i],
                mass_below=float(below.mass[i]),
                com_below_sole=below.com_sole[i],
            )
            for i, name in enumerate(drawing.sides)
        )
        self.preload = np.concatenate([_weight(foot, drawing.gravity) for foot in self.feet])
        self.device: Corruption[ForceTorqueState] = force_torque(config)

    def with_load(self, truth: Any, state: ForceTorqueState) -> ForceTorqueState:
        """Return the state unchanged: readings do not depend on earlier loads."""
        return state

    def load(self, truth: Any) -> Floats:
        """Return the loads of the whole control step, or of its end, in N and N m, shape (K,)."""
        wrench: Floats = truth.wrench_ankle
        load: Floats = wrench.mean(axis=0) if self.config.averaged else wrench[-1]
        return load.ravel()

    def force(self, truth: Any) -> Floats:
        """Return the true loads of a control step in N and N m, (K,): means for sensors that average."""
        force: Floats = self.load(truth) + self.preload
        return force

    def true_map(self, state: ForceTorqueState) -> Parameters:
        """Return the map that corrects the present errors of each axis, without cross-talk."""
        gain = 1.0 + np.diagonal(state.error, axis1=-2, axis2=-1).ravel()
        return Parameters(self.nominal.scale / gain, self.preload - state.offset.ravel() / gain)

    def cross_talk(self, state: ForceTorqueState) -> Floats:
        """Return the cross-talk, one row per reading channel, shape (K, K)."""
        scale = self.config.full_scale[:6]
        off = state.error * (1.0 - np.eye(6)) * (scale[:, None] / scale)
        talk = np.zeros((self.channels, self.channels))
        for i, block in enumerate(off):
            talk[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = block
        return talk


class Instruments:
    """All instruments under the feet: one kind, or load cells and six-axis sensors, as one row of K channels.

    Args:
        devices: Load cells, six-axis sensors, or one of each.
        drawing: The robot.
        dt: Duration of a control step in s.
        condition: How bad they are; as the devices state it, without faults, when not given.

    Attributes:
        condition: The same.
        broken: The faults of channels; ``None`` without any.
        native: Parts and faults as the library has them, by :data:`~surefoot.robot.streams.DEVICES`; ``None``
            where it has no room for one.
        channels: Their number K.
        parts: The kinds of instruments, load cells first.
        order: Index of each of the K channels in the concatenated rows of the parts, shape (K,).
        layout: Maps from channels to the wrenches of the feet.
        nominal: The map by the data sheets, shape (K,).
        slope: Counts per newton (or N m) by the data sheets, shape (K,).
        zero_code: Readings without load by the data sheets in counts, shape (K,).
        code_range: Lowest and highest readings in counts, shape (K,) each.
        space: Box of the readings in counts, shape (K,).
        age: Mean age of a reading when it is taken in s; that of the cells if there are both kinds.
        ages: Mean age of each channel in s, shape (K,).
        cross_talk: Share of a load that another axis of a six-axis sensor shows, by its data sheet; ``None``
            without such sensors.
        residue: What cells of a foot in swing typically still read of the load before, in body weights.

    Raises:
        ValueError: If an instrument does not fit the robot, or a kind is given twice.
    """

    def __init__(
        self,
        devices: tuple[FootDevice, ...],
        drawing: RobotDrawing,
        dt: float,
        condition: Condition = AS_STATED,
    ) -> None:
        self.condition = condition
        devices = tuple(
            device if condition.severity == 1.0 else scaled(device, condition.severity) for device in devices
        )
        for device in devices:
            check_wire(device, dt)
        kinds = [type(device) for device in devices]
        if not kinds or len(set(kinds)) < len(kinds):
            raise ValueError(
                f"Give load cells, six-axis sensors or one of each, got {[kind.__name__ for kind in kinds]}."
            )
        found: list[CellsUnderFeet | SensorsInAnkles] = [
            CellsUnderFeet(device, drawing, dt)
            if isinstance(device, LoadCells)
            else SensorsInAnkles(device, drawing, dt)
            for device in devices
        ]
        self.parts = tuple(sorted(found, key=lambda part: isinstance(part, SensorsInAnkles)))
        self.channels = sum(part.channels for part in self.parts)
        self._one = len(self.parts) == 1
        self.order = self._foot_by_foot(len(drawing.feet))
        feet = zip(*(part.feet for part in self.parts), strict=True)
        self.layout = FeetLayout(
            tuple(
                replace(foot[0] if self._one else FootLayout.combined(name, *foot), flat=not drawing.flaw)
                for name, foot in zip(drawing.sides, feet, strict=True)
            )
        )
        self.nominal = self._parameters([part.nominal for part in self.parts])
        self.slope = self.join([part.slope for part in self.parts])
        self.zero_code = self.join([np.full(part.channels, part.zero_code) for part in self.parts])
        low, high = (self.join([part.code_range[i] for part in self.parts]) for i in (0, 1))
        self.code_range = low, high
        with np.errstate(over="ignore"):
            self.space = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        self.age = self.parts[0].age
        cells = [part.config for part in self.parts if isinstance(part.config, LoadCells)]
        # A foot bears the weight on its cells, and then hangs.
        self.residue = max((len(drawing.feet) * one.residue / one.channels for one in cells), default=0.0)
        six_axis = [part.config for part in self.parts if isinstance(part.config, ForceTorque)]
        self.cross_talk = six_axis[0].cross_talk_std if six_axis else None
        self.ages = self.join([np.full(part.channels, part.age) for part in self.parts])
        self._add_faults()

    def _add_faults(self) -> None:
        """Build the faults and the library's devices."""
        self.native = {part.name: native_here(part.kind, part.config) for part in self.parts}
        self.broken: Corruption[FaultState] | None = None
        if faults := self.condition.faults:
            self.broken = channel_faults(faults, self)
            self.native["faults"] = native_here(FAULTS, Broken(faults, self))

    def __getstate__(self) -> dict[str, Any]:
        # Faults refer to these instruments, and are built again from them.
        return {name: part for name, part in vars(self).items() if name not in ("native", "broken")}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        vars(self).update(kept)
        self._add_faults()

    def reading_ages(self, cells: Any) -> Floats | None:
        """Return the age of each reading in s, shape (K,); ``None`` of instruments that do not report it.

        Args:
            cells: State of the load cells: whatever has ``period`` and ``due``, in s, shape (K,) each.
        """
        config = self.parts[0].config
        if not (isinstance(config, LoadCells) and config.stamped):
            return None
        # A reading is the mean over its conversions, of which the last ended some time ago.
        own = cells["period"] - cells["due"] + 0.5 * config.settling * cells["period"]
        return self.join([own, *(np.full(part.channels, part.age) for part in self.parts[1:])])

    def first_steps(self, dt: float) -> list[float]:
        """Return :func:`~surefoot.robot.sensing.device.first_steps` of these instruments."""
        return first_steps(tuple(part.config for part in self.parts), dt)

    def init(self, streams: Mapping[str, Rng]) -> HardwareState:
        """Draw instruments and faults, each from its own stream, by name."""
        drawn: dict[str, Any] = {
            part.name: part.device.init((part.channels,), streams[part.name]) for part in self.parts
        }
        return HardwareState(**drawn, faults=self.init_faults(streams))

    def init_faults(self, streams: Mapping[str, Rng]) -> Any:
        """Draw the state of the faults alone; ``()`` without any."""
        return () if self.broken is None else self.broken.init((self.channels,), streams["faults"])

    def read(
        self, truth: Any, state: HardwareState, streams: Mapping[str, Rng], dt: float
    ) -> tuple[Floats, HardwareState]:
        """Read the instruments after a control step of ``dt`` s, with one random stream per device, by name.

        Returns:
            Counts, shape (K,), and the state.
        """
        readings: list[Floats] = []
        for part in self.parts:
            device: Corruption[Any] = part.device
            reading, after = device.apply(part.load(truth), getattr(state, part.name), streams[part.name], dt)
            readings.append(reading)
            state = state._replace(**{part.name: after})
        raw = readings[0] if self._one else self.join(readings)
        if self.broken is not None:
            raw, faults = self.broken.apply(raw, state.faults, streams["faults"], dt)
            state = state._replace(faults=faults)
        return raw, state

    def with_load(self, truth: Any, state: HardwareState) -> HardwareState:
        """Return the state under the present loads, at the start of an episode."""
        for part in self.parts:
            loaded: dict[str, Any] = {part.name: part.with_load(truth, getattr(state, part.name))}
            state = state._replace(**loaded)
        return state

    def true_map(self, state: HardwareState) -> Parameters:
        """Return the map that corrects their present errors: truth, for scoring calibrators."""
        return self._parameters([part.true_map(getattr(state, part.name)) for part in self.parts])

    def with_map(self, state: HardwareState, true: Parameters) -> HardwareState:
        """Return the state of load cells whose errors a map corrects; ValueError for other instruments."""
        config = self.parts[0].config
        if not (self._one and isinstance(config, LoadCells)):
            raise ValueError("A map of known weights is of load cells alone, and there are six-axis sensors.")
        return state._replace(cells=with_true_map(config, state.cells, *true))

    def join(self, parts: list[Floats]) -> Floats:
        """Merge one row per device into one row, foot by foot."""
        row: Floats = np.concatenate(parts)[self.order]
        return row

    def _parameters(self, parts: list[Parameters]) -> Parameters:
        return Parameters(*(self.join([part[i] for part in parts]) for i in (0, 1)))

    def _foot_by_foot(self, feet: int) -> NDArray[np.intp]:
        per_foot = [part.channels // feet for part in self.parts]
        starts = np.cumsum([0, *(part.channels for part in self.parts[:-1])])
        return np.concatenate(
            [
                start + foot * k + np.arange(k)
                for foot in range(feet)
                for start, k in zip(starts, per_foot, strict=True)
            ]
        )


def usual_cells(drawing: RobotDrawing) -> LoadCells:
    """Return the cells of ``hx711-load-cells``, scaled to the robot's weight if they are too small."""
    usual = replace(HX711_LOAD_CELLS, channels=4 * len(drawing.feet))
    bears = _rating(usual, drawing)[0] >= PEAK * drawing.weight
    return usual if bears else sized(usual, drawing.weight)


def check_capacity(devices: Sequence[FootDevice], drawing: RobotDrawing) -> None:
    """Warn about instruments that are too small for a robot.

    Warns:
        UserWarning: If a foot's instruments are rated for less than 1.5 times the robot's weight.
    """
    for device in devices:
        capacity, what, way_out = _rating(device, drawing)
        if capacity < PEAK * drawing.weight:
            warnings.warn(
                f"{what} are rated for {capacity:.0f} N a foot, and a foot of this robot of "
                f"{drawing.weight:.0f} N bears {PEAK * drawing.weight:.0f} N when it lands: they are "
                f"overloaded, or read too little. To choose others, {way_out}.",
                stacklevel=4,
            )


def _rating(device: FootDevice, drawing: RobotDrawing) -> tuple[float, str, str]:
    """Return the rated load of a foot's instruments in N, their name, and how to choose larger ones.

    The rated load of ideal instruments is infinite.
    """
    if not isinstance(device, LoadCells):
        capacity = device.full_scale_force if device.converts else np.inf
        return capacity, "Six-axis sensors", "give a larger ForceTorque.full_scale_force"
    count = device.channels // len(drawing.feet)
    ideal = device.adc_bits == 0 and not device.mechanics.acts
    what = f"{'Load cells' if count == 1 else 'Four load cells'} of {device.capacity:.4g} N"
    way_out = (
        "leave 'config' out, which chooses cells of the robot's size, or give "
        f"sized(config, {drawing.weight:.0f}) of surefoot.sensors"
    )
    return np.inf if ideal else count * device.capacity, what, way_out


def layout_options(layout: FeetLayout, drawing: RobotDrawing) -> dict[str, float]:
    """Return the options of a calibrator that follow from the instruments under the feet.

    They contain a foot length if channels have no positions.
    """
    if all(foot.position_cell_sole is not None for foot in layout.feet):
        return {}
    places = drawing.position_cell_sole
    length = USUAL_LENGTH if places is None else float(np.ptp(places[..., 0], axis=1).max())
    return {"foot_length": length}


def _weight(foot: FootLayout, gravity: float) -> Floats:
    """Weight of a level foot in its sensor's frame, upwards, shape (6,)."""
    sensor = foot.sensors[0]
    load = np.array([0.0, 0.0, sensor.mass_below * gravity])
    wrench_sole = np.concatenate([load, np.cross(sensor.com_below_sole, load)])
    return np.linalg.solve(sensor.wrench_map, wrench_sole)
