"""A fit as values that JSON can hold, and back: what a robot reads of a sensor that was calibrated before."""

import dataclasses
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.calibration.in_situ.fit import InSituFit, Limb
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats
from surefoot.calibration.state import LARGEST
from surefoot.files import read_json

FORMAT = "surefoot-in-situ-calibration"
VERSION = 1

_CONVENTIONS = (
    "wrench = matrix (raw - offset), raw as it was read, in raw_unit, which stands for 'count' in all names",
    "wrench = (fx, fy, fz, tx, ty, tz) in N and N m, exerted by the limb on the robot through the sensor, "
    "at and in the sensor's frame: at rest f = m g with g pointing down",
    "response is counts per N and N m: raw = response wrench + offset",
    "offset is that of the last set at its end, offset_of_each_set_count those in the middle of each set; "
    "with a temperature coefficient, raw = response wrench + offset + coefficient (temperature_degC - "
    "temperature_reference_degC); with a temperature gain each axis of the wrench counts for 1 + gain times "
    "that difference",
    "gravity is (as read - accelerometer_bias) accelerometer_scale, and was read accelerometer_delay_s late",
    "covariance is of (matrix row by row, offset, limb mass, limb mass times centre of mass), in those units",
)
_USED = ("matrix", "offset", "response", "noise")

_NAMES = {
    "matrix": "matrix_N_Nm_per_count",
    "offset": "offset_count",
    "offsets": "offset_of_each_set_count",
    "response": "response_count_per_N_Nm",
    "noise": "noise_covariance_count2",
    "temperature_coefficient": "temperature_coefficient_count_per_K",
    "temperature_gain": "temperature_gain_per_K",
    "hysteresis": "hysteresis_share_of_swing",
    "channel_hysteresis": "hysteresis_share_of_swing_of_each_channel",
    "rotation": "R_sensor_accelerometer",
    "affine_residual": "affine_residual_of_each_set",
    "covariance": "covariance",
    "offset_doubt": "offset_covariance_by_hysteresis_count2",
    "data_share": "data_share_of_covariance",
    "maker_known": "data_share_of_factory_errors",
    "accelerometer_bias": "accelerometer_bias_m_s2",
}

_NEW = ("maker_known", "accelerometer_bias", "offset_doubt")
"""Fields that files of the same version may lack."""


def facts_of(
    fit: InSituFit,
    channels: tuple[str, ...] = (),
    sensor: str = "",
    notices: tuple[str, ...] = (),
    raw_unit: str = "counts",
) -> Any:
    """Return a calibration as values that JSON can hold, with the sensor's name and what the log lacked."""
    return _plain(
        {
            "format": FORMAT,
            "format_version": VERSION,
            "made_with": f"surefoot {version('surefoot')}",
            "sensor": sensor,
            "channels": channels,
            "raw_unit": raw_unit,
            "conventions": _CONVENTIONS,
            "result": fit.result.value,
            "refusals": [{"reason": no.reason, "cure": no.cure} for no in fit.refusals],
            "accepted": fit.accepted,
            "warnings": fit.warnings,
            "notices": notices,
            **{name: getattr(fit, field) for field, name in _NAMES.items()},
            "matrix_std_N_Nm_per_count": fit.matrix_std,
            "offset_std_count": fit.offset_std,
            "temperature_reference_degC": fit.temperature_reference,
            "bending_share_of_spread": fit.bending,
            "scope": fit.scope,
            "factory_share_of_full_scale": fit.maker_share,
            "accelerometer_scale": fit.accelerometer_scale,
            "accelerometer_delay_s": fit.delay,
            "limb": {
                "mass_kg": fit.limb.mass,
                "mass_std_kg": fit.limb_mass_std,
                "mass_com_kg_m": fit.limb.mass_com,
                "inertia_kg_m2": fit.limb.inertia,
            },
            "sets": [
                {"name": name, **dataclasses.asdict(stats)}
                for name, stats in zip(fit.set_names, fit.set_stats, strict=True)
            ],
            "all_sets": dataclasses.asdict(fit.stats),
        }
    )


def _plain(value: Any) -> Any:
    """Turn arrays into lists and what is not finite into null."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def read_calibration(path: Path) -> InSituFit:
    """Read what ``surefoot calibrate ft`` wrote as JSON, to the last digit.

    Raises:
        ValueError: If the file is not there, is no calibration, one of another version, or holds numbers that
            no sensor has.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file; 'surefoot calibrate ft' writes one.")
    try:
        given = read_json(path)
        if (given["format"], given["format_version"]) != (FORMAT, VERSION):
            raise ValueError(f"{given['format']} {given['format_version']}")
        fit = _fit_of(given)
        for field in _USED if fit.result is not FitResult.REFUSED else ():
            if not (np.abs(getattr(fit, field)) <= LARGEST).all():
                raise ValueError(f"'{_NAMES[field]}' holds what no sensor has")
        return fit
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path.name}: is no {FORMAT} {VERSION}, which this surefoot reads ({error!r}); calibrate again."
        ) from None


def _fit_of(given: dict[str, Any]) -> InSituFit:
    if given.get("nonlinear") is not None:
        raise ValueError("a polynomial, which fits no longer have")
    older = {name: None for field, name in _NAMES.items() if field in _NEW}
    given = older | given
    values = {field: _array(given[name]) for field, name in _NAMES.items() if given[name] is not None}
    limb = given["limb"]
    return InSituFit(
        limb=Limb(_number(limb["mass_kg"]), _array(limb["mass_com_kg_m"]), _array(limb["inertia_kg_m2"])),
        result=FitResult(given["result"]),
        refusals=tuple(CalibrationRefused(no["reason"], no["cure"]) for no in given["refusals"]),
        accepted=given["accepted"],
        warnings=tuple(given["warnings"]),
        stats=_stats_of(given["all_sets"]),
        set_stats=tuple(_stats_of(one) for one in given["sets"]),
        set_names=tuple(one["name"] for one in given["sets"]),
        temperature_reference=float(given["temperature_reference_degC"]),
        bending=float(given.get("bending_share_of_spread", 0.0)),
        scope=given.get("scope", ""),
        maker_share=given.get("factory_share_of_full_scale"),
        accelerometer_scale=float(given.get("accelerometer_scale", 1.0)),
        delay=float(given.get("accelerometer_delay_s", 0.0)),
        **{"temperature_coefficient": None, **values},
    )


def _array(value: Any) -> Any:
    return None if value is None else np.array(value, dtype=object).astype(np.float64)


def _number(value: float | None, absent: float = np.nan) -> float:
    return absent if value is None else float(value)


def _stats_of(given: dict[str, Any]) -> FitStats:
    rms, condition = _number(given["residual_rms"]), _number(given["condition"], np.inf)
    rest = {key: value for key, value in given.items() if key != "name"}
    return FitStats(**rest | {"residual_rms": rms, "condition": condition})
