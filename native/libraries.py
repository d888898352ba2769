"""The libraries and their functions; the specification of each is the Python of the package of its name."""

import ctypes

from surefoot.native.build import FOLDER, Sources
from surefoot.native.library import ADDRESS, Native

_DEVICES = ("cells", "force_torque", "strain_gauges", "faults")
"""What loads go into, or counts as they were, and counts come out of."""

CALIBRATION = Native(
    Sources(FOLDER / "calibration.c"),
    {
        "surefoot_fits": (ctypes.c_int, (ADDRESS,)),
        "surefoot_init": (None, (ADDRESS, ADDRESS)),
        "surefoot_retract": (None, (ADDRESS, ADDRESS)),
        "surefoot_step": (None, (ADDRESS, ADDRESS, ADDRESS, ADDRESS, ctypes.c_double, ADDRESS)),
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
            None,
            (ADDRESS, ADDRESS, ctypes.c_int, ctypes.c_double, ctypes.c_double, ctypes.c_int),
        ),
        "surefoot_sample_many": (None, (*(ADDRESS,) * 8, ctypes.c_int)),
    },
    ("surefoot_sample_many",),
)
"""Calibrators, and what robots believe."""

SENSORS = Native(
    Sources(FOLDER / "sensors.c"),
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
"""Sensors and telemetry."""

ENVS = Native(
    Sources(FOLDER / "envs.c"),
    {
        "surefoot_mean_truth": (None, (*(ADDRESS,) * 5, ctypes.c_int)),
        "surefoot_observe": (None, (*(ADDRESS,) * 8, ctypes.c_int)),
    },
    ("surefoot_mean_truth", "surefoot_observe"),
)
"""Truth and observations of this package's tasks."""
