"""A calibrated six-axis sensor as files: JSON and YAML in full, and the formats that robots read.

JSON is the whole truth and reads back by :func:`read_calibration`; YAML says the same to people and to other
programs. An FTSens of the iCub reads its matrix from 43 lines of text, and the
``force_torque_sensor_broadcaster`` of ROS 2 adds an offset to the wrench that a driver reports.
"""

from surefoot.experiments.in_situ.export_facts import (
    calibration_facts,
    read_calibration,
    write_json,
    write_yaml,
)
from surefoot.experiments.in_situ.export_icub import read_icub_matrix, write_icub_matrix
from surefoot.experiments.in_situ.export_ros2 import offset_wrench, write_ros2_parameters

__all__ = [
    "calibration_facts",
    "offset_wrench",
    "read_calibration",
    "read_icub_matrix",
    "write_icub_matrix",
    "write_json",
    "write_ros2_parameters",
    "write_yaml",
]
