"""Sways of a standing robot: one sine per axis, or a random sum of sines."""

from collections.abc import Sequence
from math import cos, pi, sin
from typing import NamedTuple

import numpy as np

Pair = tuple[float, float]

SHORTEST_PERIOD, LONGEST_PERIOD = 3.0, 8.0  # bounds of the periods of a random sway's sines in s
WAVES = 3  # number of sines per axis of a random sway
FADE_TIME = 2.0  # time in s in which a random sway reaches its full amplitude


class Sine(NamedTuple):
    """A sine of the pelvis that fades in over its first period."""

    amplitude: Pair  # of the pelvis (forward, left) in m
    rate: float  # angular frequency in rad/s
    follow: Pair  # displacement of the centre of mass per displacement of the pelvis (forward, left)
    begin: float  # time in s at which it starts

    def at(self, time: float) -> tuple[Pair, list[Pair]]:
        """Return the pelvis' displacement, and the motion of the centre of mass.

        The motion holds displacement, velocity and acceleration (forward, left) in m, m/s and m/s^2.
        """
        rate, time = self.rate, max(time - self.begin, 0.0)
        sine, cosine = sin(rate * time), cos(rate * time)
        half = 0.5 * rate
        # The fade is half a period of a cosine at half the rate, and complete after one period of the sine.
        turn = min(half * time, pi)
        fade = 0.5 - 0.5 * cos(turn)
        slope = 0.5 * half * sin(turn) if turn < pi else 0.0
        curve = 0.5 * half * half * cos(turn) if turn < pi else 0.0
        motion = (
            fade * sine,
            slope * sine + fade * rate * cosine,
            curve * sine + 2.0 * slope * rate * cosine - fade * rate * rate * sine,
        )
        (forward, left), (by_forward, by_left) = self.amplitude, self.follow
        com = [(value * (forward * by_forward), value * (left * by_left)) for value in motion]
        return (motion[0] * forward, motion[0] * left), com


class RandomSway(NamedTuple):
    r"""A sum of sines of the centre of mass with random amplitudes, periods and phases.

    With the smooth step :math:`f(\tau) = 10\tau^3 - 15\tau^4 + 6\tau^5`, where :math:`\tau` is the time since
    the beginning as a share of the fade, and the sines :math:`g`, the sway :math:`f g` and its first two
    derivatives are continuous. The amplitudes of an axis add up to at most its bound.
    """

    waves: Sequence[Sequence[Sequence[float]]]
    """Amplitude in m, rate in rad/s and phase in rad of the sines forward and to the left, (2, 3, 3)."""
    follow: Pair  # as of :class:`Sine`
    begin: float  # time in s at which it starts

    @classmethod
    def draw(
        cls, amplitude: Pair, share: Pair, follow: Pair, begin: float, rng: np.random.Generator
    ) -> "RandomSway":
        """Draw a sway.

        ``amplitude`` are bounds (forward, left) in m, ``share`` the lowest and highest share of a bound that
        the amplitudes of an axis add up to.
        """
        shares = rng.dirichlet(np.ones(WAVES), 2) * rng.uniform(*share, (2, 1))
        rate = 2.0 * pi / rng.uniform(SHORTEST_PERIOD, LONGEST_PERIOD, (2, WAVES))
        phase = rng.uniform(-pi, pi, (2, WAVES))
        waves = np.stack([shares * np.array(amplitude)[:, None], rate, phase], axis=-1)
        return cls(waves.tolist(), follow, begin)

    def at(self, time: float) -> tuple[Pair, list[Pair]]:
        """Return the same as :meth:`Sine.at`."""
        moved = time - self.begin
        if moved <= 0.0:
            return (0.0, 0.0), [(0.0, 0.0)] * 3
        fade, rise, bend = _fade(min(moved / FADE_TIME, 1.0))
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
        forward, left = motions
        pelvis = forward[0] / self.follow[0], left[0] / self.follow[1]
        return pelvis, list(zip(forward, left, strict=True))


def _fade(since: float) -> tuple[float, float, float]:
    """Return the smooth step at a share of the fade, and its first two derivatives in 1/s and 1/s^2."""
    fade = since * since * since * (10.0 - 15.0 * since + 6.0 * since * since)
    rise = 30.0 * since * since * (1.0 - since) * (1.0 - since) / FADE_TIME
    bend = 60.0 * since * (1.0 - since) * (1.0 - 2.0 * since) / FADE_TIME**2
    return fade, rise, bend
