"""Foot sensors for thousands of robots at once: true forces in, readings out, on the simulator's device.

    feet = FootSensorsModule("hx711-load-cells", env.num_envs, env.device, dt=env.step_dt)
    counts = feet(force, step=env.common_step_counter)      # (N, K), or (N, S, K) for S substeps of a step
    feet.reset(env_ids)                                     # as managers call it

A step is one kernel of ``native/surefoot_feet.h``, a robot a thread; nothing is copied to the host.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np
import torch
from torch import Tensor

from surefoot.calibration.parameters import Parameters
from surefoot.names import page
from surefoot.robot.sensing.condition import (
    Condition,
    Conditions,
    Faults,
    Severity,
    faults_of,
    severity_of_each,
    severity_range,
)
from surefoot.robot.sensing.device import FootDevice, first_steps, foot_device
from surefoot.robot.sensing.foot_equipment import FootEquipment, FootOptions, equip
from surefoot.robot.streams import check_stream, device_streams
from surefoot.sensors import LoadCells, scaled
from surefoot.sensors.devices.load_cells import true_map
from surefoot.sensors.devices.native_device import Kind, NativeDevice, native_device
from surefoot.sensors.devices.native_kinds import CELLS, FAULTS, FORCE_TORQUE, Broken
from surefoot.sensors.faults.words import CELLS as CELL_NAMES
from surefoot.sensors.faults.words import FEET
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.sensors.randomness import Stream
from surefoot.sensors.transport.wire import check_wire
from surefoot.wrappers.gpu.batch import DTYPES, BatchModule, Counter, RobotIds, mask_of
from surefoot.wrappers.gpu.kernels import Kernel, kernel

_ADVANCE = 1
"""What a thread is told: that this is a new step."""

_ELSEWHERE = {
    "ankles": "it reads one kind of instrument; make another module for them",
    "imu": "it reads feet alone",
    "encoders": "it reads feet alone",
    "link": "it reads feet alone",
}
"""Fields of :class:`FootEquipment` that are not this module's, and why."""

_BODY = """
    sf_random *streams = (sf_random *)own.data + 3 * robot;
    unsigned char *starts = (unsigned char *)marks.data + robot;
    /* One set of constants for all robots, or each its own. */
    const int mine = config.shape[0] > 1 ? robot : 0;
    const sf_{kind}_config *device = (const sf_{kind}_config *)config.data + mine;
    const sf_faults_config *broken = (const sf_faults_config *)more.data + mine;
    const int K = {channels};
    const sf_real *load = (const sf_real *)given.data + (size_t)robot * rows * {loads};
    sf_real *counts = (sf_real *)found.data + (size_t)robot * K;
    sf_feet feet;
    memset(&feet, 0, sizeof feet);
    feet.{kind}_config = device, feet.{kind} = (sf_{kind} *)state.data + robot, feet.{kind}_stream = streams;
    if (broken->count > 0) {{
        feet.faults_config = broken;
        feet.faults = (sf_faults *)other.data + robot, feet.faults_stream = streams + 1;
    }}
    feet.dt = dt, feet.first = span, feet.more = count;
    if (*starts) sf_feet_begin(&feet, load, rows, load, counts);
    else if (what & 1) sf_feet_step(&feet, load, rows, load, counts);
    *starts = 0;
"""

