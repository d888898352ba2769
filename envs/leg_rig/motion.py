"""How the hip of the in-situ rig is turned: slow sweeps of both ranges, and fast swings."""

from dataclasses import dataclass
from math import gcd

import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.leg_rig.spec import HIP_RANGE
from surefoot.envs.options import positive

RIG_SPEED_DEG = 6.0
"""Highest speed of each hip joint in deg/s: of what the sensors feel then, about 0.1 % is motion."""

_STRAIGHTNESS = 0.7  # from 0, a sine, to 1, a triangle: how sharply the joints turn around


@dataclass(frozen=True, eq=False)
class HipMotion:
    """A trajectory of the hip; columns are front-back (positive forward) and lateral (positive outward)."""

    time: Floats  # of the n samples in s, shape (n,)
    angle: Floats  # in rad, shape (n, 2)
    rate: Floats  # its derivative in rad/s, shape (n, 2)
    acceleration: Floats  # its second derivative in rad/s^2, shape (n, 2)

    def at_rest(self) -> "HipMotion":
        """Visit the same postures, standing still in each."""
        still = np.zeros_like(self.angle)
        return HipMotion(self.time, self.angle, still, still)


def sweep(
    duration: float = 300.0,
    rate: float = 100.0,
    speed_deg: float = RIG_SPEED_DEG,
    *,
    range_deg: tuple[float, float] | None = None,
    phase: float = 0.0,
) -> HipMotion:
    """Cover the hip's ranges slowly, coming to each part of them from both sides.

    Both joints swing between their ends as often as the speed allows, at nearly constant speed with rounded
    turns, and in numbers without a common divisor: the path weaves through all postures (Lissajous), and no
    slow drift of a sensor looks like a turn of the limb.

    Duration in s at a rate in 1/s, the highest speed of each joint in deg/s, the ranges (front-back, lateral)
    in deg from minus to plus the half, by default those of the rig, where 0 holds the joint, and the phase in
    rad of the lateral swing at the beginning. ValueError if numbers are not positive, or the time is too
    short for two swings at that speed.
    """
    time, amplitude = _samples(duration, rate), _half_ranges(range_deg)
    period = _periods(amplitude, speed_deg)
    needed = max(period[0], 2.0 * period[1])
    if duration < needed * (1.0 - 1e-9):
        raise ValueError(
            f"A sweep at {speed_deg:g} deg/s takes at least {needed:.0f} s, got 'duration' = {duration:g}; "
            f"let it take longer or raise 'speed_deg' to {speed_deg * needed / duration:.1f}."
        )
    # A joint that is held swings as well, by nothing.
    swings = [int(duration / one * (1.0 + 1e-9)) if one > 0.0 else 1 for one in period]
    while gcd(*swings) > 1:
        swings[0] -= 1
    frequency = 2.0 * np.pi / duration * np.array(swings)
    return _smooth_triangles(time, amplitude, frequency, np.array([np.pi, phase]))


def raster(
    duration: float = 300.0,
    rate: float = 100.0,
    speed_deg: float = RIG_SPEED_DEG,
    *,
    range_deg: tuple[float, float] | None = None,
) -> HipMotion:
    """Sweep the first joint forth and back while the second goes from one end of its range to the other once.

    This is how one would scan the range, and how the paper's figures look. A slow drift of a sensor looks
    like the second joint's turn then. Arguments and errors are those of :func:`sweep`.
    """
    time, amplitude = _samples(duration, rate), _half_ranges(range_deg)
    period = _periods(amplitude, speed_deg)[0]
    frequency = 2.0 * np.pi / duration * np.array([max(int(duration / period), 1), 0.5])
    return _smooth_triangles(time, amplitude, frequency, np.array([np.pi, np.pi]))


def swing(
    duration: float = 300.0,
    rate: float = 100.0,
    *,
    swing_deg: float = 15.0,
    range_deg: tuple[float, float] | None = None,
    seed: int = 0,
) -> HipMotion:
    """Swing both joints at 0.8 to 2 Hz about middles that move over the rest of the ranges.

    Duration, rate and ranges are those of :func:`sweep`; ``swing_deg`` is the largest deflection from the
    moving middle, and the seed is that of the three frequencies and phases of each joint. ValueError if
    numbers are not positive or the swings do not fit into the ranges.
    """
    time = _samples(duration, rate)
    rest = _half_ranges(range_deg) - np.radians(positive("swing_deg", swing_deg))
    if np.any(rest < 0.0):
        raise ValueError(
            f"'swing_deg' must be at most half of each range, {np.degrees(rest) + swing_deg} deg, "
            f"got {swing_deg:g}."
        )
    rng = np.random.default_rng([0x5716, seed])
    slow = 2.0 * np.pi / max(duration, 20.0) * np.array([2.0, 5.0])
    motion = _sines(time, rest, slow, rng.uniform(0.0, 2.0 * np.pi, 2))
    angle, speed, acceleration = motion.angle, motion.rate, motion.acceleration
    for band in ((0.8, 1.2), (1.2, 1.6), (1.6, 2.0)):
        frequency = 2.0 * np.pi * rng.uniform(*band, 2)
        part = _sines(time, np.full(2, np.radians(swing_deg) / 3.0), frequency, rng.uniform(0, 2 * np.pi, 2))
        angle, speed = angle + part.angle, speed + part.rate
        acceleration = acceleration + part.acceleration
    return HipMotion(time, angle, speed, acceleration)


def _half_ranges(range_deg: tuple[float, float] | None) -> Floats:
    half = np.asarray(HIP_RANGE if range_deg is None else np.radians(range_deg), dtype=np.float64) / 2.0
    if half.shape != (2,) or not np.all((half >= 0.0) & (half <= HIP_RANGE / 2.0 + 1e-9)) or not half.any():
        raise ValueError(
            f"'range_deg' must be two ranges within {np.degrees(HIP_RANGE).round(6).tolist()} deg, not both "
            f"0, got {range_deg!r}."
        )
    return half


def _samples(duration: float, rate: float) -> Floats:
    return np.asarray(np.arange(round(positive("duration", duration) * positive("rate", rate))) / rate)


def _periods(amplitude: Floats, speed_deg: float) -> Floats:
    """Return how long in s one swing of each joint takes at that speed."""
    top_speed = np.radians(positive("speed_deg", speed_deg))
    period: Floats = 2.0 * np.pi * amplitude * _STRAIGHTNESS / np.arcsin(_STRAIGHTNESS) / top_speed
    return period


def _sines(time: Floats, amplitude: Floats, frequency: Floats, phase: Floats) -> HipMotion:
    """Evaluate amplitude cos(frequency t + phase), one column a joint, with its derivatives."""
    argument = time[:, None] * frequency + phase
    return HipMotion(
        time,
        amplitude * np.cos(argument),
        -amplitude * frequency * np.sin(argument),
        -amplitude * frequency**2 * np.cos(argument),
    )


def _smooth_triangles(time: Floats, amplitude: Floats, frequency: Floats, phase: Floats) -> HipMotion:
    """Evaluate amplitude asin(k cos(frequency t + phase)) / asin(k), k = _STRAIGHTNESS, and derivatives."""
    k = _STRAIGHTNESS
    argument = time[:, None] * frequency + phase
    u = k * np.cos(argument)
    root = np.sqrt(1.0 - u**2)
    scale = amplitude / np.arcsin(k)
    return HipMotion(
        time,
        scale * np.arcsin(u),
        -scale * frequency * k * np.sin(argument) / root,
        -scale * frequency**2 * (1.0 - k**2) * u / root**3,
    )
