"""The compiled calibrators and beliefs: their functions."""

import ctypes
from pathlib import Path

from surefoot.native import ADDRESS, Library, Native, Sources

NATIVE = Native(
    Sources(Path(__file__).parent),
    {
        "surefoot_fits": (ctypes.c_int, (ADDRESS,)),
        "surefoot_init": (None, (ADDRESS, ADDRESS)),
        "surefoot_begin": (None, (ADDRESS, ADDRESS)),
        "surefoot_retract": (None, (ADDRESS, ADDRESS)),
        "surefoot_step": (ctypes.c_int, (ADDRESS, ADDRESS, ADDRESS, ADDRESS, ctypes.c_double, ADDRESS)),
        "surefoot_beliefs_fit": (ctypes.c_int, (ADDRESS, ADDRESS)),
        "surefoot_beliefs_init": (None, (ctypes.c_int, ADDRESS)),
        "surefoot_beliefs_packets": (
            None,
            (ADDRESS, ADDRESS, ctypes.c_int, ADDRESS, ADDRESS, ctypes.c_int),
        ),
        "surefoot_beliefs_sample": (
            ctypes.c_int,
            (ADDRESS, ctypes.c_int, ADDRESS, ctypes.c_double, ADDRESS, ctypes.c_int, ADDRESS),
        ),
        "surefoot_beliefs_reference": (None, (ADDRESS, ADDRESS, ctypes.c_double, ADDRESS)),
        "surefoot_beliefs_momentum": (None, (ADDRESS, ADDRESS, ctypes.c_double, ADDRESS)),
        "surefoot_beliefs_soles": (None, (ADDRESS, ADDRESS, ctypes.c_double, ADDRESS)),
        "surefoot_view_show": (None, (ADDRESS,) * 6),
        "surefoot_sample": (
            ctypes.c_int,
            (ADDRESS, ADDRESS, ctypes.c_int, ctypes.c_double, ctypes.c_double, ctypes.c_int),
        ),
        "surefoot_sample_many": (None, (*(ADDRESS,) * 9, ctypes.c_int)),
    },
    ("surefoot_sample_many",),
)


def rooms() -> tuple[Library, ...]:
    """Return the libraries of this package, those with the least room in their records first."""
    return NATIVE.rooms()


def installed() -> Library | None:
    """Return the library of this package; ``None``, with one line in the log, if it cannot be used."""
    return NATIVE.installed()
