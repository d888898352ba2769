"""A calibrated six-axis sensor as files: JSON and YAML in full, and an offset for ROS 2.

JSON reads back to the last digit by :func:`read_calibration`; YAML is the same for people and for other
programs. The ``force_torque_sensor_broadcaster`` of ROS 2 adds an offset to the wrench that a driver reports.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

import surefoot
from surefoot.calibration.in_situ import InSituFit, Limb
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats
from surefoot.experiments.logs.table import LogError
from surefoot.experiments.study.files import write_text

__all__ = [
    "calibration_facts",
    "offset_wrench",
    "read_calibration",
    "write_json",
    "write_ros2_parameters",
    "write_yaml",
]

FORMAT = "surefoot-in-situ-calibration"
VERSION = 1

_CONVENTIONS = (
    "wrench = matrix (raw - offset), raw in counts as the converter gave them",
    "wrench = (fx, fy, fz, tx, ty, tz) in N and N m, exerted by the limb on the robot through the sensor, "
    "at and in the sensor's frame: at rest f = m g with g pointing down",
    "response is counts per N and N m: raw = response wrench + offset",
    "offset is that of the last set at its end, offset_of_each_set_count those in the middle of each set; "
    "with a temperature coefficient, raw = response wrench + offset + coefficient (temperature_degC - "
    "temperature_reference_degC)",
    "covariance is of (matrix row by row, offset, limb mass, limb mass times centre of mass), in those units",
)
_NAMES = {
    "matrix": "matrix_N_Nm_per_count",
    "offset": "offset_count",
    "offsets": "offset_of_each_set_count",
    "response": "response_count_per_N_Nm",
    "noise": "noise_covariance_count2",
    "temperature_coefficient": "temperature_coefficient_count_per_K",
    "hysteresis": "hysteresis_share_of_swing",
    "channel_hysteresis": "hysteresis_share_of_swing_of_each_channel",
    "rotation": "R_sensor_accelerometer",
    "affine_residual": "affine_residual_of_each_set",
    "covariance": "covariance",
}


def calibration_facts(
    fit: InSituFit, *, channels: tuple[str, ...] = (), sensor: str = "", notices: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Return a calibration as values that JSON can hold; NaN becomes null.

    Args:
        fit: The calibration.
        channels: Names of the raw columns.
        sensor: The sensor's name.
        notices: What the log lacked.
    """
    facts: dict[str, Any] = {
        "format": FORMAT,
        "format_version": VERSION,
        "made_with": f"surefoot {surefoot.__version__}",
        "sensor": sensor,
        "channels": list(channels),
        "conventions": list(_CONVENTIONS),
        "result": fit.result.value,
        "refusals": [{"reason": no.reason, "cure": no.cure} for no in fit.refusals],
        "warnings": list(fit.warnings),
        "notices": list(notices),
    }
    for field, name in _NAMES.items():
        facts[name] = _plain(getattr(fit, field))
    facts["matrix_std_N_Nm_per_count"] = _plain(fit.matrix_std)
    facts["offset_std_count"] = _plain(fit.offset_std)
    facts["temperature_reference_degC"] = fit.temperature_reference
    facts["limb"] = {
        "mass_kg": _plain(fit.limb.mass),
        "mass_std_kg": _plain(fit.limb_mass_std),
        "mass_com_kg_m": _plain(fit.limb.mass_com),
        "inertia_kg_m2": _plain(fit.limb.inertia),
    }
    facts["sets"] = [
        {"name": name, **_stats(stats)} for name, stats in zip(fit.set_names, fit.set_stats, strict=True)
    ]
    facts["all_sets"] = _stats(fit.stats)
    return facts


def write_json(fit: InSituFit, path: Path, **facts: Any) -> Path:
    """Write a calibration whole as JSON, with ``facts`` as :func:`calibration_facts` takes them."""
    write_text(path, json.dumps(calibration_facts(fit, **facts), indent=1, allow_nan=False) + "\n")
    return path


def write_yaml(fit: InSituFit, path: Path, **facts: Any) -> Path:
    """Write the same as YAML."""
    layout: dict[str, Any] = {"default_flow_style": None, "sort_keys": False, "width": 160}
    write_text(path, yaml.safe_dump(calibration_facts(fit, **facts), allow_unicode=True, **layout))
    return path


