"""The sensors in C: headers for a simulator, and the library that the Python uses; see docs/native.md.

The Python of :mod:`surefoot.sensors` is the specification, and runs where no library is.
"""

from surefoot.sensors.native.library import NATIVE, installed

__all__ = ["NATIVE", "installed"]
