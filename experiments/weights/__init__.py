"""Calibrate from weights, on a virtual or a real bench."""
