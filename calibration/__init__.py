"""Calibrate the sensors under a robot's feet: on a bench, standing, and while it walks.

NumPy, SciPy and the array API standard; no simulator and no Gymnasium, so that it runs on a robot.

* :class:`FootCalibrator` in a robot's loop, :func:`replay` for a log; by name from :data:`METHODS`.
* :func:`online_method` for the pure functions beneath them, batched, on NumPy or torch.
"""

from surefoot.calibration.bench import ChannelFit, fit_channels
from surefoot.calibration.bound import Bound, posterior_bound
from surefoot.calibration.centroidal import GroundReference, ground_height, ground_reference
from surefoot.calibration.cop import (
    FORCE_THRESHOLD,
    cop_is_valid,
    cop_of_cells,
    cop_of_feet,
    cop_of_moments,
    cop_of_wrench,
    level_moments,
    moment_rows,
    sole_wrenches,
)
from surefoot.calibration.cop_correction import CopCorrectionFit, PlacementScore, fit_cop_correction
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.filters import low_pass, zero_phase
from surefoot.calibration.foot_calibrator import FootCalibrator
from surefoot.calibration.layout import FeetLayout, FootLayout, FootSensor, nao_shoe_layout
from surefoot.calibration.moment_filter import MomentFilterConfig
from surefoot.calibration.online import METHODS, OnlineMethod, OnlineSetup, online_method
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY, Reference
from surefoot.calibration.replay import replay
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats
from surefoot.calibration.standing import QuietStanding, StandingEstimate, StandingState
from surefoot.calibration.standing_fit import StandingFit, standing_start
from surefoot.calibration.state import load_state, save_state
from surefoot.calibration.tare import TareConfig
from surefoot.calibration.window import WindowConfig, confidence_from_standing

__all__ = [
    "FORCE_THRESHOLD",
    "GRAVITY",
    "METHODS",
    "Bound",
    "CalibrationRefused",
    "ChannelFit",
    "CopCorrectionFit",
    "Estimate",
    "FeetLayout",
    "FitResult",
    "FitStats",
    "Flag",
    "FootCalibrator",
    "FootLayout",
    "FootSensor",
    "GroundReference",
    "MomentFilterConfig",
    "OnlineMethod",
    "OnlineSetup",
    "Parameters",
    "PlacementScore",
    "QuietStanding",
    "Reference",
    "StandingEstimate",
    "StandingFit",
    "StandingState",
    "TareConfig",
    "WindowConfig",
    "confidence_from_standing",
    "cop_is_valid",
    "cop_of_cells",
    "cop_of_feet",
    "cop_of_moments",
    "cop_of_wrench",
    "fit_channels",
    "fit_cop_correction",
    "ground_height",
    "ground_reference",
    "level_moments",
    "load_state",
    "low_pass",
    "moment_rows",
    "nao_shoe_layout",
    "online_method",
    "posterior_bound",
    "replay",
    "save_state",
    "sole_wrenches",
    "standing_start",
    "zero_phase",
]
