"""Record the rig of in-situ calibration: the readings of true sensors while its hip is swept.

The hip follows a trajectory exactly, and MuJoCo's inverse dynamics tell the sensors' loads. So positions,
motion and wrenches of a sample belong to the same instant, and minutes are recorded in fractions of a second.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.leg_rig.icub import load_icub_leg_spec
from surefoot.envs.leg_rig.motion import RIG_SPEED_DEG, HipMotion, raster, sweep, swing
from surefoot.envs.leg_rig.spec import (
    HIP_JOINTS,
    SENSORS,
    LimbBody,
    added_mass,
    limb_beyond,
    load_leg_rig_spec,
    read_wrenches,
    sensor_frames,
)

_KNEE_ITERATIONS = 6


@dataclass(frozen=True, eq=False)
class RigRecording:
    """The truth of one data set of the rig: n samples.

    Frames: the sensors' own, x forward, y right, z down, parallel while the knee does not bend. A wrench is
    the load of limb and added mass on the robot through the sensor. The IMU is perfect and its axes are
    parallel to the foot sensor's.
    """

    name: str  # the set's name in messages
    configuration: int  # which masses were added, 1 to 8
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
        return self._gravity_at(self.position_imu_foot)

    @property
    def gravity_leg(self) -> Floats:
        """True g - a of the leg sensor's origin in its frame in m/s^2, with a straight knee, shape (n, 3)."""
        return self._gravity_at(self.position_imu_leg)

    def _gravity_at(self, arm: Floats) -> Floats:
        """Move g - a from the IMU to where the arm to the IMU begins, on a rigid body."""
        omega = self.angular_velocity
        circling = np.cross(self.angular_acceleration, arm) + np.cross(omega, np.cross(omega, arm))
        return np.asarray(circling - self.specific_force)


def record_rig(
    configurations: Iterable[int] = range(1, 9),
    *,
    duration: float = 300.0,
    rate: float = 100.0,
    speed_deg: float = RIG_SPEED_DEG,
    range_deg: tuple[float, float] | None = None,
    seed: int = 0,
    knee_slack: float = 0.0,
    floor: bool = False,
    fast_motion: bool = False,
    rasters: bool = False,
    at_rest: bool = False,
    icub: bool = False,
) -> list[RigRecording]:
    """Record data sets of the in-situ experiment.

    Args:
        configurations: Which masses to add, one set each, 1 to 8.
        duration: Of a set in s.
        rate: Samples per s.
        speed_deg: Highest speed of a sweep in deg/s.
        range_deg: Ranges (front-back, lateral) in deg; those of the rig by default, (70, 90).
        seed: Draws the phase of each set's sweep, or its swings.
        knee_slack: By how many rad the knee bends per N m: 0 holds it. The knee's angle is the one at which
            spring, weight and contact balance; the load of its own motion is left out.
        floor: Whether the tip of the beam meets a block of foam at the rear end of the front-back range.
        fast_motion: Swing at 0.8 to 2 Hz (:func:`swing`) rather than sweep slowly (:func:`sweep`).
        rasters: Move the lateral joint once a set while the other sweeps (:func:`raster`), rather than both.
        at_rest: Stand still in each posture, so that no inertia is felt at all.
        icub: Take the right leg of the official iCub v2.5 (:mod:`surefoot.envs.leg_rig.icub`), with its knee
            held and without a floor.

    Returns:
        A recording for each configuration, in the order given.

    Raises:
        ValueError: If an option is out of its range.
        ImportError: If the iCub's model is asked for and not installed.

    >>> record_rig([5], duration=120.0, rate=10.0)[0].limb_foot.mass
    0.59
    """
    if icub and (knee_slack or floor):
        raise ValueError("'icub' takes neither 'knee_slack' nor 'floor'; only the rig's own leg has them.")
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
        rig: dict[str, Any] = {"knee_slack": knee_slack, "floor": floor}
        spec = load_icub_leg_spec(configuration) if icub else load_leg_rig_spec(configuration, **rig)
        recordings.append(_record(spec.compile(), configuration, motion.at_rest() if at_rest else motion))
    return recordings


def _record(model: mujoco.MjModel, configuration: int, motion: HipMotion) -> RigRecording:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    limb_foot, limb_leg = (limb_beyond(model, data, sensor) for sensor in SENSORS)
    origins, rotations = sensor_frames(data)
    arms = data.site("imu").xpos - origins
    load = added_mass(configuration)
    added_com_leg = rotations[1].T @ (data.body("added_mass").xipos - origins[1])
    rows = _sensor_rows(model, data, motion)

    def column(name: str) -> Floats:
        sensor = model.sensor(name)
        return rows[:, int(sensor.adr[0]) : int(sensor.adr[0] + sensor.dim[0])]

    wrenches = read_wrenches(rows)
    # Rows of the IMU's axes in the world turn world vectors into its frame.
    R_imu_world = np.stack([column(f"imu_{axis}") for axis in "xyz"], axis=1)
    return RigRecording(
        name=f"set {configuration}",
        configuration=configuration,
        time=motion.time,
        hip=motion.angle,
        wrench_foot=np.ascontiguousarray(wrenches[:, 0]),
        wrench_leg=np.ascontiguousarray(wrenches[:, 1]),
        specific_force=column("specific_force").copy(),
        angular_velocity=column("angular_velocity").copy(),
        angular_acceleration=np.einsum("nij,nj->ni", R_imu_world, column("angular_acceleration_world")),
        position_imu_foot=rotations[0].T @ arms[0],
        position_imu_leg=rotations[1].T @ arms[1],
        added_mass=load.mass,
        added_com_foot=np.array(load.com_foot),
        added_com_leg=added_com_leg,
        added_inertia=load.inertia,
        limb_foot=limb_foot,
        limb_leg=limb_leg,
    )


def _sensor_rows(model: mujoco.MjModel, data: mujoco.MjData, motion: HipMotion) -> Floats:
    """Evaluate MuJoCo's sensors along the motion, shape (n, sensordata)."""
    angle, speed, acceleration = motion.angle, motion.rate, motion.acceleration
    if model.nv > len(HIP_JOINTS):
        knee = np.zeros((len(angle), 1))
        held = _knee_angles(model, data, motion)[:, None]
        angle = np.hstack([angle, held])
        speed, acceleration = np.hstack([speed, knee]), np.hstack([acceleration, knee])
    rows = np.empty((len(angle), model.nsensordata))
    qpos, qvel, qacc, sensordata = data.qpos, data.qvel, data.qacc, data.sensordata
    for row, q, v, a in zip(rows, angle, speed, acceleration, strict=True):
        qpos[:], qvel[:], qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        row[:] = sensordata
    return rows


def _knee_angles(model: mujoco.MjModel, data: mujoco.MjData, motion: HipMotion) -> Floats:
    """Find the angles at which the knee's spring carries the mass below, in rad, shape (n,)."""
    stiffness = float(model.jnt_stiffness[len(HIP_JOINTS)])
    angles, knee = np.empty(len(motion.time)), 0.0
    for i, (q, v, a) in enumerate(zip(motion.angle, motion.rate, motion.acceleration, strict=True)):
        for _ in range(_KNEE_ITERATIONS):
            data.qpos[:], data.qvel[:], data.qacc[:] = [*q, knee], [*v, 0.0], [*a, 0.0]
            mujoco.mj_inverse(model, data)
            # What a motor would have to give is what the spring still lacks.
            knee -= float(data.qfrc_inverse[-1]) / stiffness
        angles[i] = knee
    return angles
