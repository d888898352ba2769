"""An analytic leg with two six-axis F/T sensors, for studies and tests of in-situ calibration."""
