"""Logs of in-situ calibration: a sensor's counts and an accelerometer's readings, set by set.

A log is a table with one row a sample, as Parquet or CSV, with a column that names the sets; or one such file
a set. What the table leaves open (other names, units, the added masses, frames) stands in a small
TOML file beside it. ``docs/in-situ-log.md`` lists all columns and keys.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY
from surefoot.calibration.imu import AccelerometerModel, calibrate_accelerometer, gravity_from_imu
from surefoot.calibration.in_situ import InSituSet
from surefoot.calibration.results import CalibrationRefused
from surefoot.experiments.force_torque.checks import check_channels, check_times, check_values, contiguous
from surefoot.experiments.force_torque.config import AddedMass, InSituConfig, read_config
from surefoot.experiments.force_torque.signs import check_acceleration, check_against_factory, check_spin
from surefoot.experiments.force_torque.table import Samples, read_samples
from surefoot.experiments.logs.table import LogError

__all__ = ["InSituConfig", "InSituLog", "config_beside", "read_config", "read_in_situ_log"]

SMOOTHED = 0.3
"""Time in s over which the gyroscope's rate of change is taken, if that is rows enough."""

_FEWEST_ROWS = 7

_ALIKE_KG = 1e-6
_ALIKE_M = 1e-6


@dataclass(frozen=True, eq=False)
class InSituLog:
    """What was read, ready to be fitted.

    Attributes:
        sets: One for each added mass.
        channels: Names of the raw columns.
        config: What the TOML file and the command line gave.
        files: Names of the files.
        notices: What the log lacks and the fit can do without.
    """

    sets: tuple[InSituSet, ...]
    channels: tuple[str, ...]
    config: InSituConfig
    files: tuple[str, ...]
    notices: tuple[str, ...]

    @property
    def fitted(self) -> tuple[InSituSet, ...]:
        """The sets that make the fit, without those that are kept aside."""
        chosen = self.config.fit_sets
        return self.sets if chosen is None else tuple(one for one in self.sets if one.name in chosen)


def config_beside(log: Path) -> InSituConfig:
    """Read the TOML file of the log's name beside it; defaults if there is none."""
    beside = log.with_suffix(".toml")
    return read_config(beside) if beside.is_file() else InSituConfig()


def read_in_situ_log(paths: Path | Sequence[Path], config: InSituConfig | Path | None = None) -> InSituLog:
    """Read a log with all sets, or several with one set each, that does not mislead the fit.

    Args:
        paths: One ``.csv`` or ``.parquet`` file, or several; a file without a column of sets is one set that
            has the file's name without its ending.
        config: What the tables leave open, or the TOML file with it; by default the one beside the first
            file.

    Raises:
        LogError: If a file, a column, a value or a mass is not as it must be. The message names the file, the
            column, what was found and the cure.
    """
    paths = [paths] if isinstance(paths, Path) else list(paths)
    if not paths:
        raise LogError("No log was given; name a .csv or .parquet file.")
    if config is None:
        config = config_beside(paths[0])
    elif isinstance(config, Path):
        config = read_config(config)
    parts = [samples for path in paths for samples in read_samples(path, config)]
    _check_names(parts, config)
    notices: list[str] = []
    added = [_added_mass(samples, config, notices) for samples in parts]
    sound = []
    for part in parts:
        samples = check_channels(
            check_times(check_values(part, notices), notices), config.range_count, notices
        )
        check_acceleration(samples)
        check_spin(samples)
        sound.append(samples)
    if config.accelerometer_model is not None:
        sound = _calibrated(sound, config.accelerometer_model, notices)
    found = [_to_set(samples, config, mass, notices) for samples, mass in zip(sound, added, strict=True)]
    sets = [one for one, _ in found]
    check_against_factory([(used, one.gravity) for one, used in found], config.factory_matrix, notices)
    return InSituLog(
        sets=tuple(sets),
        channels=parts[0].channels,
        config=config,
        files=tuple(path.name for path in paths),
        notices=tuple(notices),
    )


def _check_names(parts: list[Samples], config: InSituConfig) -> None:
    """Raise LogError if two files hold one set, have other channels, or log and TOML differ in sets."""
    first: dict[str, Samples] = {}
    for samples in parts:
        if samples.name in first:
            raise LogError(
                f"{samples.file}: holds set '{samples.name}', and so does {first[samples.name].file}; name "
                "each set once."
            )
        first[samples.name] = samples
        if samples.channels != parts[0].channels:
            raise LogError(
                f"{samples.file}: has the channels {', '.join(samples.channels)} where {parts[0].file} has "
                f"{', '.join(parts[0].channels)}; name the same channels in every file."
            )
    there = ", ".join(f"'{name}'" for name in first)
    for name in config.fit_sets or ():
        if name not in first:
            raise LogError(
                f"{config.file}: 'fit.sets' names set '{name}', which is not in the log; there are {there}."
            )
    if config.sets is None:
        return
    for name in config.sets:
        if name not in first:
            raise LogError(
                f"{config.file}: set '{name}' is not in the log; there are {there}. Correct its name, or "
                "take it out."
            )
    for name, samples in first.items():
        if name not in config.sets and samples.added_mass is None:
            listed = ", ".join(f"'{known}'" for known in config.sets)
            raise LogError(
                f"{samples.file}: set '{name}' is not among those of {config.file} ({listed}); say there "
                "what was added, or added_mass_kg = 0."
            )


