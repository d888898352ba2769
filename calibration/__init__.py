"""Calibrate the sensors under a robot's feet: on a bench, standing, and while it walks.

NumPy, SciPy and the array API standard; no simulator and no Gymnasium, so that it runs on a robot.

* :class:`FootCalibrator` in a robot's loop, :func:`replay` for a log; by name from :data:`METHODS`.
* :func:`online_method` for the pure functions beneath them, batched, on NumPy or torch.
* :func:`calibrate_in_situ` for six-axis force-torque sensors, from gravity and known masses.
"""

from surefoot.calibration.baselines import TareConfig
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
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.foot_calibrator import FootCalibrator
from surefoot.calibration.front_end.filters import low_pass, zero_phase
from surefoot.calibration.imu import calibrate_accelerometer, gravity_from_imu
from surefoot.calibration.in_situ import (
    InSituSet,
    InSituTracker,
    KnownLimb,
    calibrate_in_situ,
    plan_excitation,
)
from surefoot.calibration.layout import FeetLayout, FootLayout, FootSensor, nao_shoe_layout
from surefoot.calibration.moment.bound import Bound, posterior_bound
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.online import METHODS, OnlineMethod, OnlineSetup, online_method
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY, Reference
from surefoot.calibration.replay import replay
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats
from surefoot.calibration.standing import (
    QuietStanding,
    StandingEstimate,
    StandingFit,
    StandingState,
    standing_start,
)
from surefoot.calibration.state import load_state, save_state
from surefoot.calibration.weights.channels import ChannelFit, fit_channels
from surefoot.calibration.weights.cop_correction import CopCorrectionFit, PlacementScore, fit_cop_correction
from surefoot.calibration.window.config import WindowConfig, confidence_from_standing

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
    "InSituSet",
    "InSituTracker",
    "KnownLimb",
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
    "calibrate_accelerometer",
    "calibrate_in_situ",
    "confidence_from_standing",
    "cop_is_valid",
    "cop_of_cells",
    "cop_of_feet",
    "cop_of_moments",
    "cop_of_wrench",
    "fit_channels",
    "fit_cop_correction",
    "gravity_from_imu",
    "ground_height",
    "ground_reference",
    "level_moments",
    "load_state",
    "low_pass",
    "moment_rows",
    "nao_shoe_layout",
    "online_method",
    "plan_excitation",
    "posterior_bound",
    "replay",
    "save_state",
    "sole_wrenches",
    "standing_start",
    "zero_phase",
]
