"""Replay logs through the online methods, each as the robot would have."""

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
    """Run one method over a log, N samples at once, from a map; options as of :class:`FootCalibrator`.

    And those of :func:`~surefoot.calibration.replay`.
    """
    known: dict[str, Any] = {"mass": log.mass, "initial": initial, "lag": log.lag, "age": age_of(log)}
    # Accelerations are what can be filtered forwards and backwards.
    beliefs = log.reference if options.get("zero_phase") else beliefs_of(log, method)
    return replay(log.layout, method, log.raw, beliefs, steps_of(log), **known, **options)


def standing_weights(log: Log, initial: Parameters, stand: float) -> dict[str, float]:
    """Return the window's weights of a log's first ``stand`` s as the CoP paper takes them, as its options.

    Raises LogError if the robot does not stand on its feet then.
    """
    known: dict[str, Any] = {"dt": log.dt, "lag": log.lag, "age": age_of(log)}
    setup = OnlineSetup(layout=log.layout, mass=log.mass, initial=initial, **known)
    # Filters settle in the first second; a reference describes the sample of `lag` samples ago.
    rows = np.flatnonzero((log.time > log.time[0] + 1.0) & (log.time < log.time[0] + stand))
    told = take_rows(log.reference, np.minimum(rows + log.lag, len(log) - 1))
    try:
        weights = confidence_from_standing(setup, log.raw[rows], told)
    except ValueError as error:
        raise LogError(f"{error} The log's first {stand:g} s were taken for a quiet stand.") from None
    return dict(zip(("delta_force", "delta_cop"), weights, strict=True))


def beliefs_of(log: Log, method: str) -> Reference | MomentumReference:
    """Return a log's beliefs of the kind that a method takes; of both kinds "moment" takes momentum."""
    return log.momentum if method == "moment" and log.momentum is not None else log.reference


def steps_of(log: Log) -> Floats:
    """Return the times since the sample before in s, shape (N,)."""
    steps: Floats = np.diff(log.time, prepend=log.time[0] - log.dt)
    return steps


def age_of(log: Log) -> float:
    """Return how old a log's readings were on average when they were taken, in s; 0 where nothing says so."""
    return float(log.about.get("sample_age_s", 0.0))


def foot_length_of(log: Log, file: str) -> dict[str, float]:
    """Return the length of a foot as an option of methods, where the places of channels do not give it.

    Raises LogError if neither they nor the description do.
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
    """Return the nominal or the calibrated map, or raise LogError; by default as ``about`` says."""
    if start is None:
        start = str(log.about.get("start", "nominal"))
    if start not in ("nominal", "calibrated"):
        raise LogError(f"A replay starts from 'nominal' or 'calibrated', not from '{start}'.")
    found = log.nominal if start == "nominal" else log.calibrated
    if found is None:
        raise LogError("The log's description has no 'calibrated' map; start from 'nominal', or add the map.")
    return found


def with_map(log: Log, path: Path) -> Log:
    """Return a log whose calibrated map is that of a JSON file, as ``surefoot calibrate`` writes one.

    Channels go by their names as they stand in columns (``left_front_left``) or in the layout. Raises
    LogError if the file holds no map, or not one for every channel. Channels with a curve have straight
    readings from then on, and ``about`` holds the ``curves``.
    """
    calibrated, curves = read_map(path, log.layout.channel_names, LogError)
    about = log.about | ({"curves": curves.as_plain()} if curves.any else {})
    return replace(log, raw=curves.straighten(log.raw), calibrated=calibrated, about=about)


def replay_logs(logs: Sequence[Log], method: str, start: str | None = None, **options: Any) -> list[Estimate]:
    """Run one method over logs of any lengths and robots, and return its estimates, N rows, on each.

    Raises LogError if a log has no such starting map, ValueError if there is no such method or option.
    """
    return [replay_log(log, method, starting_map(log, start), **options) for log in logs]
