"""What a log says of its robot beside the table; private to :mod:`surefoot.experiments`."""

from typing import Any

import numpy as np

from surefoot.calibration.layout import FeetLayout, FootLayout
from surefoot.calibration.parameters import Parameters
from surefoot.experiments._log_checks import LogError

__all__ = ["describe", "read_description"]

FORMAT_VERSION = 1


def describe(log: Any) -> dict[str, Any]:
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
            }
            for foot in log.layout.feet
        ],
        "mass_kg": log.mass,
        "nominal": _describe_parameters(log.nominal),
        "bench": None if log.bench is None else _describe_parameters(log.bench),
        "dt_s": log.dt,
        "lag_samples": log.lag,
        "seed": log.seed,
        "about": log.about,
    }


def _describe_parameters(parameters: Parameters) -> dict[str, list[float]]:
    return {
        "scale_N_per_count": np.asarray(parameters.scale, dtype=float).tolist(),
        "offset_N": np.asarray(parameters.offset, dtype=float).tolist(),
    }


def read_description(description: Any, name: str) -> dict[str, Any]:
    if not isinstance(description, dict) or description.get("format") != "surefoot-log":
        raise LogError(f'{name}: the description does not say "format": "surefoot-log".')
    version = description.get("format_version")
    if version != FORMAT_VERSION:
        raise LogError(
            f"{name}: log format version {version!r} is not {FORMAT_VERSION}, which this surefoot reads."
        )
    required = ("layout", "mass_kg", "nominal", "dt_s", "lag_samples")
    missing = [key for key in required if key not in description]
    if missing:
        raise LogError(f"{name}: the description lacks {missing}; see docs/log-format.md.")
    try:
        layout = FeetLayout(tuple(_foot(foot) for foot in description["layout"]))
        facts: dict[str, Any] = {
            "layout": layout,
            "mass": float(description["mass_kg"]),
            "nominal": _parameters(description["nominal"], layout, "nominal"),
            "bench": None,
            "dt": float(description["dt_s"]),
            "lag": int(description["lag_samples"]),
            "seed": None if description.get("seed") is None else int(description["seed"]),
            "about": dict(description.get("about") or {}),
        }
        if description.get("bench") is not None:
            facts["bench"] = _parameters(description["bench"], layout, "bench")
    except (TypeError, KeyError, ValueError) as error:
        what = f"key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise LogError(f"{name}: the description cannot be used: {what}") from None
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
