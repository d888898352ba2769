"""ROS bags as tables. Fields of topics become columns on one clock, as docs/log-format.md describes.

The package ``rosbags`` reads ROS 1 bags and ROS 2 bags (sqlite3 and MCAP) without ROS. A mapping file in TOML
assigns fields to columns.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import Field, PlainValidator, model_validator

from surefoot.arrays import Floats
from surefoot.experiments.logs.motion import (
    ACCELEROMETER,
    GYROSCOPE,
    PACKET,
    count_rows,
    even_rows,
    even_times,
    means_since,
)
from surefoot.experiments.logs.settings import Number, Settings
from surefoot.experiments.logs.table import LogError, LogTable
from surefoot.experiments.study.tables import flat
from surefoot.files import read_toml

SUFFIXES = (".bag", ".mcap", ".db3")  # of files; a ROS 2 bag may also be a folder

EARLY, LATE = 0.002, 0.05
"""Limits in s of the delay from the stamp of a message to its receipt, negative and positive. Stamps with
other delays are from another clock."""

LEAST = 0.02  # quantile of the delays that is used as the smallest delay
BRIDGED = 2.5  # longest gap between messages, in periods of the topic, that is interpolated
SPAN = 16  # number of messages over which the period of a topic is averaged

HELD = re.compile(r".*_(stance|swing|contact)|set|added_.*")  # columns that keep their last value
NEAREST = ("_qw", "_qx", "_qy", "_qz")  # columns that cannot be interpolated separately

FieldPath = tuple[str, ...]  # names of nested fields of a message


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag: a folder, or a file with one of the suffixes of bags."""
    return path.is_dir() or path.suffix.lower() in SUFFIXES


def _columns(given: Any) -> dict[FieldPath, str]:
    if not isinstance(given, Mapping) or not given:
        raise ValueError("must be a table of fields, such as data.0 = 'raw_left_front_left_count'")
    found: dict[FieldPath, str] = {}
    for name, value in given.items():
        parts = {(): value} if isinstance(value, str) else _columns(value)
        found |= {(str(name), *path): column for path, column in parts.items()}
    return found


Columns = Annotated[dict[FieldPath, str], PlainValidator(_columns)]


class Topics(Settings):
    """A mapping file, which assigns fields of topics to columns."""

    topics: Annotated[dict[str, Columns], Field(min_length=1)]
    offsets_s: dict[str, Number] = Field(default_factory=dict)
    """Time in s that is added to the stamps of a topic, in place of the estimated offset."""

    @model_validator(mode="after")
    def _once(self) -> Self:
        columns = [column for fields in self.topics.values() for column in fields.values()]
        twice = [column for column in columns if columns.count(column) > 1]
        if twice:
            raise ValueError(f"column '{twice[0]}' is there twice; name each column once")
        unknown = [topic for topic in self.offsets_s if topic not in self.topics]
        if unknown:
            raise ValueError(f"offsets_s names '{unknown[0]}', which is not among the topics")
        return self


