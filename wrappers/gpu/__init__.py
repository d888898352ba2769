"""Feet in GPU simulators, on tensors of shape (N, channels): needs torch, and no MuJoCo or Gymnasium."""

from surefoot.wrappers.gpu.foot_sensors import FootSensorsModule
from surefoot.wrappers.gpu.hooks import modifier_class, noise_model_class, observation_term_class
from surefoot.wrappers.gpu.self_calibration import SelfCalibrationModule

__all__ = [
    "FootSensorsModule",
    "SelfCalibrationModule",
    "modifier_class",
    "noise_model_class",
    "observation_term_class",
]
