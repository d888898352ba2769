"""Replay logs through the online methods, each as the robot would have."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import (
    Curves,
    Estimate,
    FootCalibrator,
    MomentumReference,
    Parameters,
    Reference,
    replay,
)
from surefoot.calibration.setup import OnlineSetup
from surefoot.calibration.window.config import confidence_from_standing
from surefoot.experiments.arrays import Floats, take_rows
from surefoot.experiments.logs.columns import channel_slugs, slug
from surefoot.experiments.logs.format import Log
from surefoot.experiments.logs.table import LogError
from surefoot.files import parse_json, read_text


def replay_log(log: Log, method: str, initial: Parameters, **options: Any) -> Estimate:
    """Run one method over a log, N samples at once, from a map; options as of :func:`make_calibrator`."""
    options = _with_standing(log, initial, options)
    known: dict[str, Any] = {"mass": log.mass, "initial": initial, "lag": log.lag, "age": age_of(log)}
    # Accelerations are what can be filtered forwards and backwards.
    beliefs = log.reference if options.get("zero_phase") else beliefs_of(log, method)
    return replay(log.layout, method, log.raw, beliefs, steps_of(log), **known, **options)


def make_calibrator(log: Log, method: str, **options: Any) -> FootCalibrator:
    """Make a calibrator of a log's robot; options as of :class:`FootCalibrator`.

    And ``stand``: for how many s the robot stands at the beginning; of these the window then takes its
    weights, as in the CoP paper.
    """
    options = _with_standing(log, starting_map(log), options)
    known: dict[str, Any] = {"mass": log.mass, "dt": log.dt, "lag": log.lag, "age": age_of(log)}
    return FootCalibrator(log.layout, method, **known, **options)


def _with_standing(log: Log, initial: Parameters, options: dict[str, Any]) -> dict[str, Any]:
    """Return options with the window's weights of a quiet stand, for ``stand`` among them.

    Raises LogError if the log has none.
    """
    if not (stand := options.pop("stand", 0.0)):
        return options
    known: dict[str, Any] = {"dt": log.dt, "lag": log.lag, "age": age_of(log)}
    setup = OnlineSetup(layout=log.layout, mass=log.mass, initial=initial, **known)
    # Filters settle in the first second; a reference describes the sample of `lag` samples ago.
    rows = np.flatnonzero((log.time > log.time[0] + 1.0) & (log.time < log.time[0] + stand))
    told = take_rows(log.reference, np.minimum(rows + log.lag, len(log) - 1))
    try:
        delta_force, delta_cop = confidence_from_standing(setup, log.raw[rows], told)
    except ValueError as error:
        raise LogError(f"{error} The log's first {stand:g} s were taken for a quiet stand.") from None
    return {**options, "delta_force": delta_force, "delta_cop": delta_cop}


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


class Replayed(NamedTuple):
    """The result of a method on one log of N samples."""

    force: Floats  # calibrated, in N, shape (N, K)
    cop: Floats  # of both feet in the reference's level frame in m, shape (N, 2)
    scale: Floats  # newtons per count, shape (N, K)
    offset: Floats  # force that a reading of zero stands for in N, shape (N, K)
    flags: NDArray[np.int64]  # bits of :class:`~surefoot.calibration.Flag`, shape (N, K)


def starting_map(log: Log, start: str | None = None) -> Parameters:
    """Return the nominal or the calibrated map, or raise LogError; by default as ``about`` says."""
    if start is None:
        start = str(log.about.get("start", "nominal"))
    if start not in ("nominal", "calibrated", "bench"):
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
    given = parse_json(read_text(path, LogError), f"{path.name}: the map", LogError)
    try:
        names = [slug(str(name)) for name in given["channels"]]
        values = [[float(x) for x in given[key]] for key in ("scale_N_per_count", "offset_N")]
        maps = dict(zip(names, zip(*values, strict=True), strict=True))
        curves = Curves.from_plain(given.get("curves", [None] * len(names)), len(names))
        bent = dict(zip(names, curves.knots, strict=True))
    except (KeyError, TypeError, ValueError) as error:
        raise LogError(
            f"{path.name}: is no map ({type(error).__name__} {error}); it needs channels, scale_N_per_count "
            "and offset_N, one of each a channel, as `surefoot calibrate weights` writes them."
        ) from None
    wanted = channel_slugs(log.layout)
    missing = [name for name in wanted if name not in maps]
    if missing:
        raise LogError(
            f"{path.name}: holds no map for the channel {missing[0]!r}; it has {names}. Name the columns "
            f"of the weighings 'raw_{missing[0]}_count' and so on."
        )
    scale, offset = np.array([maps[name] for name in wanted]).T
    curves = Curves([bent[name] for name in wanted])
    about = log.about | ({"curves": curves.as_plain()} if curves.any else {})
    return replace(log, raw=curves.straighten(log.raw), calibrated=Parameters(scale, offset), about=about)


def replay_logs(logs: Sequence[Log], method: str, start: str | None = None, **options: Any) -> list[Replayed]:
    """Run one method over logs of any lengths and robots, and return its result on each.

    Raises LogError if a log has no such starting map, ValueError if there is no such method or option.
    """
    starts = [starting_map(log, start) for log in logs]
    found = [replay_log(log, method, initial, **options) for log, initial in zip(logs, starts, strict=True)]
    return [Replayed(one.force, one.cop, one.scale, one.offset, one.flags) for one in found]
