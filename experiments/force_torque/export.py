"""A calibrated six-axis sensor as files: JSON and YAML in full, and an offset for ROS 2."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

import surefoot
from surefoot.arrays import Floats
from surefoot.calibration.in_situ import InSituFit
from surefoot.calibration.in_situ.file import facts_of
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


def map_at(fit: InSituFit, temperature: float | None) -> tuple[Floats, Floats]:
    """Return matrix and offset in readings, (6, k) and (k,), that hold at a temperature in degC."""
    if fit.temperature is None:
        return fit.matrix, fit.offset
    if temperature is None:
        raise ValueError("The offset follows the temperature; give the one at which it shall hold.")
    matrix, change = fit.at_temperature(temperature)
    return matrix, fit.offset + change


def write_ros2_parameters(
    fit: InSituFit,
    path: Path,
    *,
    temperature: float | None = None,
    node: str = "force_torque_sensor_broadcaster",
    frame_id: str = "ft_sensor",
) -> Path:
    """Write parameters of ROS 2's ``force_torque_sensor_broadcaster`` with the filter of ``ros2/``.

    The filter takes the readings that the driver reports; of a sensor that has not six channels, which is no
    wrench, it takes the matrix times the readings. A comment holds what the broadcaster needs without the
    filter. It holds at a temperature in degC, of a sensor that follows the temperature.
    """
    matrix, offset = map_at(fit, temperature)
    wrench = matrix @ offset
    limb, six = fit.limb, len(offset) == 6
    filtered: dict[str, Any] = {"matrix": matrix.ravel().tolist()} if six else {}
    filtered |= {"offset": (offset if six else wrench).tolist(), "gravity_frame": ""}
    filtered |= {"tool_mass_kg": float(limb.mass), "tool_com_m": (limb.mass_com / limb.mass).tolist()}
    one = {"name": "surefoot", "type": "surefoot_ros/CalibratedWrench", "params": filtered}
    parameters = {"frame_id": frame_id, "sensor_filter_chain": {"filter1": one}}
    bare = yaml.safe_dump({"offset": _split_axes((-wrench).tolist())}, default_flow_style=True, width=2**20)
    rows = "\n".join("#   [" + ", ".join(f"{value:.9g}" for value in row) + "]" for row in matrix)
    text = "".join(f"# REFUSED: {flat(str(no))}\n" for no in fit.refusals)
    text += f"# ACCEPTED: {flat(fit.accepted)}\n" if fit.accepted else ""
    formula = "matrix (readings - offset)" if six else "(what the driver reports) - offset"
    text += (
        f"# Made with surefoot {surefoot.__version__}. The filter of the package surefoot_ros publishes, as "
        f"~/wrench_filtered,\n# {formula}, the wrench that the limb exerts on the robot; with a\n"
        "# gravity_frame, whose z axis points up, without the limb's own weight. For the wrench of the\n"
        "# robot on the limb turn the signs round. Without that package the driver must report the matrix\n"
        "# below times the readings (rows fx fy fz tx ty tz in N and N m per reading), and in place of\n"
        "# sensor_filter_chain stands\n"
        f"#   {bare[1:-2]}\n{rows}\n"
    )
    text += yaml.safe_dump(
        {node: {"ros__parameters": parameters}}, sort_keys=False, default_flow_style=None, width=2**20
    )
    write_text(path, text)
    return path


def _split_axes(wrench: Sequence[float]) -> dict[str, dict[str, float]]:
    return {
        "force": dict(zip("xyz", wrench[:3], strict=True)),
        "torque": dict(zip("xyz", wrench[3:], strict=True)),
    }
