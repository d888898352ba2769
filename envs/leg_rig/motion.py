"""Hip trajectories for in-situ calibration: slow sweeps of both ranges, and fast swings."""

from math import gcd
from typing import Final, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.options import positive

HIP_RANGE: Final[Floats] = np.radians([70.0, 90.0])
"""Ranges of the hip joints (front-back, lateral) in rad, from minus half to plus half, shape (2,)."""

RIG_SPEED_DEG = 6.0
"""Maximum speed of each hip joint in deg/s. The motion then changes the readings by about 0.1 %."""

_STRAIGHTNESS = 0.7
"""Shape of a sweep, from 0 (a sine) to 1 (a triangle). Chosen."""


class HipMotion(NamedTuple):
    """A trajectory of the hip. Columns are front-back (positive forward) and lateral (positive outward)."""

    time: Floats  # of the n samples in s, shape (n,)
    angle: Floats  # in rad, shape (n, 2)
    rate: Floats  # its derivative in rad/s, shape (n, 2)
    acceleration: Floats  # its second derivative in rad/s^2, shape (n, 2)

    def at_rest(self) -> "HipMotion":
        """Return the same postures with zero velocity and acceleration."""
        still = np.zeros_like(self.angle)
        return self._replace(rate=still, acceleration=still)


def sweep(
    duration: float = 300.0,
    rate: float = 100.0,
    speed_deg: float = RIG_SPEED_DEG,
    *,
    range_deg: tuple[float, float] | None = None,
    phase: float = 0.0,
) -> HipMotion:
    """Cover both ranges slowly and reach each part of them from both sides.

    The numbers of swings of the two joints have no common divisor, so the path is a Lissajous curve through
    all postures and a slow sensor drift is not mistaken for a rotation of the limb.

    Args:
        duration: In s.
        rate: Samples per s.
        speed_deg: Maximum speed of each joint in deg/s.
        range_deg: Ranges (front-back, lateral) in deg; 0 holds a joint, ``None`` uses :data:`HIP_RANGE`.
        phase: Initial phase of the lateral swing in rad.

    Raises:
        ValueError: If a number is not positive, or the duration is too short for two swings at that speed.
    """
    time, amplitude = _samples(duration, rate), _half_ranges(range_deg)
    period = _periods(amplitude, speed_deg)
    needed = max(period[0], 2.0 * period[1])
    if duration < needed * (1.0 - 1e-9):
        raise ValueError(
            f"A sweep at {speed_deg:g} deg/s takes at least {needed:.0f} s, got 'duration' = {duration:g}; "
            f"increase it, or raise 'speed_deg' to {speed_deg * needed / duration:.1f}."
        )
    # A held joint also gets a frequency; its amplitude is zero.
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
    """Sweep the first joint back and forth while the second crosses its range once.

    The paper's figures show such a scan. A slow sensor drift cannot be distinguished from the rotation of
    the second joint. Arguments and errors are those of :func:`sweep`.
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
    """Swing both joints at 0.8 to 2 Hz about slowly moving centres that cover the rest of the ranges.

    ``swing_deg`` is the maximum deflection from the moving centre. The seed determines three frequencies and
    phases per joint. ValueError if a number is not positive or the swings exceed the ranges.
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
    angle, speed, acceleration = motion[1:]
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
    """Return the duration in s of one swing of each joint at that speed."""
    top_speed = np.radians(positive("speed_deg", speed_deg))
    period: Floats = 2.0 * np.pi * amplitude * _STRAIGHTNESS / np.arcsin(_STRAIGHTNESS) / top_speed
    return period


def _sines(time: Floats, amplitude: Floats, frequency: Floats, phase: Floats) -> HipMotion:
    """Evaluate amplitude cos(frequency t + phase), one column per joint, and its derivatives."""
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
