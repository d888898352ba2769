"""Calibrate one log with one method, and write a table, the final parameters and an HTML report."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

import surefoot
from surefoot.arrays import take_rows
from surefoot.calibration import Estimate, Parameters
from surefoot.calibration.results import Finding
from surefoot.calibration.setup import method_name
from surefoot.experiments.logs.checks import pass_or_refuse
from surefoot.experiments.logs.clock import find_gaps
from surefoot.experiments.logs.columns import channel_slugs
from surefoot.experiments.logs.format import Log
from surefoot.experiments.logs.table import LogError
from surefoot.experiments.study.progress import each, working
from surefoot.experiments.study.tables import Table, flat
from surefoot.experiments.walking.agreement import compare_with_start
from surefoot.experiments.walking.judge import judge_log
from surefoot.experiments.walking.lateness import PUNCTUAL, Lateness, make_punctual
from surefoot.experiments.walking.notices import check_weight, log_notices, result_notices
from surefoot.experiments.walking.page import write_walking_page
from surefoot.experiments.walking.ros2 import parameters_of_log, write_node_parameters
from surefoot.experiments.walking.tables import Facts, nis_per_row, parameter_table, terminal_tables
from surefoot.experiments.walks.replay import (
    foot_length_of,
    replay_log,
    standing_weights,
    starting_map,
    with_map,
)
from surefoot.files import atomic_path, write_text
from surefoot.names import plain_name

WRITTEN = 1 << 12  # rows of the result per block of the Parquet file, a few megabytes


@dataclass(frozen=True)
class CalibratedLog:
    """Files, tables and notices of a calibration result."""

    walk: Path  # Parquet table with forces, CoP, parameters and flags of every sample
    parameters: Path  # JSON file with the final map and its uncertainty, as in a log's description
    page: Path  # HTML report
    tables: tuple[Table, ...]  # for the terminal
    notices: tuple[str, ...]  # about the log and the result
    ros2: Path | None = None  # parameters of a ROS 2 node, if requested

    @property
    def files(self) -> dict[str, Path]:
        """Written files by kind."""
        files = {"calibrated walk": self.walk, "parameters": self.parameters, "report": self.page}
        return files if self.ros2 is None else {**files, "ROS 2": self.ros2}


def calibrate_log(
    log: Log,
    method: str,
    start: str | None = None,
    *,
    folder: Path,
    stem: str,
    file: str,
    settle: float = 0.0,
    zero_phase: bool = False,
    stand: float = 0.0,
    ros2: bool = False,
    accept: str = "",
) -> CalibratedLog:
    """Calibrate a log with one method, and write result files whose names begin with ``stem`` to ``folder``.

    ``start`` is the name of a map or a JSON file with one. Errors are computed after the first ``settle`` s.
    ``zero_phase`` filters forwards and backwards in time. The first ``stand`` s determine the window's
    weights. ``ros2`` also writes parameters of a ROS 2 node. Messages call the log ``file``. ``accept`` is
    the reason to continue although a check refuses the log, and is stored in every file.
    Raises LogError if the map does not exist, the foot forces cannot be in newtons or an option does not fit
    the log, CalibrationRefused if the log contradicts itself, and ValueError if the method is unknown or no
    samples are left to score.
    """
    method, about = method_name(method), log.about
    plain = plain_name(method)  # for file names, in which some systems forbid ':'
    start = str(about.get("start", "nominal")) if start is None else start
    if start.endswith(".json"):
        log, start = with_map(log, Path(start)), "calibrated"
    initial = starting_map(log, start)
    if ros2 and "curves" in log.about:
        raise LogError(f"{file}: a ROS 2 node takes no curves, and the map to start from has some.")
    if stand and method != "window":
        raise ValueError(
            f"A quiet stand tells the weights of the window alone, not of '{method}'; leave out --stand."
        )
    options = foot_length_of(log, file)
    if zero_phase and find_gaps(np.diff(log.time)).any():
        raise LogError(
            f"{file}: --zero-phase filters across gaps in time, which this log has; leave it "
            "out, or cut the log there."
        )
    check_weight(log, start, initial, file)
    alone = bool(log.about.get("feet_alone"))
    findings, late = ((), PUNCTUAL) if alone else _judge(log, initial)
    notices = (*_pass_or_refuse(findings, accept, file), *log_notices(log, file))
    log = make_punctual(log, late.seconds)
    watch = partial(each, "calibrating")
    weights = standing_weights(log, initial, stand) if stand else {}
    estimate = replay_log(log, method, initial, zero_phase=zero_phase, watch=watch, **options, **weights)
    worse = [] if alone else compare_with_start(log, initial, estimate, findings)
    notices += _pass_or_refuse(worse, accept, file)
    notices += result_notices(log, method, initial, estimate, file)
    node: dict[str, Any] = {}
    if ros2:
        node, lacking = parameters_of_log(log, Parameters(estimate.scale[-1], estimate.offset[-1]), **options)
        if lacking:
            notices += (f"The ROS 2 parameters are the map alone, which starts no node: {lacking}",)
    facts = Facts(log, start, initial, estimate, settle, method, file, notices)
    return _write_results(facts, node if ros2 else None, folder, f"{stem}.{plain}")


def _write_results(facts: Facts, node: dict[str, Any] | None, folder: Path, stem: str) -> CalibratedLog:
    """Write all files of a result. ``node`` contains the parameters of a ROS 2 node, if requested."""
    tables = (parameter_table(facts), *terminal_tables(facts))
    walk, parameters, page = (folder / f"{stem}.{end}" for end in ("parquet", "json", "html"))
    with atomic_path(walk) as part:
        _write_walk(part, facts)
    write_text(parameters, json.dumps(_last(facts), indent=1))
    with working("drawing the report"):
        write_walking_page(page, facts)
    written = None if node is None else _write_ros2(facts, node, folder / f"{stem}.ros2.yaml")
    return CalibratedLog(walk, parameters, page, tables, facts.notices, written)


def _judge(log: Log, initial: Parameters) -> tuple[tuple[Finding, ...], Lateness]:
    with working("judging the log"):
        judged = judge_log(log, initial)
    return judged.findings, judged.lateness


def _pass_or_refuse(findings: Sequence[Finding], accept: str, file: str) -> tuple[str, ...]:
    """Return findings as notices, or raise CalibrationRefused if one of them refuses the log."""
    passed, weaker = pass_or_refuse(findings, accept, file, "every file")
    return passed + weaker


def _write_walk(path: Path, facts: Facts) -> None:
    """Write the table of all samples in blocks of rows, to limit memory use."""
    blocks = (slice(first, first + WRITTEN) for first in range(0, len(facts.log), WRITTEN))
    parts = (
        replace(facts, log=facts.log.cut(rows), estimate=take_rows(facts.estimate, rows)) for rows in blocks
    )
    tables = (pa.table(_walk_columns(part)) for part in parts)
    first = next(tables)
    with pq.ParquetWriter(path, first.schema) as writer:
        for table in chain((first,), tables):
            writer.write_table(table)


def _walk_columns(facts: Facts) -> dict[str, NDArray[Any]]:
    log, estimate = facts.log, facts.estimate
    columns: dict[str, NDArray[Any]] = {"time_s": log.time}
    torques = [name.rpartition("/")[2] in ("tx", "ty", "tz") for name in log.layout.channel_names]
    spread = standard_deviations(estimate, facts.initial)

    def add(parts: dict[str, NDArray[Any] | None]) -> None:
        """Add one column per channel and format string. Field 0 is the channel, field 1 its unit."""
        for i, (name, torque) in enumerate(zip(channel_slugs(log.layout), torques, strict=True)):
            for form, values in parts.items():
                if values is not None:
                    columns[form.format(name, "Nm" if torque else "N")] = values[:, i]

    add({"force_{0}_{1}": estimate.force, "force_{0}_std_{1}": estimate.force_std})
    # Without the robot's motion, the relative position of the feet is unknown, and so is their common CoP.
    for i, axis in enumerate("" if facts.feet_alone else "xy"):
        columns[f"cop_level_{axis}_m"] = estimate.cop[:, i]
        if estimate.cop_covariance is not None:
            columns[f"cop_level_{axis}_std_m"] = np.sqrt(estimate.cop_covariance[:, i, i])
    if not facts.feet_alone:
        columns["cop_level_valid"] = estimate.cop_valid
    columns["vgrf_N"] = estimate.vgrf.sum(axis=1)
    for f, foot in enumerate(log.layout.feet):
        columns[f"vgrf_{foot.name}_N"] = estimate.vgrf[:, f]
        for i, axis in enumerate("xy"):
            columns[f"cop_{foot.name}_sole_{axis}_m"] = estimate.cop_foot[:, f, i]
        columns[f"cop_{foot.name}_sole_valid"] = estimate.cop_foot_valid[:, f]
    add(
        {
            "scale_{0}_{1}_per_count": estimate.scale,
            "offset_{0}_{1}": estimate.offset,
            "scale_{0}_std_{1}_per_count": spread and spread.scale,
            "offset_{0}_std_{1}": spread and spread.offset,
            "flags_{0}": estimate.flags,
        }
    )
    if estimate.nis is not None:
        columns["nis"], columns["nis_rows"] = estimate.nis, np.asarray(estimate.nis_rows)
    return {name: np.ascontiguousarray(values) for name, values in columns.items()}


def standard_deviations(estimate: Estimate, initial: Parameters) -> Parameters | None:
    """Return standard deviations of scales in N per count and offsets in N, shape (N, K) each.

    With the starting map (c0, d0), the calibrated map is c = a c0, d = a d0 + b. The estimate contains the
    covariance of (a, b). The result is ``None`` if the method does not report a covariance.
    """
    if estimate.covariance is None:
        return None
    covariance = estimate.covariance
    K = covariance.shape[-1] // 2
    a = np.arange(K)
    b = a + K
    scale, offset = np.asarray(initial.scale), np.asarray(initial.offset)
    aa, ab, bb = covariance[:, a, a], covariance[:, a, b], covariance[:, b, b]
    variance = offset**2 * aa + 2.0 * offset * ab + bb
    return Parameters(np.abs(scale) * np.sqrt(aa), np.sqrt(np.maximum(variance, 0.0)))


def _last(facts: Facts) -> dict[str, Any]:
    log, estimate = facts.log, facts.estimate
    spread = standard_deviations(estimate, facts.initial)
    last: dict[str, Any] = {
        "method": facts.method,
        "start": facts.start,
        "time_s": float(log.time[-1]),
        "channels": list(log.layout.channel_names),
        "scale_N_per_count": estimate.scale[-1].tolist(),
        "offset_N": estimate.offset[-1].tolist(),
        **({"curves": log.about["curves"]} if "curves" in log.about else {}),
        "scale_std_N_per_count": None if spread is None else spread.scale[-1].tolist(),
        "offset_std_N": None if spread is None else spread.offset[-1].tolist(),
        "nis_per_row": nis_per_row(estimate),
        "covariance_relative": None if estimate.covariance is None else estimate.covariance[-1].tolist(),
        "notices": list(facts.notices),
    }
    return last


def _write_ros2(facts: Facts, node: dict[str, Any], path: Path) -> Path:
    """Write the final map and the other required parameters of the ROS 2 node ``surefoot``."""
    last = _last(facts)
    names = ("channels", "scale_N_per_count", "offset_N", "scale_std_N_per_count", "offset_std_N")
    # A ROS 2 parameter is a number, a string or a boolean, or a list of one of these types.
    parameters = {name: last[name] for name in names if last[name] is not None}
    parameters |= {"method": facts.method, "mass_kg": float(facts.log.mass)} | node
    comment = (
        f"Made with surefoot {surefoot.__version__} from {flat(facts.file)}: force = scale count + offset."
    )
    return write_node_parameters(path, parameters, comment)
