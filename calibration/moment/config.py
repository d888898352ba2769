r"""The moment filter: a Kalman filter whose state holds the robot's momentum and an outside wrench.

A robot measures velocities, not accelerations. So nothing is differentiated: the calibrated forces, gravity
and whatever else pushes predict the robot's momentum, and its velocity measures it. In units of the body
weight W = M g, m and s, with P the momentum and H the angular momentum about a point o on the ground, both
by the believed mass,

.. math::
    \dot P_z &= (1 + m) \sum f + w_f - 1 \\
    \dot H_x &= (1 + m) \sum (p_y - o_y) f - (c_y - d_y - o_y) + w_x \\
    \dot H_y &= -(1 + m) \sum (p_x - o_x) f + (c_x - d_x - o_x) + w_y

    \text{measured at the end of a block: its mean of } [v_z, (L + (c - o) \times M v)_{xy} / M] / g

with f = a F0 + b + u: scales a, offsets b of the start, and the zeros' drift u since, as a force. That is
linear. u starts at exactly 0, and each later tare defines it again, so that drift says nothing of a scale.
d is the error of the believed centre of mass, m that of the mass, w an outside wrench. Six-axis sensors add
the other three components.

* A foot in the air shows all its zeros: the **tare** comes first (:mod:`surefoot.calibration.moment.tare`).
* A robot that **stands still** shows nothing of its scales (:mod:`surefoot.calibration.moment.still`).
* Who holds the robot is a **mode**, in which w may be large (:mod:`surefoot.calibration.moment.modes`).
* How bad the sensors are is weighed by **evidence** (:mod:`surefoot.calibration.moment.severity`).
* Whatever the data do not determine stays at the start, and the estimate says so (``undetermined``).
"""

from dataclasses import dataclass

from surefoot.calibration.checks import check_not_negative, check_positive


@dataclass(frozen=True, kw_only=True)
class Moment:
    """Options of the moment filter; the defaults are those of cheap cells under a humanoid."""

    block: float = 0.1
    """Time in s over which forces are added up before they are compared: velocities known to 2 cm/s tell
    forces to 2 % of the weight then, and a step has three blocks at least."""

    scale_std: float = 0.12
    """How far scales are thought to be from the starting map: 12 % for cells that were never calibrated.
    Whether it is a twenty-fifth of that or three times as much is weighed by evidence."""

    offset_std: float = 0.03
    """How far offsets are thought to be from the starting map, in body weights (times foot lengths for a
    torque); weighed as `scale_std` is."""

    cross_talk: float = 0.01
    """Standard deviation of the share of a load that another axis of a six-axis sensor shows, in full scales:
    1 % by the data sheets of good ones. Loads are the vertical force and the torques about the level axes.
    Cross-talk is estimated so that scales and offsets do not make up for it, and is not removed."""

    scale_drift: float = 0.02
    """Random walk of a scale per square root of a minute: 2 %, of cheap cells that warm up."""

    offset_drift: float = 0.02
    """Random walk of an offset in body weights per square root of a minute (1 N for a NAO). How many times
    faster sensors really drift is learnt from tare to tare."""

    com_std: float = 0.002
    """How far the believed centre of mass is thought to be off along each axis, in m: 3 mm in any direction,
    which drawings and the mass of a battery leave open."""

    mass_std: float = 0.005
    """How far the believed mass is thought to be off, relative: a kitchen scale's 0.5 %. It is considered and
    not estimated (Schmidt), as drifting scales would carry it along."""

    delay_std: float = 0.005
    """How late the robot's clock is thought to be against its feet's, in s: a packet's jitter."""

    velocity_noise: float = 0.01
    """Standard deviation of a block's mean level velocity in m/s, from block to block: that of velocity
    increments which stance legs pull within a second. Rolling soles make it 1 to 2 cm/s."""

    vertical_noise: float = 0.003
    """The same of the vertical velocity, which soles on level ground show better."""

    momentum_noise: float = 0.001
    """Standard deviation of a block's mean angular momentum by the mass, in m^2/s."""

    ripple: float = 2.0
    """By how much a channel's mean force over a sample's interval may differ from its reading, in changes of
    the reading from one sample to the next: 0.5 of readings that are means over the interval, 2 of chips on
    clocks of their own, whose errors repeat at every stride of a robot that is read 50 times a second, 4 of
    readings that are instants of a controller's stairs."""

    tare_noise: float = 0.0005
    """Standard deviation of a channel's mean reading over 0.2 s in the air, in body weights (times foot
    lengths for a torque): a converter's noise, and a sole's inertia in a swing (2e-4 on a NAO
    that walks)."""

    def __post_init__(self) -> None:
        """Raise an error if a value has no meaning."""
        check_positive(
            self, "block", "scale_std", "offset_std", "velocity_noise", "vertical_noise", "momentum_noise",
            "tare_noise", "com_std", "mass_std", "delay_std",
        )  # fmt: skip
        check_not_negative(self, "cross_talk", "scale_drift", "offset_drift", "ripple")
