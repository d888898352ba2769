"""Calibrate one log by one method, and write what came of it beside the log."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from surefoot.calibration import cop_of_wrench, sole_wrenches
from surefoot.experiments._files import atomic_path, write_text
from surefoot.experiments._log_columns import channel_slugs
from surefoot.experiments.log_format import Log
from surefoot.experiments.replay import Replayed, replay_logs, starting_map
from surefoot.experiments.score import score_forces
from surefoot.experiments.tables import Table, number

__all__ = ["CalibratedLog", "calibrate_log"]


@dataclass(frozen=True)
class CalibratedLog:
    """Where the result of a calibration lies.

    Attributes:
        walk: Calibrated forces, centres of pressure, parameters and flags of every sample, a Parquet table.
        parameters: The last map, in JSON as a log's description holds it.
        tables: What to show.
    """

    walk: Path
    parameters: Path
    tables: tuple[Table, ...]


def calibrate_log(
    log: Log,
    method: str,
    start: str | None = None,
    *,
    folder: Path,
    stem: str,
    settle: float = 0.0,
    zero_phase: bool = False,
) -> CalibratedLog:
    """Replay a log, and write the result.

    Args:
        log: The log.
        method: A key of :data:`~surefoot.calibration.METHODS`.
        start: ``"nominal"`` or ``"bench"``; by default what the log says, else ``"nominal"``.
        folder: Where the files go.
        stem: How their names begin.
        settle: Samples before this time in s do not count in a score.
        zero_phase: Whether to filter with hindsight.

    Raises:
        ValueError: If there is no such method or starting map, or nothing to score after ``settle``.
    """
    start = str(log.about.get("start", "nominal")) if start is None else start
    replayed = replay_logs([log], method, start, zero_phase=zero_phase)[0]
    tables = [_parameter_table(log, replayed, start)]
    if log.truth is not None:
        tables.append(_score_table(log, replayed, start, settle))
    walk = folder / f"{stem}.{method}.parquet"
    with atomic_path(walk) as part:
        pq.write_table(pa.table(_walk_columns(log, replayed)), part)
    parameters = folder / f"{stem}.{method}.json"
    last = {"scale_N_per_count": replayed.scale[-1].tolist(), "offset_N": replayed.offset[-1].tolist()}
    facts = {"method": method, "start": start, "channels": list(log.layout.channel_names), **last}
    write_text(parameters, json.dumps(facts, indent=1))
    return CalibratedLog(walk, parameters, tuple(tables))


def _walk_columns(log: Log, replayed: Replayed) -> dict[str, np.ndarray]:
    columns: dict[str, np.ndarray] = {"time_s": log.time}
    for i, name in enumerate(channel_slugs(log.layout)):
        columns[f"force_{name}_N"] = replayed.force[:, i]
    for i, axis in enumerate("xy"):
        columns[f"cop_level_{axis}_m"] = replayed.cop[:, i]
    wrench = sole_wrenches(replayed.force, log.layout)
    cop_foot = cop_of_wrench(wrench)
    for f, foot in enumerate(log.layout.feet):
        columns[f"vgrf_{foot.name}_N"] = wrench[:, f, 2]
        for i, axis in enumerate("xy"):
            columns[f"cop_{foot.name}_sole_{axis}_m"] = cop_foot[:, f, i]
    for i, name in enumerate(channel_slugs(log.layout)):
        columns[f"scale_{name}_N_per_count"] = replayed.scale[:, i]
        columns[f"offset_{name}_N"] = replayed.offset[:, i]
        columns[f"flags_{name}"] = replayed.flags[:, i]
    return columns


def _parameter_table(log: Log, replayed: Replayed, start: str) -> Table:
    began = starting_map(log, start)
    ratio = replayed.scale[-1] / began.scale
    shift = replayed.offset[-1] - ratio * began.offset
    rows = tuple(
        (
            name.replace("/", ", "),
            f"{1e6 * replayed.scale[-1, i]:.5f}",
            f"{replayed.offset[-1, i]:.4f}",
            f"{100 * (ratio[i] - 1):+.2f} %",
            f"{shift[i]:+.3f}",
        )
        for i, name in enumerate(log.layout.channel_names)
    )
    columns = ("cell", "scale (1e-6 N/count)", "offset (N)", "scale changed by", "zero changed by (N)")
    return Table("parameters", "The map at the end of the log", columns, rows, f"Changes against {start}.")


def _score_table(log: Log, replayed: Replayed, start: str, settle: float) -> Table:
    assert log.truth is not None
    rows = []
    for name, force in (
        ("calibrated", replayed.force),
        (f"by the {start} map", starting_map(log, start).force(log.raw)),
    ):
        score = score_forces(
            force,
            log.truth.force,
            layout=log.layout,
            position_sole=log.truth.position_sole,
            R_world_sole=log.truth.R_world_sole,
            time=log.time,
            settle=settle,
        )
        rows.append((name, number(1e3 * score.cop), number(score.vgrf), number(score.cell)))
    columns = ("rmse against the truth in the log", "CoP (mm)", "vGRF (N)", "single cell (N)")
    return Table("score", f"Errors from {settle:g} s on", columns, tuple(rows))
