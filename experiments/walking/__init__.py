"""Calibrate the log of a walk."""
