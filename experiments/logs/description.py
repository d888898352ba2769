"""The description of the robot that goes with a log's table."""

from typing import Any

import numpy as np

from surefoot.calibration.layout import FeetLayout, FootLayout, FootSensor
from surefoot.calibration.parameters import Parameters
from surefoot.experiments.logs.table import LogError

__all__ = ["describe", "read_description"]

FORMAT_VERSION = 1


def describe(log: Any) -> dict[str, Any]:
    """Return a log's description, for the file's header."""
    return {
        "format": "surefoot-log",
        "format_version": FORMAT_VERSION,
        "layout": [
            {
                "name": foot.name,
                "channel_names": list(foot.channel_names),
                "wrench_map": foot.wrench_map.tolist(),
                "position_cell_sole_m": (
                    None if foot.position_cell_sole is None else foot.position_cell_sole.tolist()
                ),
                "sensors": [_describe_sensor(sensor) for sensor in foot.sensors],
            }
            for foot in log.layout.feet
        ],
        "mass_kg": log.mass,
        "nominal": _describe_parameters(log.nominal),
        "calibrated": None if log.calibrated is None else _describe_parameters(log.calibrated),
        "dt_s": log.dt,
        "lag_samples": log.lag,
        "seed": log.seed,
        "about": log.about,
    }


def _describe_sensor(sensor: FootSensor) -> dict[str, Any]:
    return {
        "channels": [sensor.channels.start, sensor.channels.stop],
        "wrench_map": sensor.wrench_map.tolist(),
        "six_axis": sensor.six_axis,
        "share": sensor.share.tolist(),
        "mass_below_kg": sensor.mass_below,
        "com_below_sole_m": sensor.com_below_sole.tolist(),
    }


def _describe_parameters(parameters: Parameters) -> dict[str, list[float]]:
    return {
        "scale_N_per_count": np.asarray(parameters.scale, dtype=float).tolist(),
        "offset_N": np.asarray(parameters.offset, dtype=float).tolist(),
    }


def read_description(description: Any, name: str) -> dict[str, Any]:
    """Return a description, checked.

    Raises:
        LogError: If it is not a header of a log.
    """
    if not isinstance(description, dict) or description.get("format") != "surefoot-log":
        raise LogError(f'{name}: the description lacks "format": "surefoot-log".')
    version = description.get("format_version")
    if version != FORMAT_VERSION:
        raise LogError(
            f"{name}: log format version {version!r} is not {FORMAT_VERSION}, which this surefoot reads."
        )
    required = ["layout", "mass_kg", "nominal", "dt_s"]
    # References that are made of joints and IMU describe their own row.
    required += [] if "motion" in description else ["lag_samples"]
    missing = [key for key in required if key not in description]
    if missing:
        raise LogError(f"{name}: the description lacks {missing}; see docs/log-format.md.")
    try:
        layout = FeetLayout(tuple(_foot(foot) for foot in description["layout"]))
        facts: dict[str, Any] = {
            "layout": layout,
            "mass": float(description["mass_kg"]),
            "nominal": _parameters(description["nominal"], layout, "nominal"),
            "calibrated": None,
            "dt": float(description["dt_s"]),
            "lag": int(description.get("lag_samples", 0)),
            "seed": None if description.get("seed") is None else int(description["seed"]),
            "about": dict(description.get("about") or {}),
        }
        # Older logs call it "bench".
        calibrated = description.get("calibrated", description.get("bench"))
        if calibrated is not None:
            facts["calibrated"] = _parameters(calibrated, layout, "calibrated")
    except (TypeError, KeyError, ValueError) as error:
        what = f"key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise LogError(f"{name}: the description cannot be used: {what}") from None
    if "motion" in description and facts["lag"] != 0:
        raise LogError(
            f"{name}: the description's lag_samples is {facts['lag']} beside motion, whose references are "
            "made for the very moment of each row; leave it out and give motion.delay_s in seconds."
        )
    positive = {
        "mass_kg": facts["mass"] > 0,
        "dt_s": facts["dt"] > 0,
        "lag_samples": facts["lag"] >= 0,
    }
    for key, fine in positive.items():
        if not fine:
            raise LogError(f"{name}: the description's {key} is {description[key]}; it must be positive.")
    return facts


def _foot(description: dict[str, Any]) -> FootLayout:
    position = description.get("position_cell_sole_m")
    return FootLayout(
        name=str(description["name"]),
        wrench_map=np.asarray(description["wrench_map"], dtype=np.float64),
        channel_names=tuple(description["channel_names"]),
        position_cell_sole=None if position is None else np.asarray(position, dtype=np.float64),
        sensors=tuple(_sensor(sensor) for sensor in description.get("sensors") or ()),
    )


def _sensor(description: dict[str, Any]) -> FootSensor:
    first, last = description["channels"]
    return FootSensor(
        channels=slice(int(first), int(last)),
        wrench_map=np.asarray(description["wrench_map"], dtype=np.float64),
        six_axis=bool(description["six_axis"]),
        share=np.asarray(description["share"], dtype=np.float64),
        mass_below=float(description["mass_below_kg"]),
        com_below_sole=np.asarray(description["com_below_sole_m"], dtype=np.float64),
    )


def _parameters(description: dict[str, Any], layout: FeetLayout, what: str) -> Parameters:
    scale = np.asarray(description["scale_N_per_count"], dtype=np.float64)
    offset = np.asarray(description["offset_N"], dtype=np.float64)
    for value in (scale, offset):
        if value.shape != (layout.channels,) or not np.isfinite(value).all():
            raise ValueError(
                f"the {what} map needs {layout.channels} finite scales and offsets, one a channel, "
                f"got shape {value.shape}."
            )
    return Parameters(scale, offset)
