r"""The robot's motion in axes that do not turn, from its beliefs.

A :class:`~surefoot.calibration.reference.MomentumReference` is that already. A
:class:`~surefoot.calibration.reference.Reference` has accelerations, in level axes that may turn and move
with the robot. Soles that stand do neither: they say how the axes of one sample lie in those of the sample
before. Velocity and angular momentum are then added up,

.. math:: v \leftarrow v + c'' \Delta t + \frac{\Delta t}{T_v} (v_{legs} - v), \qquad
          L \leftarrow L + L' \Delta t - \frac{\Delta t}{T_L} L

so that an accelerometer's bias does not grow: v_legs is the centre of mass's velocity relative to soles that
stand, and the angular momentum of a robot on its feet comes back to zero. Where legs contradict accelerations
by more than a robot walks fast, they pull the less the more they do (Cauchy's weight): a log's centre of mass
may be a constant. Of a robot in the air for longer than T_v nothing is added up.
"""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.front_end.motion import MotionColumns

LEG_TIME = 1.0  # T_v in s: a step or two, over which the rolling of soles averages out

SPIN_TIME = 2.0
"""T_L in s: longer than a stride, in which the angular momentum comes back to where it was."""

FIRST_SPEED = 1.0
"""Velocity in m/s that a robot begins with, a quick walk: where legs and accelerations are further apart, one
of them is wrong."""

FASTEST = 20.0
"""Velocity in m/s, and angular momentum by the mass in m^2/s, that no robot on feet has."""


class Track(NamedTuple):
    """Where the axes of the last sample lie, and the sums so far; F feet."""

    motion: Array  # the last flat reference, shape (R,)
    samples: int  # how many have followed each other; 0 before the first
    heading: float  # angle from the fixed axes to those of the last sample in rad
    origin: Array  # their origin in the fixed axes in m, shape (3,)
    velocity: Array  # of the centre of mass in m/s, shape (3,)
    spin: Array  # angular momentum by the mass in m^2/s, shape (3,)
    adrift: float  # time in s since a foot stood and held the velocity, or it was measured

    @classmethod
    def begin(cls, motion: Array) -> "Track":
        """Return that of a robot of which nothing is known."""
        return cls(np.zeros_like(motion), 0, 0.0, np.zeros(3), np.zeros(3), np.zeros(3), LEG_TIME)

    @property
    def valid(self) -> bool:
        """Whether the velocity is of use: a robot may be in the air for as long as a step lasts."""
        return self.adrift < LEG_TIME


class Pose(NamedTuple):
    """Where the robot was while a reading was taken, in the fixed axes.

    That is the middle of the interval that a momentum describes the end of, and the moment that an
    acceleration describes.
    """

    end: Array  # centre of mass at the end of the interval in m, shape (3,)
    com: Array  # centre of mass in m, shape (3,)
    sole: Array  # soles in m, shape (F, 3)
    rotation: Array  # rotations from the sole frames, shape (F, 3, 3)


def follow_momentum(track: Track, motion: Array, columns: MotionColumns, mass: float) -> tuple[Track, Pose]:
    """Take in one sample that holds velocity and momentum, in axes that are fixed already."""
    velocity, spin = motion[columns.com_acceleration], motion[columns.angular_momentum_rate] / mass
    middle = motion if track.samples == 0 else 0.5 * (motion + track.motion)
    track = Track(motion, track.samples + 1, 0.0, np.zeros(3), velocity, spin, 0.0)
    return track, Pose(motion[columns.com], middle[columns.com], *columns.soles(middle))


def follow_accelerations(
    track: Track, motion: Array, columns: MotionColumns, mass: float, stance: Array, dt: float
) -> tuple[Track, Pose]:
    """Take in one sample that holds accelerations, in axes of its own.

    Args:
        track: The motion so far.
        motion: A flat reference, shape (R,).
        columns: Where its parts lie.
        mass: Of the robot in kg.
        stance: Feet that surely stand (bool), shape (F,).
        dt: Time since the last sample in s.

    Returns:
        The motion, and the sample in the fixed axes.
    """
    sole, rotation = columns.soles(motion)
    stands = bool(stance.any())
    if not track.valid:
        rest, com = np.zeros(3), motion[columns.com]
        adrift = 0.0 if stands else LEG_TIME
        return Track(motion, 1, 0.0, rest, rest, rest, adrift), Pose(com, com, sole, rotation)
    old_sole, old_rotation = columns.soles(track.motion)
    lowest = sole[:, 2] + old_sole[:, 2] == (sole[:, 2] + old_sole[:, 2]).min()
    still = stance if stands else lowest
    forward, old_forward = rotation[still, :, 0].sum(axis=0), old_rotation[still, :, 0].sum(axis=0)
    heading = track.heading + _angle(old_forward) - _angle(forward)
    old_R, R = _about_z(track.heading), _about_z(heading)
    origin = (old_sole[still] @ old_R.T + track.origin - sole[still] @ R.T).mean(axis=0)
    com = R @ motion[columns.com] + origin
    velocity = track.velocity + R @ motion[columns.com_acceleration] * dt
    if stands:
        by_legs = (com - (old_R @ track.motion[columns.com] + track.origin)) / dt
        # The first velocities are averaged: nothing was known before.
        share = max(1.0 / track.samples, dt / LEG_TIME)
        off = by_legs - velocity
        velocity = velocity + share * off / (1.0 + (off / FIRST_SPEED) ** 2)
    rate = R @ motion[columns.angular_momentum_rate] / mass
    spin = track.spin + (rate - track.spin / SPIN_TIME) * dt
    adrift = 0.0 if stands else track.adrift + dt
    track = Track(motion, track.samples + 1, heading, origin, velocity, spin, adrift)
    return track, Pose(com, com, sole @ R.T + origin, R @ rotation)


def plausible(track: Track) -> bool:
    """Return whether a robot can move so."""
    fastest = max(np.abs(track.velocity).max(), np.abs(track.spin).max())
    return bool(fastest < FASTEST and np.abs(track.origin).max() < np.inf)


def _angle(forward: Array) -> float:
    return float(np.arctan2(forward[1], forward[0]))


def _about_z(angle: float) -> Array:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
