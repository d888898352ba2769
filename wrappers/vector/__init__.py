"""Many robots at once: wrappers for :mod:`gymnasium.vector` and Stable-Baselines3, and their shared core.

Stable-Baselines3's are in :mod:`surefoot.wrappers.vector.sb3`, which needs it.
"""

from surefoot.extras import not_installed

try:
    from surefoot.wrappers.vector.foot_sensors import VectorFootSensors
    from surefoot.wrappers.vector.self_calibration import VectorSelfCalibration
    from surefoot.wrappers.vector.truth_row import TruthRow
except ModuleNotFoundError as missing:
    raise not_installed(__name__, missing, "sim") from None

__all__ = ["TruthRow", "VectorFootSensors", "VectorSelfCalibration"]
