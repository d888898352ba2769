"""Calibrate one six-axis sensor from a log of in-situ sets, and write the result."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.calibration.in_situ import InSituFit
from surefoot.calibration.results import CalibrationRefused, FitResult
from surefoot.experiments.force_torque.config import InSituConfig
from surefoot.experiments.force_torque.export import write_json, write_ros2_parameters, write_yaml
from surefoot.experiments.force_torque.icub import write_icub_matrix
from surefoot.experiments.force_torque.log import InSituLog, read_in_situ_log
from surefoot.experiments.force_torque.page import write_in_situ_page
from surefoot.experiments.force_torque.tables import Calibrated, make_tables
from surefoot.experiments.study.progress import working
from surefoot.experiments.study.tables import Table

SAMPLE = Path(__file__).resolve().parent / "samples" / "in_situ_leg.parquet"
"""A simulated log that ships with the package: the iCub's leg with eight added masses."""


@dataclass(frozen=True, eq=False)
class CalibratedSensor:
    """Where the result of a calibration lies."""

    fit: InSituFit
    files: dict[str, Path]  # by their kind: "calibration" (JSON), "yaml", "ros2", "report", "icub"
    tables: tuple[Table, ...]  # to show at once
    notices: tuple[str, ...]  # warnings of the fit and gaps of the log


def calibrate_in_situ_log(
    paths: Path | Sequence[Path],
    config: InSituConfig | Path | None = None,
    *,
    folder: Path,
    accept: str = "",
    stem: str | None = None,
    topics: Path | None = None,
) -> CalibratedSensor:
    """Read a log with all sets, or several with one each, fit matrix, offsets and limb, and write the result.

    ``config`` are settings that the tables leave open, by default the TOML file beside the first one;
    ``topics`` the mapping file of ROS bags, by default the one beside each. Names in the folder begin with
    ``stem``, by default the first log's name. ``accept`` is why to go on past the fit's refusals, which each
    file has beside this reason; empty for not.

    LogError if the log cannot be used, with the cure; CalibrationRefused if the log does not determine the
    calibration, and nothing is written.
    """
    paths = [paths] if isinstance(paths, Path) else list(paths)
    stem = paths[0].stem if stem is None else stem
    with working("reading the log") as then:
        log = read_in_situ_log(paths, config, topics)
        then(f"fitting {len(log.fitted)} sets")
        fit = _fit(log, accept)
        notices = list(log.notices)
        if accept and not fit.accepted:
            notices.append("Nothing was refused, so that no reason was needed to go on.")
        then("writing the calibration")
        files = _write(log, fit, folder / f"{stem}.in_situ", notices)
        then("drawing the report")
        found = Calibrated(dataclasses.replace(log, notices=tuple(notices)), fit)
        files["report"] = write_in_situ_page(folder / f"{stem}.in_situ.html", found)
    return CalibratedSensor(fit, files, make_tables(found), found.notices)


def _fit(log: InSituLog, accept: str) -> InSituFit:
    fit = log.fit(accept)
    if fit.result is FitResult.REFUSED:
        first, *others = fit.refusals
        more = "".join(f" Also: {other}" for other in others)
        if not accept:
            more += " If you know better: --accept REASON goes on, and every file says so."
        raise CalibrationRefused(f"{', '.join(log.files)}: {first.reason}", f"{first.cure}{more}")
    return fit


def _write(log: InSituLog, fit: InSituFit, stem: Path, notices: list[str]) -> dict[str, Path]:
    def at(ending: str) -> Path:
        return stem.with_name(f"{stem.name}.{ending}")

    files: dict[str, Path] = {}
    sensor, temperature = log.config.sensor, log.fitted[-1].temperature
    if log.config.units.raw == "N":
        notices.append(
            "No matrix in the iCub's format was written: it is to be multiplied with the driver's, which the "
            "log does not hold."
        )
    elif sensor.full_scale is None:
        notices.append("No matrix in the iCub's format was written; one needs sensor.full_scale.")
    elif fit.accepted:
        notices.append(
            "No matrix in the iCub's format was written: it has no room for what was refused and why it was "
            "accepted. write_icub_matrix in surefoot.experiments.force_torque.icub writes one all the same."
        )
    else:
        try:
            files["icub"] = write_icub_matrix(fit.matrix, sensor.full_scale, at("icub.txt"))
        except ValueError as error:
            notices.append(f"No matrix in the iCub's format was written. {error}")
    facts: dict[str, Any] = {"channels": log.channels, "sensor": sensor.name, "notices": tuple(notices)}
    facts["raw_unit"] = log.config.units.of_raw
    files["calibration"] = write_json(fit, at("json"), **facts)
    files["yaml"] = write_yaml(fit, at("yaml"), **facts)
    measured = [] if temperature is None else temperature[np.isfinite(temperature)].tolist()
    last = measured[-1] if measured else None
    files["ros2"] = write_ros2_parameters(fit, at("ros2.yaml"), temperature=last)
    return files
