"""Whole instruments: load cells, six-axis sensors, strain gauges, IMU and encoders."""
