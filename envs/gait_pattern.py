"""A whole walk, planned before it is walked: stand, start, walk or turn, stop, stand.

From the footsteps follows where the centre of pressure is to be: under the supporting foot while one foot
carries, moving smoothly from one foot to the other while both do. Preview control finds a motion of the
centre of mass with that centre of pressure, the swinging foot goes along smooth polynomials, and inverse
kinematics turns it all into joint targets.

The cart-table knows nothing of the swinging leg. As Kajita et al. (2003) propose, the centre of pressure that
the planned motion of the *whole* robot asks for is computed, and a second run of the preview control, on the
difference to the reference, corrects the motion of the centre of mass.

What the motors are told leads the posture by what is known to hold it back: the servos give way under their
load and lag behind by kv / kp, and the ground gives way under a foot.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from surefoot.envs.command import Command
from surefoot.envs.gait_dynamics import joint_torques, joint_velocities, motor_targets, multibody_zmp
from surefoot.envs.gait_footsteps import (
    CONTROL_RATE,
    LEFT,
    Footstep,
    GaitTiming,
    plan_footsteps,
    stance_of_stand,
)
from surefoot.envs.gait_kinematics import JointTrack, WholeBodyKinematics
from surefoot.envs.gait_preview import CartTable, track_zmp
from surefoot.envs.gait_swing import lift, minimum_jerk
from surefoot.envs.robot import load_nao_spec

__all__ = ["Pattern", "plan_walk"]

LIFT_HEIGHT = 0.015
"""How high a foot is lifted, in m."""

COM_HEIGHT = 0.266
"""Height of the centre of mass above the soles in m: knees bent by about 0.8 rad in a stand."""

COM_LOWERING = 0.12
"""By how many m the centre of mass is lowered for each m of a step beyond 0.02 m, for the legs to reach."""

HALF_WIDTH = 0.05
"""Distance of either ankle from the middle in m: legs vertical below the hips."""

GROUND_GIVE = 0.7e-3
"""How far a foot that carries the whole robot is pressed down, in m.

