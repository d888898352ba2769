"""The moment filter in C: a header for a robot's own controller, and its use from here; see docs/native.md.

The Python in :mod:`surefoot.calibration.moment` is the specification, and what runs where no library is.
"""

from surefoot.calibration.native.config import c_source
from surefoot.calibration.native.filter import NativeFilter, NativeState, native_filter
from surefoot.calibration.native.library import NATIVE, installed

__all__ = ["NATIVE", "NativeFilter", "NativeState", "c_source", "installed", "native_filter"]
