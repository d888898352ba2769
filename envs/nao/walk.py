"""The robot walks, also with an unknown load."""

from collections.abc import Sequence
from math import acos, exp
from typing import Any

from surefoot.envs.command import Command
from surefoot.envs.gait.footsteps import GaitTiming, check_gait
from surefoot.envs.gait.pattern import Pattern, Patterns, plan_route, plan_walk
from surefoot.envs.gait.route import parse_route
from surefoot.envs.gait.swing import check_roll
from surefoot.envs.nao.env import NaoEnv
from surefoot.envs.observation import Seen, closeness
from surefoot.envs.options import check_number, numbers_of, positive

VELOCITY_SCALE = 0.1
"""Error of the velocity of the centre of mass in m/s at which its reward has fallen to 1/e."""

TILT_SCALE = 0.2  # tilt of the torso in rad at which its reward has fallen to 1/e


class NaoWalkEnv(NaoEnv):
    """Walk along a line, an arc or a route of legs from standing to standing.

    :class:`NaoEnv` describes actions and observations. The zero action is the open-loop walker: the joint
    targets of a pattern planned by preview control, which knows the robot but neither its pushes nor its
    friction.

    ## Reward

    The sum of the terms below, evaluated at the end of the step and also in ``info``. True and planned values
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

    ## Carrying

    ``surefoot/NaoCarry-v0`` is this task with a random speed and a random load, and the walk goes on to the
    end of the episode. After a quiet stand the robot walks straight ahead. At a random moment a mass is fixed
    before, behind or in the torso. It moves the centre of pressure by up to 25 mm off where the pattern puts
    it, the joints by no more than 3 mrad and the tilt by up to 13 mrad, of which an IMU hides half: the feet
    measure it best. ``reward_cop`` is at most 3 with a scale of 0.012 m. Without payload and pushes the
    pattern alone is 2 mm (rms) off its reference, and 10 mm at most.

    ``surefoot/NaoCarryHard-v0`` has 0.75 to 0.8 kg, 0.38 to 0.41 m before or 0.22 to 0.245 m behind the
    torso, and weak pushes. Such a load moves the centre of pressure by 50 or 30 mm, nearly as far as the
    motor of one ankle holds; with a zero action the robot falls within seconds.

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
        speeds: Forward speeds in m/s, one of which is drawn for each episode in place of ``speed``; the walk
            then does not stop before the episode ends. Each is planned once in a process.
        push_impulse: Smallest and largest impulse of a push in N s; (0, 0) for none.
        **options: Of :class:`NaoEnv`.

    Attributes:
        pattern: The plan.

    Raises:
        ValueError: If the walk asks more than the legs can do, or an option is out of its range.
    """

    shared = (*NaoEnv.shared, "pattern")
    pattern: Pattern

    def __init__(
        self,
        *,
        speed: float = 0.04,
        turn_rate: float = 0.0,
        duration: float = 60.0,
        stand_time: float = 1.0,
        route: Sequence[Sequence[float]] | None = None,
        foot_roll: float = 0.0,
        speeds: Sequence[float] | None = None,
        push_impulse: Sequence[float] = (0.1, 0.5),
        **options: Any,
    ) -> None:
        timing = GaitTiming(stand_time=check_number("stand_time", stand_time))
        self._plan: dict[str, Any] = {"timing": timing, "foot_roll": check_roll(foot_roll)}
        self._speeds: tuple[float, ...] | None = None
        duration = check_number("duration", duration)
        if speeds is not None:
            self._speeds = numbers_of(speeds)
            if not self._speeds or route is not None or turn_rate:
                raise ValueError(
                    "'speeds' must hold at least one speed in m/s, without 'route' and 'turn_rate'; got "
                    f"{speeds!r}."
                )
            for one in self._speeds:
                check_gait(one, 0.0, timing.step_time)
            # A plan takes its last two steps and stands; an episode ends before that.
            self._plan_time = positive("duration", duration) + 3.0 * timing.step_time + timing.stand_time
            self.pattern = self._plan_at(self._speeds[0])
        elif route is None:
            speed, turn_rate = check_number("speed", speed), check_number("turn_rate", turn_rate)
            self.pattern = plan_walk(speed, turn_rate, duration, **self._plan)
        else:
            self.pattern = plan_route(parse_route(route), duration, **self._plan)
        super().__init__(
            duration=duration, stand_time=timing.stand_time, push_impulse=push_impulse, **options
        )

    def draw(self, options: dict[str, Any]) -> Pattern:
        """Draw the speed, if there are several, and the payload."""
        if self._speeds is not None:
            self.pattern = self._plan_at(self._speeds[self.np_random.integers(len(self._speeds))])
        self.draw_payload()
        return self.pattern

    def _plan_at(self, speed: float) -> Pattern:
        return plan_walk(speed, 0.0, self._plan_time, **self._plan)

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
        return {
            "reward_alive": 1.0,
            "reward_progress": closeness(
                seen.velocity_error_forward, seen.velocity_error_left, VELOCITY_SCALE
            ),
            "reward_upright": exp(-tilt * tilt),
            "reward_cop": self.cop_reward(seen),
            "reward_action": seen.effort,
        }
