"""One number for how bad an instrument is, for sweeps: 0 is perfect, 1 its configuration, 2 twice as bad.

The *errors* grow in proportion: spreads, noises, drifts, coefficients, shares, delays. The parts that the
instrument *is* stays: its number of channels, their ranges, resolution, rate and coding, the law by which it
warms up. An instrument of severity 0 therefore still rounds, clips and has a clock of its own. :data:`ERRORS`
and :data:`IDENTITY` list the fields of both kinds.

Some errors have a largest value: no wire repeats more than all of its readings. Severities above 1 take these
up to :data:`LIMITS` and no further, while all others go on.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import ceil
from types import MappingProxyType
from typing import Any, TypeVar

from surefoot.sensors.devices.encoders import Encoders
from surefoot.sensors.devices.force_torque import MOST_ERROR, ForceTorque
from surefoot.sensors.devices.imu import Imu
from surefoot.sensors.devices.load_cell_config import LoadCells
from surefoot.sensors.devices.strain_gauge_config import StrainGauges
from surefoot.sensors.stages.mechanics import Mechanics
from surefoot.sensors.transport.link import Link
from surefoot.sensors.transport.wire import Wire

Config = TypeVar("Config")

ERRORS: Mapping[type, tuple[str, ...]] = MappingProxyType(
    {
        LoadCells: (
            "input_noise",
            "initial_scale_std",
            "initial_offset_std",
            "scale_drift",
            "offset_drift",
            "scale_tempco",
            "offset_tempco",
            "shear_std",
            "mechanics",
            "wire",
        ),
        Mechanics: (
            "nonlinearity",
            "hysteresis",
            "creep_shares",
            "mounting_warp_std",
            "mounting_common_std",
            "overload_share",
        ),
        Wire: (
            "spike_rate",
            "wrong_words",
            "stale_repeats",
            "packet_loss",
            "gap_share",
            "delay",
            "jitter",
        ),
        ForceTorque: (
            "noise_force",
            "noise_torque",
            "initial_scale_std",
            "cross_talk_std",
            "initial_offset_force_std",
            "initial_offset_torque_std",
            "scale_drift",
            "offset_drift_force",
            "offset_drift_torque",
            "wire",
        ),
        StrainGauges: (
            "scale_error_std",
            "cross_talk_std",
            "offset_force",
            "offset_torque",
            "noise_force",
            "noise_torque",
            "hysteresis",
            "nonlinearity",
            "cross_nonlinearity",
            "creep_shares",
            "offset_drift_force",
            "offset_drift_torque",
            "offset_tempco_force",
            "offset_tempco_torque",
            "scale_tempco",
        ),
        Imu: (
            "accelerometer_noise",
            "gyroscope_noise",
            "accelerometer_bias_std",
            "gyroscope_bias_std",
            "accelerometer_walk",
            "gyroscope_walk",
            "accelerometer_scale_std",
            "gyroscope_scale_std",
            "misalignment_std",
        ),
        Encoders: ("bias_std", "noise_std"),
        Link: ("delay", "jitter"),
    }
)
"""Fields that are errors, by the configuration's class: they grow with the severity; zero is no error."""

BELOW = 1.0 - 1e-12
"""Factor by which a limit of a sum is missed, or rounding could take the sum over it."""

LIMITS: Mapping[type, Mapping[str, float]] = MappingProxyType(
    {
        Mechanics: {"nonlinearity": 0.08, "hysteresis": 0.12, "overload_share": 1.0},
        Wire: {"wrong_words": 1.0, "stale_repeats": 0.95, "packet_loss": 0.95, "gap_share": 0.95},
        StrainGauges: {
            "scale_error_std": 0.5,
            "cross_talk_std": 0.5,
            "hysteresis": 0.08,
            "nonlinearity": 0.08,
            "cross_nonlinearity": 0.018,
        },
    }
)
"""The largest value to which a severity above 1 takes a field. Beyond, readings would fall under a growing
load (nonlinearity, hysteresis), more would stay of an overload than there was, more readings would be wrong
than there are, no reading would be new, or a sensor would lose an axis. A configuration that is beyond
already stays as it is. The scales and the cross-talk of a :class:`~surefoot.sensors.ForceTorque` have one
limit together, 0.25 for ``initial_scale_std + 5 cross_talk_std``, at which both stop."""

