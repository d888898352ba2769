"""The study of robots that others made: what calibration is worth on each, standing, moving and falling."""
