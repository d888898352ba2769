"""Truth and observations in C: the library that the Python uses; see docs/native.md.

The Python of :mod:`surefoot.envs` is the specification, and runs where no library is.
"""

from surefoot.envs.native.library import NATIVE, Call, installed, record_at

__all__ = ["NATIVE", "Call", "installed", "record_at"]
