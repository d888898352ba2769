"""A centre of pressure that is commanded to move smoothly at random."""

from math import pi

import numpy as np

Pair = tuple[float, float]
"""Something forward and to the left."""

SHORTEST_PERIOD = 3.0
LONGEST_PERIOD = 8.0
"""Bounds of the periods of the sines that a sway is the sum of, in s."""

WAVES = 3
"""How many sines each axis has."""

FADE_TIME = 2.0
"""How long in s a sway takes to reach its full size."""


class RandomSway:
    r"""A sum of sines with random shares, periods and phases, faded in after a quiet stand.

    With the smooth step :math:`f(\tau) = 10\tau^3 - 15\tau^4 + 6\tau^5` over the time :math:`\tau` since the
    stand, in shares of the fade, and sines :math:`g`, the sway :math:`f g` and its first two derivatives are
    continuous; the amplitudes of an axis add up to at most its bound.

    Args:
        amplitude: Bounds (forward, left) in m.
        stand_time: How long it is still first, in s.
        rng: Draws everything.
    """

    def __init__(self, amplitude: tuple[float, float], stand_time: float, rng: np.random.Generator) -> None:
        share = rng.dirichlet(np.ones(WAVES), 2) * rng.uniform(0.5, 1.0, (2, 1))
        self._rate = 2.0 * pi / rng.uniform(SHORTEST_PERIOD, LONGEST_PERIOD, (2, WAVES))
        self._phase = rng.uniform(-pi, pi, (2, WAVES))
        self._waves = np.stack([share * np.array(amplitude)[:, None], self._rate], axis=-1).tolist()
        self._stand_time = stand_time

    def at(self, time: float) -> tuple[Pair, Pair, Pair]:
        """Give the sway, its velocity and its acceleration, (forward, left), in m, m/s and m/s^2."""
        since = (time - self._stand_time) / FADE_TIME
        if since <= 0.0:
            return (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)
        fade, rise, bend = _fade(since)
        angle = self._rate * (time - self._stand_time) + self._phase
        motions = []
        for waves, sines, cosines in zip(
            self._waves, np.sin(angle).tolist(), np.cos(angle).tolist(), strict=True
        ):
            wave = slope = curve = 0.0
            for (size, rate), sine, cosine in zip(waves, sines, cosines, strict=True):
                wave += size * sine
                slope += size * cosine * rate
                curve -= size * sine * (rate * rate)
            motions.append(
                (fade * wave, rise * wave + fade * slope, bend * wave + 2.0 * rise * slope + fade * curve)
            )
        forward, left = motions
        return (forward[0], left[0]), (forward[1], left[1]), (forward[2], left[2])


def _fade(since: float) -> tuple[float, float, float]:
    """The smooth step in shares of the fade, and its first two derivatives in time in 1/s and 1/s^2."""
    if since >= 1.0:
        return 1.0, 0.0, 0.0
    fade = since**3 * (10.0 - 15.0 * since + 6.0 * since**2)
    rise = 30.0 * since**2 * (1.0 - since) ** 2 / FADE_TIME
    bend = 60.0 * since * (1.0 - since) * (1.0 - 2.0 * since) / FADE_TIME**2
    return fade, rise, bend
