"""Disturbances of a simulated robot while it moves: pushes, a payload, a slope."""

from collections.abc import Sequence
from math import cos, hypot, radians, sin
from typing import Any

from surefoot.calibration import GRAVITY
from surefoot.envs.nao.disturbances import PUSH_TIME, Payload

LARGEST_PUSH = 20.0  # largest impulse of a push in N s per kilogram of the robot; chosen, far beyond a fall
STEEPEST = 10.0  # steepest slope in degrees; chosen, robots slip or fall before


class LiveWorld:
    """Changes the surroundings of a robot between two steps.

    A slope rotates gravity instead of the ground. The physics are the same, and coordinates stay those of the
    ground. ``source`` is the environment that records the truth, with its ``model`` and ``data``.

    Attributes:
        carries: Whether the robot has a torso to which a payload can be fixed.
    """

    def __init__(self, source: Any) -> None:
        self._source = source
        self._torso = int(source.model.body(source.drawing.torso).id)
        self._steps_left = 0  # control steps until the push ends
        self._mass = 0.0
        self.carries = source.drawing.torso == "torso"
        self._payload = Payload(source.model, None, float(source.dt)) if self.carries else None

    def push(self, impulse: Sequence[float]) -> None:
        """Push the torso for 0.1 s with an impulse (forward, left) in N s."""
        forward, left = (float(part) for part in impulse)
        largest = LARGEST_PUSH * float(self._source.model.body_subtreemass[self._torso])
        if not hypot(forward, left) <= largest:
            raise ValueError(f"A push must be at most {largest:.3g} N s, got {forward:g} and {left:g}.")
        dt = float(self._source.dt)
        self._steps_left = max(round(PUSH_TIME / dt), 1)
        duration = self._steps_left * dt
        self._source.data.xfrc_applied[self._torso, :3] = forward / duration, left / duration, 0.0

    def advance(self) -> None:
        """End a push whose time is over. Call this after every step."""
        if self._steps_left:
            self._steps_left -= 1
            if not self._steps_left:
                self._source.data.xfrc_applied[self._torso, :3] = 0.0

    def tilt(self, degrees: float) -> None:
        """Let the ground rise in the walking direction by an angle in degrees."""
        if not abs(degrees) <= STEEPEST:
            raise ValueError(f"A slope must be at most {STEEPEST:g} degrees, got {degrees:g}.")
        angle = radians(degrees)
        self._source.model.opt.gravity[:] = -GRAVITY * sin(angle), 0.0, -GRAVITY * cos(angle)

    def load(self, mass: float) -> None:
        """Fix a mass in kg in front of the chest, in place of the one before."""
        heaviest = self._source.drawing.weight / GRAVITY
        if self._payload is None:
            raise ValueError("A payload is fixed to a body called 'torso', which this robot does not have.")
        if not 0.0 <= mass <= heaviest:
            raise ValueError(f"A payload must have from 0 to {heaviest:.3g} kg, got {mass:g}.")
        self._mass = mass
        self._payload.reset()
        self._payload.plan(mass, 0.0)
        self._payload.apply(1)

    def put_down(self) -> None:
        """Remove the payload and end a push. Call this before every reset."""
        self._steps_left = 0
        if self._payload is not None:
            self._payload.reset()

    def pick_up(self) -> None:
        """Fix the payload again. Call this after every reset."""
        if self._mass:
            self.load(self._mass)
