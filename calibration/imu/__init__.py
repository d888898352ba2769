"""Calibrate an accelerometer, and read gravity and motion from an IMU."""
