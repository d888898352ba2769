"""Feet in GPU simulators, on tensors of shape (N, channels): needs torch and Warp, no MuJoCo or Gymnasium."""

from surefoot.extras import not_installed

try:
    from surefoot.wrappers.gpu.foot_sensors import FootSensorsModule
    from surefoot.wrappers.gpu.hooks import modifier_class, noise_model_class, observation_term_class
    from surefoot.wrappers.gpu.self_calibration import SelfCalibrationModule
except ModuleNotFoundError as missing:
    raise not_installed(__name__, missing, "gpu") from None

__all__ = [
    "FootSensorsModule",
    "SelfCalibrationModule",
    "modifier_class",
    "noise_model_class",
    "observation_term_class",
]
