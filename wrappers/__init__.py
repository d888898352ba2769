"""Sensors and calibrators around an environment."""

from surefoot.wrappers.beliefs import Beliefs
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.history import SampleHistory
from surefoot.wrappers.nominal import NominalModel
from surefoot.wrappers.self_calibration import SelfCalibration

__all__ = ["Beliefs", "FootSensors", "NominalModel", "SampleHistory", "SelfCalibration"]
