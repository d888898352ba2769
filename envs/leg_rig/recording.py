r"""An analytic leg with F/T sensors at hip and foot: true wrenches and IMU readings of a hip trajectory.

The leg is a rigid body on two hip joints. Its load on the robot through a sensor follows from Newton and
Euler: with mass :math:`m`, first moment :math:`s` and inertia :math:`I` about the sensor's origin, and
:math:`g - a` of that origin,

.. math:: f = m (g - a) - \alpha \times s - \omega \times (\omega \times s), \qquad
    \mu = s \times (g - a) - I \alpha - \omega \times I \omega

so that at rest w = M(m, c) g with M = [m I; m [c]x] (Eqs. 3-5 of Traversaro, Pucci and Nori, "In situ
calibration of six-axes force-torque sensors using accelerometer measurements", ICRA 2015). All frames have
the sensors' axes: x forward, y right, z down.

Masses and inertias follow the right leg of the iCub v2.5. Thigh and shank are shortened to 0.84 of their
length, so that the sensors are as far apart as the published centres of mass of the paper's added masses.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.leg_rig.motion import RIG_SPEED_DEG, HipMotion, raster, sweep, swing
from surefoot.envs.options import positive

GRAVITY = 9.81  # in m/s^2
STEEL: Final = 7850.0  # density of the added masses in kg/m^3

LEG_IN_HIP: Final[Floats] = np.array([0.0, 0.0, 0.0743])  # origin of the leg sensor in m (iCub v2.5)
KNEE_IN_LEG: Final[Floats] = np.array([0.0, 0.0, 0.1346])  # in the leg sensor's frame in m
FOOT_IN_LEG: Final[Floats] = np.array([-0.0035, 0.0, 0.3636])
"""Origin of the foot sensor in the leg sensor's frame in m, as the experiment's centres of mass imply."""
IMU_IN_FOOT: Final[Floats] = np.array([0.16, 0.0, 0.0186])  # on the beam, in the foot sensor's frame in m

_KNEE_ITERATIONS = 40
"""Fixed-point iterations for the angle of a compliant knee. Each leaves about half of the error at a slack of
0.1 rad per N m, so that these reach rounding errors."""


class LimbBody(NamedTuple):
    """A rigid body, without the added mass."""

    mass: float  # in kg
    mass_com: Floats  # first moment m c in the sensor's frame in kg m, shape (3,)
    inertia: Floats  # about the sensor's origin in its frame in kg m^2, shape (3, 3)


class AddedMass(NamedTuple):
    """The mass that one data set adds to the foot."""

    mass: float  # in kg
    com_foot: tuple[float, float, float]  # centre of mass in the frame of the foot's sensor in m

    @property
    def inertia(self) -> float:
        """Moment of inertia of a steel cube of that mass about its centre in kg m^2 (not published)."""
        return self.mass * float(np.cbrt(self.mass / STEEL)) ** 2 / 6.0


ADDED_MASSES: Final[Mapping[int, AddedMass]] = MappingProxyType(
    {
        1: AddedMass(0.0, (0.0, 0.0, 0.0)),
        2: AddedMass(0.703, (-0.018, 0.108341707, 0.003776111)),
        3: AddedMass(0.703, (0.222, 0.108341707, 0.003776111)),
        4: AddedMass(0.703, (0.262, 0.025223889, -0.093879972)),
        5: AddedMass(0.51102, (0.39, -0.0347, 0.029)),
        6: AddedMass(0.51102, (0.21, 0.0, 0.0637)),
        7: AddedMass(0.0, (0.0, 0.0, 0.0)),
        8: AddedMass(0.51102, (-0.04, 0.0, 0.0637)),
    }
)
"""The eight data sets of the in-situ paper, which its first author published. The paper fits on 1 to 4 and
validates on 5 to 8."""

# Mass in kg, centre of mass in the leg sensor's frame in m, principal moments of inertia in kg m^2.
_THIGH = ((1.90, (0.0032, 0.0, 0.074), (0.0056, 0.0056, 0.0014)),)
_SHANK = (
    (1.29, (0.0012, 0.0035, 0.2092), (0.0032, 0.0034, 0.0013)),
    (0.94, (0.0112, 0.0006, 0.3139), (0.0011, 0.0012, 0.0006)),  # ankle
)
_FOOT = (
    (0.383, (0.0301, 0.0054, 0.3625), (0.0003, 0.0012, 0.0014)),
    (0.19, (0.1565, 0.0, 0.3972), (0.00003, 0.0043, 0.0043)),  # beam for the added masses
    (0.017, (0.1565, 0.0, 0.3822), (0.000002, 0.000002, 0.000003)),  # IMU
)


@dataclass(frozen=True, eq=False)
class RigRecording:
    """The truth of one data set: n samples.

    The frames of both sensors and of the IMU are parallel while the knee does not bend. A wrench is the load
    of limb and added mass on the robot through the sensor. The IMU is perfect.
    """

    name: str  # the set's name in messages
    configuration: int  # key of :data:`ADDED_MASSES`
    time: Floats  # in s, shape (n,)
    hip: Floats  # angles (front-back, lateral) in rad, shape (n, 2)
    wrench_foot: Floats  # at and in the foot sensor's frame in N and N m, shape (n, 6)
    wrench_leg: Floats  # at and in the leg sensor's frame in N and N m, shape (n, 6)
    specific_force: Floats  # of the IMU in m/s^2, at rest -g, shape (n, 3)
    angular_velocity: Floats  # of the IMU in rad/s, shape (n, 3)
    angular_acceleration: Floats  # of the IMU in rad/s^2, which no IMU measures, shape (n, 3)
    position_imu_foot: Floats  # of the IMU in the foot sensor's frame in m, shape (3,)
    position_imu_leg: Floats  # of the IMU in the leg sensor's frame in m, with a straight knee, shape (3,)
    added_mass: float  # in kg
    added_com_foot: Floats  # its centre of mass in the foot sensor's frame in m, shape (3,)
    added_com_leg: Floats  # the same in the leg sensor's frame, with a straight knee
    added_inertia: float  # moment of inertia of the added mass about axes through its centre in kg m^2
    limb_foot: LimbBody  # the mass beyond the foot's sensor, nothing added
    limb_leg: LimbBody  # the mass beyond the leg's sensor, nothing added, with a straight knee

    @property
    def gravity_foot(self) -> Floats:
        """True g - a of the foot sensor's origin in its frame in m/s^2, pointing down, shape (n, 3)."""
        return self._motion.proper_at(-self.position_imu_foot)

    @property
    def gravity_leg(self) -> Floats:
        """True g - a of the leg sensor's origin in its frame in m/s^2, with a straight knee, shape (n, 3)."""
        return self._motion.proper_at(-self.position_imu_leg)

    @property
    def _motion(self) -> "_Motion":
        return _Motion(-self.specific_force, self.angular_velocity, self.angular_acceleration)


