"""Calibration from quiet standing (CoP paper, Eqs. 12 and 13)."""
