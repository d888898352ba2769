"""Readings and results in an MCAP file, for viewers such as Foxglove and Rerun: JSON messages with schemas.

Topics are ``/readings`` in counts, ``/force`` in N (torques in N m), ``/cop`` in m and ``/flags``, of each
sample. Numbers that do not exist are null.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.writer import Writer

import surefoot
from surefoot.calibration import FeetLayout, Parameters
from surefoot.calibration.estimate import Estimate
from surefoot.experiments.arrays import Floats, take_rows
from surefoot.experiments.logs.columns import channel_slugs
from surefoot.experiments.logs.format import Log
from surefoot.experiments.logs.table import LogError
from surefoot.experiments.walks.replay import replay_log
from surefoot.files import atomic_path

Keep = Callable[[float, Floats, Estimate], None]  # takes a sample: its time in s, its counts, and its result

LATEST = 2**64 * 1e-9  # s that a stamp can hold


class _Topics:
    """The topics of a file that is open."""

    def __init__(self, file: BinaryIO, layout: FeetLayout) -> None:
        self.writer = Writer(file)
        self.writer.start(profile="", library=f"surefoot {surefoot.__version__}")
        cells = channel_slugs(layout)
        self._feet = [foot.name for foot in layout.feet]
        places = [f"{name}_{axis}_m" for name in ("level", *self._feet) for axis in "xy"]
        vertical = [f"vgrf_{name}_N" for name in self._feet]
        self._fields = {"/readings": cells, "/force": [*cells, *vertical], "/cop": places, "/flags": cells}
        self._channels = {topic: self._register(topic, names) for topic, names in self._fields.items()}

    def _register(self, topic: str, names: Iterable[str]) -> int:
        number = {"type": "integer" if topic == "/flags" else ["number", "null"]}
        schema = {"type": "object", "properties": dict.fromkeys(names, number)}
        data = json.dumps(schema).encode()
        number_of = self.writer.register_schema(f"surefoot{topic.replace('/', '.')}", "jsonschema", data)
        return int(self.writer.register_channel(topic, "json", number_of))

    def write(self, time: float, raw: Floats, estimate: Estimate) -> None:
        """Write a sample."""
        if not 0.0 <= time < LATEST:
            raise LogError(f"The time {time:g} s cannot stand in an MCAP file, which counts from 0 s on.")
        level = np.where(estimate.cop_valid, estimate.cop, np.nan)
        feet = np.where(np.asarray(estimate.cop_foot_valid)[:, None], estimate.cop_foot, np.nan)
        values = {
            "/readings": raw,
            "/force": np.concatenate([estimate.force, estimate.vgrf]),
            "/cop": np.concatenate([level, feet.ravel()]),
            "/flags": np.asarray(estimate.flags),
        }
        stamp = round(1e9 * time)
        for topic, row in values.items():
            plain = [None if isinstance(x, float) and not math.isfinite(x) else x for x in row.tolist()]
            message = json.dumps(dict(zip(self._fields[topic], plain, strict=True))).encode()
            self.writer.add_message(self._channels[topic], stamp, message, stamp)


@contextmanager
def open_mcap(path: Path, layout: FeetLayout) -> Iterator[Keep]:
    """Give a function that writes samples of feet into a file, which is there when all are written."""
    with atomic_path(path) as part, part.open("wb") as file:
        topics = _Topics(file, layout)
        yield topics.write
        topics.writer.finish()  # type: ignore[no-untyped-call]


def write_mcap(path: Path, log: Log, method: str, initial: Parameters) -> Path:
    """Write a log, calibrated by a method from a map; LogError if its times are below 0."""
    estimate = replay_log(log, method, initial)
    with open_mcap(path, log.layout) as keep:
        for i, (time, raw) in enumerate(zip(log.time, log.raw, strict=True)):
            keep(float(time), raw, take_rows(estimate, i))
    return path
