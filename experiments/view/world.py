"""Disturbances of a robot while it walks: pushes, a payload, a slope."""

from collections.abc import Sequence
from math import cos, hypot, radians, sin
from typing import Any

import numpy as np

from surefoot.calibration import GRAVITY
from surefoot.envs.nao.disturbances import PUSH_TIME, Payload

LARGEST_PUSH = 20.0  # impulse of a push in N s for each kilogram of the robot
STEEPEST = 10.0  # slope in degrees


class LiveWorld:
    """Changes a simulated robot's surroundings between two steps.

    The slope turns gravity and not the ground: physics are the same, and coordinates stay those of the
    ground. ``source`` is the environment that records the truth, with its ``model`` and ``data``; a robot
    ``carries`` if there is a torso that a payload can be fixed to.
    """

    def __init__(self, source: Any) -> None:
        self._source = source
        self._torso = int(source.model.body(source.drawing.torso).id)
        self._left = 0
        self.carries = source.drawing.torso == "torso"
        self._payload = Payload(source.model, None, float(source.dt)) if self.carries else None
        self._mass = 0.0

    def push(self, impulse: Sequence[float]) -> None:
        """Push the torso for 0.1 s with an impulse (forward, left) in N s; ValueError if it is none."""
        forward, left = (float(part) for part in impulse)
        model, dt = self._source.model, float(self._source.dt)
        largest = LARGEST_PUSH * float(model.body_subtreemass[self._torso])
        if not hypot(forward, left) <= largest:
            raise ValueError(f"A push is at most {largest:.3g} N s, got {forward:g} and {left:g}.")
        self._left = max(round(PUSH_TIME / dt), 1)
        force = forward / (self._left * dt), left / (self._left * dt), 0.0
        self._source.data.xfrc_applied[self._torso, :3] = force

    def advance(self) -> None:
        """End a push that has lasted: called after every step."""
        if self._left:
            self._left -= 1
            if not self._left:
                self._source.data.xfrc_applied[self._torso, :3] = 0.0

    def tilt(self, degrees: float) -> None:
        """Let the ground rise in the walking direction, or fall; ValueError beyond 10 degrees."""
        if not abs(degrees) <= STEEPEST:
            raise ValueError(f"A slope is at most {STEEPEST:g} degrees, got {degrees:g}.")
        angle = radians(degrees)
        self._source.model.opt.gravity[:] = GRAVITY * np.array([-sin(angle), 0.0, -cos(angle)])

    def load(self, mass: float) -> None:
        """Fix a mass in kg before the chest, in place of the last one; 0 for none.

        Raises ValueError if it is negative, heavier than the robot, or nothing can be fixed to the robot.
        """
        heaviest = self._source.drawing.weight / GRAVITY
        if self._payload is None:
            raise ValueError("A payload is fixed to a body called 'torso', and this robot has none.")
        if not 0.0 <= mass <= heaviest:
            raise ValueError(f"A payload has from 0 to {heaviest:.3g} kg, got {mass:g}.")
        self._mass = mass
        self._payload.reset()
        self._payload.plan(mass, 0.0)
        self._payload.apply(1)

    def put_down(self) -> None:
        """Take the payload away and end a push: called before every reset."""
        self._left = 0
        if self._payload is not None:
            self._payload.reset()

    def pick_up(self) -> None:
        """Give the payload back: called after every reset."""
        if self._mass:
            self.load(self._mass)
