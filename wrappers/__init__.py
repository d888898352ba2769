"""Sensors and calibrators around an environment.

Modules are loaded when something of theirs is asked for: what serves GPU simulators
(:mod:`surefoot.wrappers.gpu`) needs no MuJoCo.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from surefoot.extras import not_installed

if TYPE_CHECKING:
    from surefoot.wrappers.belief_errors import BeliefErrors
    from surefoot.wrappers.beliefs import Beliefs
    from surefoot.wrappers.calibrate_first import CalibrateFirst
    from surefoot.wrappers.foot_sensors import FootSensors
    from surefoot.wrappers.history import SampleHistory
    from surefoot.wrappers.nominal import NominalModel
    from surefoot.wrappers.self_calibration import SelfCalibration
    from surefoot.wrappers.vector.foot_sensors import VectorFootSensors
    from surefoot.wrappers.vector.self_calibration import VectorSelfCalibration
    from surefoot.wrappers.vector.truth_row import TruthRow

__all__ = [
    "BeliefErrors",
    "Beliefs",
    "CalibrateFirst",
    "FootSensors",
    "NominalModel",
    "SampleHistory",
    "SelfCalibration",
    "TruthRow",
    "VectorFootSensors",
    "VectorSelfCalibration",
]

_MODULES = {
    "BeliefErrors": "belief_errors",
    "Beliefs": "beliefs",
    "CalibrateFirst": "calibrate_first",
    "FootSensors": "foot_sensors",
    "NominalModel": "nominal",
    "SampleHistory": "history",
    "SelfCalibration": "self_calibration",
    "TruthRow": "vector.truth_row",
    "VectorFootSensors": "vector.foot_sensors",
    "VectorSelfCalibration": "vector.self_calibration",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    except ModuleNotFoundError as missing:
        raise not_installed(f"{__name__}.{name}", missing, "sim") from None


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