_DEVICES = {
    True: (CELLS, "device->channels", "sf_loads(device)"),
    False: (FORCE_TORQUE, "6 * device->sensors", "K"),
}
"""For load cells and for others: how the library has them, their channels and loads there."""


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
        config: The name of a preset, a mapping or a configuration; or a
            :class:`~surefoot.wrappers.FootEquipment` of feet alone.
        num_envs: Number N of robots.
        device: Where forces are and readings are wanted.
        dtype: Of readings, ``float32`` or ``float64``. ``float32`` holds every code of a 24-bit converter.
        seed: Of the first robot; it counts up.
        dt: Time between steps in s.
        counter: Returns the number of the simulation step.
        options: ``severity``, ``faults``, ``fresh`` and ``stream`` of
            :class:`~surefoot.wrappers.FootEquipment`. In words of faults feet are left and right, more than
            two have numbers; axes of six-axis sensors are "cell left/fz".

    Attributes:
        config: The instrument with its severity, the usual one where robots draw theirs.
        severity: Factor of all errors, or the lowest and the highest.
        channels: Number K of readings.
        nominal: The map that a robot may know, by the data sheet, shape (K,) each: where a calibrator starts.

    Raises:
        ValueError: If a preset is unknown, a value is refused, equipment is of more than feet, a fault cannot
            happen, there is no kernel for such sensors, or more readings are under way than the wire holds
            (:func:`~surefoot.sensors.transport.wire.check_wire`).
    """

    _sensors: Tensor
    _faults: Tensor
    _streams: Tensor
    _config: Tensor
    _faults_config: Tensor
    _severity: Tensor

    def __init__(
        self,
        config: str | Mapping[str, Any] | FootDevice | FootEquipment | None,
        num_envs: int,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
        *,
        seed: int = 0,
        dt: float = 1.0 / 50.0,
        counter: Counter | None = None,
        **options: Unpack[FootOptions],
    ) -> None:
        super().__init__(num_envs, device, dtype, dt, counter)
        equipment = equip(config, **options)
        for name, why in _ELSEWHERE.items():
            if getattr(equipment, name) is not None:
                raise ValueError(f"FootSensorsModule takes no {name!r}: {why}.")
        check_stream("FootSensorsModule", equipment.stream)
        self._drawn = foot_device(HX711_LOAD_CELLS if equipment.config is None else equipment.config)
        conditions = conditions_of(equipment.severity, equipment.faults, self._drawn)
        self._conditions = [conditions] * num_envs
        # Robots whose faults are drawn at a reset: by chance, or because they are others.
        self._redrawn = set(range(num_envs)) if conditions.chances else set()
        self._said = repr((*conditions.faults, *conditions.chances))
        self.severity: Severity = equipment.severity
        self.seed, self.fresh = seed, equipment.fresh
        usual = conditions.usual
        self.config: FootDevice = scaled(self._drawn, usual.severity)
        self.channels = self.config.channels
        self.nominal = Parameters(1.0 / self.config.slope, -self.config.zero_code / self.config.slope)
        self._blocks = isinstance(self.config, LoadCells)
        for severity in {conditions.lowest, conditions.highest}:
            check_wire(scaled(self._drawn, severity), self.dt)
        first, *more = first_steps((self.config,), self.dt)
        self._first = len(more), first
        self._slope = torch.as_tensor(self.config.slope, dtype=dtype, device=self.device)
        self._kernel = self._build()
        self._usual = usual, self._parts(usual)
        streams = [device_streams(equipment.stream, seed + robot) for robot in range(num_envs)]
        own = "cells" if self._blocks else "ankles", "faults", "condition"
        keys = [tuple(each[name] for name in own) for each in streams]
        found = self._draw(range(num_envs), [usual.severity] * num_envs, keys, True)
        names = "sensors", "faults", "streams", "config", "faults_config", "severity"
        records = dict(zip(names, found, strict=True))
        if not conditions.by_chance:
            # The constants of all robots are the same, and no part of a state.
            self._config, self._faults_config = (records.pop(name)[:1].to(self.device) for name in names[3:5])
            records.pop("severity")
        for name, record in records.items():
            setattr(self, f"_{name}", self._register(name, record))
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
            rows = force.shape[1] if force.ndim == 3 else 1
            self._kernel.launch(self.num_envs, given, _ADVANCE * advances, rows, count, self.dt, first)
            self._asked = False
        return self._reading.clone()

    def reset(self, env_ids: RobotIds = None, fresh: bool | None = None) -> None:
        """Start new episodes.

        Args:
            env_ids: Robots that begin one; all by default.
            fresh: Whether they get fresh sensors: scales, offsets, clocks, severity, and the time of faults;
                by default as the equipment says. They are drawn on the host, which waits for a GPU, and so
                are faults by chance at each reset.

        Raises:
            ValueError: If there is no such robot.
        """
        mask, fresh = self._note_starting(env_ids), self.fresh if fresh is None else fresh
        if fresh or self._redrawn:
            those = mask.nonzero()[:, 0]
            if not fresh:
                redrawn = [robot in self._redrawn for robot in those.tolist()]
                those = those[torch.tensor(redrawn, dtype=torch.bool, device=self.device)]
            keys = self._streams[those].cpu().numpy().view(np.uint64).reshape(-1, 3, 2)
            own = "config" in self._records
            before = self._severity[those].tolist() if own else [self._usual[0].severity] * len(those)
            drawn = self._draw(those.tolist(), before, [tuple(map(_stream, key)) for key in keys], fresh)
            kept = [self._sensors, self._faults, self._streams]
            if own:
                kept += [self._config, self._faults_config, self._severity]
            for record, new in zip(kept, drawn, strict=False):
                if len(new):
                    record[those] = new.to(self.device)
            self._redrawn -= {robot for robot in those.tolist() if not self._conditions[robot].chances}

    def set_severity(self, severity: Any, env_ids: RobotIds = None) -> None:
        """Let the next fresh sensors of some robots be of another severity.

        Args:
            severity: A number or a tuple (lowest, highest) for all of them; or a list or an array of such,
                one a robot.
            env_ids: These robots; all by default.

        Raises:
            ValueError: If there is no such robot, there are more or fewer values than robots, or there is no
                kernel for sensors that are so bad.
        """
        which = self._numbers(env_ids)
        ranges = map(severity_range, severity_of_each(severity, len(which)))
        own = zip(which, ranges, strict=True)
        self._set(which, [self._conditions[i]._replace(lowest=low, highest=high) for i, (low, high) in own])

    def set_faults(self, faults: Faults, env_ids: RobotIds = None) -> None:
        """Let other things break on some robots, or with other probabilities, from their next resets on.

        Args:
            faults: As of :class:`~surefoot.wrappers.FootEquipment`, for each of them.
            env_ids: These robots; all by default.

        Raises:
            ValueError: If there is no such robot, a fault or a probability is refused, or there is no kernel
                for so many faults.
        """
        which = self._numbers(env_ids)
        found = conditions_of(0.0, faults, self._drawn)._asdict()
        given = {name: found[name] for name in ("faults", "chances")}
        self._set(which, [self._conditions[i]._replace(**given) for i in which])
        self._redrawn |= set(which)

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
        states = []
        for row in self._sensors.cpu().numpy():
            state = cells.empty()
            state.bytes[:] = row
            states.append(state.python())
        severity = self._severity.tolist() if "config" in self._records else [self._usual[0].severity]
        configs: list[Any] = [scaled(self._drawn, one) for one in severity]
        configs *= self.num_envs // len(configs)
        maps = [true_map(*of) for of in zip(configs, states, strict=True)]
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
        if "config" in state:
            self._take_own_constants()
        self._restore(self._kernel, state, self._identity())

    def _numbers(self, env_ids: RobotIds) -> list[int]:
        """Return the numbers of robots, in the order in which they are named."""
        mask_of(env_ids, self.num_envs, self.device)  # which refuses others
        every = torch.arange(self.num_envs, device=self.device)
        named: list[int] = (every if env_ids is None else every[env_ids].reshape(-1)).tolist()
        return named

    def _set(self, which: list[int], found: Sequence[Conditions]) -> None:
        """Give robots other conditions.

        Raises:
            ValueError: If there is no kernel for one.
        """
        for one in set(found):
            for severity in {one.lowest, one.highest}:
                check_wire(scaled(self._drawn, severity), self.dt)
                self._parts(Condition(severity, one.faults))
        self._take_own_constants()
        for robot, one in zip(which, found, strict=True):
            self._conditions[robot] = one

    def _take_own_constants(self) -> None:
        """Let each robot have constants of its own from here on."""
        if "config" not in self._records:
            severity = torch.full((self.num_envs,), self._usual[0].severity, dtype=torch.float64)
            own = {"config": self._config, "faults_config": self._faults_config, "severity": severity}
            for name, part in own.items():
                setattr(self, f"_{name}", self._register(name, part.expand(self.num_envs, *part.shape[1:])))

    def _identity(self) -> dict[str, Any]:
        return {
            "configuration": repr(self.config),
            "faults": self._said,
            "num_envs": self.num_envs,
            "dt": self.dt,
            "dtype": str(self.dtype),
        }

    def _build(self) -> Kernel:
        """Return the kernel, with room for these sensors."""
        kind, channels, loads = _DEVICES[self._blocks]
        config = self.config
        cells = isinstance(config, LoadCells)
        sizes = {
            "ON_WIRE": max(16, self.channels),
            "UNDER_WAY": max(16, config.wire.under_way),
            "LOAD_CELLS": max(16, self.channels if cells else 0),
            "SETTLING": max(8, config.settling if isinstance(config, LoadCells) else 0),
            "SIX_AXIS": max(2, 0 if cells else self.channels // 6),
            "FAULTS": max(16, self.channels, len(self._conditions[0].faults)),
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

    def _parts(self, condition: Condition, instrument: NativeDevice | None = None) -> list[NativeDevice]:
        """Return the instrument, if there is none yet, and the faults of robots in a condition."""
        config = scaled(self._drawn, condition.severity)
        faults = self._device(FAULTS, Broken(condition.faults, config))
        return [instrument or self._device(_DEVICES[self._blocks][0], config), faults]

    def _draw(
        self, robots: Sequence[int], before: list[float], streams: Sequence[tuple[Stream, ...]], fresh: bool
    ) -> tuple[Tensor, ...]:
        """Draw conditions and sensors of some robots, by their numbers.

        Each draws from its own streams of the instrument, of faults and of the condition, and had a severity
        ``before``. Return sensors, faults, streams, the constants of both and severities; no sensors and no
        constants of theirs if they are not fresh.
        """
        found: list[list[Any]] = [[] for _ in range(6)]
        usual, same = self._usual
        for robot, severity, (own, of_faults, of_condition) in zip(robots, before, streams, strict=True):
            condition = self._conditions[robot].draw(
                Condition(severity, usual.faults), fresh, self.channels, of_condition
            )
            device, broken = same
            if condition != usual:
                known = not fresh or condition.severity == usual.severity
                device, broken = self._parts(condition, device if known else None)
            if fresh:
                found[0].append(device.pack(device.python.init((self.channels,), own)).now)
                found[3].append(device.constants)
            found[1].append(broken.pack(broken.python.init((self.channels,), of_faults)).now)
            found[2].append(np.stack([stream.record for stream in (own, of_faults, of_condition)]))
            found[4].append(broken.constants)
            found[5].append(condition.severity)
        *records, severities = found
        parts_of = [_in_bytes(record) if record else torch.zeros(0) for record in records]
        return *parts_of, torch.tensor(severities, dtype=torch.float64)


AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
"""Channels of a six-axis sensor as faults name them."""


def conditions_of(severity: Severity, faults: Faults, config: FootDevice) -> Conditions:
    """Return how bad the feet of robots may be; refuse what has no meaning."""
    cells = CELL_NAMES if isinstance(config, LoadCells) else AXES
    feet = config.channels // len(cells)
    names = FEET[:feet] if feet <= len(FEET) else [str(number) for number in range(1, feet + 1)]
    return Conditions(*severity_range(severity), *faults_of(faults, names, cells))


def _stream(record: Any) -> Stream:
    """Return a stream that goes on where a kernel's did, of its key and the number of its next block."""
    stream = Stream(record[0])
    stream.record["count"] = record[1]
    return stream


def _in_bytes(records: list[Any]) -> Tensor:
    """Return records of robots, a row each."""
    return torch.from_numpy(np.stack([np.atleast_1d(one).view(np.uint8) for one in records]))
