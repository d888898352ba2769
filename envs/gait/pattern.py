"""A whole walk, planned before it is walked: stand, start, walk or turn, stop, stand.

From the footsteps follows where the centre of pressure is to be: under the supporting foot while one foot
carries, moving smoothly from one foot to the other while both do. Preview control finds a motion of the
centre of mass with that centre of pressure, the swinging foot goes along smooth polynomials, and inverse
kinematics turns it all into joint targets.

The cart-table knows nothing of the swinging leg. As Kajita et al. (2003) propose, the centre of pressure that
the planned motion of the *whole* robot asks for is computed, and a second run of the preview control, on the
difference to the reference, corrects the motion of the centre of mass.

The motors' targets lead the posture by its known delays: the servos give way under their
load and lag behind by kv / kp, and the ground gives way under a foot.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.envs.command import Command
from surefoot.envs.gait.dynamics import joint_torques, joint_velocities, motor_targets, multibody_zmp
from surefoot.envs.gait.footsteps import CONTROL_RATE, Footstep, GaitTiming, plan_footsteps
from surefoot.envs.gait.ground import Walk, lay_out
from surefoot.envs.gait.kinematics import JointTrack, WholeBodyKinematics
from surefoot.envs.gait.preview import CartTable, track_zmp
from surefoot.envs.gait.route import Leg, plan_legs
from surefoot.envs.gait.swing import check_roll
from surefoot.envs.robots.nao import nao_model

COM_HEIGHT = 0.266
"""Height of the centre of mass above the soles in m: knees bent by about 0.8 rad in a stand."""

COM_LOWERING = 0.12
"""By how many m the centre of mass is lowered for each m of a step beyond 0.02 m, for the legs to reach."""

GROUND_GIVE = 0.7e-3
"""How far a foot that carries the whole robot is pressed down, in m.

The ground gives way by 0.5 mm and the legs by the rest. Otherwise the swinging foot would meet the ground
early, and take over weight that the other is still to carry.
"""


@dataclass(frozen=True, eq=False)
class Pattern:
    """A planned walk at the control rate; arrays are read-only and have one row a control step.

    Fields of :class:`~surefoot.envs.Command` are in the pattern's world.
    """

    joint_target: Floats
    qpos: Floats  # the planned posture, floating torso first, shape (ticks, nq)
    com: Floats
    com_velocity: Floats
    com_acceleration: Floats
    cop: Floats
    position_sole: Floats
    yaw_sole: Floats
    pitch_sole: Floats  # soles' pitch, positive toe down, shape (ticks, 2), rad
    stance: NDArray[np.bool_]
    phase: Floats
    footsteps: tuple[Footstep, ...]  # the footsteps after the initial stand
    kinematic_error: float  # largest error of a planned sole or centre of mass in m

    @property
    def ticks(self) -> int:
        """Number of control steps."""
        return len(self.com)

    def command(self, tick: Any) -> Command:
        """The robot's command at a control step; before the first and after the last, it stands there.

        Control steps of many robots, shape (N,), give a command with the robots in front of each field.
        """
        k = np.minimum(np.maximum(tick, 0), self.ticks - 1)
        planned = {name: getattr(self, name)[k] for name in Command._fields if name != "swing"}
        return Command(**planned, swing=~self.stance[k])


class Patterns:
    """The patterns of N robots, of which many may be the same."""

    def __init__(self, patterns: Sequence[Pattern]) -> None:
        self._distinct = list({id(pattern): pattern for pattern in patterns}.values())
        which = [next(i for i, own in enumerate(self._distinct) if own is one) for one in patterns]
        self._which = np.array(which), np.arange(len(patterns))

    def command(self, ticks: NDArray[np.int_]) -> Command:
        """The robots' commands at a control step each; see :meth:`Pattern.command`."""
        commands = [pattern.command(ticks) for pattern in self._distinct]
        return Command(*(np.array(parts)[self._which] for parts in zip(*commands, strict=True)))


