"""How well a motion lets the feet be calibrated: its bound, plans of motions, and when a robot is certain."""
