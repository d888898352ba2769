"""The matrix of a six-axis sensor as an FTSens of the iCub reads it: 43 lines of text."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.experiments.in_situ._matrix import icub_text, read_icub_text
from surefoot.experiments.logs.checks import LogError
from surefoot.experiments.study.files import atomic_path

__all__ = ["read_icub_matrix", "write_icub_matrix"]


def write_icub_matrix(matrix: ArrayLike, full_scale: ArrayLike, path: Path) -> Path:
    """Write C as the iCub's FTSens reads it; offset and covariance are not in that format.

    Args:
        matrix: C in N and N m per count, shape (6, 6).
        full_scale: Of the sensor in whole N and N m, shape (6,).
        path: Where.

    Raises:
        ValueError: If the sensor has other than six channels, or an entry, as a share of full scale per 32767
            counts, is not in [-1, 1).
    """
    text = icub_text(np.asarray(matrix), np.asarray(full_scale))
    with atomic_path(path) as part:
        part.write_bytes(text.encode("ascii"))
    return path


def read_icub_matrix(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read C and the full scales from an FTSens file.

    Returns:
        C in N and N m per count, shape (6, 6), and the full scales in N and N m, shape (6,).

    Raises:
        LogError: If the file is not there or not of the format.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such file; give an FTSens matrix of 43 lines.")
    return read_icub_text(path.read_text(encoding="utf-8", errors="replace"), path.name)
