"""Logs of any kind as readings over time: walks, sets of six-axis sensors, weighings and bare channels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening

from surefoot.arrays import Floats
from surefoot.experiments.force_torque.config import Columns, config_beside
from surefoot.experiments.force_torque.log import InSituLog, read_in_situ_log
from surefoot.experiments.instrument.noise import BLOCK
from surefoot.experiments.logs.bag import is_bag, read_bag
from surefoot.experiments.logs.clock import Clock, read_clock
from surefoot.experiments.logs.columns import LOADS, raw_names_of
from surefoot.experiments.logs.contacts import FELT
from surefoot.experiments.logs.format import METADATA_KEY, Log, read_log
from surefoot.experiments.logs.mapping import TableMapping
from surefoot.experiments.logs.table import LogError, LogTable, join_names
from surefoot.files import read_toml


@dataclass(frozen=True, eq=False)
class Recording:
    """N samples of K channels."""

    file: str
    kind: str  # "walk", "feet alone", "six-axis sensor", "weighings" or "channels"
    names: tuple[str, ...]  # of the channels
    time: Floats  # in s, shape (N,); NaN if unknown
    raw: Floats  # in counts, shape (N, K); NaN where no sample arrived
    unloaded: NDArray[np.bool_]  # where a channel certainly carries no load, shape (N, K)
    load: Floats | None = None  # known load of each channel in N, shape (N, K)
    scale: Floats | None = None  # nominal N per count with its sign, shape (K,)
    read: Log | InSituLog | None = None  # the log as its command reads it
    refusal: str = ""  # why its command cannot read it
    notices: tuple[str, ...] = ()
    clock: Clock | None = None  # analysis of the times, if there are any

    @property
    def has_times(self) -> bool:
        """Whether all samples have times."""
        return bool(len(self.time) > 1 and np.isfinite(self.time).all())

    @property
    def has_loads(self) -> bool:
        """Whether the load is known in any row, including rows without load."""
        return self.load is not None or bool(self.unloaded.any())


def read_recording(path: Path, topics: Path | None = None) -> Recording:
    """Read a log of any kind; LogError if it is not a readable table or has no channels.

    If the command for this kind of log cannot read it, the recording contains the reason.
    """
    if is_bag(path):
        bag = read_bag(path, topics)
        return _walk(path, bag.table(lambda name: name.startswith("raw_")), topics)
    if _has_in_situ_settings(path.with_suffix(".toml")):
        return _six_axis(path)
    mapping = TableMapping.beside(path)
    table = mapping.read_by_mapping(
        path, "give a log, or a table with time_s and raw_<channel>_count.", mapping.columns
    )
    if any(name.startswith(("specific_force_", "gravity_")) for name in table.names):
        return _six_axis(path)
    if METADATA_KEY in (table.data.schema.metadata or {}) or path.with_suffix(".json").is_file():
        return _walk(path, table, topics)
    loads = [name for name in LOADS if name in table]
    if loads and "time_s" not in table:
        return _channels(table, "weighings", loads)
    return _channels(table, "channels", loads)


def _has_in_situ_settings(path: Path) -> bool:
    """Return whether a TOML file exists and has keys of the log of a six-axis sensor."""
    given = read_toml(path, LogError) if path.is_file() else {}
    columns = given.get("columns")
    named = set(columns) if isinstance(columns, dict) else set()
    return bool(set(given) - set(TableMapping.model_fields) or named & set(Columns.model_fields))


def _walk(path: Path, table: LogTable, topics: Path | None) -> Recording:
    read: Log | None = None
    refusal = ""
    try:
        read = read_log(path, float("inf"), topics, feet_alone=True)
    except LogError as error:
        refusal = str(error)
    if read is None:
        found = _channels(table, "walk", [])
        return replace(found, refusal=refusal)
    foot = (read.layout.wrench_map != 0.0).any(axis=1).argmax(axis=0)
    swing = np.asarray(read.reference.swing)[read.reference_rows]
    swing[len(swing) - read.lag :] = False
    if read.about.get("contacts") == FELT:
        # A load is also flat at its minimum, but only briefly.
        size = round(BLOCK / read.dt)
        swing = np.stack([binary_opening(one, np.ones(max(size, 1))) for one in swing.T], axis=-1)
    return Recording(
        file=path.name,
        kind="feet alone" if read.about.get("feet_alone") else "walk",
        names=tuple(raw_names_of(read.layout)),
        time=read.time,
        raw=read.raw,
        unloaded=swing[:, foot],
        scale=np.asarray(read.nominal.scale),
        read=read,
        notices=tuple(read.about.get("notices", ())),
        clock=read_clock(table.numbers("time_s")),
    )


def _six_axis(path: Path) -> Recording:
    log = read_in_situ_log(path, config_beside(path))
    parts = log.sets
    raw = np.concatenate([one.raw for one in parts])
    times = [np.full(len(one.raw), np.nan) if one.time is None else one.time for one in parts]
    return Recording(
        file=path.name,
        kind="six-axis sensor",
        names=log.channels,
        time=np.concatenate(times),
        raw=raw,
        unloaded=np.zeros(raw.shape, dtype=bool),
        read=log,
        notices=log.notices,
    )


def _channels(table: LogTable, kind: str, loads: Sequence[str]) -> Recording:
    names = table.channels
    if not names:
        cure = f"Name yours under [columns] in {Path(table.file).stem}.toml."
        there = (
            f"there are {join_names(table.names)}. {cure}" if table.names else "no topic is mapped to one."
        )
        raise LogError(f"{table.file}: has no column 'raw_<channel>_count'; {there}")
    raw = table.stack_columns(names)
    clock = read_clock(table.numbers("time_s")) if "time_s" in table else None
    time = np.full(len(raw), np.nan) if clock is None else clock.time
    found = () if clock is None else tuple(f"{table.file}: column 'time_s' {text}." for text in clock.notices)
    load: Floats | None = None
    if loads:
        one = table.numbers(loads[0]) * LOADS[loads[0]]
        load = np.repeat(one[:, None], len(names), axis=1)
    unloaded = np.zeros(raw.shape, dtype=bool) if load is None else load == 0.0
    notices = table.notices + found
    return Recording(table.file, kind, names, time, raw, unloaded, load, notices=notices, clock=clock)
