"""A calibrated six-axis sensor as files: JSON and YAML in full, and an offset for ROS 2."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

import surefoot
from surefoot.calibration.in_situ import InSituFit
from surefoot.calibration.in_situ.fit import facts_of
from surefoot.experiments.study.tables import flat
from surefoot.files import write_text


def write_json(fit: InSituFit, path: Path, **facts: Any) -> Path:
    """Write a calibration whole as JSON, with facts for ``facts_of``."""
    write_text(path, json.dumps(facts_of(fit, **facts), indent=1, allow_nan=False) + "\n")
    return path


def write_yaml(fit: InSituFit, path: Path, **facts: Any) -> Path:
    """Write the same as YAML."""
    layout: dict[str, Any] = {"default_flow_style": None, "sort_keys": False, "width": 160}
    write_text(path, yaml.safe_dump(facts_of(fit, **facts), allow_unicode=True, **layout))
    return path


def offset_wrench(fit: InSituFit, temperature: float | None = None) -> NDArray[np.float64]:
    """Compute the wrench -C o, (6,), that ROS 2's broadcaster adds to C r of a driver, at a temperature."""
    offset = fit.offset
    if fit.temperature_coefficient is not None:
        if temperature is None:
            raise ValueError("The offset follows the temperature; give the one at which it shall hold.")
        offset = offset + (temperature - fit.temperature_reference) * fit.temperature_coefficient
    return np.asarray(-fit.matrix @ offset)


def write_ros2_parameters(
    fit: InSituFit,
    path: Path,
    *,
    temperature: float | None = None,
    node: str = "force_torque_sensor_broadcaster",
    frame_id: str = "ft_sensor",
) -> Path:
    """Write parameters of ROS 2's ``force_torque_sensor_broadcaster``.

    It publishes (reported + offset) x multiplier axis by axis and takes no matrix: the driver has to report C
    r, and the offset in this file is -C o, at a temperature as :func:`offset_wrench` takes it. Gains that go
    with the temperature are multipliers. A comment holds C.
    """
    rows = "\n".join("#   [" + ", ".join(f"{value:.9g}" for value in row) + "]" for row in fit.matrix)
    add = offset_wrench(fit, temperature).tolist()
    parameters: dict[str, Any] = {"frame_id": frame_id, "offset": _split_axes(add)}
    hotter = ""
    if fit.temperature_gain is not None:
        assert temperature is not None
        gain = 1.0 + (temperature - fit.temperature_reference) * fit.temperature_gain
        parameters["multiplier"] = _split_axes((1.0 / gain).tolist())
        hotter = f"# 'multiplier' makes up for what the axes read more at {temperature:.4g} degC.\n"
    text = "".join(f"# REFUSED: {flat(str(no))}\n" for no in fit.refusals)
    text += f"# ACCEPTED: {flat(fit.accepted)}\n" if fit.accepted else ""
    text += (
        f"# Made with surefoot {surefoot.__version__}. The broadcaster adds 'offset' (N, N m) to what the "
        "driver\n# reports. The driver must report the matrix below times the readings, without an offset "
        "of its own:\n# offset = -matrix offset_count, and what is published is matrix (raw - "
        "offset_count), the wrench that\n# the limb exerts on the robot. For the wrench of the robot on the "
        "limb turn the signs of both round.\n# Matrix (rows fx fy fz tx ty tz in N and N m per reading):\n"
        f"{rows}\n{hotter}" + yaml.safe_dump({node: {"ros__parameters": parameters}}, sort_keys=False)
    )
    write_text(path, text)
    return path


def _split_axes(wrench: Sequence[float]) -> dict[str, dict[str, float]]:
    return {
        "force": dict(zip("xyz", wrench[:3], strict=True)),
        "torque": dict(zip("xyz", wrench[3:], strict=True)),
    }
