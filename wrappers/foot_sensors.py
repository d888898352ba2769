"""Sensors between an environment's truth and who observes it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any, NamedTuple, SupportsFloat

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration import GRAVITY
from surefoot.calibration.state import load_state, save_state
from surefoot.sensors import Encoders, Fault, Imu, Link, channel_faults, parse_fault, scaled
from surefoot.sensors.presets import resolve
from surefoot.sensors.randomness import Stream
from surefoot.sensors.transport.link import Packets
from surefoot.sensors.transport.wire import check_wire
from surefoot.wrappers.foot_device import FootDevice, foot_device
from surefoot.wrappers.instruments import Instruments, InstrumentsState, usual_cells
from surefoot.wrappers.native_sensing import NativeSensing, native_sensing
from surefoot.wrappers.native_telemetry import telemetry_of
from surefoot.wrappers.raw_view import RawView
from surefoot.wrappers.source import (
    Source,
    check_clock,
    check_stream,
    find_source,
    robot_note,
    split_options,
    wants_fresh,
    with_source,
)
from surefoot.wrappers.telemetry import Telemetry, timely_link

SENSOR_STREAM = 0x5F00
"""Number of the random stream that sensors draw from unless another is given."""

DEVICES = ("cells", "ankles", "faults", "telemetry")
"""Devices of a robot that draw; each has a stream of its own within that one, by its place here."""


def stream_key(device: str, stream: int, seed: int | None) -> tuple[int, ...]:
    """Return what the stream of one robot's device is keyed by; nothing without a seed."""
    return () if seed is None else (stream, seed, DEVICES.index(device))


class HardwareState(NamedTuple):
    """What stays as it is while the power is on, whatever happens to the robot.

    Attributes:
        instruments: What is under the feet.
        faults: What is broken about it, or ``()``.
        telemetry: IMU and encoders (:class:`~surefoot.wrappers.telemetry.Hardware`), or ``None`` where nobody
            listens.
    """

    instruments: InstrumentsState
    faults: Any
    telemetry: Any