IDENTITY: Mapping[type, tuple[str, ...]] = MappingProxyType(
    {
        LoadCells: (
            "averaged",
            "channels",
            "capacity",
            "rated_output",
            "excitation",
            "adc_gain",
            "adc_bits",
            "coding",
            "polarity",
            "rate",
            "settling",
            "temperature_ramp",
            "temperature_rise",
        ),
        Mechanics: ("creep_time_constants", "impact_threshold", "safe_overload"),
        # under_way grows with the delay, see _limited.
        Wire: ("spike_size", "gap_length", "under_way"),
        ForceTorque: (
            "sensors",
            "full_scale_force",
            "full_scale_torque",
            "resolution_force",
            "averaged",
            "resolution_torque",
        ),
        StrainGauges: (
            "matrix",
            "full_scale_force",
            "full_scale_torque",
            "adc_bits",
            "hysteresis_of",
            "hysteresis_true_force",
            "hysteresis_true_torque",
            "creep_time_constants",
            "temperature_ramp",
            "temperature_rise",
        ),
        Imu: (
            "accelerometer_resolution",
            "gyroscope_resolution",
            "accelerometer_range",
            "gyroscope_range",
            "averaged",
        ),
        Encoders: ("bits",),
        Link: ("rate",),
    }
)
"""Fields that are what the instrument is: they stay. Each field stands in one of the two tables."""


def scaled(config: Config, severity: float) -> Config:
    """Return an instrument that is better or worse: all of its errors times one factor.

    Args:
        config: The configuration of severity 1; it is not changed.
        severity: Factor of every error: 0 leaves none, 1 the configuration as it is, 2 doubles them, but for
            those that have reached their :data:`LIMITS`. Every preset can be of any severity up to 5.

    Raises:
        ValueError: If the severity is negative, or so large that an error is refused.
        TypeError: If the class has no table.

    >>> from surefoot.sensors import LoadCells
    >>> worse = scaled(LoadCells(), 2.0)
    >>> worse.initial_offset_std, worse.adc_bits
    (3.0, 24)
    """
    if not 0.0 <= severity < float("inf"):
        raise ValueError(f"'severity' must be finite and not negative, got {severity}.")
    severity, kind = float(severity), type(config)
    if kind not in ERRORS:
        raise TypeError(f"{kind.__name__} has no severity; {[known.__name__ for known in ERRORS]} have.")
    errors = {name: _times(getattr(config, name), severity) for name in ERRORS[kind]}
    if severity > 1.0:
        errors |= _at_limit(config, errors, severity)
    try:
        worse: Config = replace(config, **errors)  # type: ignore[type-var]
    except ValueError as refused:
        raise ValueError(
            f"A severity of {severity} is more than this device can have: {refused}"
        ) from refused
    return worse


def _times(value: Any, factor: float) -> Any:
    if type(value) in ERRORS:
        return scaled(value, factor)
    return tuple(factor * part for part in value) if isinstance(value, tuple) else factor * value


def _at_limit(config: Any, errors: Mapping[str, Any], severity: float) -> dict[str, Any]:
    """Return the values of the errors that reach a limit."""
    limits = LIMITS.get(type(config), {})
    found = {name: min(errors[name], max(most, getattr(config, name))) for name, most in limits.items()}
    if isinstance(config, ForceTorque):
        together = config.initial_scale_std + 5.0 * config.cross_talk_std
        if severity * together > MOST_ERROR:
            factor = max(1.0, MOST_ERROR * BELOW / together)
            names = ("initial_scale_std", "cross_talk_std")
            found |= {name: factor * getattr(config, name) for name in names}
    if isinstance(config, Wire) and config.late:
        found["under_way"] = ceil(severity * config.under_way)
    return found
