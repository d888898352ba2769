"""The ground plan of a walk: where the soles are and where the centre of pressure is to be."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.envs.gait.footsteps import LEFT, Footstep, GaitTiming, stance_of_stand
from surefoot.envs.gait.swing import TOE_AND_HEEL, lift, minimum_jerk, pivot_of, roll_of_step

COP_SOLE = (0.015, 0.010)
"""Where the centre of pressure is under a foot that carries alone: ahead of the ankle and inwards, in m."""


class Walk(NamedTuple):
    """Footsteps without a stand between them."""

    start: int  # control step at which the weight begins to move onto the first supporting foot
    footsteps: tuple[Footstep, ...]  # the steps in order; the last one closes the feet


@dataclass
class Ground:
    """The ground's side of a pattern, one row a control step."""

    position_sole: Floats  # soles' origins, shape (ticks, 2, 3), m
    yaw_sole: Floats  # soles' headings, shape (ticks, 2), rad
    pitch_sole: Floats  # soles' pitch, positive toe down, shape (ticks, 2), rad
    cop: Floats  # where the centre of pressure is to be, shape (ticks, 2), m
    cop_foot: Floats  # where each foot is to carry when it does, shape (ticks, 2, 2), m
    stance: NDArray[np.bool_]  # whether a foot is planned to carry, shape (ticks, 2)
    phase: Floats  # phase of the stride in [0, 1), shape (ticks,)

    @property
    def share(self) -> Floats:
        """Share of the weight on each foot, as the centre of pressure says, shape (ticks, 2)."""
        between = self.cop_foot[:, 1] - self.cop_foot[:, 0]
        right = ((self.cop - self.cop_foot[:, 0]) * between).sum(axis=1) / (between**2).sum(axis=1)
        return np.where(self.stance, np.stack([1.0 - right, right], axis=1), 0.0)


def lay_out(walks: Sequence[Walk], timing: GaitTiming, ticks: int, foot_roll: float = 0.0) -> Ground:
    """Return, tick by tick, where the soles and the centre of pressure are to be.

    Walks come in the order of time, each with room for the last shift of the weight before the next;
    ``foot_roll`` is the pitch at lift-off and touch-down in rad.
    """
    feet = list(stance_of_stand())
    ground = Ground(
        position_sole=np.tile(np.array([[*foot.position, 0.0] for foot in feet]), (ticks, 1, 1)),
        yaw_sole=np.zeros((ticks, 2)),
        pitch_sole=np.zeros((ticks, 2)),
        cop=np.empty((ticks, 2)),
        cop_foot=np.tile(np.array([_cop_of(foot) for foot in feet]), (ticks, 1, 1)),
        stance=np.ones((ticks, 2), dtype=bool),
        phase=np.zeros(ticks),
    )
    cop, double, tick = ground.cop, timing.double_ticks, 0
    cop_now = np.mean([_cop_of(foot) for foot in feet], axis=0)
    for walk in walks:
        cop[tick : walk.start] = cop_now
        tick = walk.start
        for step in walk.footsteps:
            cop_next = _cop_of(feet[1 - step.foot])
            _shift(cop[tick : tick + double], cop_now, cop_next)
            cop[tick + double : tick + timing.step_ticks] = cop_now = cop_next
            _step(ground, tick, feet[step.foot], step, timing, foot_roll)
            feet[step.foot] = step
            tick += timing.step_ticks
        cop_last = np.mean([_cop_of(foot) for foot in feet], axis=0)
        _shift(cop[tick : tick + double], cop_now, cop_last)
        tick, cop_now = tick + double, cop_last
    cop[tick:] = cop_now
    if foot_roll:
        _roll(ground, foot_roll)
    return ground


def _step(
    ground: Ground, tick: int, old: Footstep, step: Footstep, timing: GaitTiming, foot_roll: float
) -> None:
    """Move a foot from an old footstep to a new one, from the control step at which the step begins."""
    foot, double, single = step.foot, timing.double_ticks, timing.step_ticks - timing.double_ticks
    # In the air throughout the swing, the foot stands on the ground a tick before it and a tick after.
    air = (np.arange(single) + 1.0) / (single + 1.0)
    way = minimum_jerk(air)[:, None]
    swing = slice(tick + double, tick + timing.step_ticks)
    position, yaw = ground.position_sole, ground.yaw_sole
    position[swing, foot, :2] = np.add(old.position, way * np.subtract(step.position, old.position))
    position[swing, foot, 2] = lift(air)
    yaw[swing, foot] = old.yaw + way[:, 0] * (step.yaw - old.yaw)
    position[swing.stop :, foot, :2] = step.position
    yaw[swing.stop :, foot] = step.yaw
    ground.stance[swing, foot] = False
    ground.cop_foot[tick + double :, foot] = _cop_of(step)
    if foot_roll:
        rolled = roll_of_step(foot_roll * _direction(old, step), double, single)
        ground.pitch_sole[tick : swing.stop + double, foot] += np.concatenate(rolled)
    ground.phase[tick : swing.stop] = (0.5 * (foot + np.arange(timing.step_ticks) / timing.step_ticks)) % 1.0


def _roll(ground: Ground, foot_roll: float) -> None:
    """Turn pitched soles about the edge that stays down, and let them carry there."""
    forward, up = pivot_of(ground.pitch_sole)
    ahead = np.stack([np.cos(ground.yaw_sole), np.sin(ground.yaw_sole)], axis=-1)
    ground.position_sole[..., :2] += forward[..., None] * ahead
    ground.position_sole[..., 2] += up
    edge = np.where(ground.pitch_sole > 0.0, *TOE_AND_HEEL) - COP_SOLE[0]
    moved = np.abs(ground.pitch_sole) / foot_roll * edge
    ground.cop_foot += moved[..., None] * ahead


def _direction(old: Footstep, new: Footstep) -> float:
    """1 for a step forward or on the spot, -1 for one backwards."""
    x, y = np.subtract(new.position, old.position)
    return -1.0 if np.cos(new.yaw) * x + np.sin(new.yaw) * y < -1e-6 else 1.0


def _cop_of(foot: Footstep) -> Floats:
    """Where the centre of pressure is to be when this foot alone carries, shape (2,)."""
    forward, inward = COP_SOLE
    left = -inward if foot.foot == LEFT else inward
    c, s = np.cos(foot.yaw), np.sin(foot.yaw)
    x, y = foot.position
    return np.array([x + c * forward - s * left, y + s * forward + c * left])


def _shift(cop: Floats, start: Floats, end: Floats) -> None:
    """Move smoothly from one place to another, in place, shape (ticks, 2)."""
    way = minimum_jerk(np.arange(len(cop)) / len(cop))
    cop[:] = start + way[:, None] * (end - start)
