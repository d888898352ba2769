"""The robot balances with a load that it does not know and that only its feet can measure."""

from collections.abc import Sequence
from math import cos, exp, hypot, pi, sin
from typing import Any, NamedTuple

import numpy as np

from surefoot.envs.command import Command
from surefoot.envs.nao.env import CONTROL_STEP
from surefoot.envs.nao.stand import LARGEST_SWAY, NaoStandEnv
from surefoot.envs.nao.surprise import NaoSurpriseEnv
from surefoot.envs.observation import Seen
from surefoot.envs.options import check_range, numbers_of

COP_SCALE = 0.015  # error of the centre of pressure in m at which its reward is down to 1/e

PAYLOAD_BOXES = (((-0.08, -0.12, 0.0), (0.10, 0.12, 0.10)),)
"""Corners of the box in the torso's frame within which a payload's centre of mass lies, in m."""


class NaoBalanceEnv(NaoSurpriseEnv, NaoStandEnv):
    r"""Keep the centre of pressure where it is commanded, under pushes and a payload that is not announced.

    Actions and observations are :class:`NaoEnv`'s. After a quiet stand the commanded centre of pressure
    (``cop_reference`` in ``"state"``) moves smoothly at random, and the open-loop pattern sways the pelvis by
    the holding torques *without a payload*. At a random moment a mass is fixed somewhere to the torso. It
    moves the centre of pressure by up to two centimetres and the joints by next to nothing, so that neither
    encoders nor tilt show it: only the feet do.

    ## Action

    During the quiet stand residuals are not applied, so that calibrators get a standing start.

    ## Reward

    ``reward_alive`` = 1, ``reward_cop`` = 2 exp(-(e / 0.015 m)^2) with e the distance between the true
    centre of pressure and the commanded one in the level frame of the commanded soles (0 where there is
    none), and ``reward_action`` = -0.1 times the mean square of the action. A step 10 mm off costs
    0.72 of 3.

    ## Drawn at each episode

    All from the environment's generator: the sway (three sines per axis, periods of 3 to 8 s), the payload's
    mass, its place in a box of 0.18 x 0.24 x 0.10 m about the chest, when it comes, pushes, friction and the
    starting state.

    ## The hard version

    ``surefoot/NaoBalanceHard-v0`` has 1 to 1.4 kg within 0.2 m before or behind and 0.15 m beside the torso,
    sways of up to 65 mm, which bring it to within two centimetres of the heels, weak pushes, and lasts 30 s.
    The load moves the centre of pressure by up to 40 mm; if nobody corrects it, one robot in three falls.

    Args:
        duration: Length of an episode in s, or ``None`` for no end.
        sway: Bounds (forward, left) of the sway of the centre of mass in m; zero to stand still.
        sway_share: Lowest and highest share of a bound that the amplitudes of an axis add up to.
        payload_mass: Lowest and highest mass of the payload in kg; (0, 0) for none.
        payload_boxes: Boxes in the torso's frame in m, of which an episode draws one, shape (boxes, 2, 3).
        push_impulse: Smallest and largest impulse of a push in N s; (0, 0) for none.
        push_interval: Mean time between pushes in s.
        **options: ``stand_time`` and ``payload_time`` in s, how long the quiet stand is and when after it the
            payload comes (:class:`~surefoot.envs.nao.surprise.NaoSurpriseEnv`), and those of :class:`NaoEnv`.

    Raises:
        ValueError: If an option is out of its range, naming it.
        TypeError: If ``payload`` is given.
    """

    def __init__(
        self,
        *,
        duration: float | None = 21.5,
        sway: Sequence[float] = (0.025, 0.03),
        sway_share: Sequence[float] = (0.5, 1.0),
        payload_mass: Sequence[float] = (0.5, 1.0),
        payload_boxes: Sequence[Sequence[Sequence[float]]] = PAYLOAD_BOXES,
        push_impulse: Sequence[float] = (0.3, 2.4),
        push_interval: float = 4.0,
        **options: Any,
    ) -> None:
        bounds = numbers_of(sway)
        if len(bounds) != 2 or not all(0.0 <= part <= LARGEST_SWAY for part in bounds):
            raise ValueError(
                f"'sway' must be bounds (forward, left) between 0 and {LARGEST_SWAY} m, which keep the robot "
                f"over its feet; got {sway!r}."
            )
        self._bounds = (bounds[0], bounds[1])
        self._share = check_range("sway_share", sway_share)
        super().__init__(
            duration=duration,
            payload_mass=payload_mass,
            payload_boxes=payload_boxes,
            push_impulse=push_impulse,
            push_interval=push_interval,
            **options,
        )

    def draw(self, options: dict[str, Any]) -> "RandomSway":
        """Draw the sway and the payload."""
        sway = RandomSway.draw(self._bounds, self._share, self.stand_time, self.np_random)
        self.draw_payload()
        return sway

    @staticmethod
    def join(plans: Sequence["RandomSway"]) -> list["RandomSway"]:
        """Put sways of many robots into one plan."""
        return list(plans)

    def command_at(self, plan: Any, tick: Any) -> Command:
        """Return the command at a control step of an episode; tasks' rules are in :class:`BipedEnv`."""
        if np.ndim(tick):
            times = np.where(tick > self.quiet_ticks, tick, 0) * CONTROL_STEP
            motion = np.array([sway.at(time) for sway, time in zip(plan, times.tolist(), strict=True)])
        elif tick <= self.quiet_ticks:
            return self._still
        else:
            motion = np.array(plan.at(tick * CONTROL_STEP))
        forward, left = self._follow
        level = np.zeros((*motion.shape[:-1], 3))
        level[..., :2] = motion
        return self._sway_command(motion[..., 0, 0] / forward, motion[..., 0, 1] / left, level)

    def reward(self, seen: Seen) -> dict[str, float]:
        """Return the terms of the reward, by name."""
        error = hypot(seen.cop_error_forward, seen.cop_error_left) / COP_SCALE
        cop = 2.0 * exp(-error * error) if seen.cop_valid else 0.0
        return {"reward_alive": 1.0, "reward_cop": cop, "reward_action": seen.effort}


