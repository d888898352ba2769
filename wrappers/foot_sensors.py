"""Puts sensors between an environment's truth and who observes it."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY
from surefoot.sensors import Encoders, Imu, Link, LoadCells, LoadCellState, load_cells, resolve, true_map
from surefoot.sensors.configuration import require
from surefoot.sensors.link import Packets
from surefoot.wrappers.telemetry import LONGEST_DELAY, Telemetry, TelemetryState

SENSOR_STREAM = 0x5F00
"""Number of the random stream that sensors draw from unless another is given."""

TRUE_KEYS = ("foot_force", "cop", "cop_foot", "cop_valid")
"""Parts of an observation that only truth can tell; readings take their place."""


class FootSensors(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Let an environment be felt through load cells, joint encoders and an IMU.

    The observation loses what only truth can tell (``"foot_force"``, ``"cop"``, ``"cop_foot"`` and
    ``"cop_valid"``) and gains

    | Key | Observation | Min | Max | Unit |
    |-----|-------------|-----|-----|------|
    | ``"foot_raw"`` (8) | load cells, left then right: FL, FR, RL, RR | 0 | 2^24 - 1 | count |

    (the range is the configuration's). In ``"state"``, ``joint_position``, ``joint_velocity``, ``tilt`` and
    ``gyroscope`` become those of the newest packet of telemetry that has arrived. Truth stays in
    ``info["surefoot"]["truth"]``.

    At each reset the sensors are drawn anew: other gains, zeros, clocks and biases. They have a random
    stream of their own, seeded from the seed of the reset, so that the environment's trajectory is the bare
    one's, and the same seed under other wrappers is the same episode.

    Args:
        env: An environment that records its truth, such as ``surefoot/NaoWalk-v0``.
        config: The load cells: the name of a preset, a mapping or a :class:`~surefoot.sensors.LoadCells`.
        imu: The IMU, likewise.
        encoders: The joint encoders, likewise.
        link: The link over which encoders and IMU reach the host, likewise.
        stream: Number of the random stream, for independent sensors on the same episode.

    Attributes:
        config: The load cells.
        packets: Telemetry that arrived during the last step, in order.
        telemetry: What the packets hold (``telemetry.layout``) and how often they are sent.
        time: The host's time since the reset in s.

    Raises:
        TypeError: If the environment records no truth, or its observation is no ``Dict``.
        ValueError: If a preset is unknown or a value is refused.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        config: str | Mapping[str, Any] | LoadCells = "hx711-load-cells",
        *,
        imu: str | Mapping[str, Any] | Imu = "nao-imu",
        encoders: str | Mapping[str, Any] | Encoders = "nao-encoders",
        link: str | Mapping[str, Any] | Link = "nao-wlan",
        stream: int = SENSOR_STREAM,
    ) -> None:
        check_stream("FootSensors", stream)
        gym.utils.RecordConstructorArgs.__init__(
            self, config=config, imu=imu, encoders=encoders, link=link, stream=stream
        )
        gym.Wrapper.__init__(self, env)
        space = env.observation_space
        known = all(hasattr(env.unwrapped, name) for name in ("state_layout", "joint_names", "dt"))
        if not known or not isinstance(space, spaces.Dict) or "foot_force" not in space.spaces:
            raise TypeError(
                f"FootSensors needs an environment that records its truth (unwrapped.truth, "
                f".state_layout, .joint_names, .dt) and shows it as observation['foot_force'], such as "
                f"surefoot/NaoWalk-v0, as the first wrapper around it; got {env}."
            )
        self.config = resolve(config, LoadCells)
        self._configs = (resolve(imu, Imu), resolve(encoders, Encoders), resolve(link, Link))
        require(
            self._configs[2].delay <= LONGEST_DELAY,
            self._configs[2],
            "delay",
            f"be at most {LONGEST_DELAY} s, which is as late as telemetry is of use here",
        )
        channels = space["foot_force"].shape
        if channels != (self.config.channels,):
            raise ValueError(
                f"The environment has {channels} cells, but LoadCells.channels is {self.config.channels}."
            )
        low, high = self.config.code_range
        self.observation_space = spaces.Dict(
            {key: part for key, part in space.spaces.items() if key not in TRUE_KEYS}
            | {"foot_raw": spaces.Box(np.float32(low), np.float32(high), channels, dtype=np.float32)}
        )
        self._cells = load_cells(self.config)
        self._stream = stream
        self._rng = np.random.default_rng()
        self.packets: Packets = ()
        self.time = 0.0
        self.telemetry: Telemetry
        self._cell_state: LoadCellState
        self._raw: NDArray[np.float64]
        self._telemetry_state: TelemetryState
        self._newest: NDArray[np.float64]
        self._measured: list[tuple[slice, slice]] = []
        state = space["state"]
        self._state_bounds = (state.low, state.high)  # type: ignore[attr-defined]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment and draw the sensors anew.

        Args:
            seed: Seeds the environment, and the sensors with it; without, they draw on.
            options: Handed to the environment.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._rng = np.random.default_rng([self._stream, seed])
        base: Any = self.unwrapped
        truth = base.truth
        substeps, dt = len(truth.time), float(base.dt)
        if not hasattr(self, "telemetry") or self.telemetry.dt != dt:
            imu, encoders, link = self._configs
            self.telemetry = Telemetry(len(base.joint_names), imu, encoders, link, dt, substeps)
            self._measured = _overwritten(base.state_layout, self.telemetry)
        self._switch_on(truth)
        self.time = 0.0
        return self._observe(observation), info

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Step the environment and read the sensors."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        base: Any = self.unwrapped
        truth, dt = base.truth, self.telemetry.dt
        self.time += dt
        self._raw, self._cell_state = self._cells.apply(truth.force_cell, self._cell_state, self._rng, dt)
        self.packets, self._telemetry_state = self.telemetry.advance(
            truth.joint_position,
            np.concatenate((truth.accelerometer, truth.gyroscope), axis=1),
            self.time,
            self._telemetry_state,
            self._rng,
        )
        return self._observe(observation), float(reward), terminated, truncated, info

    @property
    def raw(self) -> NDArray[np.float64]:
        """The load cells' last reading in counts, in double precision, shape (K,)."""
        return self._raw

    def true_parameters(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Tell the map that would undo the load cells' errors now: truth, to score calibrators against.

        Returns:
            Scale in N per count and offset in N, each (K,).
        """
        scale: NDArray[np.float64]
        offset: NDArray[np.float64]
        scale, offset = true_map(self.config, self._cell_state)
        return scale, offset

    def _switch_on(self, truth: Any) -> None:
        """Draw fresh sensors and let every chip and the link deliver once."""
        rng = self._rng
        force = truth.force_cell
        state = self._cells.init((self.config.channels,), rng)
        slowest = self.telemetry.dt if self.config.rate is None else 1.0 / self.config.rate[0]
        self._raw, self._cell_state = self._cells.apply(force, state, rng, slowest)
        # At the reset the robot hangs just above its footprints; the packets before tell of one that stood.
        inertial = np.concatenate([GRAVITY * truth.R_world_torso[-1][2], np.zeros(3)])
        self.packets, self._telemetry_state = self.telemetry.init(
            truth.joint_position[-1].copy(), inertial, rng
        )

    def _observe(self, observation: dict[str, Any]) -> dict[str, Any]:
        if self.packets:
            self._newest = self.packets[-1].values
        seen = {key: part for key, part in observation.items() if key not in TRUE_KEYS}
        state = seen["state"].copy()
        for where, source in self._measured:
            state[where] = self._newest[source]
        low, high = self._state_bounds
        np.maximum(state, low, out=state)
        seen["state"] = np.minimum(state, high, out=state)
        seen["foot_raw"] = self._raw.astype(np.float32)
        return seen


def check_stream(owner: str, stream: Any) -> None:
    """Refuse what cannot number a random stream, in the name of the wrapper that it was given to.

    Raises:
        ValueError: If it is no whole number from 0 on.
    """
    whole = isinstance(stream, (int, np.integer)) and not isinstance(stream, bool)
    if not whole or stream < 0:
        raise ValueError(f"{owner}: 'stream' must be a whole number from 0 on, got {stream!r}.")


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
