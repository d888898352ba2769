"""Calibration motions: their posterior bound, plans of motions, and a measure of certainty."""
