"""Encoders and IMU on their way: the robot's own computer measures, makes a tilt of it and sends packets."""
