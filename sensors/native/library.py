"""The compiled sensors: their functions."""

import ctypes
from pathlib import Path

from surefoot.native import ADDRESS, Library, Native, Sources

_DEVICES = ("cells", "force_torque", "strain_gauges", "faults")
"""What loads go into, or counts as they were, and counts come out of."""

NATIVE = Native(
    Sources(Path(__file__).parent),
    {
        "surefoot_philox": (None, (ADDRESS, ADDRESS, ADDRESS)),
        "surefoot_draw": (None, (ADDRESS, ctypes.c_int, ctypes.c_int, ADDRESS)),
        **{f"surefoot_{device}_fits": (ctypes.c_int, (ADDRESS,)) for device in _DEVICES},
        **{
            f"surefoot_{device}_step": (None, (*(ADDRESS,) * 4, ctypes.c_int, ctypes.c_double, ADDRESS))
            for device in _DEVICES
        },
        "surefoot_telemetry_fits": (ctypes.c_int, (ADDRESS,)),
        "surefoot_telemetry_init": (ctypes.c_int, (*(ADDRESS,) * 3, ctypes.c_int)),
        "surefoot_sense": (ctypes.c_int, (ADDRESS, ADDRESS, ctypes.c_double, ctypes.c_int)),
        "surefoot_sense_many": (None, (*(ADDRESS,) * 4, ctypes.c_int)),
        "surefoot_telemetry_advance": (ctypes.c_int, (ADDRESS, ADDRESS, ADDRESS, ctypes.c_double)),
    },
    ("surefoot_sense_many",),
)


def installed() -> Library | None:
    """Return the library of this package; ``None``, with one line in the log, if it cannot be used."""
    return NATIVE.installed()
