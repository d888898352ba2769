"""Controllers: an observation in, an action out, NumPy alone.

A controller sees the observation and nothing else. The same one therefore walks on true, drifting
or calibrated readings: the wrapper around the environment decides which.
"""

from surefoot.controllers.calibration_motion import CalibrationMotion
from surefoot.controllers.policy import PolicyFileError, PolicyNetwork
from surefoot.controllers.posture import PostureDrive
from surefoot.controllers.stabiliser import Stabiliser, zero_action

__all__ = [
    "CalibrationMotion",
    "PolicyFileError",
    "PolicyNetwork",
    "PostureDrive",
    "Stabiliser",
    "zero_action",
]
