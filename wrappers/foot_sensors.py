"""Puts sensors between an environment's truth and who observes it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any, NamedTuple, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration import GRAVITY
from surefoot.calibration.state import load_state, save_state
from surefoot.sensors import Encoders, Fault, Imu, Link, channel_faults, parse_fault, resolve, scaled
from surefoot.sensors.configuration import require
from surefoot.sensors.link import Packets
from surefoot.wrappers.instruments import FootDevice, Instruments, InstrumentsState, foot_device
from surefoot.wrappers.source import (
    Source,
    check_stream,
    find_source,
    split_options,
    wants_fresh,
    with_source,
)
from surefoot.wrappers.telemetry import LONGEST_DELAY, Hardware, Telemetry, TelemetryState

SENSOR_STREAM = 0x5F00
"""Number of the random stream that sensors draw from unless another is given."""

TELEMETRY_STREAM = 1
"""Number, within that, of the stream of an IMU and of encoders that no observation shows."""

TRUE_KEYS = ("foot_force", "cop", "cop_foot", "cop_valid")
"""Parts of an observation that only truth can tell; readings take their place."""


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
    """Let an environment be felt through load cells or ankle sensors, joint encoders and an IMU.

    Any environment built on MuJoCo will do: one that does not record its truth is instrumented first, in
    memory (:class:`~surefoot.envs.InstrumentedEnv`). The observation becomes a ``Dict``, with what the
    environment showed as ``"state"`` unless it was a ``Dict`` already, and gains

    | Key | Observation | Min | Max | Unit |
    |-----|-------------|-----|-----|------|
    | ``"foot_raw"`` (K) | cells, left then right: FL, FR, RL, RR; ankles: fx to tz | 0 | 2^24 - 1 | count |

    (the range is the configuration's; where no reading arrives the last one is held, and before the first
    that of an unloaded sensor). It loses what only truth can tell (``"foot_force"``, ``"cop"``,
    ``"cop_foot"`` and ``"cop_valid"``), and where the environment has a ``state_layout``, ``joint_position``,
    ``joint_velocity``, ``tilt`` and ``gyroscope`` become those of the newest packet of telemetry that has
    arrived; other environments' states are left as they are. Truth stays in ``info["surefoot"]["truth"]``.

    Sensors have a random stream of their own, seeded from the seed of the reset, so that the environment's
    trajectory is the bare one's, and the same seed under other wrappers is the same episode. A reset with a
    seed draws the sensors anew: other gains, zeros, clocks and biases. A reset without one keeps them, and
    they drift on, as hardware does; ``fresh=True`` or ``options={"surefoot": {"sensors": "fresh"}}`` draws
    them anew then as well, and ``"keep"`` keeps them whatever the seed.

    Args:
        env: An environment built on MuJoCo, such as ``surefoot/NaoWalk-v0`` or ``Humanoid-v5``.
        config: What is under the feet: the name of a preset, a mapping (with ``"device": "force-torque"`` for
            six-axis sensors), a :class:`~surefoot.sensors.LoadCells` or a
            :class:`~surefoot.sensors.ForceTorque`.
        ankles: Six-axis sensors besides load cells, likewise; ``None`` for none.
        imu: The IMU, likewise.
        encoders: The joint encoders, likewise.
        link: The link over which encoders and IMU reach the host, likewise.
        severity: Factor of all errors of the feet's sensors, see :func:`~surefoot.sensors.scaled`.
        faults: What breaks when, on the clock of the power-up: words such as ``"at t=12 s cell left/2 dies"``
            (:func:`~surefoot.sensors.parse_fault`), :class:`~surefoot.sensors.Fault` or mappings of its
            fields.
        fresh: Whether every reset draws the sensors anew.
        measure_state: Whether encoders and IMU take the place of what a ``state_layout`` names.
        feet: Names of the feet's bodies, for a robot whose feet cannot be guessed.
        cells: Places of the cells, see :class:`~surefoot.envs.InstrumentedEnv`.
        soles: Flat soles for feet without area, likewise; they change how the robot moves.
        stream: Number of the random stream, for independent sensors on the same episode.

    Attributes:
        source: What records the truth.
        instruments: What is under the feet.
        packets: Telemetry that arrived during the last step, in order; only while somebody listens.
        telemetry: What the packets hold (``telemetry.layout``) and how often they are sent.
        time: The host's time since the reset in s.
        drawn_anew: Whether the last reset drew the sensors anew.

    Raises:
        TypeError: If the environment is not built on MuJoCo, or is wrapped already.
        ValueError: If a preset is unknown, a value is refused, or the feet have no place for the sensors.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        config: str | Mapping[str, Any] | FootDevice = "hx711-load-cells",
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
        devices = [foot_device(given) for given in (config, ankles) if given is not None]
        if severity != 1.0:
            devices = [scaled(device, severity) for device in devices]
        self.instruments = Instruments(tuple(devices), source.drawing)
        self._configs = (resolve(imu, Imu), resolve(encoders, Encoders), resolve(link, Link))
        require(
            self._configs[2].delay <= LONGEST_DELAY,
            self._configs[2],
            "delay",
            f"be at most {LONGEST_DELAY} s, which is as late as telemetry is of use here",
        )
        broken = [self._fault(fault) for fault in faults]
        self._broken = channel_faults(broken, self.instruments) if broken else None
        layout = getattr(source, "state_layout", None) if measure_state else None
        self._state_layout: Mapping[str, slice] | None = layout
        self.observation_space, self._was_dict = self._space(self.env.observation_space)
        if self._state_layout is not None:
            state = self.observation_space["state"]
            self._state_bounds = (state.low, state.high)  # type: ignore[attr-defined]
        self._link_by_name = isinstance(link, str)
        self._fresh, self._stream = fresh, stream
        self._rng = self._telemetry_rng = np.random.default_rng()
        self._listening = self._state_layout is not None
        self._hardware: HardwareState | None = None
        self.drawn_anew = True
        self.packets: Packets = ()
        self.time = 0.0
        self.telemetry: Telemetry
        self._raw: NDArray[np.float64]
        self._held = self.instruments.zero_code.astype(np.float32)
        self._telemetry_state: TelemetryState
        self._newest: NDArray[np.float64]
        self._measured: list[tuple[slice, slice]] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment, and draw the sensors anew or keep them.

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
            self._rng = self._telemetry_rng = np.random.default_rng([self._stream, seed])
            if self._state_layout is None:
                # What is read only if somebody listens must not shift what the feet draw.
                self._telemetry_rng = np.random.default_rng([self._stream, seed, TELEMETRY_STREAM])
        truth, dt = self.source.truth, float(self.source.dt)
        if not hasattr(self, "telemetry") or self.telemetry.dt != dt:
            self.telemetry = self._make_telemetry(dt, len(truth.time))
        self.drawn_anew = wants_fresh(asked.get("sensors"), seed, self._fresh, self._hardware is not None)
        self._switch_on(truth)
        self.time = 0.0
        return self._observe(observation), info

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment and read the sensors."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        truth, dt = self.source.truth, self.telemetry.dt
        self.time += dt
        self._read(truth, dt)
        if self._listening:
            self.packets, self._telemetry_state = self.telemetry.advance(
                truth.joint_position,
                np.concatenate((truth.accelerometer, truth.gyroscope), axis=1),
                self.time,
                self._telemetry_state,
                self._telemetry_rng,
            )
        return self._observe(observation), reward, terminated, truncated, info

    @property
    def raw(self) -> NDArray[np.float64]:
        """The feet's last reading in counts, in double precision, shape (K,); NaN: none arrived."""
        return self._raw

    def listen(self) -> None:
        """Have telemetry sent from the next reset on, even if no observation shows it."""
        self._listening = True

    def true_parameters(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Tell the map that would undo the feet's errors now: truth, to score calibrators against.

        Returns:
            Scale in N per count and offset in N, each (K,).
        """
        scale, offset = self.instruments.true_map(self._devices.instruments)
        return scale, offset

    def save(self, path: str | PathLike[str]) -> None:
        """Write what the hardware keeps while the power is on, its gains and zeros, to an ``.npz``.

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
        if self._listening:
            computer = self._telemetry_state.computer._replace(**self._hardware.telemetry._asdict())
            self._telemetry_state = self._telemetry_state._replace(computer=computer)

    @property
    def _devices(self) -> HardwareState:
        if self._hardware is None:
            raise RuntimeError("There are no sensors before the first reset(), which draws them.")
        return self._hardware

    def _now(self) -> HardwareState:
        """What the hardware is now, telemetry's part included."""
        hardware = self._devices
        if not self._listening:
            return hardware
        computer = self._telemetry_state.computer
        return hardware._replace(telemetry=Hardware(computer.imu, computer.encoders))

    def _notes(self) -> dict[str, str]:
        return {
            "robot": f"{self.source.drawing.torso} with {', '.join(self.source.joint_names)}",
            "sensors": " ".join(repr(part.config) for part in self.instruments.parts),
            "channels": " ".join(self.instruments.layout.channel_names),
        }

    def _switch_on(self, truth: Any) -> None:
        """Draw fresh sensors, or take those that there are, and let every chip and the link deliver once."""
        rng = self._rng
        kept = None if self.drawn_anew else self._now().telemetry
        if self.drawn_anew:
            broken = () if self._broken is None else self._broken.init((self.instruments.channels,), rng)
            self._hardware = HardwareState(self.instruments.init(rng), broken, None)
            self._held = self.instruments.zero_code.astype(np.float32)
        settled = self.instruments.settled(truth, self._devices.instruments)
        self._hardware = self._devices._replace(instruments=settled)
        self._read(truth, max(self.telemetry.dt, self.instruments.slowest))
        if self._listening:
            # At the reset a robot hangs just above its footprints; packets before tell of one that stood.
            inertial = np.concatenate([GRAVITY * truth.R_world_torso[-1][2], np.zeros(3)])
            self.packets, self._telemetry_state = self.telemetry.init(
                truth.joint_position[-1].copy(), inertial, self._telemetry_rng, kept
            )

    def _read(self, truth: Any, dt: float) -> None:
        hardware = self._devices
        self._raw, instruments = self.instruments.read(truth, hardware.instruments, self._rng, dt)
        faults = hardware.faults
        if self._broken is not None:
            self._raw, faults = self._broken.apply(self._raw, faults, self._rng, dt)
        self._hardware = HardwareState(instruments, faults, hardware.telemetry)

    def _make_telemetry(self, dt: float, substeps: int) -> Telemetry:
        """Build telemetry; a link by name sends no more packets than there are moments of truth."""
        imu, encoders, link = self._configs
        if self._link_by_name and link.rate is not None:
            link = replace(link, rate=min(link.rate, substeps / dt))
        telemetry = Telemetry(len(self.source.joint_names), imu, encoders, link, dt, substeps)
        if self._state_layout is not None:
            self._measured = _overwritten(self._state_layout, telemetry)
        return telemetry

    def _fault(self, given: str | Fault | Mapping[str, Any]) -> Fault:
        if not isinstance(given, str):
            return resolve(given, Fault)
        return parse_fault(given, self.source.drawing.feet, self.instruments.layout.feet[0].channel_names)

    def _space(self, shown: spaces.Space[Any]) -> tuple[spaces.Dict, bool]:
        """Say what is observed, and whether the environment shows a ``Dict``."""
        is_dict = isinstance(shown, spaces.Dict)
        parts = dict(shown.spaces) if isinstance(shown, spaces.Dict) else {"state": shown}
        if "foot_raw" in parts:
            raise TypeError(
                "FootSensors found 'foot_raw' among the observations: it is the first wrapper around an "
                f"environment that it reads, and one is enough; got {self.env}."
            )
        low, high = self.instruments.code_range
        with np.errstate(over="ignore"):
            counts = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        kept = {key: part for key, part in parts.items() if key not in TRUE_KEYS}
        return spaces.Dict(kept | {"foot_raw": counts}), is_dict

    def _observe(self, observation: Any) -> dict[str, Any]:
        if not self._was_dict:
            return {"state": observation, "foot_raw": self._counts()}
        seen = {key: part for key, part in observation.items() if key not in TRUE_KEYS}
        if self._state_layout is not None:
            if self.packets:
                self._newest = self.packets[-1].values
            state = seen["state"].copy()
            for where, measured in self._measured:
                state[where] = self._newest[measured]
            low, high = self._state_bounds
            np.maximum(state, low, out=state)
            seen["state"] = np.minimum(state, high, out=state)
        seen["foot_raw"] = self._counts()
        return seen

    def _counts(self) -> NDArray[np.float32]:
        """Show the last reading of each channel that arrived."""
        counts = self._raw.astype(np.float32)
        missing = np.isnan(counts)
        if missing.any():
            counts[missing] = self._held[missing]
        self._held = counts
        return counts.copy()


def _overwritten(layout: Mapping[str, slice], telemetry: Telemetry) -> list[tuple[slice, slice]]:
    """Pair the measured parts of the state with those of a packet, neighbours joined."""
    joined: list[tuple[slice, slice]] = []
    for name in ("joint_position", "joint_velocity", "tilt", "gyroscope"):
        where, source = layout[name], getattr(telemetry.layout, name)
        if joined and joined[-1][0].stop == where.start and joined[-1][1].stop == source.start:
            last_where, last_source = joined.pop()
            where = slice(last_where.start, where.stop)
            source = slice(last_source.start, source.stop)
        joined.append((where, source))
    return joined
