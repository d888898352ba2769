"""A quiet stand, and later a payload that nobody announces: what balancing and carrying have in common."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from surefoot.envs.nao.env import CONTROL_STEP, NaoEnv
from surefoot.envs.options import check_range, positive


class NaoSurpriseEnv(NaoEnv):
    """Stand still first, so that calibrators get a standing start, and get a mass on the torso after it.

    During the quiet stand of ``stand_time`` s residuals are not applied, and nobody pushes. The payload has a
    mass between a lowest and a highest one in kg, (0, 0) for none, and comes so many s after the stand: by
    default not before a calibrator can tell a load from a broken sensor. Its centre of mass lies in one of
    some boxes in the torso's frame, two corners each in m, shape (boxes, 2, 3). Other options are those of
    :class:`NaoEnv`, but for ``payload``, which is drawn here. ValueError names an option that is out of its
    range; a ``payload`` is a TypeError.
    """

    def __init__(
        self,
        *,
        stand_time: float = 3.5,
        payload_mass: Sequence[float],
        payload_time: Sequence[float] = (10.5, 12.5),
        payload_boxes: Sequence[Sequence[Sequence[float]]],
        **options: Any,
    ) -> None:
        if "payload" in options:
            raise TypeError(
                f"{type(self).__name__} draws its payload: give 'payload_mass' and 'payload_time' in place "
                "of 'payload'."
            )
        self.stand_time = positive("stand_time", stand_time, or_zero=True)
        self._mass = check_range("payload_mass", payload_mass)
        self._time = check_range("payload_time", payload_time)
        try:
            self._boxes = np.array(payload_boxes, dtype=np.float64)
        except (TypeError, ValueError):
            self._boxes = np.zeros(0)
        if self._boxes.shape[1:] != (2, 3) or not np.isfinite(self._boxes).all() or not len(self._boxes):
            raise ValueError(
                "'payload_boxes' must be boxes of a lowest and a highest corner in m, shape (boxes, 2, 3), "
                f"at least one and all finite; got {payload_boxes!r}."
            )
        super().__init__(**options)
        self._pushes.quiet_time = self.stand_time
        self.quiet_ticks = round(self.stand_time / CONTROL_STEP)

    def draw_payload(self) -> None:
        """Plan the payload of an episode: its mass, when it comes, and where it lies."""
        rng = self.np_random
        mass, time = rng.uniform(*self._mass), self.stand_time + rng.uniform(*self._time)
        low, high = self._boxes[rng.integers(len(self._boxes))]
        self._payload.plan(mass, time, rng.uniform(low, high).tolist())
