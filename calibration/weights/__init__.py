"""Calibration from known weights (CoP paper, Eqs. 1-5)."""