def record_rig(
    configurations: Iterable[int] = range(1, 9),
    *,
    duration: float = 300.0,
    rate: float = 100.0,
    speed_deg: float = RIG_SPEED_DEG,
    range_deg: tuple[float, float] | None = None,
    seed: int = 0,
    knee_slack: float = 0.0,
    fast_motion: bool = False,
    rasters: bool = False,
    at_rest: bool = False,
) -> list[RigRecording]:
    """Record data sets of the in-situ experiment, one per configuration.

    Args:
        configurations: Added masses, keys of :data:`ADDED_MASSES`.
        duration: Duration of each set in s.
        rate: Samples per s.
        speed_deg: Maximum speed of each hip joint in deg/s; not used by ``fast_motion``.
        range_deg: Ranges of the hip joints (front-back, lateral) in deg; ``None`` uses the full ranges.
        seed: Seed of the differences between sets.
        knee_slack: Compliance of the knee in rad per N m; 0 keeps the leg rigid.
        fast_motion: Swing at 0.8 to 2 Hz (:func:`swing`) instead of sweeping slowly (:func:`sweep`).
        rasters: Move the lateral joint once per set while the other sweeps (:func:`raster`).
        at_rest: Hold each posture, so that no inertial forces act.

    Raises:
        ValueError: If an option is out of its range.

    >>> round(record_rig([5], duration=120.0, rate=10.0)[0].limb_foot.mass, 9)
    0.59
    """
    positive("knee_slack", knee_slack, or_zero=True)
    recordings = []
    for index, configuration in enumerate(configurations):
        rng = np.random.default_rng([seed, index])
        if fast_motion:
            motion = swing(duration, rate, range_deg=range_deg, seed=int(rng.integers(2**31)))
        elif rasters:
            motion = raster(duration, rate, speed_deg, range_deg=range_deg)
        else:
            phase = float(rng.uniform(0.0, 2.0 * np.pi))
            motion = sweep(duration, rate, speed_deg, range_deg=range_deg, phase=phase)
        recordings.append(_record(configuration, motion.at_rest() if at_rest else motion, knee_slack))
    return recordings


