"""Files of in-situ calibrations: a fit as values that JSON can hold, and back."""

import dataclasses
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.calibration.in_situ.fit import (
    Hysteresis,
    ImuErrors,
    InSituFit,
    Limb,
    MakerErrors,
    SetFit,
    TemperatureEffect,
)
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats
from surefoot.calibration.state import LARGEST
from surefoot.files import read_json

FORMAT = "surefoot-in-situ-calibration"
VERSION = 2

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
    "covariance": "covariance",
    "noise": "noise_covariance_count2",
    "accepted": "accepted",
    "scope": "scope",
    "data_share": "data_share_of_covariance",
    "offset_doubt": "offset_covariance_by_hysteresis_count2",
    "imu.bias": "accelerometer_bias_m_s2",
    "imu.scale": "accelerometer_scale",
    "imu.rotation": "R_sensor_accelerometer",
    "imu.delay": "accelerometer_delay_s",
    "temperature.coefficient": "temperature_coefficient_count_per_K",
    "temperature.reference": "temperature_reference_degC",
    "temperature.gain": "temperature_gain_per_K",
    "hysteresis.share": "hysteresis_share_of_swing",
    "hysteresis.amplitude": "amplitude_of_matrix_N_Nm",
    "hysteresis.swing_gain": "gain_at_swings_of_sets",
    "maker.share": "factory_share_of_full_scale",
    "maker.known": "data_share_of_factory_errors",
}
"""Names in files of the parts of a fit."""

_PARTS = {"imu": ImuErrors, "temperature": TemperatureEffect, "hysteresis": Hysteresis, "maker": MakerErrors}


def _part(fit: InSituFit, path: str) -> Any:
    """Return a part of a fit by its path; None if the fit does not have it."""
    value: Any = fit
    for name in path.split("."):
        value = None if value is None else getattr(value, name)
    return value


def facts_of(
    fit: InSituFit,
    channels: tuple[str, ...] = (),
    sensor: str = "",
    notices: tuple[str, ...] = (),
    raw_unit: str = "counts",
) -> Any:
    """Return a calibration as values that JSON can hold, with the sensor's name and notices of the log."""
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
            "warnings": fit.warnings,
            "notices": notices,
            **{name: _part(fit, path) for path, name in _NAMES.items()},
            "matrix_std_N_Nm_per_count": fit.matrix_std,
            "offset_std_count": fit.offset_std,
            "limb": {
                "mass_kg": fit.limb.mass,
                "mass_std_kg": fit.limb_mass_std,
                "mass_com_kg_m": fit.limb.mass_com,
                "inertia_kg_m2": fit.limb.inertia,
            },
            "sets": [
                {"name": one.name, "affine_residual": one.affine_residual, **dataclasses.asdict(one.stats)}
                for one in fit.sets
            ],
            "all_sets": dataclasses.asdict(fit.stats),
        }
    )


def _plain(value: Any) -> Any:
    """Turn arrays into lists and values that are not finite into null."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def read_calibration(path: Path) -> InSituFit:
    """Read a JSON file of ``surefoot calibrate ft``, to the last digit.

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
    values: dict[str, Any] = {}
    parts: dict[str, dict[str, Any]] = {name: {} for name in _PARTS}
    for path, name in _NAMES.items():
        value = _array(given[name]) if isinstance(given[name], list) else given[name]
        part, _, of_part = path.partition(".")
        if value is not None:
            (parts[part] if of_part else values)[of_part or part] = value
    limb, offsets = given["limb"], values.pop("offsets")
    return InSituFit(
        limb=Limb(_number(limb["mass_kg"]), _array(limb["mass_com_kg_m"]), _array(limb["inertia_kg_m2"])),
        result=FitResult(given["result"]),
        refusals=tuple(CalibrationRefused(no["reason"], no["cure"]) for no in given["refusals"]),
        warnings=tuple(given["warnings"]),
        stats=_stats_of(given["all_sets"]),
        sets=tuple(
            SetFit(one["name"], offset, _stats_of(one), _number(one["affine_residual"]))
            for one, offset in zip(given["sets"], offsets, strict=True)
        ),
        **values,
        **{name: make(**parts[name]) for name, make in _PARTS.items() if parts[name]},
    )


def _array(value: Any) -> Any:
    return None if value is None else np.array(value, dtype=object).astype(np.float64)


def _number(value: float | None, absent: float = np.nan) -> float:
    return absent if value is None else float(value)


def _stats_of(given: dict[str, Any]) -> FitStats:
    rms, condition = _number(given["residual_rms"]), _number(given["condition"], np.inf)
    rest = {key: value for key, value in given.items() if key not in ("name", "affine_residual")}
    return FitStats(**rest | {"residual_rms": rms, "condition": condition})
