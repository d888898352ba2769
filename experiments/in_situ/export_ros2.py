"""The offset of a six-axis sensor as ROS 2's ``force_torque_sensor_broadcaster`` adds it."""

from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

import surefoot
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.experiments.study.files import write_text

__all__ = ["offset_wrench", "write_ros2_parameters"]


def offset_wrench(fit: InSituFit, temperature: float | None = None) -> NDArray[np.float64]:
    """Compute what the broadcaster of ROS 2 must add to the wrench C r of a driver: -C o, shape (6,).

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
