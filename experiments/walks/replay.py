"""Replay recorded logs through the online calibrators, as they would run on the robot."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.arrays import Floats, take_rows
from surefoot.calibration import Estimate, MomentumReference, Parameters, Reference, replay
from surefoot.calibration.setup import OnlineSetup
from surefoot.calibration.weights.known_map import read_map
from surefoot.calibration.window.config import confidence_from_standing
from surefoot.experiments.logs.format import Log
from surefoot.experiments.logs.table import LogError


def replay_log(log: Log, method: str, initial: Parameters, **options: Any) -> Estimate:
    """Run one method over the N samples of a log, starting from a calibration map.

    ``options`` are those of :class:`FootCalibrator` and of :func:`~surefoot.calibration.replay`.
    """
    known: dict[str, Any] = {"mass": log.mass, "initial": initial, "lag": log.lag, "age": age_of(log)}
    # The zero-phase filter works on accelerations, which only a Reference contains.
    beliefs = log.reference if options.get("zero_phase") else beliefs_of(log, method)
    return replay(log.layout, method, log.raw, beliefs, steps_of(log), **known, **options)


def standing_weights(log: Log, initial: Parameters, stand: float) -> dict[str, float]:
    """Return the weights of the window method, computed from the first ``stand`` s of a log.

    The computation is the one of the CoP paper, and the result is a dictionary of options. Raises LogError if
    the robot does not stand on its feet during that time.
    """
    known: dict[str, Any] = {"dt": log.dt, "lag": log.lag, "age": age_of(log)}
    setup = OnlineSetup(layout=log.layout, mass=log.mass, initial=initial, **known)
    # Skip the first second, in which the filters settle. The reference at row i belongs to sample i - lag.
    rows = np.flatnonzero((log.time > log.time[0] + 1.0) & (log.time < log.time[0] + stand))
    told = take_rows(log.reference, np.minimum(rows + log.lag, len(log) - 1))
    try:
        weights = confidence_from_standing(setup, log.raw[rows], told)
    except ValueError as error:
        raise LogError(f"{error} The log's first {stand:g} s were taken for a quiet stand.") from None
    return dict(zip(("delta_force", "delta_cop"), weights, strict=True))


def beliefs_of(log: Log, method: str) -> Reference | MomentumReference:
    """Return the reference for a method: the momentum reference for "moment" if the log contains one."""
    return log.momentum if method == "moment" and log.momentum is not None else log.reference


def steps_of(log: Log) -> Floats:
    """Return the time steps since the previous sample in s, shape (N,)."""
    steps: Floats = np.diff(log.time, prepend=log.time[0] - log.dt)
    return steps


def age_of(log: Log) -> float:
    """Return the mean age in s of readings when they were sampled, or 0 if the log does not contain it."""
    return float(log.about.get("sample_age_s", 0.0))


def foot_length_of(log: Log, file: str) -> dict[str, float]:
    """Return the foot length as an option of the methods, or no option if cell positions determine it.

    Raises LogError if neither the description nor the cell positions determine it.
    """
    if "foot_length_m" in log.about:
        return {"foot_length": float(log.about["foot_length_m"])}
    if any(foot.position_cell_sole is None for foot in log.layout.feet):
        raise LogError(
            f"{file}: the channels have no places, which would give the length of a foot; give it in m in "
            'the description: "about": {"foot_length_m": 0.25}.'
        )
    return {}


def starting_map(log: Log, start: str | None = None) -> Parameters:
    """Return the nominal or the calibrated map of a log.

    ``start`` defaults to the entry "start" of ``about``, then to "nominal". Raises LogError if the name is
    unknown or the log does not contain that map.
    """
    if start is None:
        start = str(log.about.get("start", "nominal"))
    if start not in ("nominal", "calibrated"):
        raise LogError(f"A replay starts from 'nominal' or 'calibrated', not from '{start}'.")
    found = log.nominal if start == "nominal" else log.calibrated
    if found is None:
        raise LogError("The log's description has no 'calibrated' map; start from 'nominal', or add the map.")
    return found


def with_map(log: Log, path: Path) -> Log:
    """Return a copy of a log with the calibrated map of a JSON file written by ``surefoot calibrate``.

    Channels are matched by their names in columns (``left_front_left``) or in the layout. If the file
    contains linearisation curves, they are applied to the readings and stored as ``curves`` in ``about``.
    Raises LogError if the file does not contain a map for every channel.
    """
    calibrated, curves = read_map(path, log.layout.channel_names, LogError)
    about = log.about | ({"curves": curves.as_plain()} if curves.any else {})
    return replace(log, raw=curves.straighten(log.raw), calibrated=calibrated, about=about)


def replay_logs(logs: Sequence[Log], method: str, start: str | None = None, **options: Any) -> list[Estimate]:
    """Run one method over several logs and return one estimate of N rows per log.

    The logs may differ in length and robot. Raises LogError if a log does not contain the starting map, and
    ValueError if the method or an option is unknown.
    """
    return [replay_log(log, method, starting_map(log, start), **options) for log in logs]