def plan_walk(
    speed: float = 0.04,
    turn_rate: float = 0.0,
    duration: float = 60.0,
    *,
    timing: GaitTiming | None = None,
    foot_roll: float = 0.0,
) -> Pattern:
    """Plan a walk on the flat from standing to standing.

    The same arguments give the same pattern, planned once in a process.

    Args:
        speed: Forward speed in m/s, negative backwards; 0 marks time, or turns in place.
        turn_rate: Change of heading in rad/s, positive to the left.
        duration: Duration of all of it, standing included, in s.
        timing: Duration of a step and of its parts.
        foot_roll: Pitch in rad with which a foot leaves its toe last and lands on its heel; 0 keeps it flat.

    Raises:
        ValueError: If the walk asks more than the legs can do, or does not fit into its duration.

    >>> plan_walk(0.04, 0.0, 6.0).ticks
    480
    """
    timing = GaitTiming() if timing is None else timing
    ticks = _ticks_of(duration)
    steps = timing.steps_within(duration)
    if steps < 2:
        least = 2 * (timing.stand_time + timing.step_time) + timing.double_support * timing.step_time
        raise ValueError(
            f"'duration' {duration} s leaves no room for two steps between {timing.stand_time} s of standing "
            f"at either end; walk for at least {least + 0.05:.2f} s."
        )
    walks = (Walk(timing.stand_ticks, plan_footsteps(speed, turn_rate, steps, timing.step_time)),)
    return _plan(walks, timing, ticks, check_roll(foot_roll), _com_height(speed, timing))


def plan_route(
    legs: tuple[Leg, ...],
    duration: float | None = None,
    *,
    timing: GaitTiming | None = None,
    foot_roll: float = 0.0,
) -> Pattern:
    """Plan walking, turning and standing one after another, from standing to standing.

    Legs that walk flow into each other; a leg that stands has the feet side by side from its first moment to
    its last. A walk takes whole steps, so that it may stand up to a step before its time is over. The stands
    before and after the route are part of the duration, and so is the time that it leaves over; without one
    it is as long as it takes. Other arguments are those of :func:`plan_walk`. ValueError if the route asks
    more than the legs can do, or does not fit into the duration.

    >>> plan_route((Leg(4.0, 0.04, 0.0), Leg(2.0, 0.0, 0.0), Leg(4.0, 0.0, 0.2))).ticks
    960
    """
    timing = GaitTiming() if timing is None else timing
    walks, end = plan_legs(legs, timing)
    least = end + timing.stand_ticks
    ticks = least if duration is None else _ticks_of(duration)
    if ticks < least:
        raise ValueError(
            f"'route' takes {least / CONTROL_RATE} s with {timing.stand_time} s of standing at either end, "
            f"longer than its 'duration' of {duration} s; give it that time or leave out a leg."
        )
    fastest = max(abs(leg.speed) for leg in legs)
    return _plan(walks, timing, ticks, check_roll(foot_roll), _com_height(fastest, timing))


def _ticks_of(duration: float) -> int:
    if not (np.isfinite(duration) and duration > 0):
        raise ValueError(f"'duration' must be a positive number of seconds, got {duration}.")
    return round(duration * CONTROL_RATE)


def _com_height(speed: float, timing: GaitTiming) -> float:
    """Height of the centre of mass in m: the longer the steps, the lower."""
    return COM_HEIGHT - COM_LOWERING * max(abs(speed) * timing.step_time - 0.02, 0.0)


@lru_cache(maxsize=64)
def _plan(
    walks: tuple[Walk, ...], timing: GaitTiming, ticks: int, foot_roll: float, com_height: float
) -> Pattern:
    ground = lay_out(walks, timing, ticks, foot_roll)
    model = nao_model()
    kinematics = WholeBodyKinematics(model)
    table = CartTable(com_height, 1.0 / CONTROL_RATE)
    height = np.full((len(ground.cop), 1), com_height)

    def postures(com: Floats, press: float = 0.0) -> JointTrack:
        sole = ground.position_sole.copy()
        sole[..., 2] -= press * ground.share
        return kinematics.track(np.hstack([com, height]), sole, ground.yaw_sole, ground.pitch_sole)

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
        "pitch_sole": ground.pitch_sole,
        "stance": ground.stance,
        "phase": ground.phase,
    }
    for array in arrays.values():
        array.flags.writeable = False
    footsteps = tuple(step for walk in walks for step in walk.footsteps)
    return Pattern(**arrays, footsteps=footsteps, kinematic_error=error)
