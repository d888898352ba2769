"""Fit the cells of a real robot to known weights, from a table of weighings."""

import json
from pathlib import Path

import numpy as np

from surefoot.calibration import GRAVITY, fit_channels
from surefoot.experiments.logs.table import LogError, read_table
from surefoot.experiments.study.tables import Cell, Table, laid_out, number, with_deviation
from surefoot.files import write_text


def fit_weighings(path: Path, out: Path) -> tuple[Table, Path]:
    """Fit a line to each cell's readings under known weights (CoP paper, Eqs. 1, 2).

    The table has one weighing a row: the weight that every cell bore by itself as ``load_kg`` or ``load_N``,
    and readings as ``raw_<cell>_count``, empty where not weighed. Returns what to show, and the map's path;
    raises LogError or ValueError at what is refused.
    """
    table = read_table(path, "give a CSV of weighings, one a row.")
    units = {"load_kg": GRAVITY, "load_N": 1.0}
    given = [name for name in units if name in table]
    if len(given) != 1:
        raise LogError(
            f"{path.name}: needs one column of weights, 'load_kg' or 'load_N', and has {given or 'neither'}."
        )
    cells = [name for name in table.names if name.startswith("raw_") and name.endswith("_count")]
    if not cells:
        raise LogError(
            f"{path.name}: has no column 'raw_<cell>_count'; name each cell's readings so, e.g. "
            "'raw_left_front_left_count'."
        )
    names = [name.removeprefix("raw_").removesuffix("_count") for name in cells]
    load = table.numbers(given[0]) * units[given[0]]
    fit = fit_channels(table.stacked(cells), load, names)
    facts = {
        "channels": names,
        "scale_N_per_count": fit.value.scale.tolist(),
        "offset_N": fit.value.offset.tolist(),
    }
    write_text(out, json.dumps(facts, indent=1))
    columns: dict[str, Cell] = {
        "cell": lambda i: names[i],
        "weighings": lambda i: str(fit.stats[i].samples),
        "scale (1e-6 N/count), ± one sigma": lambda i: with_deviation(
            1e6 * fit.value.scale[i], 1e6 * np.sqrt(fit.covariance[i, 0, 0])
        ),
        "offset (N)": lambda i: f"{fit.value.offset[i]:.5f}",
        "residual rms (mN)": lambda i: number(1e3 * fit.stats[i].residual_rms),
    }
    return laid_out("weighings", "F = scale · count + offset", columns, range(len(names))), out
