"""Six-axis calibration matrices as text files, among them those of the iCub's FTSens.

These have 43 lines: the 36 entries of diag(1 / full scale) C 32767 row by row, in [-1, 1), as 16-bit
two's-complement hexadecimal in 1.15 fixed point, a gain of 1, and the six full scales in N and N m.
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.experiments.logs.table import LogError
from surefoot.files import atomic_path

ICUB_COUNTS = 32767.0  # counts at the end of an FTSens's converter

_UNIT = 2**15


def write_icub_matrix(matrix: ArrayLike, full_scale: ArrayLike, path: Path) -> Path:
    """Write C, (6, 6) in N and N m per count, as the iCub's FTSens reads it, to 2^-15 of full scale.

    Full scales are six whole numbers of N and N m. Raises ValueError at other channels, scales or entries.
    """
    matrix, scale = np.asarray(matrix, dtype=np.float64), np.asarray(full_scale, dtype=np.float64)
    if matrix.shape != (6, 6):
        raise ValueError(
            f"The iCub's format holds a 6 x 6 matrix, got shape {matrix.shape}; write JSON or YAML for a "
            "sensor with other than six channels."
        )
    if scale.shape != (6,) or not (np.isfinite(scale) & (scale > 0.0) & (scale == np.round(scale))).all():
        raise ValueError(
            f"The iCub's format needs six full scales in whole N and N m, got {scale.tolist()}; give "
            "sensor.full_scale as its data sheet does."
        )
    share = matrix * ICUB_COUNTS / scale[:, None]
    fixed = np.round(share * _UNIT)
    if not ((fixed >= -_UNIT) & (fixed < _UNIT)).all():
        i, j = np.unravel_index(int(np.argmax(np.nan_to_num(np.abs(share), nan=np.inf))), share.shape)
        raise ValueError(
            f"The iCub's format holds entries in [-1, 1), and that of row {i}, column {j} is "
            f"{share[i, j]:.4g} of a full scale of {scale[i]:g}; give a larger full scale for that row."
        )
    entries = [f"{int(value) & 0xFFFF:04X}" for value in fixed.ravel()]
    lines = [*entries, "1", *(f"{int(value)}" for value in scale)]
    with atomic_path(path) as part:
        part.write_bytes("".join(f"{line}\r\n" for line in lines).encode("ascii"))
    return path


def read_matrix(path: Path) -> tuple[Floats, Floats | None]:
    """Read six rows of numbers, or an iCub's file: C in N and N m per count, (6, k), and full scales."""
    if not path.is_file():
        raise LogError(f"{path}: no such file; factory.file gives its path from the configuration.")
    text = path.read_text(encoding="utf-8", errors="replace")
    rows = [_cells(line) for line in text.splitlines() if line.strip()]
    try:
        if rows and all(len(row) == 1 for row in rows):
            return _parse_icub([row[0] for row in rows])
        matrix = np.array(rows, dtype=np.float64)
        if matrix.ndim != 2 or len(matrix) != 6 or matrix.shape[1] < 6 or not np.isfinite(matrix).all():
            raise ValueError(f"got shape {matrix.shape}")
    except ValueError as error:
        raise LogError(
            f"{path.name}: a factory matrix has six rows (fx fy fz tx ty tz) of a finite number a channel, "
            "at least six of them, or an iCub's 43 lines (36 entries of up to four hexadecimal digits, a "
            f"gain, six full scales); {error}."
        ) from None
    return matrix, None


def _cells(line: str) -> list[str]:
    """Return the numbers of a line; commas between them, or decimal commas between other separators."""
    cells = re.split(r"[\s;]+", line.strip().strip(";"))
    if len(cells) > 1 and all(re.fullmatch(r"[^,]*(\d,\d[^,]*)?", cell) for cell in cells):
        return [cell.replace(",", ".") for cell in cells]
    return line.replace(",", " ").split()


def _parse_icub(lines: list[str]) -> tuple[Floats, Floats]:
    """Return C and the full scales of an FTSens file; raise ValueError if it is none."""
    if len(lines) != 43:
        raise ValueError(f"got {len(lines)} lines")
    if any(len(line) > 4 for line in lines[:36]):
        raise ValueError("an entry is longer than four digits")
    entries = np.array([int(line, 16) for line in lines[:36]], dtype=np.float64)
    gain, scale = float(lines[36]), np.array([float(line) for line in lines[37:]])
    share = np.where(entries >= _UNIT, entries - 2 * _UNIT, entries).reshape(6, 6) / _UNIT
    return gain * scale[:, None] * share / ICUB_COUNTS, scale
