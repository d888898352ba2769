"""The C code of this package, and how its libraries are compiled, found and loaded (docs/native.md).

This folder contains all headers, and one source file per library. The contents of records are defined by the
packages ``calibration``, ``robot``, ``sensors`` and ``envs``.
"""

from surefoot.native.build import FOLDER, Sources, compiler
from surefoot.native.calls import Call
from surefoot.native.libraries import CALIBRATION, ENVS, SENSORS
from surefoot.native.library import ADDRESS, Library, Native, places_at, require
from surefoot.native.records import (
    PointerRecord,
    Record,
    StateRecord,
    c_header,
    leaves_of,
    rebuilt,
    state_dtype,
)
from surefoot.native.threads import call_for_many, cores

__all__ = [
    "ADDRESS",
    "CALIBRATION",
    "ENVS",
    "FOLDER",
    "SENSORS",
    "Call",
    "Library",
    "Native",
    "PointerRecord",
    "Record",
    "Sources",
    "StateRecord",
    "c_header",
    "call_for_many",
    "compiler",
    "cores",
    "leaves_of",
    "places_at",
    "rebuilt",
    "require",
    "state_dtype",
]
