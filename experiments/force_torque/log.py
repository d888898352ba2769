"""Logs of in-situ calibration, set by set: docs/in-situ-log.md lists columns and keys of its TOML file."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY
from surefoot.calibration.imu import AccelerometerModel, calibrate_accelerometer, gravity_from_imu
from surefoot.calibration.in_situ import InSituFit, InSituSet, KnownLimb, calibrate_in_situ, limits
from surefoot.calibration.in_situ.report import refuse_fit
from surefoot.calibration.results import CalibrationRefused, Finding, FitResult, decide
from surefoot.experiments.force_torque.checks import FEWEST, check_samples, contiguous
from surefoot.experiments.force_torque.config import (
    Accelerometer,
    AddedMass,
    InSituConfig,
    config_beside,
    read_config,
)
from surefoot.experiments.force_torque.table import Samples, read_samples
from surefoot.experiments.logs.table import LogError

SMOOTHED = 0.3  # time in s over which the gyroscope's rate of change is taken, if that is rows enough

_FORCES = {"kgf": 9.80665, "lbf": 4.44822, "kN": 1e3}  # in N
_NOTICED = 0.01  # share by which the limb may come out from its given mass without a notice

_FEWEST_ROWS = 7

_ALIKE = 1e-6  # in kg or m


@dataclass(frozen=True, eq=False)
class InSituLog:
    """A log that was read, ready for the fit."""

    sets: tuple[InSituSet, ...]  # one for each added mass
    channels: tuple[str, ...]  # names of the raw columns
    config: InSituConfig  # of the TOML file and the command line
    files: tuple[str, ...]
    notices: tuple[str, ...]  # gaps of the log that the fit can do without

    @property
    def fitted(self) -> tuple[InSituSet, ...]:
        """The sets that make the fit, without those that are kept aside."""
        chosen = self.config.fit.sets
        return self.sets if chosen is None else tuple(one for one in self.sets if one.name in chosen)

    def fit(self, accept: str = "") -> InSituFit:
        """Fit these sets, refusals in the result; LogError if there is no matrix to keep."""
        config = self.config
        if config.fit.keep_matrix and config.factory.matrix is None:
            raise LogError(
                f"{', '.join(self.files)}: 'fit.keep_matrix' keeps the maker's matrix, and 'factory' names "
                "none; name it there, or leave out 'keep_matrix' (or --keep-matrix)."
            )
        mass, std = config.limb.mass_kg, config.limb.mass_std_kg
        fit = calibrate_in_situ(
            self.fitted,
            factory_matrix=config.factory.matrix,
            limb=None if mass is None or std is None else KnownLimb(mass, std),
            matrix="keep" if config.fit.keep_matrix else "update",
            options=config.fit.options(config.sensor),
            refuse=False,
            accept=accept,
        )
        decision = decide(_check_weight(fit, mass), accept)
        if decision.refused:
            return refuse_fit(self.fitted, decision.refused)
        if decision.passed:
            fit = replace(fit, result=FitResult.ACCEPTED, accepted=accept)
        return replace(
            fit,
            refusals=(*fit.refusals, *decision.passed),
            warnings=(*fit.warnings, *decision.warnings),
        )


def _check_weight(fit: InSituFit, known: float | None) -> list[Finding]:
    """Return a finding if the limb's fitted mass is not the known one in kg."""
    if known is None or fit.result is FitResult.REFUSED:
        return []
    off = fit.limb.mass / known - 1.0
    if abs(off) < max(_NOTICED, 3.0 * fit.limb_mass_std / known):
        return []
    reason = (
        f"The limb comes out at {fit.limb.mass:.4g} kg, and limb.mass_kg is {known:.4g} kg ({100 * off:+.1f} "
        "%): all forces may be off by as much."
    )
    apart = abs(float(np.log(fit.limb.mass / known))) if fit.limb.mass > 0.0 else np.inf
    for unit, newtons in _FORCES.items():
        if abs(known / newtons - fit.limb.mass) < limits.MASS * abs(fit.limb.mass):
            reason += f" Forces in {unit} that are read as N are off by this factor."
    cure = (
        "Check the units of forces, and that limb.mass_kg and the added masses are what hung on the sensor."
    )
    refuses = apart > limits.FACTORY_APART
    return [Finding("limb", reason, cure, apart, limits.FACTORY_APART, refuses)]


def read_in_situ_log(
    paths: Path | Sequence[Path], config: InSituConfig | Path | None = None, topics: Path | None = None
) -> InSituLog:
    """Read a log with all sets, or several with one set each, that does not mislead the fit.

    Tables or ROS bags; a file without a column of sets is one set that has the file's name without its
    ending. Settings that the tables leave open are those of ``config``, by default the TOML file beside the
    first file; ``topics`` is the mapping file of bags, by default the one beside each. LogError names the
    file, the column, the value and the cure.
    """
    paths = [paths] if isinstance(paths, Path) else list(paths)
    if not paths:
        raise LogError("No log was given; name a .csv or .parquet file.")
    if config is None:
        config = config_beside(paths[0])
    elif isinstance(config, Path):
        config = read_config(config)
    notices: list[str] = []
    parts = [samples for path in paths for samples in read_samples(path, config, notices, topics)]
    _check_names(parts, config)
    added = [_read_added_mass(samples, config, notices) for samples in parts]
    sound = [check_samples(samples, config.sensor.range_count, notices) for samples in parts]
    if config.accelerometer.calibrate is not None:
        sound = _calibrate(sound, config.accelerometer.calibrate, notices)
    sets = tuple(
        _to_set(samples, config.accelerometer, mass, notices)
        for samples, mass in zip(sound, added, strict=True)
    )
    file, channels, matrix = parts[0].file, parts[0].channels, config.factory.matrix
    if matrix is None:
        moves = any(one.moves for one in sets)
        signs = "" if moves else " The signs of the torques are those of the places as given."
        notices.append(
            f"{file}: there is no factory matrix to check the accelerometer's sign with, and a wrong one "
            "would turn the calibrated wrench round; see that a limb that hangs pulls along gravity."
            f"{signs}"
        )
    elif matrix.shape[1] != len(channels):
        raise LogError(
            f"{file}: has {len(channels)} channels and the factory matrix {matrix.shape[1]} columns; name "
            "the channels under columns.raw in the matrix's order."
        )
    return InSituLog(
        sets=sets,
        channels=channels,
        config=config,
        files=tuple(path.name for path in paths),
        notices=tuple(notices),
    )


