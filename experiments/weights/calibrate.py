"""Fit the cells of a real robot to known weights, from a table of weighings."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import CalibrationRefused, Curves, Parameters, fit_channels
from surefoot.calibration.weights.channels import ChannelFit
from surefoot.experiments.logs.checks import pass_or_refuse
from surefoot.experiments.logs.columns import LOADS
from surefoot.experiments.logs.mapping import TableMapping
from surefoot.experiments.logs.table import LogError, join_names
from surefoot.experiments.study.tables import NOTHING, Cell, Table, decimal, number, table_of, with_deviation
from surefoot.experiments.weights.judge import ROUNDING, Judged, Shape, Weighings, judge_weighings
from surefoot.experiments.weights.loop import Memory
from surefoot.files import write_text

NAMED = "Other names go under [columns] in"


@dataclass(frozen=True, eq=False)
class CalibratedCells:
    """The result of weighings of K cells: the path of the map, and what there is to show of it."""

    path: Path  # of the map
    file: str  # of the weighings
    names: tuple[str, ...]
    weighings: Weighings  # as they were read
    kept: Floats  # counts that made the fit, NaN elsewhere, shape (n, K)
    fit: ChannelFit  # behind the curves
    std: Floats  # standard deviations of scales and offsets, shape (K, 2)
    curves: Curves
    shapes: list[Shape]  # of the cells
    notices: tuple[str, ...]

    @property
    def map(self) -> Parameters:
        """Scales in N per count and offsets in N, shape (K,)."""
        return self.fit.value

    @property
    def table(self) -> Table:
        """A row a cell."""
        fit, std, shapes = self.fit, self.std, self.shapes
        columns: dict[str, Cell] = {
            "cell": lambda i: self.names[i],
            "weighings": lambda i: decimal(fit.stats[i].samples, "d"),
            "scale (1e-6 N/count), ± one sigma": lambda i: with_deviation(
                1e6 * fit.value.scale[i], 1e6 * std[i, 0]
            ),
            "offset (N)": lambda i: decimal(fit.value.offset[i], ".5f"),
            "curve": lambda i: NOTHING if (one := shapes[i].curve) is None else one.shape,
            "hysteresis (% of full scale)": lambda i: (
                with_deviation(*percents(one)) if (one := shapes[i].loop) else NOTHING
            ),
            "residual rms (mN)": lambda i: number(1e3 * fit.stats[i].residual_rms),
        }
        if not self.curves.any:
            del columns["curve"]
        if not any(one.loop for one in shapes):
            del columns["hysteresis (% of full scale)"]
        more = ", of counts that the curve makes straight" if self.curves.any else ""
        return table_of("weighings", f"F = scale · count + offset{more}", columns, range(len(self.names)))


def percents(memory: Memory) -> tuple[float, float]:
    """Hysteresis and its standard deviation in percent of full scale."""
    return 100.0 * memory.hysteresis, 100.0 * memory.hysteresis_std


def fit_weighings(path: Path, out: Path, accept: str = "") -> CalibratedCells:
    """Fit a line to each cell's readings under known weights (CoP paper, Eqs. 1, 2), or a curve.

    The table has one weighing a row: the weight that every cell bore by itself as ``load_kg`` or ``load_N``,
    and readings as ``raw_<cell>_count``, empty where not weighed. Readings that lie far off are left out.
    ``accept`` is the reason to go on past what is refused. Raises LogError or ValueError at data that cannot
    be read, CalibrationRefused if the weighings contradict themselves or do not determine a line.
    """
    weighings = read_weighings(path)
    names = names_of_cells(weighings)
    judged = judge_weighings(weighings)
    passed, weaker = pass_or_refuse(judged.findings, accept, path.name, "the map")
    bent, memory = [one.curve for one in judged.shapes], [one.loop for one in judged.shapes]
    try:
        curves, fit, std = fit_cells(weighings, judged)
    except CalibrationRefused as refusal:
        raise CalibrationRefused(f"{path.name}: {refusal.reason}", refusal.cure) from None
    facts: dict[str, Any] = {
        "channels": names,
        "scale_N_per_count": fit.value.scale.tolist(),
        "offset_N": fit.value.offset.tolist(),
        "scale_std_N_per_count": [float(one) if np.isfinite(one) else None for one in std[:, 0]],
        "offset_std_N": [float(one) if np.isfinite(one) else None for one in std[:, 1]],
        "notices": [*passed, *weaker],
    }
    if curves.any:
        facts["curves"] = curves.as_plain()
        facts["curve_std_N"] = [one and one.std for one in bent]
    if any(memory):
        facts["hysteresis"] = [one and one.hysteresis for one in memory]
        facts["hysteresis_std"] = [one and one.hysteresis_std for one in memory]
    write_text(out, json.dumps(facts, indent=1))
    rest = (fit, std, curves, judged.shapes, passed + weaker)
    return CalibratedCells(out, path.name, tuple(names), weighings, judged.kept, *rest)


def fit_cells(weighings: Weighings, judged: Judged) -> tuple[Curves, ChannelFit, Floats]:
    """Return curves, the lines behind them, and deviations of these, (K, 2); or raise CalibrationRefused."""
    curves = Curves([None if one.curve is None else one.curve.knots for one in judged.shapes])
    code = curves.straighten(judged.kept)
    fit = fit_channels(code, weighings.load, names_of_cells(weighings))
    return curves, fit, _deviations(fit, code)


def names_of_cells(weighings: Weighings) -> list[str]:
    """Return the names of the cells in a map."""
    return [name.removeprefix("raw_").removesuffix("_count") for name in weighings.cells]


def read_weighings(path: Path) -> Weighings:
    """Read a table of weighings; LogError if it is none."""
    mapping = TableMapping.beside(path)
    table = mapping.read_by_mapping(path, "give a CSV of weighings, one a row.", mapping.columns)
    given = [name for name in LOADS if name in table]
    if len(given) != 1:
        raise LogError(
            f"{path.name}: needs one column of weights, 'load_kg' or 'load_N', and has "
            f"{'both' if given else 'neither'}; there are {join_names(table.names)}. "
            f"{NAMED} {path.stem}.toml."
        )
    if not table.channels:
        raise LogError(
            f"{path.name}: has no column 'raw_<cell>_count'; name each cell's readings so, e.g. "
            f"'raw_left_front_left_count'. {NAMED} {path.stem}.toml."
        )
    unit = LOADS[given[0]]
    return Weighings(
        table.numbers(given[0]) * unit, table.stack_columns(table.channels), table.channels, given[0], unit
    )


def _deviations(fit: ChannelFit, code: Floats) -> Floats:
    """Standard deviations of scales and offsets, (K, 2): no reading is surer than its rounding."""
    found = np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2))
    for i, scale in enumerate(fit.value.scale):
        kept = code[np.isfinite(code[:, i]), i]
        least = ROUNDING * abs(scale)
        x = kept - kept.mean()
        floor = least / np.sqrt(max(float(x @ x), 1e-300))
        found[i] = np.maximum(found[i], (floor, np.hypot(least / np.sqrt(len(kept)), floor * kept.mean())))
    return found