class Series(NamedTuple):
    """Columns of one topic, in order of time."""

    topic: str
    time: Floats  # in s since the bag began, increasing, shape (M,)
    columns: dict[str, Floats]  # NaN where a message lacks a value, (M,) each

    @property
    def reach(self) -> str:
        """The topic with its first and last time."""
        return f"'{self.topic}' from {self.time[0]:.6g} to {self.time[-1]:.6g} s"

    @property
    def period(self) -> float:
        """Median time between two messages in s."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else np.inf


class Bag(NamedTuple):
    """The selected data of a bag."""

    file: str
    series: tuple[Series, ...]  # in the order of the mapping file
    notices: tuple[str, ...]  # about the clock of each topic

    def table(self, wanted: Callable[[str], bool] = lambda name: True) -> LogTable:
        """Return some columns. The rows are the messages of the first topic that has one of the columns.

        Rows without values of the other topics are left out. Raises LogError if no rows remain.
        """
        parts = [one for one in self.series if any(map(wanted, one.columns))]
        if not parts:
            return LogTable(self.file, pa.table({}), self.notices)
        return self._on_rows(parts[0], parts, wanted, _onto)

    def motion(self, averaged: bool) -> tuple[LogTable, bool]:
        """Return joints and IMU at the rows of the joints, and whether the IMU is a mean since the last row.

        ``averaged`` states this of the rows of the IMU. An IMU with separate rows is averaged between the
        rows of the joints, including rows that were lost, so that no sample of the IMU is lost.
        """
        inertial = {*ACCELEROMETER, *GYROSCOPE}
        jointed = [one for one in self.series if any(name.startswith("joint_") for name in one.columns)]
        apart = [one for one in self.series if inertial & set(one.columns)]
        if not jointed or not apart or any(one in jointed for one in apart):
            return self.table(is_motion), averaged
        rows, own = _complete(jointed[0])

        def onto(rows: Series, one: Series, name: str) -> Floats:
            if name in rows.columns:
                return rows.columns[name]
            if name not in inertial:
                return _onto(rows, own if one is jointed[0] else one, name)
            there = np.isfinite(one.columns[name])
            time, values = one.time[there], one.columns[name][there]
            if len(time) < 2 or len(rows.time) < 2:
                return np.full(len(rows.time), np.nan)
            return means_since(time, values, rows.time, averaged, BRIDGED * max(one.period, rows.period))

        def is_known(name: str) -> bool:
            return is_motion(name) and (name != PACKET or PACKET in own.columns)

        return self._on_rows(rows, [*jointed, *apart], is_known, onto), True

    def _on_rows(
        self,
        rows: Series,
        parts: Iterable[Series],
        wanted: Callable[[str], bool],
        onto: Callable[[Series, Series, str], Floats],
    ) -> LogTable:
        """Return columns of topics at the times of ``rows``. ``onto`` computes one of them."""
        values = {"time_s": rows.time}
        for one in parts:
            for name in filter(wanted, one.columns):
                values[name] = onto(rows, one, name)
                if not np.isfinite(values[name]).any() and not name.startswith("raw_"):
                    raise LogError(
                        f"{self.file}: no overlap in time: {rows.reach}, and {one.reach}; their clocks "
                        "differ or they were not recorded together. Give offsets_s in the mapping file."
                    )
        whole = np.all([np.isfinite(v) for k, v in values.items() if not k.startswith("raw_")], axis=0)
        return LogTable(self.file, pa.table({k: v[whole] for k, v in values.items()}), self.notices)


def is_motion(name: str) -> bool:
    """Return whether a column belongs to the table of joints and IMU."""
    return name.startswith("joint_") or name in (*ACCELEROMETER, *GYROSCOPE, PACKET)


def _complete(one: Series) -> tuple[Series, Series]:
    """Return all rows of a topic including lost ones, and the topic, both at even times."""
    packet = one.columns.get(PACKET)
    if packet is not None and not (np.isfinite(packet).all() and (np.diff(packet) > 0).all()):
        return one, one  # read_motion reports the error
    number, even = even_rows(one.time, packet)
    every = np.arange(number[-1] + 1)
    counted = {} if packet is None else {PACKET: packet[0] + every}
    return Series(one.topic, np.interp(every, number, even), counted), one._replace(time=even)


def _onto(rows: Series, one: Series, name: str) -> Floats:
    """Return a column at the times of other rows, NaN where it is unknown."""
    there = np.isfinite(one.columns[name])
    time, values = one.time[there], one.columns[name][there]
    if not len(time):
        return np.full(len(rows.time), np.nan)
    before = np.searchsorted(time, rows.time, side="right") - 1
    last, following = before.clip(0), (before + 1).clip(max=len(time) - 1)
    if HELD.fullmatch(name):
        return np.where(before >= 0, values[last], np.nan)
    if name.startswith("raw_") or name.endswith(NEAREST):
        nearest = np.where(rows.time - time[last] <= time[following] - rows.time, last, following)
        nearest = np.where(before < 0, 0, nearest)
        limit = 0.5 * rows.period if name.startswith("raw_") else 0.5 * BRIDGED * one.period
        return np.where(np.abs(time[nearest] - rows.time) <= limit, values[nearest], np.nan)
    found = np.interp(rows.time, time, values, left=np.nan, right=np.nan)
    bridged = (time[following] - time[last] <= BRIDGED * one.period) | (time[last] == rows.time)
    return np.where(bridged, found, np.nan)


def read_bag(path: Path, mapping: Path | None = None) -> Bag:
    """Read the topics that a mapping file names, by default the file beside the bag.

    Raises LogError if the bag is incomplete, the mapping is missing, or it does not fit the topics.
    """
    mapping = path.with_suffix(".topics.toml") if mapping is None else mapping
    with open_bag(path) as reader:
        topics = _read_topics(path, mapping)
        there = reader.topics
        for topic in topics.topics:
            if topic not in there or not there[topic].msgcount:
                names = ", ".join(f"'{name}'" for name, info in there.items() if info.msgcount)
                raise LogError(
                    f"{path.name}: has no message of the topic '{topic}', which {mapping.name} names; there "
                    f"are {names}."
                )
        wanted = [one for one in reader.connections if one.topic in topics.topics]
        with explain_damage(path):
            messages = list(reader.messages(wanted))
        series, notices = [], []
        for topic, fields in topics.topics.items():
            mine = [one for one in messages if one[0].topic == topic]
            decoded = [message_of(path, reader, link, data) for link, _, data in mine]
            received = 1e-9 * (np.array([stamp for _, stamp, _ in mine]) - messages[0][1])
            joints = dict.fromkeys(name for message in decoded for name in getattr(message, "name", ()))
            for rows, some in _by_publisher(decoded, fields):
                messages_of = [decoded[row] for row in rows]
                columns = _numbers(f"{path.name}: '{topic}'", some, messages_of, joints)
                stamps = _stamps(messages_of, messages[0][1])
                time, clock = _clock(received[rows], stamps, topics.offsets_s.get(topic))
                one, notice = _series_of(topic, time, columns)
                series.append(one)
                notices.append(f"{path.name}: '{topic}': {notice.format(clock)}")
    return Bag(path.name, tuple(series), tuple(notices))


def _series_of(topic: str, time: Floats, columns: Mapping[str, Floats]) -> tuple[Series, str]:
    """Return messages in order of time without repeats, and a notice with a placeholder for the clock."""
    kept = np.unique(time, return_index=True)[1]
    one = Series(topic, time[kept], {name: values[kept] for name, values in columns.items()})
    rate = f", {1.0 / one.period:.4g} a second" if len(kept) > 1 else ""
    repeats = len(time) - len(kept)
    more = f" {repeats} messages repeat a time and were left out." if repeats else ""
    return one, f"{len(time)} message{'s' * (len(time) != 1)}{rate}; {{}}.{more}"


def _by_publisher(
    messages: list[Any], fields: Mapping[FieldPath, str]
) -> Iterator[tuple[NDArray[np.intp], dict[FieldPath, str]]]:
    """Yield the rows of the messages of each publisher of a topic, and their fields.

    Several drivers may publish different joints on one topic at different rates. Messages with the same names
    come from the same driver. Fields without names belong to all messages.
    """
    names = [tuple(getattr(message, "name", ())) for message in messages]
    # If several drivers publish one joint, the most frequent one is read, and its messages are the rows.
    kinds = [kind for kind, _ in Counter(names).most_common()]
    found: dict[tuple[str, ...], dict[FieldPath, str]] = {kind: {} for kind in kinds}
    for path, column in fields.items():
        found[next((kind for kind in kinds if path[-1] in kind), kinds[0])][path] = column
    for kind, some in found.items():
        if some:
            yield np.array([row for row, one in enumerate(names) if one == kind], dtype=np.intp), some


def _read_topics(path: Path, mapping: Path) -> Topics:
    if not mapping.is_file():
        raise LogError(
            f"{path.name}: the mapping file {mapping.name} is not there; --guess prints one to begin with, "
            "and --topics names another."
        )
    return Topics.read(read_toml(mapping, LogError), mapping.name)


@contextmanager
def explain_damage(path: Path) -> Iterator[None]:
    """Turn errors about an unreadable file into a LogError with a remedy."""
    try:
        yield
    except Exception as error:  # rosbags and its readers raise many types for a file that ends early
        reason = flat(str(error))[:160].rstrip(".") or type(error).__name__
        if reason.startswith("Profile is not"):
            raise LogError(
                f"{path.name}: is MCAP, but no bag of ROS 2; record it by `ros2 bag`, or export a table."
            ) from None
        raise LogError(
            f"{path.name}: not a whole bag ({reason}); `ros2 bag reindex` or `rosbag reindex` mends a "
            "recording that was cut off, and `rosbags-convert --exclude-topic` leaves out what cannot be "
            "decoded."
        ) from None


@contextmanager
def open_bag(path: Path) -> Iterator[Any]:
    """Open a bag that has messages, and return its reader."""
    if path.exists() and not is_bag(path):
        raise LogError(f"{path.name}: no bag; one is a folder or ends in {', '.join(SUFFIXES)}.")
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise LogError(
            f'{path.name}: bags are read by {error.name}, which is missing: pip install "surefoot[ros]".'
        ) from None
    if not path.exists():
        raise LogError(f"{path}: no such bag.")
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise LogError(f"{path.name}: a folder without metadata.yaml is no bag of ROS 2; give a log.")
    with explain_damage(path):
        # Bags of older releases have no definitions. Those of the common messages have not changed.
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    with closing(reader):
        if not reader.message_count:
            raise LogError(f"{path.name}: the bag is empty: it holds no message.")
        yield reader


def message_of(path: Path, reader: Any, connection: Any, data: bytes) -> Any:
    """Decode a message, or raise LogError."""
    try:
        return reader.deserialize(data, connection.msgtype)
    except Exception as error:  # rosbags raises many types here too
        raise LogError(
            f"{path.name}: '{connection.topic}' holds {connection.msgtype}, which cannot be decoded "
            f"({error!r}); record it with its definition, as MCAP does, or publish it as a common type."
        ) from None


def _numbers(
    where: str, fields: Mapping[FieldPath, str], messages: list[Any], names: Iterable[str]
) -> dict[str, Floats]:
    """Return columns of messages; LogError if a field is missing or never contains a number.

    ``names`` are the names of all joints of the topic.
    """
    columns: dict[str, Floats] = {}
    for path, column in fields.items():
        columns[column] = np.array([_number(where, message, path) for message in messages])
        if not np.isfinite(columns[column]).any():
            cure = f" Its names are {', '.join(names)}." if names else ""
            raise LogError(f"{where} holds no number under '{'.'.join(path)}' in any message.{cure}")
    return columns


def _number(where: str, message: Any, path: FieldPath) -> float:
    """Return a field: an element by its number, or by the name of its joint. NaN if it is absent."""
    value = message
    for name in path:
        if isinstance(value, np.ndarray | list | tuple):
            names = list(getattr(message, "name", ()))
            place = int(name) if name.isdigit() else names.index(name) if name in names else len(value)
            value = value[place] if place < len(value) else None
        elif value is not None and not hasattr(value, name):
            raise LogError(
                f"{where} holds {_type(message)}, which has no field '{name}'; there are "
                f"{', '.join(_field_names(value))}."
            )
        else:
            value = getattr(value, name, None)
    if not isinstance(value, bool | int | float | np.number | np.bool_ | None):
        raise LogError(
            f"{where} holds {_type(message)}, in which '{'.'.join(path)}' is no number; name one of its "
            "parts, or another topic."
        )
    return float("nan") if value is None else float(value)


def _type(message: Any) -> str:
    return str(getattr(message, "__msgtype__", type(message).__name__))


def _field_names(holder: Any) -> list[str]:
    names = [name for name in getattr(holder, "__dataclass_fields__", {}) if not name.startswith("__")]
    return names or ["none"]


def _stamps(messages: list[Any], origin: int) -> Floats | None:
    """Return header stamps in s since the start of the bag, None if there are none."""
    stamps: list[Any] = [getattr(getattr(one, "header", None), "stamp", None) for one in messages]
    if any(stamp is None or stamp.sec == stamp.nanosec == 0 for stamp in stamps):
        return None
    return 1e-9 * np.array([stamp.sec * 1_000_000_000 + stamp.nanosec - origin for stamp in stamps])


def _clock(received: Floats, stamps: Floats | None, given: float | None) -> tuple[Floats, str]:
    """Return times of messages on the recorder's clock, and a description of how they were found.

    The delay of a message is never negative, and most messages are about as fast as the fastest. So the
    smallest difference of receipt and stamp is the offset of the two clocks, up to the delay of the fastest
    message.
    """
    if stamps is None:
        time = _even(received)
        jitter = f"{1e3 * np.std(received - time):.2g} ms"
        how = f"no stamps, so times of receipt, whose jitter of {jitter} was averaged out"
        if time is received:
            how = "no stamps and no even rate, so times of receipt as they are"
        return (time, how) if given is None else (time + given, f"{how}, and {given:g} s, as offsets_s says")
    least, median = np.quantile(received - stamps, (LEAST, 0.5))
    if given is not None:
        return stamps + given, f"stamps and {given:g} s, as offsets_s says"
    late = f"they reach the recorder after {1e3 * least:.1f} ms at least, {1e3 * median:.1f} ms in the median"
    if -EARLY <= least <= LATE:
        return stamps, f"its stamps as they are; {late}"
    side = "behind" if least > 0 else "ahead of"
    return stamps + least, (
        f"its stamps are of a clock {abs(least):.4f} s {side} the recorder's, by the least time from stamp "
        "to receipt, and were moved by that; offsets_s says it better if you know it"
    )


def _even(received: Floats) -> Floats:
    """Return times of receipt without jitter if the rate is even, as early as the fastest messages."""
    if len(received) <= 2 * SPAN:
        return received
    period = float(np.median(received[SPAN:] - received[:-SPAN])) / SPAN
    if period <= 0.0:
        return received
    time, _ = even_times(received, count_rows(received, period))
    early = received - time
    if np.quantile(np.abs(early), 0.9) > 0.5 * period:
        return received
    return np.asarray(time + np.quantile(early, LEAST))