def _added_mass(samples: Samples, config: InSituConfig, notices: list[str]) -> AddedMass:
    """Return the added mass of columns or TOML; raise LogError if the two, or two rows, disagree."""
    listed = None if config.sets is None else config.sets.get(samples.name)
    if samples.added_mass is None:
        if listed is None:
            notices.append(
                f"{samples.file}: nothing tells what was added in set '{samples.name}'; it counts as the "
                "bare limb. Give added_mass_kg and added_com_m under [[sets]], or as columns."
            )
        return listed or AddedMass()
    at = f"{samples.file}: column '{samples.columns.added_mass}'"
    mass = _constant(samples.added_mass, _ALIKE_KG)
    if mass is None:
        values = samples.added_mass
        raise LogError(
            f"{at} goes from {np.nanmin(values):g} to {np.nanmax(values):g} kg within set '{samples.name}'; "
            "give one mass for each set, and another set for another mass."
        )
    if mass < 0.0:
        raise LogError(
            f"{at} is {mass:g} in set '{samples.name}'; a mass is at least 0 (take the limb without its part "
            "as the bare one)."
        )
    com = (0.0, 0.0, 0.0)
    if samples.added_com is not None:
        place = [_constant(column, _ALIKE_M) for column in samples.added_com.T]
        if any(value is None for value in place):
            raise LogError(
                f"{samples.file}: columns 'added_com' change within set '{samples.name}'; give one place for "
                "each set, and another set for another place."
            )
        com = (float(place[0] or 0.0), float(place[1] or 0.0), float(place[2] or 0.0))
    elif mass > 0.0 and listed is None:
        raise LogError(
            f"{at} is {mass:g} in set '{samples.name}' and its place is missing; give added_com_x_m, "
            "added_com_y_m, added_com_z_m, or added_com_m under [[sets]]."
        )
    if listed is None:
        return AddedMass(mass, com)
    if abs(listed.mass - mass) > _ALIKE_KG:
        raise LogError(
            f"{at} is {mass:g} kg in set '{samples.name}', and {config.file} says {listed.mass:g} kg; "
            "correct one of them."
        )
    if samples.added_com is not None and np.abs(np.subtract(listed.com, com)).max() > _ALIKE_M:
        raise LogError(
            f"{samples.file}: columns 'added_com' say {list(com)} m in set '{samples.name}', and "
            f"{config.file} says {list(listed.com)} m; correct one of them."
        )
    return listed


def _calibrated(parts: list[Samples], model: AccelerometerModel, notices: list[str]) -> list[Samples]:
    """Return samples with an accelerometer that is corrected by the size of gravity in all sets."""
    try:
        fit = calibrate_accelerometer(
            np.concatenate([samples.acceleration for samples in parts]), gravity=GRAVITY, model=model
        )
    except CalibrationRefused as refusal:
        raise LogError(
            f"{parts[0].file}: the accelerometer cannot be calibrated from this log. {refusal} Or take "
            "accelerometer.calibrate out of the TOML file."
        ) from None
    bias = ", ".join(f"{value:.3g}" for value in fit.bias)
    notices.append(
        f"{parts[0].file}: the accelerometer was calibrated from the log itself ({model}): its bias was "
        f"({bias}) m/s^2."
    )
    return [replace(samples, acceleration=fit.correct(samples.acceleration)) for samples in parts]


def _constant(values: NDArray[np.float64], alike: float) -> float | None:
    """Return the one value of a column; ``None`` if it has several, or none in some row."""
    if np.isnan(values).any() or np.ptp(values) > alike:
        return None
    return float(values[0])


def _to_set(
    samples: Samples, config: InSituConfig, added: AddedMass, notices: list[str]
) -> tuple[InSituSet, Samples]:
    """Return a set with gravity in the sensor's frame and at its origin, and the samples behind it."""
    R = config.R_sensor_accelerometer
    up = -samples.acceleration if samples.points_down else samples.acceleration
    spin = rate = None
    if samples.angular_velocity is None:
        gravity = -up @ R.T
    else:
        if samples.time is None:
            raise LogError(
                f"{samples.file}: a gyroscope without a column of time; name it under columns.time, as "
                "angular acceleration is its rate of change."
            )
        gravity = np.full((len(up), 3), np.nan)
        spin, rate = gravity.copy(), gravity.copy()
        dt = float(np.median(np.diff(samples.time)))
        window = max(_FEWEST_ROWS, 2 * round(0.5 * SMOOTHED / dt) + 1)
        for part in contiguous(samples.time):
            if part.stop - part.start < window:
                continue
            gravity[part], spin[part], rate[part] = gravity_from_imu(
                up[part],
                samples.angular_velocity[part],
                dt=dt,
                position_imu=np.asarray(config.position_imu),
                R_sensor_imu=R,
                window=window,
            )
        known = np.asarray(np.isfinite(gravity).all(axis=1))
        if not known.all():
            notices.append(
                f"{samples.file}: {(~known).sum()} rows of set '{samples.name}' stand between gaps too close "
                "together for an angular acceleration; the fit does without them."
            )
            samples, gravity, spin, rate = samples.take(known), gravity[known], spin[known], rate[known]
    found = InSituSet(
        raw=samples.raw,
        gravity=gravity,
        added_mass=added.mass,
        added_com=added.com,
        angular_velocity=spin,
        angular_acceleration=rate,
        temperature=samples.temperature,
        time=samples.time,
        name=samples.name,
    )
    return found, samples
