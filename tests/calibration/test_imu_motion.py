"""An IMU's log carried to the sensor's origin, held against rigid bodies in closed form."""

import numpy as np
import pytest
from _refusals import refusals
from scipy.spatial.transform import Rotation

from surefoot.calibration.imu import gravity_from_imu

DT, N = 0.01, 400
TIME = np.arange(N) * DT
GRAVITY_WORLD = np.array([0.0, 0.0, -9.81])
POSITION_IMU = np.array([0.12, -0.03, 0.41])
R_SENSOR_IMU = Rotation.from_rotvec([0.3, -0.8, 2.1]).as_matrix()
SENSOR_FROM_HIP = np.array([0.02, 0.05, -0.3])


def attitude(time):
    """R_world_sensor of a leg that swings about two hip axes."""
    front, side = 0.6 * np.sin(2.0 * time), 0.4 * np.cos(1.3 * time)
    return Rotation.from_euler("yx", np.stack([front, side], axis=-1)).as_matrix()


def second_derivative(path, step=1e-3):
    """Of a world position by the five-point formula: nothing of rigid bodies is put in."""
    weights = {-2: -1.0, -1: 16.0, 0: -30.0, 1: 16.0, 2: -1.0}
    return sum(w * path(TIME + k * step) for k, w in weights.items()) / (12.0 * step**2)


def angular_velocity_sensor(time, step=1e-4):
    before, after = attitude(time - step), attitude(time + step)
    turned = np.swapaxes(before, -1, -2) @ after
    return Rotation.from_matrix(turned).as_rotvec() / (2.0 * step)


def to_sensor(vectors_world):
    return np.einsum("nji,nj->ni", attitude(TIME), vectors_world)


@pytest.fixture(scope="module")
def swing():
    origin = second_derivative(lambda time: attitude(time) @ SENSOR_FROM_HIP)
    imu = second_derivative(lambda time: attitude(time) @ (SENSOR_FROM_HIP + POSITION_IMU))
    omega = angular_velocity_sensor(TIME)
    alpha = (angular_velocity_sensor(TIME + 1e-3) - angular_velocity_sensor(TIME - 1e-3)) / 2e-3
    return {
        "specific_force": to_sensor(imu - GRAVITY_WORLD) @ R_SENSOR_IMU,
        "rate": omega @ R_SENSOR_IMU,
        "gravity": to_sensor(GRAVITY_WORLD - origin),
        "omega": omega,
        "alpha": alpha,
    }


def test_a_swinging_leg(swing):
    motion = gravity_from_imu(
        swing["specific_force"],
        swing["rate"],
        dt=DT,
        position_imu=POSITION_IMU,
        R_sensor_imu=R_SENSOR_IMU,
        window=11,
    )
    np.testing.assert_allclose(motion.angular_velocity, swing["omega"], atol=1e-6)
    np.testing.assert_allclose(motion.angular_acceleration, swing["alpha"], atol=2e-3)
    np.testing.assert_allclose(motion.gravity, swing["gravity"], atol=1e-3)
    # Without the lever, the same log would be wrong by far more.
    no_lever = gravity_from_imu(swing["specific_force"], swing["rate"], dt=DT, R_sensor_imu=R_SENSOR_IMU)
    assert np.abs(no_lever.gravity - swing["gravity"]).max() > 0.5


def test_a_wheel_with_a_cubic_angle_is_exact():
    # About z through the origin: omega is quadratic, and local cubics lose nothing of it.
    angle = 0.3 * TIME**3 - TIME**2 + 0.5 * TIME
    rate, acceleration = 0.9 * TIME**2 - 2.0 * TIME + 0.5, 1.8 * TIME - 2.0
    radius, zero = 0.4, np.zeros(N)
    gravity_sensor = 9.81 * np.stack([-np.sin(angle), -np.cos(angle), zero], axis=-1)  # y up in the world
    of_imu = np.stack([-(rate**2) * radius, acceleration * radius, zero], axis=-1)
    motion = gravity_from_imu(
        of_imu - gravity_sensor, np.stack([zero, zero, rate], axis=-1), dt=DT, position_imu=[radius, 0.0, 0.0]
    )
    np.testing.assert_allclose(motion.gravity, gravity_sensor, atol=1e-9)
    np.testing.assert_allclose(motion.angular_acceleration[:, 2], acceleration, atol=1e-9)


def test_at_rest_the_place_does_not_matter():
    force = np.tile(R_SENSOR_IMU.T @ [0.0, 0.0, 9.81], (50, 1))
    motion = gravity_from_imu(
        force, np.zeros((50, 3)), dt=DT, position_imu=POSITION_IMU, R_sensor_imu=R_SENSOR_IMU
    )
    np.testing.assert_allclose(motion.gravity, np.tile([0.0, 0.0, -9.81], (50, 1)), atol=1e-12)
    np.testing.assert_array_equal(motion.angular_acceleration, 0.0)


def test_a_turned_sensor_frame_turns_the_result(swing):
    R = Rotation.from_rotvec([1.0, -0.2, 0.7]).as_matrix()
    plain = gravity_from_imu(
        swing["specific_force"], swing["rate"], dt=DT, position_imu=POSITION_IMU, R_sensor_imu=R_SENSOR_IMU
    )
    turned = gravity_from_imu(
        swing["specific_force"],
        swing["rate"],
        dt=DT,
        position_imu=R @ POSITION_IMU,
        R_sensor_imu=R @ R_SENSOR_IMU,
    )
    for vectors, others in zip(plain, turned, strict=True):
        np.testing.assert_allclose(others, vectors @ R.T, atol=1e-9)


def test_gaps_of_the_accelerometer_stay_where_they_are(swing):
    force = swing["specific_force"].copy()
    force[17, 1] = np.nan
    motion = gravity_from_imu(force, swing["rate"], dt=DT, position_imu=POSITION_IMU)
    assert np.flatnonzero(~np.isfinite(motion.gravity).all(axis=1)).tolist() == [17]


test_bad_arguments_are_refused = refusals(
    lambda force, rate, options: gravity_from_imu(force, rate, dt=DT, **options),
    (np.ones(3), np.ones(3), {}, "'specific_force' must have shape (n, 3), got (3,)."),
    (np.ones((40, 3)), np.ones((39, 3)), {}, "'angular_velocity' must have shape (40, 3), got (39, 3)."),
    (
        np.ones((40, 3)),
        np.ones((40, 3)),
        {"position_imu": [0.0, np.nan, 0.0]},
        "'position_imu' must be three finite numbers",
    ),
    (
        np.ones((40, 3)),
        np.ones((40, 3)),
        {"R_sensor_imu": np.diag([1.0, 1.0, -1.0])},
        "'R_sensor_imu' must be a rotation of shape (3, 3), got [[1.0, 0.0, 0.0],",
    ),
    (np.ones((14, 3)), np.ones((14, 3)), {}, "The log holds 14 samples, but the filter's window is 15"),
    (np.ones((40, 3)), np.full((40, 3), np.nan), {}, "40 of 40 samples are not finite"),
    plain=True,
)
