"""Compile the library beside this file, for who installed without a compiler."""

import sys

from surefoot.calibration.native.build import LIBRARY, compile_library

if __name__ == "__main__":
    problem = compile_library()
    sys.exit(f"Not compiled: {problem}." if problem else print(f"Compiled {LIBRARY}."))
