"""One robot as it senses, believes and calibrates itself over its episodes, whatever moves it.

A step goes through it in this order: truth is read by :class:`RobotSensors` (:mod:`surefoot.robot.sensing`)
into counts and packets of telemetry, :class:`Beliefs` (:mod:`surefoot.robot.beliefs`) make references of the
packets, and :class:`RobotCalibration` holds the counts against them. Wrappers of one robot and of many are
made of it.

Modules are loaded when something of theirs is asked for: code that serves GPU simulators needs no MuJoCo.
"""

from typing import TYPE_CHECKING

from surefoot.extras import names_of

if TYPE_CHECKING:
    from surefoot.robot.beliefs.errors import BeliefErrors as BeliefErrors
    from surefoot.robot.beliefs.nominal import NominalModel as NominalModel
    from surefoot.robot.beliefs.references import Beliefs as Beliefs
    from surefoot.robot.calibration import CalibrationSetup as CalibrationSetup
    from surefoot.robot.calibration import RobotCalibration as RobotCalibration
    from surefoot.robot.robot_state import RobotState as RobotState
    from surefoot.robot.sensing.equipment import Equipment as Equipment
    from surefoot.robot.sensing.sensors import RobotSensors as RobotSensors
    from surefoot.sensors.telemetry.computer import Telemetry as Telemetry
    from surefoot.sensors.telemetry.computer import TelemetryLayout as TelemetryLayout

_MODULES = {
    "BeliefErrors": "surefoot.robot.beliefs.errors",
    "Beliefs": "surefoot.robot.beliefs.references",
    "CalibrationSetup": "surefoot.robot.calibration",
    "Equipment": "surefoot.robot.sensing.sensors",
    "NominalModel": "surefoot.robot.beliefs.nominal",
    "RobotCalibration": "surefoot.robot.calibration",
    "RobotState": "surefoot.robot.robot_state",
    "RobotSensors": "surefoot.robot.sensing.sensors",
    "Telemetry": "surefoot.sensors.telemetry.computer",
    "TelemetryLayout": "surefoot.sensors.telemetry.computer",
}

__all__ = [*_MODULES]
__getattr__, __dir__ = names_of(__name__, _MODULES, "sim")
