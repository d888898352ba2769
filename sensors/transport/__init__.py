"""Errors of a reading between the chip and the robot: clocks, delays, lost and wrong words."""
