"""The compiled sensors: their functions."""

import ctypes
from pathlib import Path

from surefoot.native import ADDRESS, Library, Native, Sources

_SIZE = ctypes.c_size_t

NATIVE = Native(
    Sources(Path(__file__).parent),
    {
        "surefoot_philox": (None, (ADDRESS, ADDRESS, ADDRESS)),
        "surefoot_draw": (None, (ADDRESS, ADDRESS, _SIZE, _SIZE, _SIZE, ctypes.c_int, ADDRESS)),
        "surefoot_cells_fits": (ctypes.c_int, (ADDRESS,)),
        "surefoot_cells_step": (
            None,
            (*(ADDRESS,) * 4, ctypes.c_int, ctypes.c_double, ADDRESS),
        ),
        "surefoot_telemetry_fits": (ctypes.c_int, (ADDRESS,)),
        "surefoot_telemetry_draws": (ctypes.c_int, (ADDRESS,)),
        "surefoot_telemetry_coming": (ctypes.c_int, (ADDRESS, ADDRESS)),
        "surefoot_telemetry_init": (ctypes.c_int, (*(ADDRESS,) * 4, ctypes.c_int)),
        "surefoot_telemetry_advance": (ctypes.c_int, (ADDRESS, ADDRESS, ADDRESS, ctypes.c_double)),
    },
)


def installed() -> Library | None:
    """Return the library of this package; ``None``, with one line in the log, if it cannot be used."""
    return NATIVE.installed()
