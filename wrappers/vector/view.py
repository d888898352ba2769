"""Observations of copies of a robot with sensors in the place of their rows of truth."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.envs import RobotDrawing
from surefoot.wrappers.vector.sensors import BatchSensors
from surefoot.wrappers.vector.truth_row import TRUTH_KEY, RowMeaning

Attribute = Callable[[str], Sequence[Any]]
"""Asks each copy for an attribute."""


def check_copies(owner: str, space: Any, attribute: Attribute) -> tuple[RobotDrawing, RowMeaning]:
    """Return the robot of all copies, which must be the same and show its truth.

    Args:
        owner: Who asks, for messages.
        space: Observation space of one copy.
        attribute: Asks each copy for an attribute.

    Returns:
        The robot, and what rows hold.

    Raises:
        TypeError: If copies have no row of truth.
        ValueError: If copies differ.
    """
    if not isinstance(space, spaces.Dict) or TRUTH_KEY not in space.spaces:
        raise TypeError(
            f"{owner} reads a row of truth beside each copy's observation, found none in {space}; wrap "
            f"each copy: gym.make_vec(..., vectorization_mode='sync', wrappers=[TruthRow]), and {owner} "
            "right around what it makes."
        )
    shown = attribute("observation_space")
    odd = [i for i, own in enumerate(shown) if own != shown[0]]
    if odd:
        raise ValueError(
            f"{owner} needs copies with one observation space, but those of copies {odd} are not that of "
            f"copy 0: {shown[odd[0]]} is not {shown[0]}."
        )
    drawings, meanings = attribute("drawing"), attribute("row_meaning")
    odd = [
        i
        for i, own in enumerate(drawings)
        if own.xml != drawings[0].xml or not _same_cells(own, drawings[0]) or meanings[i] != meanings[0]
    ]
    if odd:
        raise ValueError(
            f"{owner} needs copies of one robot, but copies {odd} are of another than copy 0 (other bodies, "
            "masses, joints, cells or control steps); put them into vector environments of their own."
        )
    return drawings[0], meanings[0]


def _same_cells(one: RobotDrawing, other: RobotDrawing) -> bool:
    places, others = one.position_cell_sole, other.position_cell_sole
    if places is None or others is None:
        return places is others
    return np.array_equal(places, others)


class BatchView:
    """Shows readings instead of truth.

    Args:
        sensors: The robots' sensors.
        space: Observation space of one copy, with a row of truth.

    Attributes:
        space: Observation space of one robot as it is shown.

    Raises:
        TypeError: If readings are shown already.
    """

    def __init__(self, sensors: BatchSensors, space: spaces.Dict) -> None:
        if "foot_raw" in space.spaces:
            raise TypeError("The copies show 'foot_raw' already: leave FootSensors around each of them out.")
        self._sensors = sensors
        parts = {key: part for key, part in space.spaces.items() if key != TRUTH_KEY}
        self.space = spaces.Dict(parts | {"foot_raw": sensors.instruments.space})
        layout = sensors.telemetry.layout
        self._measured = [
            (slice(start, stop), getattr(layout, name)) for name, start, stop in sensors.meaning.state
        ]
        if self._measured:
            state: Any = parts["state"]
            self._bounds = state.low, state.high

    def show(self, observations: Mapping[str, Any]) -> dict[str, Any]:
        """Show what the hosts have now; arrays of the environment are not changed."""
        return self._shown(observations, self._sensors.readings.raw, self._sensors.readings.packet)

    def show_one(self, observation: Mapping[str, Any], robot: int) -> dict[str, Any]:
        """Show what one host had at the end of the last step."""
        readings = self._sensors.stepped
        packet = None if readings.packet is None else readings.packet[robot]
        return self._shown(observation, readings.raw[robot], packet)

    def _shown(
        self, observation: Mapping[str, Any], raw: NDArray[np.float64], packet: NDArray[np.float64] | None
    ) -> dict[str, Any]:
        seen = {key: part for key, part in observation.items() if key != TRUTH_KEY}
        if self._measured and packet is not None:
            state = seen["state"].copy()
            for where, source in self._measured:
                state[..., where] = packet[..., source]
            low, high = self._bounds
            seen["state"] = np.minimum(np.maximum(state, low), high)
        seen["foot_raw"] = raw.astype(np.float32)
        return seen


def merge_rows(rows: NDArray[np.float64], finals: Mapping[int, Mapping[str, Any]]) -> NDArray[np.float64]:
    """Put the rows of robots' last moments in the place of those of their first.

    Args:
        rows: One row of truth a robot, shape (N, R); it is not changed.
        finals: The last observation of some robots' episodes, by their numbers.
    """
    if not finals:
        return rows
    merged = rows.copy()
    for robot, final in finals.items():
        merged[robot] = final[TRUTH_KEY]
    return merged
