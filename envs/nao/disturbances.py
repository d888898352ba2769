"""Pushes against the torso, and a payload that is fixed to it during an episode."""

from collections.abc import Sequence
from math import cos, isfinite, pi, sin
from typing import Any, NamedTuple

import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.options import check_range, numbers_of, positive

PUSH_TIME = 0.1  # how long a push lasts in s


class Pushes:
    """Horizontal pushes of constant force at the torso's centre of mass, at random times.

    ``impulse`` is the smallest and the largest impulse in N s. The intervals between pushes are exponentially
    distributed with the mean ``interval`` in s. The first push comes at least ``quiet_time`` s after a reset.
    """

    def __init__(
        self, model: Any, impulse: Sequence[float], interval: float, dt: float, quiet_time: float = 0.0
    ) -> None:
        self._impulse = check_range("push_impulse", impulse)
        self._interval = positive("push_interval", interval) / dt
        self._length = round(PUSH_TIME / dt)
        self._dt, self._quiet_time = dt, quiet_time
        self._body = int(model.body("torso").id)
        self._next = 0.0
        self._left = 0

    def reset(self, rng: np.random.Generator) -> None:
        """Draw the time of the first push."""
        self._left = 0
        self._next = self._quiet_time / self._dt + rng.exponential(self._interval)

    def apply(self, data: Any, rng: np.random.Generator) -> None:
        """Set the force on the torso for the next control step."""
        if self._impulse[1] == 0.0:
            return
        self._next -= 1.0
        if self._left > 0:
            self._left -= 1
            if self._left == 0:
                data.xfrc_applied[self._body, :3] = 0.0
        if self._next <= 0.0:
            force = rng.uniform(*self._impulse) / (self._length * self._dt)
            angle = rng.uniform(-pi, pi)
            data.xfrc_applied[self._body, :3] = (force * cos(angle), force * sin(angle), 0.0)
            self._left = self._length
            self._next = rng.exponential(self._interval)


POSITION_PAYLOAD_TORSO = (0.06, 0.0, 0.04)
"""Default position of a payload's centre of mass in the torso's frame in m, before the chest."""

CHEST = ((POSITION_PAYLOAD_TORSO, POSITION_PAYLOAD_TORSO),)
"""The same position as boxes to draw from."""

HALF_EDGE = 0.03  # half the edge in m of the cube whose inertia is used for a payload; chosen


LINK = ("body_mass", "body_ipos", "body_inertia", "body_iquat")
"""Fields of a model: mass, centre of mass, principal inertia and its axes of a body."""


class PayloadRange(NamedTuple):
    """Ranges from which an episode draws its payload."""

    mass: tuple[float, float]  # in kg
    time: tuple[float, float]  # after the initial stand in s
    boxes: Floats  # corners of boxes in the torso's frame in m, shape (boxes, 2, 3)
    stand_time: float  # duration of the initial stand in s

    @classmethod
    def of(
        cls, mass: Sequence[float] | None, time: Any, boxes: Any, stand_time: float, payload: Any
    ) -> "PayloadRange | None":
        """Return ranges, ``None`` without a mass; ValueError names the option that is out of its range."""
        if mass is None:
            return None
        if payload is not None:
            raise ValueError(
                f"Pass either 'payload' or 'payload_mass', got {payload!r} and {mass!r}: an episode has one "
                "payload."
            )
        try:
            corners = np.array(boxes, dtype=np.float64)
        except (TypeError, ValueError):
            corners = np.zeros(0)
        if corners.shape[1:] != (2, 3) or not np.isfinite(corners).all() or not len(corners):
            raise ValueError(
                "'payload_boxes' must be boxes of a lowest and a highest corner in m, shape (boxes, 2, 3), "
                f"at least one and all finite; got {boxes!r}."
            )
        ranges = check_range("payload_mass", mass), check_range("payload_time", time)
        return cls(*ranges, corners, stand_time)

    def draw(self, rng: np.random.Generator) -> tuple[float, float, list[float]]:
        """Draw mass in kg, time of the episode in s and place in the torso's frame in m."""
        mass, time = rng.uniform(*self.mass), self.stand_time + rng.uniform(*self.time)
        low, high = self.boxes[rng.integers(len(self.boxes))]
        return mass, time, rng.uniform(low, high).tolist()


class Payload:
    """A cube that is fixed to the torso at a given time of the episode: (mass in kg, time in s), or ``None``.

    It changes the simulated robot only. The pattern and all nominal models remain those of the robot without
    it. ``carried`` is true while the robot carries it. ValueError if the payload is not such a pair, or a
    number is negative.
    """

    def __init__(self, model: mujoco.MjModel, payload: Sequence[float] | None, dt: float) -> None:
        self._model = model
        self._body = int(model.body("torso").id)
        self._dt = dt
        mass, time = _check_payload(payload)
        self.carried = False
        self.plan(mass, time)
        self._empty = [getattr(model, name)[self._body].copy() for name in LINK]

    def plan(self, mass: float, time: float, position: Sequence[float] = POSITION_PAYLOAD_TORSO) -> None:
        """Plan a mass in kg, 0 for none, at a time of the episode in s and a place in the torso's frame in m.

        RuntimeError if the robot carries a payload; :meth:`reset` removes it.
        """
        if self.carried:
            raise RuntimeError(
                "The robot carries a payload; reset() puts it down before the next is planned."
            )
        self.mass = mass
        self.position = np.array(position, dtype=np.float64)
        self._tick = round(time / self._dt)

    def reset(self) -> None:
        """Remove the payload."""
        if self.carried:
            self._set(self._empty)
            self.carried = False

    def apply(self, tick: int) -> bool:
        """Add the payload if it is due before the step to ``tick``; return whether it was added."""
        picked = bool(self.mass) and not self.carried and tick > self._tick
        if picked:
            self._set(self._torso_with_payload())
            self.carried = True
        return picked

    def _torso_with_payload(self) -> list[Any]:
        """Return the torso and the payload as one rigid body, by the parallel axis theorem."""
        mass, com, inertia, quaternion = self._empty
        where = self.position
        total = mass + self.mass
        centre = (mass * com + self.mass * where) / total
        axes = np.empty(9)
        mujoco.mju_quat2Mat(axes, quaternion)
        R = axes.reshape(3, 3)
        cube = self.mass * (2.0 * HALF_EDGE) ** 2 / 6.0
        tensor = R @ np.diag(inertia) @ R.T + cube * np.eye(3)
        for part, place in ((mass, com), (self.mass, where)):
            arm = place - centre
            tensor += part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        principal, vectors = np.linalg.eigh(tensor)
        if np.linalg.det(vectors) < 0.0:
            vectors[:, 0] *= -1.0
        mujoco.mju_mat2Quat(quaternion := np.empty(4), vectors.ravel())
        return [total, centre, principal, quaternion]

    def _set(self, link: list[Any]) -> None:
        for name, part in zip(LINK, link, strict=True):
            getattr(self._model, name)[self._body] = part
        # Update the constants that MuJoCo derives from masses; another MjData keeps the state unchanged.
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))


def _check_payload(payload: Any) -> tuple[float, float]:
    if payload is None:
        return 0.0, 0.0
    numbers = numbers_of(payload)
    if len(numbers) != 2 or not all(isfinite(number) and number >= 0.0 for number in numbers):
        raise ValueError(
            "'payload' must be (mass in kg, time in s at which it appears), both finite and not negative, or "
            f"None for none; got {payload!r}."
        )
    return numbers[0], numbers[1]
