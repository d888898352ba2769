"""The observation of sensors instead of truth: counts under the feet, and telemetry in the state."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.sensors.telemetry.computer import MEASURED, TelemetryLayout

TRUE_KEYS = ("foot_force", "cop", "cop_foot", "cop_valid")
"""Parts of an observation that only truth has; readings take their place."""


TRUTH_KEY = "surefoot_truth"
"""Name of the row of truth that vector environments carry in an observation."""

HIDDEN = (*TRUE_KEYS, TRUTH_KEY)  # parts that nobody is shown


class RawView:
    """Shows readings instead of truth, of one robot or of many.

    Spaces are those of one robot's observation and of its readings. The layout says where parts of
    ``"state"`` lie that a packet of telemetry has; ``None`` leaves it as it is.

    Attributes:
        space: The observation space.
        bounds: Those of the state, of which parts are measured; of nothing where none are.
    """

    def __init__(
        self,
        shown: spaces.Space[Any],
        readings: spaces.Box,
        state_layout: Mapping[str, slice] | None,
        packet: TelemetryLayout,
    ) -> None:
        self._was_dict = isinstance(shown, spaces.Dict)
        parts = dict(shown.spaces) if isinstance(shown, spaces.Dict) else {"state": shown}
        kept = {key: part for key, part in parts.items() if key not in HIDDEN}
        self._alone = list(kept) == ["state"]
        self.space = spaces.Dict(kept | {"foot_raw": readings})
        self.measures = state_layout is not None
        state: Any = spaces.Box(0.0, 0.0, (0,)) if state_layout is None else kept["state"]
        self.bounds = state.low, state.high
        self._measured = [] if state_layout is None else _overwritten(state_layout, packet)

    def show(self, observation: Any, counts: NDArray[np.float32], newest: Floats) -> dict[str, Any]:
        """Show one step of one robot or of all; the environment's arrays are not changed.

        Counts are the last ones that have arrived, shape (..., K); ``newest`` are the values of the newest
        packet, shape (..., C).
        """
        state = None
        if self.measures:
            state = own_copy(observation["state"])
            for where, measured in self._measured:
                state[..., where] = newest[..., measured]
            low, high = self.bounds
            np.maximum(state, low, out=state)
            np.minimum(state, high, out=state)
        return self.compose(observation, counts.copy(), state)

    def compose(self, observation: Any, counts: NDArray[np.float32], state: Any) -> dict[str, Any]:
        """Put together the observation, with readings, and a state in place of the environment's if given."""
        if not self._was_dict:
            return {"state": own_copy(observation), "foot_raw": counts}
        if state is not None and self._alone:
            return {"state": state, "foot_raw": counts}
        seen = {key: own_copy(part) for key, part in observation.items() if key not in HIDDEN}
        if state is not None:
            seen["state"] = state
        seen["foot_raw"] = counts
        return seen

    def state_places(self) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]:
        """Return room for a state to be shown, and which of its numbers are which ones of a packet."""
        to, taken = (
            np.array([i for pair in self._measured for i in range(pair[k].start, pair[k].stop)], np.int32)
            for k in (0, 1)
        )
        return np.zeros_like(self.bounds[0]), to, taken


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
