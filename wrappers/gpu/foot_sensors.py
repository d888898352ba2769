"""Foot sensors for thousands of robots at once: true forces in, readings out, on the simulator's device.

    feet = FootSensorsModule("hx711-load-cells", env.num_envs, env.device, dt=env.step_dt)
    counts = feet(force, step=env.common_step_counter)      # (N, K), or (N, S, K) for S substeps of a step
    feet.reset(env_ids)                                     # as managers call it

A step is one kernel of ``sensors/native/surefoot_feet.h``, a robot a thread; nothing is copied to the host.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from surefoot.calibration.parameters import Parameters
from surefoot.names import page
from surefoot.robot.sensing.device import FootDevice, first_steps, foot_device
from surefoot.robot.streams import SENSOR_STREAM, device_streams
from surefoot.sensors import Fault, LoadCells, parse_fault, scaled
from surefoot.sensors.devices.load_cells import true_map
from surefoot.sensors.devices.native_cells import CELLS
from surefoot.sensors.devices.native_device import Kind, NativeDevice, NativeState, native_device
from surefoot.sensors.devices.native_faults import FAULTS, Broken
from surefoot.sensors.devices.native_force_torque import FORCE_TORQUE
from surefoot.sensors.faults.words import CELLS as CELL_NAMES
from surefoot.sensors.faults.words import FEET
from surefoot.sensors.presets import resolve
from surefoot.sensors.randomness import Stream
from surefoot.sensors.transport.wire import check_wire
from surefoot.wrappers.gpu.batch import DTYPES, BatchModule, Counter, RobotIds
from surefoot.wrappers.gpu.kernels import Kernel, kernel

_ADVANCE, _BROKEN = 1, 2
"""What a thread is told: that this is a new step, and that channels have faults."""

_BODY = """
    sf_random *streams = (sf_random *)own.data + 2 * robot;
    unsigned char *starts = (unsigned char *)marks.data + robot;
    const sf_{kind}_config *device = (const sf_{kind}_config *)config.data;
    const int K = {channels};
    const sf_real *load = (const sf_real *)given.data + (size_t)robot * rows * {loads};
    sf_real *counts = (sf_real *)found.data + (size_t)robot * K;
    sf_feet feet;
    memset(&feet, 0, sizeof feet);
    feet.{kind}_config = device, feet.{kind} = (sf_{kind} *)state.data + robot, feet.{kind}_stream = streams;
    if (what & 2) {{
        feet.faults_config = (const sf_faults_config *)more.data;
        feet.faults = (sf_faults *)other.data + robot, feet.faults_stream = streams + 1;
    }}
    feet.dt = dt, feet.first = span, feet.more = count;
    if (*starts) sf_feet_begin(&feet, load, rows, load, counts);
    else if (what & 1) sf_feet_step(&feet, load, rows, load, counts);
    *starts = 0;
"""

_DEVICES = {
    True: (CELLS, "device->channels", "sf_loads(device)", "cells"),
    False: (FORCE_TORQUE, "6 * device->sensors", "K", "ankles"),
}
"""For load cells and for others: the library's kind, channels and loads there, who draws for them."""


