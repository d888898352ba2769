"""Calibrate six-axis force-torque sensors where they are built in, from gravity and known masses.

* :func:`calibrate_in_situ`: the fit to use; :class:`InSituTracker` keeps its offset up to date.
* :func:`read_calibration`: a fit that ``surefoot calibrate ft`` wrote.
* :func:`estimate_offset` and :func:`estimate_matrix`: the paper's own method, III-B and III-C (Traversaro,
  Pucci and Nori, 2015).
"""

from surefoot.calibration.in_situ.calibrate import calibrate_in_situ
from surefoot.calibration.in_situ.data import InSituOptions, InSituSet, InSituTrackerConfig, KnownLimb
from surefoot.calibration.in_situ.file import read_calibration
from surefoot.calibration.in_situ.fit import InSituFit, Limb
from surefoot.calibration.in_situ.paper import OffsetFit, PaperMatrixFit, estimate_matrix, estimate_offset
from surefoot.calibration.in_situ.track import InSituEstimate, InSituTracker

__all__ = [
    "InSituEstimate",
    "InSituFit",
    "InSituOptions",
    "InSituSet",
    "InSituTracker",
    "InSituTrackerConfig",
    "KnownLimb",
    "Limb",
    "OffsetFit",
    "PaperMatrixFit",
    "calibrate_in_situ",
    "estimate_matrix",
    "estimate_offset",
    "read_calibration",
]
