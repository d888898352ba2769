"""Calibrate the sensors under a robot's feet: from known weights, standing, and while it walks.

NumPy and SciPy; no simulator and no Gymnasium, so that it runs on a robot.

* :class:`FootCalibrator` in a robot's loop, :func:`replay` for a log; by name from :data:`METHODS`;
  :func:`register_method` adds one of your own.
* :func:`online_method` for the pure functions that both use.
* :func:`calibrate_in_situ` for six-axis force-torque sensors, from gravity and known masses.
"""

from surefoot.calibration.baselines import SwingTare
from surefoot.calibration.centroidal import ground_reference
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.excitation.bound import posterior_bound
from surefoot.calibration.excitation.plan import FootMotion, MovingRobot, plan_foot_excitation
from surefoot.calibration.foot_calibrator import FootCalibrator
from surefoot.calibration.front_end.filters import zero_phase
from surefoot.calibration.imu import calibrate_accelerometer, gravity_from_imu
from surefoot.calibration.in_situ import (
    InSituSet,
    InSituTracker,
    KnownLimb,
    Limb,
    calibrate_in_situ,
    read_calibration,
)
from surefoot.calibration.layout import FeetLayout, FootLayout, nao_shoe_layout
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.online import METHODS, online_method, register_method
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY, MomentumReference, Reference
from surefoot.calibration.replay import replay
from surefoot.calibration.results import CalibrationRefused, FitResult
from surefoot.calibration.setup import OnlineMethod, OnlineSetup
from surefoot.calibration.standing import QuietStanding, standing_start
from surefoot.calibration.weights.channels import fit_channels
from surefoot.calibration.weights.cop_correction import fit_cop_correction
from surefoot.calibration.weights.curves import Curves
from surefoot.calibration.window.config import Window

__all__ = [
    "GRAVITY",
    "METHODS",
    "CalibrationRefused",
    "Curves",
    "Estimate",
    "FeetLayout",
    "FitResult",
    "Flag",
    "FootCalibrator",
    "FootLayout",
    "FootMotion",
    "InSituSet",
    "InSituTracker",
    "KnownLimb",
    "Limb",
    "Moment",
    "MomentumReference",
    "MovingRobot",
    "OnlineMethod",
    "OnlineSetup",
    "Parameters",
    "QuietStanding",
    "Reference",
    "SwingTare",
    "Window",
    "calibrate_accelerometer",
    "calibrate_in_situ",
    "fit_channels",
    "fit_cop_correction",
    "gravity_from_imu",
    "ground_reference",
    "nao_shoe_layout",
    "online_method",
    "plan_foot_excitation",
    "posterior_bound",
    "read_calibration",
    "register_method",
    "replay",
    "standing_start",
    "zero_phase",
]
