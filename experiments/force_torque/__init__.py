"""Calibrate a six-axis force-torque sensor from the log of a robot (docs/in-situ-log.md)."""
