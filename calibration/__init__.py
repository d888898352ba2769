"""surefoot.calibration."""
