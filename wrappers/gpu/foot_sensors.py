"""Foot sensors for thousands of robots at once: true forces in, readings out, on the simulator's device.

    feet = FootSensorsModule("hx711-load-cells", env.num_envs, env.device, dt=env.step_dt)
    counts = feet(force, step=env.common_step_counter)      # (N, K), or (N, S, K) for S substeps of a step
    feet.reset(env_ids)                                     # as managers call it

Nothing is copied to the host. torch is imported by the modules of this package alone.
"""

from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any

import torch
from torch import Tensor

from surefoot.calibration.parameters import Parameters
from surefoot.sensors import Fault, LoadCells, channel_faults, parse_fault, scaled
from surefoot.sensors.devices.load_cells import true_map
from surefoot.sensors.faults.words import CELLS, FEET
from surefoot.sensors.presets import resolve
from surefoot.sensors.select import batch_axes, select
from surefoot.sensors.transport.wire import check_wire
from surefoot.wrappers.foot_device import FootDevice, foot_corruption, foot_device
from surefoot.wrappers.gpu.batch import BatchModule, Counter, RobotIds, restored, saved_leaves


class FootSensorsModule(BatchModule):
    """Read the feet of N robots through load cells or six-axis sensors.

    **Steps.** A manager may ask several times within one simulation step. With a step's number, from the
    argument ``step`` or from ``counter``, the sensors advance at the first call of a step and hand out copies
    of the same readings at the others. Without one every call is a step.

    **Resets.** Sensors are hardware: a robot that starts an episode keeps its own, and drift goes on. With
    ``fresh=True`` it gets fresh ones. Either way converters with a clock run through under the first load of
    the new episode, so that no reading is of the one before, even when asked again within the same step.

    **Loads that are not finite**, as of a simulation that blew up, read NaN at the robot that has them and
    have no effect after its next finite ones. Forces come in without their graph: nothing is differentiated.

    **Chance.** One generator on the device, seeded, draws for the whole batch: the same seed, calls and
    resets give the same readings on the same device, but what one robot reads depends on how many there are.

    Args:
        config: The name of a preset, a mapping or a configuration.
        num_envs: Number N of robots.
        device: Where forces are and readings are wanted.
        dtype: Of readings. ``float32`` holds every code of a 24-bit converter.
        seed: Of the generator.
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
        ValueError: If a preset is unknown, a value is refused, a fault cannot happen, or more readings are
            under way than the wire holds (:func:`~surefoot.sensors.transport.wire.check_wire`).

    >>> feet = FootSensorsModule("perfect", 2, dt=0.02)
    >>> feet(torch.full((2, 8), 6.5)).tolist()[0]
    [6.5, 6.5, 6.5, 6.5, 6.5, 6.5, 6.5, 6.5]
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
        self._cells = foot_corruption(self.config)
        broken = tuple(_fault(fault, self.config) for fault in faults)
        self._faults = channel_faults(broken, self.config) if broken else None
        self._fault_notes = repr(broken)
        self._first_steps = _first_steps(self.config, self.dt)
        for _, apart in [(1, self.dt), *self._first_steps]:
            check_wire(self.config, apart)
        self._slope = torch.as_tensor(self.config.slope, dtype=dtype, device=self.device)
        axes = batch_axes(self._cells, self.channels)
        self._axes = (axes, () if self._faults is None else batch_axes(self._faults, self.channels))
        self._generator = torch.Generator(device=self.device)
        self._generator.manual_seed(seed)
        self._state = self._draw()
        self._reading: Tensor | None = None

    def forward(self, force: Tensor, step: int | None = None) -> Tensor:
        """Read the sensors.

        Args:
            force: True forces in N (for six-axis sensors wrenches in N and N m) at the end of the step, shape
                (N, K), or for load cells at the ends of S equal substeps, shape (N, S, K).
            step: Number of the simulation step, if the module has no ``counter``.

        Returns:
            Readings in counts, shape (N, K), the caller's own.

        Raises:
            TypeError: If forces are no tensor.
            ValueError: If their shape or device is not the module's.
        """
        tails = (("channels",), ("S", "channels")) if self._blocks else (("channels",),)
        force = self._bring(force, "force", tails, self.channels)
        block = force[:, None] if force.ndim == 2 and self._blocks else force
        advances, before, starting = self._begins(step), self._state, self._starting
        plain, first = [(block, self.dt)], self._first(block)
        if self._reading is None:
            reading, state = self._read(first, self._with_finite_loads(before, block))
        else:
            reading, state = self._read(plain, before) if advances else (self._reading, before)
            # Sensors that remember no load read the step itself as their first.
            if starting is not None and (len(self._first_steps) > 0 or not advances):
                first_reading, after = self._read(first, self._with_finite_loads(before, block))
                reading = torch.where(starting[:, None], first_reading, reading)
                state = select(starting, after, state, self._axes)
        self._reading, self._state, self._starting = reading, state, None
        return reading.clone()

    def reset(self, env_ids: RobotIds = None, fresh: bool = False) -> None:
        """Start new episodes.

        Args:
            env_ids: Robots that begin one; all by default.
            fresh: Whether they get fresh sensors: scales, offsets, clocks, and the time of faults.

        Raises:
            ValueError: If there is no such robot.
        """
        mask = self._note_starting(env_ids)
        if fresh:
            self._state = select(mask, self._draw(), self._state, self._axes)

    def newtons(self, counts: Tensor) -> Tensor:
        """Return counts in N (and N m) by the data sheet: what a robot without a calibrator believes."""
        return (counts - self.config.zero_code) / self._slope

    def true_parameters(self) -> Parameters:
        """Return the map that undoes the load cells' errors now, shape (N, K) each: truth, to score by.

        Raises:
            TypeError: If the sensors are not load cells.
        """
        if not isinstance(self.config, LoadCells):
            raise TypeError("Only load cells have a map of their own for each channel.")
        return Parameters(*true_map(self.config, self._state[0]))

    def get_extra_state(self) -> dict[str, Any]:
        """Return everything for ``state_dict()``: sensors, the last readings and the random stream."""
        return {
            "identity": self._identity(),
            "leaves": saved_leaves(self._state),
            "generator": self._generator.get_state(),
            "reading": None if self._reading is None else self._reading.clone(),
            **self._saved_steps(),
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Go on, bit for bit, from what :meth:`get_extra_state` returned.

        Raises:
            ValueError: If it is of other sensors.
        """
        self._check_saved(state, self._identity())
        self._state = restored(self._state, state["leaves"], self.device)
        self._generator.set_state(state["generator"].cpu())
        reading = state["reading"]
        self._reading = None if reading is None else reading.to(self.device, copy=True)
        self._restore_steps(state)

    def _identity(self) -> dict[str, Any]:
        return {
            "configuration": repr(self.config),
            "faults": self._fault_notes,
            "num_envs": self.num_envs,
            "dt": self.dt,
            "dtype": str(self.dtype),
            "device": self.device.type,  # the streams of generators differ
        }

    def _draw(self) -> Any:
        """Draw sensors for all robots."""
        shape = (self.num_envs, self.channels)
        cells = self._cells.init(shape, self._generator, self.dtype)
        faults = () if self._faults is None else self._faults.init(shape, self._generator, self.dtype)
        return cells, faults

    def _with_finite_loads(self, state: Any, block: Tensor) -> Any:
        """Return a state in which loads before an episode that were not finite are its first load."""
        if not self._blocks:
            return state
        cells, faults = state
        known = torch.isfinite(cells.previous)
        return cells._replace(previous=torch.where(known, cells.previous, block[:, -1])), faults

    def _first(self, block: Tensor) -> list[tuple[Tensor, float]]:
        """Return for how long the last load of a block lasts before an episode's first reading."""
        if not self._first_steps:
            return [(block, self.dt)]
        if not self._blocks:
            return [(block, dt) for _, dt in self._first_steps]
        return [(block[:, -1:].expand(-1, rows, -1), dt) for rows, dt in self._first_steps]

    def _read(self, blocks: list[tuple[Tensor, float]], state: Any) -> tuple[Tensor, Any]:
        """Apply loads one after the other, and return the last reading."""
        cells, faults = state
        counts = blocks[0][0]
        for block, dt in blocks:
            counts, cells = self._cells.apply(block, cells, self._generator, dt)
        if self._faults is not None:
            counts, faults = self._faults.apply(counts, faults, self._generator, self.dt)
        return counts, (cells, faults)


AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
"""Channels of a six-axis sensor as faults name them."""


def _fault(given: str | Fault | Mapping[str, Any], config: FootDevice) -> Fault:
    """Make a fault of what a user gives."""
    if not isinstance(given, str):
        return resolve(given, Fault)
    cells = CELLS if isinstance(config, LoadCells) else AXES
    feet = config.channels // len(cells)
    names = FEET[:feet] if feet <= len(FEET) else [str(number) for number in range(1, feet + 1)]
    return parse_fault(given, names, cells)


def _first_steps(config: FootDevice, dt: float) -> list[tuple[int, float]]:
    """Return in how many substeps, and for how long each, a load must last until readings are of it alone.

    Returns:
        Pairs of the number of substeps and their time in s; none for an instrument that remembers no load.
    """
    rate = config.rate if isinstance(config, LoadCells) else None
    period = dt if rate is None else 1.0 / rate[0]
    averaged = config.settling if isinstance(config, LoadCells) else 1
    late = ceil((config.wire.delay + 3.0 * config.wire.jitter) / period - 1e-9)
    if rate is None and averaged + late == 1:
        return []
    # Of two substeps of the same load the second begins with that load, and every chip converts in it.
    first = (1, period) if rate is None else (2, 2.0 * period)
    return [first, *[(1, period)] * (averaged - 1 + late)]