class _Motion(NamedTuple):
    """The motion of a rigid body at a point, in the body's axes: n samples."""

    proper: Floats  # g - a of the point in m/s^2, shape (n, 3)
    omega: Floats  # angular velocity in rad/s, shape (n, 3)
    alpha: Floats  # angular acceleration in rad/s^2, shape (n, 3)

    def proper_at(self, arm: Floats) -> Floats:
        """Return g - a of another point of the body, shape (n, 3)."""
        return self.proper - np.cross(self.alpha, arm) - np.cross(self.omega, np.cross(self.omega, arm))

    def at(self, arm: Floats) -> "_Motion":
        """Return the motion at another point of the body."""
        return self._replace(proper=self.proper_at(arm))

    def turn(self, angle: Floats) -> "_Motion":
        """Return the motion in axes turned by an angle about y, shape (n,)."""
        return _Motion(*(_pitch(-angle, part) for part in self))

    def wrench(self, body: LimbBody) -> Floats:
        """Return the load of a body about the point (Newton and Euler), shape (n, 6)."""
        proper, omega, alpha = self
        force = body.mass * proper - np.cross(alpha, body.mass_com)
        force -= np.cross(omega, np.cross(omega, body.mass_com))
        torque = np.cross(body.mass_com, proper) - alpha @ body.inertia
        torque -= np.cross(omega, omega @ body.inertia)
        return np.hstack([force, torque])


def _record(configuration: int, motion: HipMotion, knee_slack: float) -> RigRecording:
    if configuration not in ADDED_MASSES:
        raise ValueError(
            f"There is no configuration {configuration!r}; the paper's data sets are {list(ADDED_MASSES)}."
        )
    load = ADDED_MASSES[configuration]
    added = ((load.mass, tuple(FOOT_IN_LEG + load.com_foot), (load.inertia,) * 3),)
    leg = _hip_motion(motion).at(LEG_IN_HIP)
    knee, angle = leg.at(KNEE_IN_LEG), np.zeros(len(motion.time))
    below = _body((*_SHANK, *_FOOT, *added), KNEE_IN_LEG)
    for _ in range(_KNEE_ITERATIONS if knee_slack > 0.0 else 0):
        # The spring carries the load's torque about the knee's axis, y.
        angle = knee_slack * knee.turn(angle).wrench(below)[:, 4]
    shank = knee.turn(angle)
    foot = shank.at(FOOT_IN_LEG - KNEE_IN_LEG)
    carried = shank.wrench(below)
    force, torque = _pitch(angle, carried[:, :3]), _pitch(angle, carried[:, 3:])
    below_knee = np.hstack([force, torque + np.cross(KNEE_IN_LEG, force)])
    return RigRecording(
        name=f"set {configuration}",
        configuration=configuration,
        time=motion.time,
        hip=motion.angle,
        wrench_foot=foot.wrench(_body((*_FOOT, *added), FOOT_IN_LEG)),
        wrench_leg=leg.wrench(_body(_THIGH, np.zeros(3))) + below_knee,
        specific_force=-foot.proper_at(IMU_IN_FOOT),
        angular_velocity=foot.omega,
        angular_acceleration=foot.alpha,
        position_imu_foot=IMU_IN_FOOT.copy(),
        position_imu_leg=FOOT_IN_LEG + IMU_IN_FOOT,
        added_mass=load.mass,
        added_com_foot=np.array(load.com_foot),
        added_com_leg=FOOT_IN_LEG + load.com_foot,
        added_inertia=load.inertia,
        limb_foot=_body(_FOOT, FOOT_IN_LEG),
        limb_leg=_body((*_THIGH, *_SHANK, *_FOOT), np.zeros(3)),
    )


def _body(parts: Iterable[tuple[float, tuple[float, ...], tuple[float, ...]]], origin: Floats) -> LimbBody:
    """Add up parts about an origin in the leg sensor's frame (parallel-axis theorem)."""
    mass, mass_com, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for m, com, moments in parts:
        c = np.array(com) - origin
        mass, mass_com = mass + m, mass_com + m * c
        inertia += np.diag(moments) + m * (c @ c * np.eye(3) - np.outer(c, c))
    return LimbBody(mass, mass_com, inertia)


def _hip_motion(motion: HipMotion) -> _Motion:
    """Return the leg's motion at the hip, for R_world_leg = R_y(front-back) R_x(-lateral)."""
    (q, p), (dq, dp), (ddq, ddp) = motion.angle.T, motion.rate.T, motion.acceleration.T
    c, s = np.cos(p), np.sin(p)
    gravity = GRAVITY * np.stack([-np.sin(q), -s * np.cos(q), c * np.cos(q)], axis=1)
    omega = np.stack([-dp, dq * c, dq * s], axis=1)
    alpha = np.stack([-ddp, ddq * c - dq * dp * s, ddq * s + dq * dp * c], axis=1)
    return _Motion(gravity, omega, alpha)


def _pitch(angle: Floats, vectors: Floats) -> Floats:
    """Rotate vectors, shape (n, 3), about y by angles in rad, shape (n,)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = vectors.T
    return np.stack([c * x + s * z, y, c * z - s * x], axis=1)
