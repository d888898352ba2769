"""Devices by their names."""

from collections.abc import Mapping
from typing import Any, TypeVar

from surefoot.sensors.configuration import from_mapping
from surefoot.sensors.encoders import Encoders
from surefoot.sensors.force_torque import ForceTorque
from surefoot.sensors.imu import Imu
from surefoot.sensors.link import Link
from surefoot.sensors.load_cell_config import LoadCells
from surefoot.sensors.strain_gauge_config import FTSENS_SN142, StrainGauges

Config = TypeVar("Config")

HX711_LOAD_CELLS = LoadCells()
"""Eight uncalibrated cells of 98.1 N and 1 mV/V on HX711 chips at gain 128 and nominally 80 SPS."""

PERFECT_LOAD_CELLS = LoadCells(
    adc_bits=0,
    polarity=(1,),
    input_noise=0.0,
    rate=None,
    initial_gain_std=0.0,
    initial_zero_std=0.0,
    gain_drift=0.0,
    zero_drift=0.0,
)
"""Cells that report the true load at the instant they are read, in N."""

ICUB_FORCE_TORQUE = ForceTorque()
"""Two sensors like the FTSens in an iCub's ankles."""

PERFECT_FORCE_TORQUE = ForceTorque(
    resolution_force=0.0,
    resolution_torque=0.0,
    noise_force=0.0,
    noise_torque=0.0,
    initial_gain_std=0.0,
    cross_talk_std=0.0,
    initial_zero_force_std=0.0,
    initial_zero_torque_std=0.0,
    gain_drift=0.0,
    zero_drift_force=0.0,
    zero_drift_torque=0.0,
)
"""Sensors that report the true wrench, in N and N m."""

ICUB_FTSENS_LEG = StrainGauges()
"""The old FTSens in an iCub's leg, number 39."""

ICUB_FTSENS_FOOT = StrainGauges(
    FTSENS_SN142, gain_error_std=0.15, hysteresis_true_force=10.0, hysteresis_true_torque=0.5
)
"""The younger one in a foot, number 142; the weight of a foot of 0.8 kg shows as an ellipsoid with axes of
1.3 to 1 in the median (in-situ paper, Table I: 1.4), of 1.1 to 1.6 in 80 % of sensors."""

PERFECT_STRAIN_GAUGES = StrainGauges(
    gain_error_std=0.0,
    cross_talk_std=0.0,
    offset_force=0.0,
    offset_torque=0.0,
    noise_force=0.0,
    noise_torque=0.0,
    adc_bits=0,
    hysteresis=0.0,
    creep_shares=(),
    creep_time_constants=(),
    zero_drift_force=0.0,
    zero_drift_torque=0.0,
    zero_tempco_force=0.0,
    zero_tempco_torque=0.0,
    span_tempco=0.0,
)
"""Gauges of which the maker's matrix, that of the leg's sensor, makes the true wrench."""

NAO_IMU = Imu()
"""Accelerometer and gyroscope of a NAO V5."""

PERFECT_IMU = Imu(
    accelerometer_noise=0.0,
    gyroscope_noise=0.0,
    accelerometer_bias_std=0.0,
    gyroscope_bias_std=0.0,
    accelerometer_walk=0.0,
    gyroscope_walk=0.0,
    accelerometer_resolution=0.0,
    gyroscope_resolution=0.0,
    accelerometer_range=0.0,
    gyroscope_range=0.0,
    averaged=False,
)
"""An IMU that reports what happens at the instant it is read."""

NAO_ENCODERS = Encoders()
"""The 12-bit joint encoders of a NAO."""

NAO_LINK = Link()
"""NAOqi over a wireless network: 100 packets/s, 20 +- 4 ms late."""

PRESETS: dict[type, dict[str, Any]] = {
    LoadCells: {"hx711-load-cells": HX711_LOAD_CELLS, "perfect": PERFECT_LOAD_CELLS},
    ForceTorque: {"icub-force-torque": ICUB_FORCE_TORQUE, "perfect": PERFECT_FORCE_TORQUE},
    StrainGauges: {
        "icub-ftsens-leg": ICUB_FTSENS_LEG,
        "icub-ftsens-foot": ICUB_FTSENS_FOOT,
        "perfect": PERFECT_STRAIN_GAUGES,
    },
    Imu: {
        "nao-imu": NAO_IMU,
        "perfect": PERFECT_IMU,
    },
    Encoders: {"nao-encoders": NAO_ENCODERS, "perfect": Encoders(bits=0, bias_std=0.0, noise_std=0.0)},
    Link: {"nao-wlan": NAO_LINK, "perfect": Link(rate=None, delay=0.0, jitter=0.0)},
}
"""Every preset by the class of its configuration and its name."""


def preset(name: str, kind: type[Config] = LoadCells) -> Config:  # type: ignore[assignment]
    """Look a device up by its name.

    Args:
        name: Such as ``"hx711-load-cells"``.
        kind: The class of the configuration: :class:`LoadCells`, :class:`ForceTorque`,
            :class:`StrainGauges`, :class:`Imu`, :class:`Encoders` or :class:`Link`.

    Raises:
        ValueError: If there is none of that name; the message lists what there is.

    >>> preset("hx711-load-cells").adc_bits
    24
    """
    found = PRESETS[kind]
    if name not in found:
        raise ValueError(f"There is no {kind.__name__} preset '{name}'; there are {sorted(found)}.")
    return found[name]  # type: ignore[no-any-return]


def resolve(config: str | Mapping[str, Any] | Config, kind: type[Config]) -> Config:
    """Make a configuration of a preset's name, a mapping or a configuration.

    Raises:
        ValueError: If the name or a key of the mapping is unknown, or a value is refused.
        TypeError: If it is none of the three.
    """
    if isinstance(config, kind):
        return config
    if isinstance(config, str):
        return preset(config, kind)
    if isinstance(config, Mapping):
        return from_mapping(kind, config)
    raise TypeError(
        f"Give the name of a preset, a mapping or a {kind.__name__}, got {type(config).__name__}."
    )
