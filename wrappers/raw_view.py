"""What is observed of sensors instead of truth: counts under the feet, and telemetry in the state."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import ObservationWrapper, spaces
from gymnasium.wrappers import FilterObservation
from numpy.typing import NDArray

from surefoot.sensors.transport.link import Packets
from surefoot.wrappers.instruments import Instruments
from surefoot.wrappers.telemetry import MEASURED, TelemetryLayout

TRUE_KEYS = ("foot_force", "cop", "cop_foot", "cop_valid")
"""Parts of an observation that only truth has; readings take their place."""


class RawView:
    """Shows readings instead of truth, and holds the last ones that arrived.

    Args:
        instruments: What is under the feet.
        source: What records the truth; what it shows says what only truth has.
        state_layout: Where parts of ``"state"`` lie that telemetry has; ``None`` leaves it as it is.
        env: Who shows it, for messages.

    Attributes:
        space: What is shown.
        bounds: Those of the state, of which parts are measured; of nothing where none are.
        held: The last reading of each channel that has arrived in counts, shape (K,).
        newest: Values of the newest packet.

    Raises:
        TypeError: If readings are shown already, or truth is where it cannot be taken out.
    """

    def __init__(
        self,
        instruments: Instruments,
        source: Any,
        state_layout: Mapping[str, slice] | None,
        env: Any,
    ) -> None:
        shown = env.observation_space
        check_order("FootSensors", env, source)
        self._was_dict = isinstance(shown, spaces.Dict)
        parts = dict(shown.spaces) if isinstance(shown, spaces.Dict) else {"state": shown}
        if "foot_raw" in parts:
            raise TypeError(
                "FootSensors found 'foot_raw' among the observations: it is the first wrapper around an "
                f"environment that it reads, and one is enough; got {env}."
            )
        kept = {key: part for key, part in parts.items() if key not in TRUE_KEYS}
        self._alone = list(kept) == ["state"]
        self.space = spaces.Dict(kept | {"foot_raw": instruments.space})
        self._state_layout = state_layout
        state: Any = spaces.Box(0.0, 0.0, (0,)) if state_layout is None else kept["state"]
        self.bounds = state.low, state.high
        self._measured: list[tuple[slice, slice]] = []
        self.newest: NDArray[np.float64]
        self._zero_code = instruments.zero_code.astype(np.float32)
        self.held = self._zero_code.copy()

    def hold_unloaded(self) -> None:
        """Hold the readings of unloaded sensors until others arrive."""
        self.held[:] = self._zero_code

    def listen(self, layout: TelemetryLayout) -> None:
        """Learn where the measured parts of the state lie in a packet."""
        self.newest = np.zeros(layout.size)
        if self._state_layout is not None:
            self._measured = _overwritten(self._state_layout, layout)

    def show(self, observation: Any, raw: NDArray[np.float64], packets: Packets) -> dict[str, Any]:
        """Show one step; the environment's arrays are not changed.

        Args:
            observation: What the environment shows.
            raw: The feet's readings in counts, shape (K,); NaN where none arrived.
            packets: Telemetry that arrived, in order.
        """
        state = None
        if self._state_layout is not None:
            if packets:
                self.newest[:] = packets[-1].values
            state = own_copy(observation["state"])
            for where, measured in self._measured:
                state[where] = self.newest[measured]
            low, high = self.bounds
            np.maximum(state, low, out=state)
            np.minimum(state, high, out=state)
        return self.seen(observation, self._counts(raw), state)

    def seen(self, observation: Any, counts: NDArray[np.float32], state: Any) -> dict[str, Any]:
        """Put together what is seen.

        Args:
            observation: What the environment shows.
            counts: What is shown of the readings.
            state: What is shown as the state; ``None`` for the environment's.
        """
        if not self._was_dict:
            return {"state": own_copy(observation), "foot_raw": counts}
        if state is not None and self._alone:
            return {"state": state, "foot_raw": counts}
        seen = {key: own_copy(part) for key, part in observation.items() if key not in TRUE_KEYS}
        if state is not None:
            seen["state"] = state
        seen["foot_raw"] = counts
        return seen

    def measured(self) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]:
        """Return room for a state to be shown, and which of its numbers are which ones of a packet."""
        to, taken = (
            np.array([i for pair in self._measured for i in range(pair[k].start, pair[k].stop)], np.int32)
            for k in (0, 1)
        )
        return np.zeros_like(self.bounds[0]), to, taken

    def _counts(self, raw: NDArray[np.float64]) -> NDArray[np.float32]:
        """Show the last reading of each channel that arrived."""
        counts = raw.astype(np.float32)
        # One number tells whether to look closer, in a third of the time.
        if not raw.dot(raw) < np.inf:
            missing = np.isnan(counts)
            counts[missing] = self.held[missing]
        self.held[:] = counts
        return counts


def check_order(owner: str, env: gym.Env[Any, Any], source: Any) -> None:
    """Raise TypeError if truth was mixed with what may be seen before it is taken out.

    Only an environment with a ``state_layout`` shows truth that can be taken out; of others the whole
    observation is handed on, whatever was made of it.

    Args:
        owner: The wrapper that takes it out, for messages.
        env: What it goes around.
        source: The environment.
    """
    below: Any = env
    while below is not source and getattr(source, "state_layout", None) is not None:
        filters = isinstance(below, FilterObservation)
        if _state(below) != _state(below.env) or (isinstance(below, ObservationWrapper) and not filters):
            raise TypeError(
                f"{owner} takes the truth out of an observation and must see it as the environment shows it, "
                f"but {type(below).__name__} below it makes something else of it; wrap in this order, and "
                f"whatever changes observations around all sensors: {owner}(env). Got {env}."
            )
        below = below.env


def _state(env: gym.Env[Any, Any]) -> spaces.Space[Any] | None:
    space = env.observation_space
    return space.spaces.get("state") if isinstance(space, spaces.Dict) else None


def own_copy(part: Any) -> Any:
    """Copy a part of an observation: an environment may hand out its own."""
    return part.copy() if isinstance(part, np.ndarray) else deepcopy(part)


def _overwritten(layout: Mapping[str, slice], packet: TelemetryLayout) -> list[tuple[slice, slice]]:
    """Pair the measured parts of the state with those of a packet, neighbours joined."""
    joined: list[tuple[slice, slice]] = []
    for name in MEASURED:
        where, source = layout[name], getattr(packet, name)
        if joined and joined[-1][0].stop == where.start and joined[-1][1].stop == source.start:
            last_where, last_source = joined.pop()
            where = slice(last_where.start, where.stop)
            source = slice(last_source.start, source.stop)
        joined.append((where, source))
    return joined