class FootSensors(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Read an environment through load cells or ankle sensors, joint encoders and an IMU.

    Any environment built on MuJoCo will do: one that does not record its truth is instrumented first, in
    memory (:class:`~surefoot.envs.InstrumentedEnv`). The observation becomes a ``Dict``, with what the
    environment showed as ``"state"`` unless it was a ``Dict`` already, and gains

    | Key | Observation | Min | Max | Unit |
    |-----|-------------|-----|-----|------|
    | ``"foot_raw"`` (K) | cells, left then right: FL, FR, RL, RR; ankles: fx to tz | 0 | 2^24 - 1 | count |

    (the range is the configuration's; where no reading arrives the last one is held, and before the first
    that of an unloaded sensor). It loses what only truth has (``"foot_force"``, ``"cop"``,
    ``"cop_foot"`` and ``"cop_valid"``), and where the environment has a ``state_layout``, ``joint_position``,
    ``joint_velocity``, ``tilt`` and ``gyroscope`` become those of the newest packet of telemetry that has
    arrived; other environments' states are left as they are. Truth stays in ``info["surefoot"]["truth"]``.

    A calibrator around it uses the attributes below, :attr:`raw`, :attr:`telemetry`, :meth:`listen` and
    :meth:`true_parameters`, and nothing else.

    Sensors have random streams of their own, seeded from the seed of the reset, so that the environment's
    trajectory is the bare one's, and the same seed under other wrappers is the same episode. A reset with a
    seed draws fresh sensors: other scales, offsets, clocks and biases, those of a vector's copy that is reset
    with it. A reset without one keeps them, and they drift on, as hardware does; ``fresh=True`` or
    ``options={"surefoot": {"sensors": "fresh"}}`` draws
    fresh ones then as well, and ``"keep"`` keeps them whatever the seed.

    Args:
        env: An environment built on MuJoCo, such as ``surefoot/NaoWalk-v0`` or ``Humanoid-v5``.
        config: What is under the feet: the name of a preset, a :class:`~surefoot.sensors.LoadCells` or a
            :class:`~surefoot.sensors.ForceTorque`, or a mapping of the fields of either. ``None`` for the
            cells of ``"hx711-load-cells"``, or larger ones of their kind for a robot that is too heavy for
            these (:func:`~surefoot.sensors.sized`).
        ankles: Six-axis sensors besides load cells, likewise; ``None`` for none.
        imu: The IMU, likewise.
        encoders: The joint encoders, likewise.
        link: The link over which encoders and IMU reach the host, likewise.
        severity: Factor of all errors of the feet's sensors, see :func:`~surefoot.sensors.scaled`.
        faults: What breaks when, on the clock of the power-up: words such as ``"at t=12 s cell left/2 dies"``
            (:func:`~surefoot.sensors.parse_fault`), :class:`~surefoot.sensors.Fault` or mappings of its
            fields.
        fresh: Whether every reset draws fresh sensors.
        measure_state: Whether encoders and IMU take the place of what a ``state_layout`` names.
        feet: Names of the feet's bodies, for a robot whose feet cannot be guessed.
        cells: Places of the cells, see :class:`~surefoot.envs.InstrumentedEnv`.
        soles: Flat soles for feet without area, likewise; they change how the robot moves.
        stream: Number of the random stream, for independent sensors on the same episode.

    Attributes:
        source: What records the truth.
        instruments: What is under the feet.
        time: The host's time since the reset in s.
        sensors_fresh: Whether the last reset drew fresh sensors.

    Raises:
        TypeError: If the environment is not built on MuJoCo, or is wrapped already.
        ValueError: If a preset is unknown, a value is refused, or the feet have no place for the sensors.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        config: str | Mapping[str, Any] | FootDevice | None = None,
        *,
        ankles: str | Mapping[str, Any] | FootDevice | None = None,
        imu: str | Mapping[str, Any] | Imu = "nao-imu",
        encoders: str | Mapping[str, Any] | Encoders = "nao-encoders",
        link: str | Mapping[str, Any] | Link = "nao-wlan",
        severity: float = 1.0,
        faults: Sequence[str | Fault | Mapping[str, Any]] = (),
        fresh: bool = False,
        measure_state: bool = True,
        feet: Sequence[str] | None = None,
        cells: Mapping[str, ArrayLike] | None = None,
        soles: bool | Mapping[str, Sequence[float]] | None = None,
        stream: int = SENSOR_STREAM,
    ) -> None:
        check_stream("FootSensors", stream)
        gym.utils.RecordConstructorArgs.__init__(
            self,
            config=config,
            ankles=ankles,
            imu=imu,
            encoders=encoders,
            link=link,
            severity=severity,
            faults=faults,
            fresh=fresh,
            measure_state=measure_state,
            # Where the sensors are is recorded by InstrumentedEnv, which a spec brings back first.
            stream=stream,
        )
        gym.Wrapper.__init__(self, with_source(env, feet=feet, cells=cells, soles=soles))
        source = find_source(self.env)
        assert source is not None
        self.source: Source = source
        cells_or_ankles = usual_cells(source.drawing) if config is None else config
        devices = [foot_device(given) for given in (cells_or_ankles, ankles) if given is not None]
        if severity != 1.0:
            devices = [scaled(device, float(severity)) for device in devices]
        for device in devices:
            check_wire(device, float(source.dt))
        self.instruments = Instruments(tuple(devices), source.drawing)
        self._configs = (resolve(imu, Imu), resolve(encoders, Encoders), timely_link(link))
        if isinstance(faults, (str, Mapping)):
            raise TypeError(f"'faults' must be a sequence of faults, such as [{faults!r}]; got one alone.")
        self._faults = [self._fault(fault) for fault in faults]
        self._broken = channel_faults(self._faults, self.instruments) if self._faults else None
        layout = getattr(source, "state_layout", None) if measure_state else None
        self._measures = layout is not None
        self._view = RawView(self.instruments, source, layout, self.env)
        self.observation_space = self._view.space
        self._link_by_name = isinstance(link, str)
        self._fresh, self._stream = fresh, stream
        self._streams: dict[str, Any] = self._drawn_streams(None)
        self._listening = self._measures
        self._hardware: HardwareState | None = None
        self.sensors_fresh = True
        self._packets: Packets | None = ()
        self._sensing: NativeSensing | None = None
        self.time = 0.0
        self._telemetry: Telemetry | None = None
        self._raw: NDArray[np.float64] | None = None
        self._telemetry_state: Any = None
        self._clock: float | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment, with fresh or kept sensors.

        Args:
            seed: Seeds the environment, and the sensors with it; without, they go on.
            options: ``options["surefoot"]["sensors"]`` may be ``"fresh"`` or ``"keep"``; the rest is handed
                to the environment.

        Raises:
            ValueError: If a choice does not exist.
        """
        rest, asked = split_options(options, "sensors", "calibration")
        observation, info = self.env.reset(seed=seed, options=rest)
        if seed is not None:
            self._streams = self._drawn_streams(seed)
        truth, dt = self.source.truth, float(self.source.dt)
        if self._telemetry is None or self._telemetry.dt != dt:
            self._telemetry = self._make_telemetry(dt, len(truth.time))
        self.sensors_fresh = wants_fresh(asked.get("sensors"), seed, self._fresh, self._hardware is not None)
        self._switch_on(truth)
        self.time, self._clock = 0.0, None
        return self._view.show(observation, self.raw, self.packets), info

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment and read the sensors."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        truth, dt = self.source.truth, self.telemetry.dt
        before, self._clock = self._clock, float(truth.time[-1])
        if before is not None:
            check_clock("FootSensors", self.env, self._clock - before, dt)
        self.time += dt
        sensing = self._by_library(truth)
        read = None if sensing is None else sensing.step(truth, self.time, observation)
        if read is not None:
            self._packets = None  # made of the library's rows when somebody asks
            self._raw, seen = read
            return seen, reward, terminated, truncated, info
        self._read(truth, dt)
        if self._telemetry_state is not None:
            self._packets, self._telemetry_state = self.telemetry.advance(
                truth.joint_position,
                truth.inertial,
                self.time,
                self._telemetry_state,
                self._streams["telemetry"],
            )
        return self._view.show(observation, self.raw, self.packets), reward, terminated, truncated, info

    @property
    def packets(self) -> Packets:
        """Telemetry that arrived during the last step, in order; only while somebody listens."""
        if self._packets is None:
            self._packets = () if self._sensing is None else self._sensing.packets()
        return self._packets

    def arrived(self) -> tuple[int, int] | None:
        """Return where the library has rows of :attr:`packets`, until the next step, and how many."""
        return None if self._packets is not None or self._sensing is None else self._sensing.arrived()

    @property
    def raw(self) -> NDArray[np.float64]:
        """The feet's last reading in counts, in double precision, shape (K,); NaN: none arrived."""
        if self._raw is None:
            raise gym.error.ResetNeeded("There are no readings before the first reset().")
        return self._raw

    @property
    def telemetry(self) -> Telemetry:
        """What the packets hold (``telemetry.layout``) and how often they are sent."""
        if self._telemetry is None:
            raise gym.error.ResetNeeded("There is no telemetry before the first reset().")
        return self._telemetry

    def listen(self) -> None:
        """Send telemetry from the next reset on, even if no observation shows it."""
        self._listening = True

    def true_parameters(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the map that undoes the feet's errors now: truth, to score calibrators against.

        Returns:
            Scale in N per count and offset in N, each (K,).
        """
        scale, offset = self.instruments.true_map(self._devices.instruments)
        return scale, offset

    def save(self, path: str | PathLike[str]) -> None:
        """Write what the hardware keeps while the power is on, its scales and offsets, to an ``.npz``.

        Raises:
            RuntimeError: If nothing was drawn yet.
        """
        save_state(path, self._now(), **self._notes())

    def load(self, path: str | PathLike[str]) -> None:
        """Go on with the hardware of a file that :meth:`save` wrote.

        Raises:
            RuntimeError: If the environment has not been reset.
            ValueError: If the file is of another robot, or of other sensors.
        """
        self._hardware = load_state(path, self._now(), **self._notes())
        if self._telemetry_state is not None:
            self._telemetry_state = self.telemetry.with_hardware(
                self._telemetry_state, self._hardware.telemetry
            )

    @property
    def _devices(self) -> HardwareState:
        if self._hardware is None:
            raise RuntimeError("There are no sensors before the first reset(), which draws them.")
        return self._hardware

    def _now(self) -> HardwareState:
        """What the hardware is now, telemetry's part included, as the Python has it."""
        hardware = self._devices
        hardware = hardware._replace(instruments=self.instruments.plain(hardware.instruments))
        if self._telemetry_state is None:
            return hardware
        return hardware._replace(telemetry=self.telemetry.hardware(self._telemetry_state))

    def _notes(self) -> dict[str, str]:
        return {
            "robot": robot_note(self.source),
            "sensors": " ".join(repr(part.config) for part in self.instruments.parts),
            "channels": " ".join(self.instruments.layout.channel_names),
            "faults": "; ".join(map(repr, self._faults)) or "none",
            "telemetry": "none" if self._telemetry_state is None else "an IMU and encoders, which are read",
        }

    def _by_library(self, truth: Any) -> NativeSensing | None:
        """Return what reads a whole step in one call; ``None`` where Python does it, or its parts."""
        state, streams, sensing = self._telemetry_state, self._streams, self._sensing
        if self._broken is not None or state is None:
            return None
        now = self._devices.instruments
        if sensing is None or not sensing.goes_on(now, state, streams):
            sensing = native_sensing(
                truth, self.instruments, now, self._telemetry, state, streams, self._view
            )
            self._sensing = sensing
        return sensing

    def __getstate__(self) -> dict[str, Any]:
        # The library's rows, of which packets are made, stay behind.
        return {**vars(self), "_packets": self.packets}

    def _drawn_streams(self, seed: int | None) -> dict[str, Any]:
        return {device: Stream.of(*stream_key(device, self._stream, seed)) for device in DEVICES}

    def _switch_on(self, truth: Any) -> None:
        """Draw fresh sensors or keep those there are, and read every chip and the link once."""
        streams = self._streams
        kept = None if self.sensors_fresh else self._now().telemetry
        if self.sensors_fresh:
            shape = (self.instruments.channels,)
            broken = () if self._broken is None else self._broken.init(shape, streams["faults"])
            self._hardware = HardwareState(self.instruments.init(streams), broken, None)
            self._view.hold_unloaded()
        with_load = self.instruments.with_load(truth, self._devices.instruments)
        self._hardware = self._devices._replace(instruments=with_load)
        for dt in self.instruments.first_steps(self.telemetry.dt):
            self._read(truth, dt)
        if self._listening:
            # At the reset a robot hangs just above its footprints; packets before are of one that stood.
            inertial = np.concatenate([GRAVITY * truth.R_world_torso[-1][2], np.zeros(3)])
            self._packets, self._telemetry_state = self.telemetry.init(
                truth.joint_position[-1].copy(), inertial, streams["telemetry"], kept
            )

    def _read(self, truth: Any, dt: float) -> None:
        hardware = self._devices
        self._raw, instruments = self.instruments.read(truth, hardware.instruments, self._streams, dt)
        if instruments is not hardware.instruments:
            hardware = hardware._replace(instruments=instruments)
        if self._broken is not None:
            self._raw, faults = self._broken.apply(self._raw, hardware.faults, self._streams["faults"], dt)
            hardware = hardware._replace(faults=faults)
        self._hardware = hardware

    def _make_telemetry(self, dt: float, substeps: int) -> Telemetry:
        """Build telemetry; a link by name sends no more packets than there are moments of truth."""
        imu, encoders, link = self._configs
        if self._link_by_name and link.rate is not None:
            link = replace(link, rate=min(link.rate, substeps / dt))
        telemetry = telemetry_of(len(self.source.joint_names), imu, encoders, link, dt, substeps)
        self._view.listen(telemetry.layout)
        return telemetry

    def _fault(self, given: str | Fault | Mapping[str, Any]) -> Fault:
        if not isinstance(given, str):
            return resolve(given, Fault)
        return parse_fault(given, self.source.drawing.feet, self.instruments.layout.feet[0].channel_names)
