"""A quiet stand first, and some time after it a load that nobody told about."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from surefoot.envs.disturbances.payload import Payload
from surefoot.envs.nao.env import CONTROL_STEP
from surefoot.envs.options import checked_range, positive


class Surprise:
    """When an episode is still, and what it has its robot carry later.

    Args:
        stand_time: Length of the quiet stand in s, with which an episode begins: calibrators get a standing
            start.
        payload_mass: Lowest and highest mass of the payload in kg; (0, 0) for none.
        payload_time: Earliest and latest moment at which it comes, in s after the quiet stand.
        payload_box: Two corners of the box in the torso's frame within which its centre of mass lies, in m,
            shape (2, 3).

    Raises:
        ValueError: If an option is out of its range, naming it.
    """

    def __init__(
        self,
        stand_time: float,
        payload_mass: Sequence[float],
        payload_time: Sequence[float],
        payload_box: Sequence[Sequence[float]],
    ) -> None:
        self.stand_time = positive("stand_time", stand_time, or_zero=True)
        self.stand_ticks = round(self.stand_time / CONTROL_STEP)
        self._mass = checked_range("payload_mass", payload_mass)
        self._time = checked_range("payload_time", payload_time)
        self._box = np.array(payload_box, dtype=np.float64)

    def draw(self, payload: Payload, rng: np.random.Generator) -> None:
        """Plan the payload of an episode: its mass, when it comes, and where within the box it lies."""
        mass = rng.uniform(*self._mass)
        time = self.stand_time + rng.uniform(*self._time)
        low, high = self._box
        payload.plan(mass, time, rng.uniform(low, high).tolist())


def refuse_planned_payload(task: str, options: Mapping[str, Any]) -> None:
    """Refuse the option of :class:`NaoEnv` whose place is taken by a payload that is drawn.

    Raises:
        TypeError: If it is among the options.
    """
    if "payload" in options:
        raise TypeError(
            f"{task} draws its payload: give 'payload_mass' and 'payload_time' in place of 'payload'."
        )