def read_calibration(path: Path) -> InSituFit:
    """Read what :func:`write_json` wrote, to the last digit.

    Raises:
        LogError: If the file is not there, is no calibration, or one of another version.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such file; 'surefoot calibrate ft' writes one.")
    try:
        given = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise LogError(f"{path.name}: not JSON: {error}.") from None
    if not isinstance(given, dict) or given.get("format") != FORMAT:
        raise LogError(f"{path.name}: no in-situ calibration (its 'format' is not '{FORMAT}').")
    if given.get("format_version") != VERSION:
        raise LogError(
            f"{path.name}: format_version {given.get('format_version')!r}, and this surefoot reads "
            f"{VERSION}; calibrate again."
        )
    try:
        return _fit_of(given)
    except KeyError as error:
        raise LogError(f"{path.name}: key {error} is missing; calibrate again.") from None
    except (TypeError, ValueError) as error:
        raise LogError(f"{path.name}: holds what a calibration cannot: {error}; calibrate again.") from None


def _plain(value: Any) -> Any:
    """Turn arrays into lists and what is not finite into null."""
    if value is None:
        return None
    if isinstance(value, np.ndarray):
        return [_plain(part) for part in value] if value.ndim else _plain(value.item())
    return float(value) if np.isfinite(value) else None


def _stats(stats: FitStats) -> dict[str, Any]:
    return {
        key: _plain(value) if isinstance(value, float) else value
        for key, value in dataclasses.asdict(stats).items()
    }


def _fit_of(given: dict[str, Any]) -> InSituFit:
    values: dict[str, Any] = {
        field: _array(given[name]) for field, name in _NAMES.items() if given[name] is not None
    }
    limb = given["limb"]
    mass = limb["mass_kg"]
    return InSituFit(
        limb=Limb(
            np.nan if mass is None else float(mass),
            _array(limb["mass_com_kg_m"]),
            None if limb["inertia_kg_m2"] is None else _array(limb["inertia_kg_m2"]),
        ),
        result=FitResult(given["result"]),
        refusals=tuple(CalibrationRefused(no["reason"], no["cure"]) for no in given["refusals"]),
        warnings=tuple(given["warnings"]),
        stats=_stats_of(given["all_sets"]),
        set_stats=tuple(_stats_of(one) for one in given["sets"]),
        set_names=tuple(one["name"] for one in given["sets"]),
        temperature_reference=float(given["temperature_reference_degC"]),
        **{"temperature_coefficient": None, **values},
    )


def _array(value: Any) -> NDArray[np.float64]:
    return np.array(value, dtype=object).astype(np.float64)


def _stats_of(given: dict[str, Any]) -> FitStats:
    given = {key: value for key, value in given.items() if key != "name"}
    for key, absent in (("residual_rms", np.nan), ("condition", np.inf)):
        given[key] = absent if given[key] is None else given[key]
    return FitStats(**given)


def offset_wrench(fit: InSituFit, temperature: float | None = None) -> NDArray[np.float64]:
    """Return what the broadcaster of ROS 2 must add to the wrench C r of a driver: -C o, shape (6,).

    Args:
        fit: The calibration.
        temperature: Of the sensor, in the unit of the fit's; needed where the fit knows its effect.

    Raises:
        ValueError: If the temperature is needed and missing.
    """
    if fit.temperature_coefficient is None:
        return np.asarray(-fit.matrix @ fit.offset)
    if temperature is None:
        raise ValueError("The offset follows the temperature; give the one at which it shall hold.")
    return np.asarray(
        -fit.matrix @ (fit.offset + (temperature - fit.temperature_reference) * fit.temperature_coefficient)
    )


def write_ros2_parameters(
    fit: InSituFit,
    path: Path,
    *,
    temperature: float | None = None,
    node: str = "force_torque_sensor_broadcaster",
    frame_id: str = "ft_sensor",
) -> Path:
    """Write parameters of ROS 2's ``force_torque_sensor_broadcaster``.

    The broadcaster publishes (reported + offset) x multiplier axis by axis and takes no matrix: C has to be
    applied by the driver, which reports C r. The offset in this file is then -C o, so that C r - C o = C (r -
    o) is published. A comment holds C.

    Args:
        fit: The calibration.
        path: Where.
        temperature: As :func:`offset_wrench` takes it.
        node: Name of the broadcaster.
        frame_id: Frame of the sensor.
    """
    rows = "\n".join("#   [" + ", ".join(f"{value:.9g}" for value in row) + "]" for row in fit.matrix)
    add = offset_wrench(fit, temperature)
    axes = ("x", "y", "z")
    parameters = {
        node: {
            "ros__parameters": {
                "frame_id": frame_id,
                "offset": {
                    "force": {axis: float(add[i]) for i, axis in enumerate(axes)},
                    "torque": {axis: float(add[3 + i]) for i, axis in enumerate(axes)},
                },
            }
        }
    }
    text = (
        f"# Made with surefoot {surefoot.__version__}. The broadcaster adds 'offset' (N, N m) to what the "
        "driver\n# reports. The driver must report the matrix below times the raw counts, without an offset "
        "of its own:\n# offset = -matrix offset_count, and what is published is matrix (raw - "
        "offset_count), the wrench that\n# the limb exerts on the robot. For the wrench of the robot on the "
        "limb turn the signs of both round.\n# The matrix (rows fx fy fz tx ty tz in N and N m per count):\n"
        f"{rows}\n" + yaml.safe_dump(parameters, sort_keys=False)
    )
    write_text(path, text)
    return path
