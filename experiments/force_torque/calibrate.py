"""Calibrate one six-axis sensor from a log of in-situ sets, and write what came of it."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from surefoot.calibration.in_situ import InSituFit, KnownLimb, calibrate_in_situ
from surefoot.calibration.results import CalibrationRefused
from surefoot.experiments.force_torque.export import write_json, write_ros2_parameters, write_yaml
from surefoot.experiments.force_torque.icub import write_icub_matrix
from surefoot.experiments.force_torque.log import InSituConfig, InSituLog, read_in_situ_log
from surefoot.experiments.force_torque.page import InSituPage
from surefoot.experiments.force_torque.tables import Calibrated
from surefoot.experiments.study.tables import Table

__all__ = ["SAMPLE", "CalibratedSensor", "calibrate_in_situ_log"]

SAMPLE = Path(__file__).resolve().parent / "samples" / "in_situ_leg.parquet"
"""A simulated log that ships with the package: the iCub's leg with eight added masses."""

ALIKE = 0.01
"""Share by which the limb's fitted mass may differ from the known one without a word."""


@dataclass(frozen=True, eq=False)
class CalibratedSensor:
    """Where the result of a calibration lies.

    Attributes:
        fit: The calibration.
        files: What was written, by what it is: ``"calibration"`` (JSON), ``"yaml"``, ``"ros2"``, ``"report"``
            and, where full scales are known, ``"icub"``.
        tables: What to show at once.
        notices: Warnings of the fit and what the log lacks, in plain words.
    """

    fit: InSituFit
    files: dict[str, Path]
    tables: tuple[Table, ...]
    notices: tuple[str, ...]


def calibrate_in_situ_log(
    paths: Path | Sequence[Path],
    config: InSituConfig | Path | None = None,
    *,
    folder: Path,
    stem: str | None = None,
    console: Console | None = None,
) -> CalibratedSensor:
    """Read a log, fit matrix, offsets and limb, and write the result.

    Args:
        paths: One log with all sets, or several with one each.
        config: What the tables do not say; by default the TOML file beside the first one.
        folder: Where the files go.
        stem: How their names begin; by default the first log's name.
        console: Where progress is shown; nowhere by default.

    Raises:
        LogError: If the log cannot be used; it says why and what to do.
        CalibrationRefused: If the log cannot tell what was asked, with all reasons; nothing is written.
    """
    paths = [paths] if isinstance(paths, Path) else list(paths)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console or Console(quiet=True), transient=True) as progress:
        task = progress.add_task("reading the log", total=4)
        log = read_in_situ_log(paths, config)
        progress.update(task, advance=1, description=f"fitting {len(log.fitted)} sets")
        fit = _fit(log)
        log = _with_notices(log, fit)
        progress.update(task, advance=1, description="writing the calibration")
        stem = paths[0].stem if stem is None else stem
        files, log = _write(log, fit, folder, stem)
        progress.update(task, advance=1, description="drawing the report")
        page = InSituPage(Calibrated(log, fit))
        files["report"] = page.write(folder / f"{stem}.in_situ.html")
        progress.update(task, advance=1, description="done")
    return CalibratedSensor(fit, files, page.shown_tables(), (*fit.warnings, *log.notices))


def _fit(log: InSituLog) -> InSituFit:
    known = log.config.limb_mass
    std = log.config.limb_mass_std
    limb = None if known is None or std is None else KnownLimb(known, std)
    fit = calibrate_in_situ(
        log.fitted,
        factory_matrix=log.config.factory_matrix,
        limb=limb,
        options=log.config.options,
        refuse=False,
    )
    if fit.refusals:
        first, *others = fit.refusals
        more = "".join(f" Also: {other}" for other in others)
        raise CalibrationRefused(f"{', '.join(log.files)}: {first.reason}", f"{first.cure}{more}")
    return fit


def _with_notices(log: InSituLog, fit: InSituFit) -> InSituLog:
    """Say where the limb's fitted mass is not the known one."""
    known = log.config.limb_mass
    if known is None:
        return log
    off = fit.limb.mass / known - 1.0
    if abs(off) < max(ALIKE, 3.0 * fit.limb_mass_std / known):
        return log
    told = (
        f"The limb comes out at {fit.limb.mass:.4g} kg and weighs {known:.4g} kg ({100 * off:+.1f} %): so "
        "far may all forces be off. See that the added masses, and limb.mass_kg, are what hung beyond the "
        "sensor."
    )
    return dataclasses.replace(log, notices=(told, *log.notices))


def _write(log: InSituLog, fit: InSituFit, folder: Path, stem: str) -> tuple[dict[str, Path], InSituLog]:
    config = log.config
    files: dict[str, Path] = {}
    if config.full_scale is not None:
        try:
            files["icub"] = write_icub_matrix(
                fit.matrix, config.full_scale, folder / f"{stem}.in_situ.icub.txt"
            )
        except ValueError as error:
            said = f"No matrix in the iCub's format was written. {error}"
            log = dataclasses.replace(log, notices=(*log.notices, said))
    facts = {"channels": log.channels, "sensor": config.sensor, "notices": log.notices}
    files["calibration"] = write_json(fit, folder / f"{stem}.in_situ.json", **facts)
    files["yaml"] = write_yaml(fit, folder / f"{stem}.in_situ.yaml", **facts)
    files["ros2"] = write_ros2_parameters(
        fit, folder / f"{stem}.in_situ.ros2.yaml", temperature=_last_temperature(log)
    )
    return files, log


def _last_temperature(log: InSituLog) -> float | None:
    last = log.fitted[-1].temperature
    return None if last is None else float(last[-1])