class FootSensorsModule(BatchModule):
    """Read the feet of N robots through load cells or six-axis sensors.

    **Steps.** A manager may ask several times within one simulation step. With a step's number, from the
    argument ``step`` or from ``counter``, the sensors advance at the first call of a step and hand out copies
    of the same readings at the others. Without one every call is a step.

    **Resets.** Sensors are hardware: a robot that starts an episode keeps its own, and drift goes on. With
    ``fresh=True`` it gets fresh ones, which are drawn on the host. Either way the first load of the new
    episode runs through converters, filters and wires, so that no reading is of the one before, even when
    asked again within the same step.

    **Loads that are not finite**, as of a simulation that blew up, read NaN at the robot that has them and
    have no effect after its next finite ones. Forces come in without their graph: nothing is differentiated.

    **Chance** belongs to the robot: robot i of a module with seed s has the sensors and reads the counts of
    :class:`~surefoot.wrappers.FootSensors` with seed s + i, however many there are and on any device.

    Args:
        config: The name of a preset, a mapping or a configuration.
        num_envs: Number N of robots.
        device: Where forces are and readings are wanted.
        dtype: Of readings, ``float32`` or ``float64``. ``float32`` holds every code of a 24-bit converter.
        seed: Of the first robot; it counts up.
        dt: Time between steps in s.
        severity: Factor of all errors: 0 for none, 1 for the configuration's; see
            :func:`surefoot.sensors.scaled`.
        faults: Faults of single channels, the same for all robots, by the time since a robot's sensors
            were drawn: words (:func:`~surefoot.sensors.parse_fault`; feet are left and right, more than two
            have numbers; axes of six-axis sensors are "cell left/fz"), :class:`~surefoot.sensors.Fault` or
            mappings of its fields.
        counter: Returns the number of the simulation step.

    Attributes:
        config: The instrument with its severity.
        severity: Factor of all errors.
        channels: Number K of readings.
        nominal: The map that a robot may know, by the data sheet, shape (K,) each: where a calibrator starts.

    Raises:
        ValueError: If a preset is unknown, a value is refused, a fault cannot happen, there is no kernel for
            such sensors, or more readings are under way than the wire holds
            (:func:`~surefoot.sensors.transport.wire.check_wire`).
    """

    def __init__(
        self,
        config: str | Mapping[str, Any] | FootDevice,
        num_envs: int,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
        *,
        seed: int = 0,
        dt: float = 1.0 / 50.0,
        severity: float = 1.0,
        faults: Sequence[str | Fault | Mapping[str, Any]] = (),
        counter: Counter | None = None,
    ) -> None:
        super().__init__(num_envs, device, dtype, dt, counter)
        self.config: FootDevice = scaled(foot_device(config), severity)
        self.severity, self.seed = float(severity), seed
        self.channels = self.config.channels
        self.nominal = Parameters(1.0 / self.config.slope, -self.config.zero_code / self.config.slope)
        self._blocks = isinstance(self.config, LoadCells)
        self._broken = Broken(tuple(_fault(fault, self.config) for fault in faults), self.config)
        FAULTS.build(self._broken)  # refuses faults that cannot happen
        check_wire(self.config, self.dt)
        first, *more = first_steps((self.config,), self.dt)
        self._first = len(more), first
        self._slope = torch.as_tensor(self.config.slope, dtype=dtype, device=self.device)
        self._kernel = self._build()
        kind, *_, self._part = _DEVICES[self._blocks]
        parts = self._device(kind, self.config), self._device(FAULTS, self._broken)
        self._config, self._faults_config = (self._record(part.constants) for part in parts)
        streams = [device_streams(SENSOR_STREAM, seed + robot) for robot in range(num_envs)]
        drawn = self._draw((own[self._part], own["faults"]) for own in streams)
        names = "sensors", "faults", "streams"
        self._sensors, self._faults, self._streams = map(self._register, names, drawn)
        self._reading = self._register(
            "reading", torch.full((num_envs, self.channels), torch.nan, dtype=dtype, device=self.device)
        )

    def forward(self, force: Tensor, step: int | None = None) -> Tensor:
        """Read the sensors.

        Args:
            force: True forces in N (for six-axis sensors wrenches in N and N m) at the end of the step, shape
                (N, K), or for load cells at the ends of S equal substeps, shape (N, S, K); 3 K with
                shear, all vertical ones first, then those along the sole's x, then y.
            step: Number of the simulation step, if the module has no ``counter``.

        Returns:
            Readings in counts, shape (N, K), the caller's own.

        Raises:
            TypeError: If forces are no tensor.
            ValueError: If their shape or device is not the module's.
        """
        tails = (("channels",), ("S", "channels")) if self._blocks else (("channels",),)
        loads = getattr(self.config, "loads", self.channels)
        force = self._bring(force, "force", tails, loads).contiguous()
        advances = self._begins(step)
        if advances or self._asked:
            count, first = self._first
            given = (
                *(self._config, self._sensors, self._streams, force, self._faults_config, self._reading),
                *(self._starting, self._faults),
            )
            what = _ADVANCE * advances + _BROKEN * bool(self._broken.faults)
            rows = force.shape[1] if force.ndim == 3 else 1
            self._kernel.launch(self.num_envs, given, what, rows, count, self.dt, first)
            self._asked = False
        return self._reading.clone()

    def reset(self, env_ids: RobotIds = None, fresh: bool = False) -> None:
        """Start new episodes.

        Args:
            env_ids: Robots that begin one; all by default.
            fresh: Whether they get fresh sensors: scales, offsets, clocks, and the time of faults. They are
                drawn on the host, which waits for a GPU.

        Raises:
            ValueError: If there is no such robot.
        """
        mask = self._note_starting(env_ids)
        if fresh:
            those = mask.nonzero()[:, 0]
            keys = self._streams[those].cpu().numpy().view(np.uint64).reshape(-1, 2, 2)
            drawn = self._draw(tuple(map(_stream, pair)) for pair in keys)
            for kept, new in zip((self._sensors, self._faults, self._streams), drawn, strict=True):
                kept[those] = new.to(self.device)

    def newtons(self, counts: Tensor) -> Tensor:
        """Return counts in N (and N m) by the data sheet, as a robot without a calibrator believes them."""
        return (counts - self.config.zero_code) / self._slope

    def true_parameters(self) -> Parameters:
        """Return the map that undoes the load cells' errors now, shape (N, K) each: truth, to score by.

        It is worked out on the host.

        Raises:
            TypeError: If the sensors are not load cells.
        """
        if not isinstance(self.config, LoadCells):
            raise TypeError("Only load cells have a map of their own for each channel.")
        cells = self._device(CELLS, self.config)
        records = np.split(self._sensors.cpu().numpy().view(cells.layout), self.num_envs)
        states = (cells.unpack(NativeState(one.reshape(()), cells)) for one in records)
        maps = [true_map(self.config, state) for state in states]
        parts = (np.stack(part) for part in zip(*maps, strict=True))
        return Parameters(*(torch.as_tensor(p, dtype=self.dtype, device=self.device) for p in parts))

    def get_extra_state(self) -> dict[str, Any]:
        """Return everything for ``state_dict()``: sensors, the last readings and the random streams."""
        return self._state_of(self._kernel, self._identity())

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Go on, bit for bit, from a result of :meth:`get_extra_state`.

        Raises:
            ValueError: If it is of other sensors.
        """
        self._restore(self._kernel, state, self._identity())

    def _identity(self) -> dict[str, Any]:
        return {
            "configuration": repr(self.config),
            "faults": repr(self._broken.faults),
            "num_envs": self.num_envs,
            "dt": self.dt,
            "dtype": str(self.dtype),
        }

    def _build(self) -> Kernel:
        """Return the kernel, with room for these sensors."""
        kind, channels, loads, _ = _DEVICES[self._blocks]
        config = self.config
        cells = isinstance(config, LoadCells)
        sizes = {
            "ON_WIRE": max(16, self.channels),
            "UNDER_WAY": max(16, config.wire.under_way),
            "LOAD_CELLS": max(16, self.channels if cells else 0),
            "SETTLING": max(8, config.settling if isinstance(config, LoadCells) else 0),
            "SIX_AXIS": max(2, 0 if cells else self.channels // 6),
            "FAULTS": max(16, len(self._broken.faults)),
        }
        fits = tuple(f"surefoot_{name}_fits" for name in (kind.name, FAULTS.name))
        body = _BODY.format(kind=kind.name, channels=channels, loads=loads)
        return kernel("sensors", ("surefoot_feet",), body, fits, tuple(sizes.items()), DTYPES[self.dtype])

    def _device(self, kind: Kind, config: Any) -> NativeDevice:
        device = native_device(self._kernel.library, kind, config)
        if device is None:
            raise ValueError(
                "There is no kernel for such sensors, which FootSensors reads in Python: cells that average "
                f"('settling') without a clock ('rate'), or of more mechanics than {page('native')} allows."
            )
        return device

    def _draw(self, streams: Iterable[tuple[Stream, ...]]) -> tuple[Tensor, Tensor, Tensor]:
        """Draw sensors of some robots, each from its own two streams; return records and streams in bytes."""
        kind, *_ = _DEVICES[self._blocks]
        makers = [
            (self._device(*of), of[0].build(of[1])) for of in ((kind, self.config), (FAULTS, self._broken))
        ]
        drawn: list[list[Any]] = [[], [], []]
        for own in streams:
            for (device, python), stream, records in zip(makers, own, drawn, strict=False):
                records.append(device.pack(python.init((self.channels,), stream)).record)
            drawn[2].append(np.stack([stream.record for stream in own]))
        return tuple(_in_bytes(records) for records in drawn)  # type: ignore[return-value]


AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
"""Channels of a six-axis sensor as faults name them."""


def _fault(given: str | Fault | Mapping[str, Any], config: FootDevice) -> Fault:
    """Make a fault of a user's words."""
    if not isinstance(given, str):
        return resolve(given, Fault)
    cells = CELL_NAMES if isinstance(config, LoadCells) else AXES
    feet = config.channels // len(cells)
    names = FEET[:feet] if feet <= len(FEET) else [str(number) for number in range(1, feet + 1)]
    return parse_fault(given, names, cells)


def _stream(record: Any) -> Stream:
    """Return a stream that goes on where a kernel's did, of its key and the number of its next block."""
    stream = Stream(record[0])
    stream.record["count"] = record[1]
    return stream


def _in_bytes(records: list[Any]) -> Tensor:
    """Return records of robots, a row each."""
    return torch.from_numpy(np.stack([np.atleast_1d(one).view(np.uint8) for one in records]))
