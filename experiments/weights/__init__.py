"""Calibrate load cells from known weights, of a real robot or simulated."""
