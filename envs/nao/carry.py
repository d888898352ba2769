"""The robot walks with a load that it does not know and that its feet measure best."""

from collections.abc import Sequence
from typing import Any

from surefoot.envs.gait.footsteps import GaitTiming, check_gait
from surefoot.envs.gait.pattern import Pattern, plan_walk
from surefoot.envs.nao.surprise import NaoSurpriseEnv
from surefoot.envs.nao.walk import NaoPatternEnv
from surefoot.envs.observation import Seen
from surefoot.envs.options import numbers_of, positive

PAYLOAD_BOXES = (((-0.18, -0.02, 0.0), (0.22, 0.02, 0.10)),)
"""Corners of the box in the torso's frame within which a payload's centre of mass lies, in m.

It reaches far before and behind, and not to the side: where one leg carries, its hip takes 2.8 of the 3.35
N m that its motor gives before any load comes: a load at the side would be a matter of torque, not balance.
"""

COP_SCALE = 0.012  # error of the centre of pressure in m at which its reward has fallen to 1/e

COP_WEIGHT = 3.0
"""What a centre of pressure where it is planned is paid, as a multiple of what walking alone pays."""


class NaoCarryEnv(NaoSurpriseEnv, NaoPatternEnv):
    """Walk on under pushes and a payload that is not announced.

    Actions and observations are :class:`NaoEnv`'s, and the zero action is the open-loop pattern of
    :class:`~surefoot.envs.NaoWalkEnv`. After a quiet stand the robot walks straight ahead. At a random moment
    a mass is fixed somewhere before, behind or in the torso. It moves the centre of pressure by up to 25 mm
    off where the pattern puts it, joints by no more than 3 mrad and the tilt by up to 13 mrad, of which an
    IMU hides half: the feet measure it best. The walk goes on to the end of the episode.

    ## Action

    During the quiet stand residuals are not applied, so that calibrators get a standing start.

    ## Reward

    The terms of :class:`~surefoot.envs.NaoWalkEnv` with a keener eye on the feet, at most 6 a step:

    | Term | Value |
    |------|-------|
    | ``reward_alive``, ``reward_progress``, ``reward_upright``, ``reward_action`` | as there |
    | ``reward_cop`` | 3 exp(-(e / 0.012 m)^2), e: centre of pressure less its reference; 0 where undefined |

    Without payload and pushes the pattern alone is 2 mm (rms) off its reference, and 10 mm at most.

    ## Drawn at each episode

    All from the environment's generator: the speed, the payload's mass, its place in a box of
    0.40 x 0.04 x 0.10 m, when it comes, pushes, friction and the starting state.

    ## The hard version

    ``surefoot/NaoCarryHard-v0`` has 0.75 to 0.8 kg, 0.38 to 0.41 m before or 0.22 to 0.245 m behind the
    torso, and weak pushes. Such a load moves the centre of pressure by 50 or 30 mm, nearly as far as the
    motor of one ankle holds: if nobody leans against it, the robot falls within seconds.

    Args:
        speeds: Forward speeds in m/s, of which an episode draws one; each is planned once in a process.
        duration: Length of an episode in s.
        payload_mass: Lowest and highest mass of the payload in kg; (0, 0) for none.
        payload_boxes: Boxes in the torso's frame in m, of which an episode draws one, shape (boxes, 2, 3).
        push_impulse: Smallest and largest impulse of a push in N s; (0, 0) for none.
        push_interval: Mean time between pushes in s.
        **options: ``stand_time`` and ``payload_time`` in s, how long the quiet stand is and when after it the
            payload comes (:class:`~surefoot.envs.nao.surprise.NaoSurpriseEnv`), and those of :class:`NaoEnv`.

    Attributes:
        pattern: The plan of this episode.

    Raises:
        ValueError: If an option is out of its range, naming it, or a speed asks more than the legs can do.
        TypeError: If ``payload`` is given.
    """

    cop_scale = COP_SCALE

    def __init__(
        self,
        *,
        speeds: Sequence[float] = (0.02, 0.04, 0.06),
        duration: float = 26.0,
        payload_mass: Sequence[float] = (0.5, 0.7),
        payload_boxes: Sequence[Sequence[Sequence[float]]] = PAYLOAD_BOXES,
        push_impulse: Sequence[float] = (0.4, 2.0),
        push_interval: float = 5.0,
        **options: Any,
    ) -> None:
        self._speeds = numbers_of(speeds)
        if not self._speeds:
            raise ValueError("'speeds' must hold at least one speed in m/s, got none.")
        super().__init__(
            duration=positive("duration", duration),
            payload_mass=payload_mass,
            payload_boxes=payload_boxes,
            push_impulse=push_impulse,
            push_interval=push_interval,
            **options,
        )
        self._timing = GaitTiming(stand_time=self.stand_time)
        for speed in self._speeds:
            check_gait(speed, 0.0, self._timing.step_time)
        # A plan takes its last two steps and stands; an episode ends before that.
        end = 3.0 * self._timing.step_time + self.stand_time
        self._plan_time = duration + end

    def draw(self, options: dict[str, Any]) -> Pattern:
        """Draw the speed and the payload."""
        speed = self._speeds[self.np_random.integers(len(self._speeds))]
        self.pattern = plan_walk(speed, 0.0, self._plan_time, timing=self._timing)
        self.draw_payload()
        return self.pattern

    def reward(self, seen: Seen) -> dict[str, float]:
        """Return the terms of the reward, by name."""
        paid = super().reward(seen)
        return paid | {"reward_cop": COP_WEIGHT * paid["reward_cop"]}
