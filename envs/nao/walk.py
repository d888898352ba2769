"""The robot walks."""

from collections.abc import Sequence
from math import acos, exp
from typing import Any

from surefoot.envs.command import Command
from surefoot.envs.gait.footsteps import GaitTiming
from surefoot.envs.gait.pattern import Pattern, Patterns, plan_route, plan_walk
from surefoot.envs.gait.route import parse_route
from surefoot.envs.gait.swing import check_roll
from surefoot.envs.nao.env import COP_SCALE, NaoEnv
from surefoot.envs.observation import Seen, closeness
from surefoot.envs.options import check_number

VELOCITY_SCALE = 0.1
"""Error of the velocity of the centre of mass in m/s at which its reward has fallen to 1/e."""

TILT_SCALE = 0.2  # tilt of the torso in rad at which its reward has fallen to 1/e


class NaoPatternEnv(NaoEnv):
    """Follow a pattern; subclasses make the ``pattern``, at the latest when an episode starts.

    True and planned values are compared in the level frames of the true and of the commanded soles, so that a
    walk that has drifted off its line is not paid less for it. ``cop_scale`` is the error of the centre of
    pressure in m at which its reward has fallen to 1/e.
    """

    pattern: Pattern
    cop_scale = COP_SCALE

    def draw(self, options: dict[str, Any]) -> Pattern:
        """Return the plan, which is the same in all episodes."""
        return self.pattern

    @staticmethod
    def join(plans: Sequence[Pattern]) -> Patterns:
        """Put plans of many robots into one."""
        return Patterns(plans)

    def command_at(self, plan: Pattern | Patterns, tick: Any) -> Command:
        """Return the command at a control step of an episode; tasks' rules are in :class:`BipedEnv`."""
        return plan.command(tick)

    def reward(self, seen: Seen) -> dict[str, float]:
        """Return the terms of the reward, by name."""
        tilt = acos(min(max(seen.up_z, -1.0), 1.0)) / TILT_SCALE
        cop = (
            closeness(seen.cop_error_forward, seen.cop_error_left, self.cop_scale) if seen.cop_valid else 0.0
        )
        return {
            "reward_alive": 1.0,
            "reward_progress": closeness(
                seen.velocity_error_forward, seen.velocity_error_left, VELOCITY_SCALE
            ),
            "reward_upright": exp(-tilt * tilt),
            "reward_cop": cop,
            "reward_action": seen.effort,
        }


class NaoWalkEnv(NaoPatternEnv):
    """Walk along a line, an arc or a route of legs from standing to standing.

    :class:`NaoEnv` describes actions and observations. The zero action is the open-loop walker: the joint
    targets of a pattern planned by preview control, which knows the robot but neither its pushes nor its
    friction.

    ## Reward

    The sum of the terms below, all of the step's end, which ``info`` holds as well. True and planned values
    are compared in the level frames of the true and of the commanded soles, so that a walk that has drifted
    off its line is not paid less for it.

    | Term | Value |
    |------|-------|
    | ``reward_alive`` | 1 |
    | ``reward_progress`` | exp(-(e / 0.1 m/s)^2), e: velocity of the centre of mass less the planned one |
    | ``reward_upright`` | exp(-(e / 0.2 rad)^2), e: angle between the torso and the vertical |
    | ``reward_cop`` | exp(-(e / 0.02 m)^2), e: centre of pressure less its reference; 0 where undefined |
    | ``reward_action`` | -0.1 times the mean square of the action |

    ## End of an episode

    *Terminated* at a fall, as in :class:`NaoEnv`; *truncated* at the end of the plan.

    Args:
        speed: Forward speed in m/s, negative backwards; 0 marks time, or turns in place.
        turn_rate: Change of heading in rad/s, positive to the left.
        duration: Duration of the plan, standing at either end included, in s.
        stand_time: Standing before the first and after the last step, in s.
        route: Legs (duration in s, speed in m/s, turn rate in rad/s) to go one after another, in place of
            ``speed`` and ``turn_rate``; a leg with both zero stands still, and the rest of the
            duration is stood. For instance ``[[8, 0.04, 0], [3, 0, 0], [6, 0, 0.2], [8, 0.04, 0.1]]`` walks,
            stops, turns in place and goes on along an arc.
        foot_roll: Pitch in rad with which a foot leaves its toe last and lands on its heel, 0.05 for
            instance; 0 keeps the feet flat.
        push_impulse: Smallest and largest impulse of a push in N s; (0, 0) for none.
        **options: Of :class:`NaoEnv`.

    Attributes:
        pattern: The plan.

    Raises:
        ValueError: If the walk asks more than the legs can do, or an option is out of its range.
    """

    shared = (*NaoPatternEnv.shared, "pattern")

    def __init__(
        self,
        *,
        speed: float = 0.04,
        turn_rate: float = 0.0,
        duration: float = 60.0,
        stand_time: float = 1.0,
        route: Sequence[Sequence[float]] | None = None,
        foot_roll: float = 0.0,
        push_impulse: Sequence[float] = (0.1, 0.5),
        **options: Any,
    ) -> None:
        timing = GaitTiming(stand_time=check_number("stand_time", stand_time))
        roll = check_roll(foot_roll)
        duration = check_number("duration", duration)
        if route is None:
            speed, turn_rate = check_number("speed", speed), check_number("turn_rate", turn_rate)
            self.pattern = plan_walk(speed, turn_rate, duration, timing=timing, foot_roll=roll)
        else:
            legs = parse_route(route)
            self.pattern = plan_route(legs, duration, timing=timing, foot_roll=roll)
        super().__init__(duration=duration, push_impulse=push_impulse, **options)