def _check_names(parts: list[Samples], config: InSituConfig) -> None:
    """Raise LogError if two files hold one set, have other channels, or log and TOML differ in sets."""
    first: dict[str, Samples] = {}
    for samples in parts:
        if samples.name in first:
            other = first[samples.name].file
            raise LogError(
                f"{samples.file}: holds set '{samples.name}', and so does {other}; name each set once."
            )
        first[samples.name] = samples
        if samples.channels != parts[0].channels:
            raise LogError(
                f"{samples.file}: has the channels {', '.join(samples.channels)} where {parts[0].file} has "
                f"{', '.join(parts[0].channels)}; name the same channels in every file."
            )
    listed = None if config.sets is None else [one.name for one in config.sets]
    for name in (*(config.fit.sets or ()), *(listed or ())):
        if name not in first:
            raise LogError(
                f"{parts[0].file}: the TOML file names set '{name}', which is not in the log; there are "
                f"{_quote(first)}. Correct its name, or take it out."
            )
    for name, samples in first.items():
        if listed is not None and name not in listed and samples.added_mass is None:
            raise LogError(
                f"{samples}: is not among the sets of the TOML file ({_quote(listed)}); say there what was "
                "added, or added_mass_kg = 0."
            )


def _quote(names: Iterable[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _read_added_mass(samples: Samples, config: InSituConfig, notices: list[str]) -> AddedMass:
    """Return the added mass of columns or TOML; raise LogError if the two, or two rows, disagree."""
    listed = {one.name: one for one in config.sets or ()}.get(samples.name)
    if samples.added_mass is None:
        if listed is None:
            notices.append(
                f"{samples}: nothing tells what was added; it counts as the bare limb. Give added_mass_kg "
                "and added_com_m under [[sets]], or as columns."
            )
        return listed or AddedMass(name=samples.name)
    columns = samples.columns
    mass = _constant(samples, columns.added_mass, samples.added_mass)
    given: dict[str, Any] = {"name": samples.name, "added_mass_kg": mass}
    if samples.added_com is not None:
        place = zip(columns.added_com or (), samples.added_com.T, strict=True)
        given["added_com_m"] = [_constant(samples, name, column) for name, column in place]
    elif listed is not None:
        given["added_com_m"] = listed.added_com_m
    added = AddedMass.read(given, str(samples))
    if listed is None:
        return added
    both = [np.array([one.added_mass_kg, *one.added_com_m]) for one in (added, listed)]
    if np.abs(both[0] - both[1]).max() > _ALIKE:
        said = [f"{values[0]:g} kg at {values[1:].tolist()} m" for values in both]
        raise LogError(
            f"{samples}: the columns say {said[0]}, and the TOML file {said[1]}; correct one of them."
        )
    return listed


def _constant(samples: Samples, name: str | None, values: Floats) -> float:
    """Return the one value of a column; raise LogError if it has several, or none in some row."""
    if np.isnan(values).any() or np.ptp(values) > _ALIKE:
        raise LogError(
            f"{samples}: column '{name}' goes from {values.min():g} to {values.max():g}; give one value for "
            "each set, and another set for another one."
        )
    return float(values[0])


def _calibrate(parts: list[Samples], model: AccelerometerModel, notices: list[str]) -> list[Samples]:
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


def _to_set(
    samples: Samples, accelerometer: Accelerometer, added: AddedMass, notices: list[str]
) -> InSituSet:
    """Return a set with gravity in the sensor's frame and at its origin."""
    R = accelerometer.R_sensor_accelerometer
    up = samples.acceleration if samples.columns.gravity is None else -samples.acceleration
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
                position_imu=accelerometer.position_m,
                R_sensor_imu=R,
                window=window,
            )
        known = np.asarray(np.isfinite(gravity).all(axis=1))
        if known.sum() < FEWEST:
            rows = "all" if not known.any() else f"{(~known).sum()} of"
            raise LogError(
                f"{samples}: {rows} {len(known)} rows stand between gaps too close together for an angular "
                "acceleration; record without gaps, or, if the limb rested at every row, say "
                'columns.angular_velocity = "".'
            )
        if not known.all():
            notices.append(
                f"{samples}: {(~known).sum()} rows stand between gaps too close together for an angular "
                "acceleration; the fit does without them."
            )
            samples, gravity, spin, rate = samples.take(known), gravity[known], spin[known], rate[known]
    return InSituSet(
        raw=samples.raw,
        gravity=gravity,
        added_mass=added.added_mass_kg,
        added_com=added.added_com_m,
        angular_velocity=spin,
        angular_acceleration=rate,
        temperature=samples.temperature,
        time=samples.time,
        name=samples.name,
    )
