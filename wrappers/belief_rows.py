"""What a row of beliefs holds: vectors of three at the middle between two packets of telemetry."""

COM, IMU, SOLES, AXES, MOMENTUM, FORCE = 0, 1, slice(2, 4), slice(4, 10), 10, 11
"""In odometry axes, from the torso's origin: centre of mass, IMU and soles in m, both soles' axes x, y and z,
angular momentum about the centre of mass in kg m^2/s and specific force in m/s^2."""

ACCELERATION, MOMENTUM_RATE = 12, 13
"""What follows from the row's neighbours in time: m/s^2 and N m."""

ACCELEROMETER, GYROSCOPE = 14, 15
"""What was measured, in the IMU's own axes: m/s^2 and rad/s."""

ROWS = 16
"""Number of the vectors."""

SLOPE = 3
"""Packets over which the soles' velocities are taken."""

FURTHEST = 8.0
"""How many packets ahead soles are supposed to go on as they went."""
