"""The moment filter in C: headers for a robot's own controller, and their use from here; see docs/native.md.

The Python in :mod:`surefoot.calibration.moment` is the specification, and runs where no library is. The
library also makes the references, for :mod:`surefoot.robot`.
"""

from surefoot.calibration.native.config import c_source, constants_of
from surefoot.calibration.native.filter import NativeFilter, native_filter
from surefoot.calibration.native.reference import ReferenceRecord

__all__ = ["NativeFilter", "ReferenceRecord", "c_source", "constants_of", "native_filter"]
