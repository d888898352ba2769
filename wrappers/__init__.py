"""Sensors and calibrators around an environment: faces of :mod:`surefoot.robot`.

Modules are loaded when something of theirs is asked for: code that serves GPU simulators
(:mod:`surefoot.wrappers.gpu`) needs no MuJoCo.
"""

from typing import TYPE_CHECKING

from surefoot.extras import names_of

if TYPE_CHECKING:
    from surefoot.robot.beliefs.errors import BeliefErrors as BeliefErrors
    from surefoot.robot.beliefs.nominal import NominalModel as NominalModel
    from surefoot.robot.beliefs.references import Beliefs as Beliefs
    from surefoot.robot.sensing.foot_equipment import FootEquipment as FootEquipment
    from surefoot.wrappers.calibrate_first import CalibrateFirst as CalibrateFirst
    from surefoot.wrappers.foot_sensors import FootSensors as FootSensors
    from surefoot.wrappers.history import SampleHistory as SampleHistory
    from surefoot.wrappers.self_calibration import SelfCalibration as SelfCalibration
    from surefoot.wrappers.vector.foot_sensors import VectorFootSensors as VectorFootSensors
    from surefoot.wrappers.vector.self_calibration import VectorSelfCalibration as VectorSelfCalibration
    from surefoot.wrappers.vector.truth_row import TruthRow as TruthRow

_MODULES = {
    "BeliefErrors": "surefoot.robot.beliefs.errors",
    "Beliefs": "surefoot.robot.beliefs.references",
    "CalibrateFirst": "surefoot.wrappers.calibrate_first",
    "FootEquipment": "surefoot.robot.sensing.foot_equipment",
    "FootSensors": "surefoot.wrappers.foot_sensors",
    "NominalModel": "surefoot.robot.beliefs.nominal",
    "SampleHistory": "surefoot.wrappers.history",
    "SelfCalibration": "surefoot.wrappers.self_calibration",
    "TruthRow": "surefoot.wrappers.vector.truth_row",
    "VectorFootSensors": "surefoot.wrappers.vector.foot_sensors",
    "VectorSelfCalibration": "surefoot.wrappers.vector.self_calibration",
}

__all__ = [*_MODULES]
__getattr__, __dir__ = names_of(__name__, _MODULES, "sim")