SHORTEST_PERIOD = 3.0

LONGEST_PERIOD = 8.0  # bounds of the periods of the sines that a sway is the sum of, in s
WAVES = 3  # how many sines each axis has
FADE_TIME = 2.0  # how long in s a sway takes to reach its full size


class RandomSway(NamedTuple):
    r"""A sum of sines with random shares, periods and phases, faded in after a quiet stand.

    With the smooth step :math:`f(\tau) = 10\tau^3 - 15\tau^4 + 6\tau^5` over the time :math:`\tau` since the
    stand, in shares of the fade, and sines :math:`g`, the sway :math:`f g` and its first two derivatives are
    continuous; the amplitudes of an axis add up to at most its bound.
    """

    waves: Sequence[Sequence[Sequence[float]]]
    """Amplitude in m, rate in rad/s and phase in rad of the sines forward and to the left, (2, 3, 3)."""
    stand_time: float  # how long it is still first, in s

    @classmethod
    def draw(
        cls,
        amplitude: tuple[float, float],
        share: tuple[float, float],
        stand_time: float,
        rng: np.random.Generator,
    ) -> "RandomSway":
        """Draw a sway that is still for ``stand_time`` s first.

        ``amplitude`` are bounds (forward, left) in m, ``share`` the lowest and highest share of a bound that
        the amplitudes of an axis add up to.
        """
        shares = rng.dirichlet(np.ones(WAVES), 2) * rng.uniform(*share, (2, 1))
        rate = 2.0 * pi / rng.uniform(SHORTEST_PERIOD, LONGEST_PERIOD, (2, WAVES))
        phase = rng.uniform(-pi, pi, (2, WAVES))
        waves = np.stack([shares * np.array(amplitude)[:, None], rate, phase], axis=-1)
        return cls(waves.tolist(), stand_time)

    def at(self, time: float) -> list[tuple[float, ...]]:
        """Return the sway, its velocity and its acceleration, (forward, left), in m, m/s and m/s^2."""
        moved = time - self.stand_time
        fade, rise, bend = _fade(min(max(moved / FADE_TIME, 0.0), 1.0))
        motions = []
        for waves in self.waves:
            wave = slope = curve = 0.0
            for size, rate, phase in waves:
                sine, cosine = sin(rate * moved + phase), cos(rate * moved + phase)
                wave += size * sine
                slope += size * cosine * rate
                curve -= size * sine * (rate * rate)
            motions.append(
                (fade * wave, rise * wave + fade * slope, bend * wave + 2.0 * rise * slope + fade * curve)
            )
        return list(zip(*motions, strict=True))


def _fade(since: float) -> tuple[float, float, float]:
    """The smooth step at a share of the fade, and its first two derivatives in time in 1/s and 1/s^2."""
    fade = since * since * since * (10.0 - 15.0 * since + 6.0 * since * since)
    rise = 30.0 * since * since * (1.0 - since) * (1.0 - since) / FADE_TIME
    bend = 60.0 * since * (1.0 - since) * (1.0 - 2.0 * since) / FADE_TIME**2
    return fade, rise, bend