The ground gives way by 0.5 mm and the legs by the rest. Otherwise the swinging foot would meet the ground
early, and take over weight that the other is still to carry.
"""

COP_SOLE = (0.015, 0.010)
"""Where the centre of pressure is under a foot that carries alone: ahead of the ankle and inwards, in m."""


@dataclass(frozen=True, eq=False)
class Pattern:
    """A planned walk at the control rate; arrays are read-only and have one row a control step.

    Attributes:
        joint_target: Targets of the motors in the order of the model's actuators, shape (ticks, M), rad.
        qpos: The planned posture, floating torso first, shape (ticks, nq).
        com: Centre of mass in the pattern's world, shape (ticks, 3), m.
        com_velocity: Its velocity, shape (ticks, 3), m/s.
        com_acceleration: Its acceleration, shape (ticks, 3), m/s².
        cop: Where the centre of pressure is to be, shape (ticks, 2), m.
        position_sole: Soles' origins, shape (ticks, 2, 3), m.
        yaw_sole: Soles' headings, shape (ticks, 2), rad.
        stance: Whether a foot is planned to carry, shape (ticks, 2).
        phase: Phase of the stride (two steps) in [0, 1), shape (ticks,); 0 while standing.
        footsteps: The footsteps after the initial stand.
        kinematic_error: Largest error of a planned sole or centre of mass in m.
    """

    joint_target: NDArray[np.float64]
    qpos: NDArray[np.float64]
    com: NDArray[np.float64]
    com_velocity: NDArray[np.float64]
    com_acceleration: NDArray[np.float64]
    cop: NDArray[np.float64]
    position_sole: NDArray[np.float64]
    yaw_sole: NDArray[np.float64]
    stance: NDArray[np.bool_]
    phase: NDArray[np.float64]
    footsteps: tuple[Footstep, ...]
    kinematic_error: float

    @property
    def ticks(self) -> int:
        """Number of control steps."""
        return len(self.com)

    def command(self, tick: int) -> Command:
        """What the robot commands at a control step; before the first and after the last, it stands there."""
        k = min(max(tick, 0), self.ticks - 1)
        return Command(
            joint_target=self.joint_target[k],
            com=self.com[k],
            com_velocity=self.com_velocity[k],
            com_acceleration=self.com_acceleration[k],
            cop=self.cop[k],
            position_sole=self.position_sole[k],
            yaw_sole=self.yaw_sole[k],
            stance=self.stance[k],
            swing=~self.stance[k],
            phase=float(self.phase[k]),
        )


@dataclass
class _Ground:
    """What happens on the ground: where the soles are and the centre of pressure is to be, row by row."""

    position_sole: NDArray[np.float64]
    yaw_sole: NDArray[np.float64]
    cop: NDArray[np.float64]
    cop_foot: NDArray[np.float64]
    stance: NDArray[np.bool_]
    phase: NDArray[np.float64]

    @property
    def share(self) -> NDArray[np.float64]:
        """Share of the weight on each foot, as the centre of pressure says, shape (ticks, 2)."""
        between = self.cop_foot[:, 1] - self.cop_foot[:, 0]
        right = ((self.cop - self.cop_foot[:, 0]) * between).sum(axis=1) / (between**2).sum(axis=1)
        return np.where(self.stance, np.stack([1.0 - right, right], axis=1), 0.0)


@lru_cache(maxsize=32)
def plan_walk(
    speed: float = 0.04,
    turn_rate: float = 0.0,
    duration: float = 60.0,
    *,
    timing: GaitTiming | None = None,
    lift_height: float = LIFT_HEIGHT,
    com_height: float | None = None,
    half_width: float = HALF_WIDTH,
) -> Pattern:
    """Plan a walk on the flat from standing to standing.

    The same arguments give the same pattern, planned once in a process.

    Args:
        speed: Forward speed in m/s, negative backwards; 0 marks time, or turns in place.
        turn_rate: Change of heading in rad/s, positive to the left.
        duration: Duration of all of it, standing included, in s.
        timing: Duration of a step and of its parts.
        lift_height: How high a foot is lifted, in m.
        com_height: Height of the centre of mass in m; the longer the steps, the lower, when not given.
        half_width: Distance of either ankle from the path in m.

    Raises:
        ValueError: If the walk asks more than the legs can do, or does not fit into its duration.

    >>> plan_walk(0.04, 0.0, 6.0).ticks
    480
    """
    timing = GaitTiming() if timing is None else timing
    if not (np.isfinite(duration) and duration > 0):
        raise ValueError(f"'duration' must be a positive number of seconds, got {duration}.")
    steps = timing.steps_within(duration)
    if steps < 2:
        least = 2 * (timing.stand_time + timing.step_time) + timing.double_support * timing.step_time
        raise ValueError(
            f"'duration' {duration} s leaves no room for two steps between {timing.stand_time} s of standing "
            f"at either end; walk for at least {least + 0.05:.2f} s."
        )
    footsteps = plan_footsteps(speed, turn_rate, steps, timing.step_time, half_width)
    if com_height is None:
        com_height = COM_HEIGHT - COM_LOWERING * max(abs(speed) * timing.step_time - 0.02, 0.0)
    ground = _lay_out(footsteps, timing, round(duration * CONTROL_RATE), lift_height, half_width)
    return _make_pattern(ground, footsteps, com_height)


def _lay_out(
    footsteps: tuple[Footstep, ...], timing: GaitTiming, ticks: int, lift_height: float, half_width: float
) -> _Ground:
    """Write down, tick by tick, what the footsteps mean."""
    stand = stance_of_stand(half_width)
    position = np.tile(np.array([[*foot.position, 0.0] for foot in stand]), (ticks, 1, 1))
    yaw = np.zeros((ticks, 2))
    stance = np.ones((ticks, 2), dtype=bool)
    phase = np.zeros(ticks)
    cop = np.empty((ticks, 2))
    cop_foot = np.tile(np.array([_cop_of(foot) for foot in stand]), (ticks, 1, 1))

    feet = list(stand)
    tick = timing.stand_ticks
    cop_now = np.mean([_cop_of(foot) for foot in feet], axis=0)
    cop[:tick] = cop_now
    double, single = timing.double_ticks, timing.step_ticks - timing.double_ticks
    # In the air throughout the swing, the foot stands on the ground a tick before it and a tick after.
    air = (np.arange(single) + 1.0) / (single + 1.0)
    for step in footsteps:
        support, old = feet[1 - step.foot], feet[step.foot]
        cop_next = _cop_of(support)
        _shift(cop[tick : tick + double], cop_now, cop_next)
        swing = slice(tick + double, tick + double + single)
        cop[swing] = cop_now = cop_next
        way = minimum_jerk(air)[:, None]
        position[swing, step.foot, :2] = np.add(old.position, way * np.subtract(step.position, old.position))
        position[swing, step.foot, 2] = lift(air, lift_height)
        yaw[swing, step.foot] = old.yaw + way[:, 0] * (step.yaw - old.yaw)
        position[swing.stop :, step.foot, :2] = step.position
        yaw[swing.stop :, step.foot] = step.yaw
        stance[swing, step.foot] = False
        cop_foot[tick + double :, step.foot] = _cop_of(step)
        phase[tick : swing.stop] = (
            0.5 * (step.foot + np.arange(timing.step_ticks) / timing.step_ticks)
        ) % 1.0
        feet[step.foot] = step
        tick = swing.stop
    cop_last = np.mean([_cop_of(foot) for foot in feet], axis=0)
    _shift(cop[tick : tick + double], cop_now, cop_last)
    cop[tick + double :] = cop_last
    return _Ground(position, yaw, cop, cop_foot, stance, phase)


def _cop_of(foot: Footstep) -> NDArray[np.float64]:
    """Where the centre of pressure is to be when this foot alone carries, shape (2,)."""
    forward, inward = COP_SOLE
    left = -inward if foot.foot == LEFT else inward
    c, s = np.cos(foot.yaw), np.sin(foot.yaw)
    x, y = foot.position
    return np.array([x + c * forward - s * left, y + s * forward + c * left])


def _shift(cop: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]) -> None:
    """Move smoothly from one place to another, in place, shape (ticks, 2)."""
    way = minimum_jerk(np.arange(len(cop)) / len(cop))
    cop[:] = start + way[:, None] * (end - start)


def _make_pattern(ground: _Ground, footsteps: tuple[Footstep, ...], com_height: float) -> Pattern:
    model = load_nao_spec().compile()
    kinematics = WholeBodyKinematics(model)
    table = CartTable(com_height, 1.0 / CONTROL_RATE)
    height = np.full((len(ground.cop), 1), com_height)

    def postures(com: NDArray[np.float64], press: float = 0.0) -> JointTrack:
        sole = ground.position_sole.copy()
        sole[..., 2] -= press * ground.share
        return kinematics.track(np.hstack([com, height]), sole, ground.yaw_sole)

    motion = track_zmp(ground.cop, table)
    excess = multibody_zmp(model, postures(motion.position).qpos, table.dt) - ground.cop
    correction = track_zmp(excess, table)
    com, velocity, acceleration = (
        planned - corrected for planned, corrected in zip(motion[:3], correction[:3], strict=True)
    )
    qpos, error = postures(com)
    pressing = postures(com, GROUND_GIVE).qpos
    torque = joint_torques(model, qpos, ground.cop_foot, ground.share, table.dt)
    flat = np.zeros_like(height)
    arrays = {
        "joint_target": motor_targets(model, pressing, joint_velocities(model, qpos, table.dt), torque),
        "qpos": qpos,
        "com": np.hstack([com, height]),
        "com_velocity": np.hstack([velocity, flat]),
        "com_acceleration": np.hstack([acceleration, flat]),
        "cop": ground.cop,
        "position_sole": ground.position_sole,
        "yaw_sole": ground.yaw_sole,
        "stance": ground.stance,
        "phase": ground.phase,
    }
    for array in arrays.values():
        array.flags.writeable = False
    return Pattern(**arrays, footsteps=footsteps, kinematic_error=error)
