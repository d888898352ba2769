"""Calibrate a stream as it comes: samples from a socket or a growing file in, calibrated forces out.

Every line is JSON. The first describes the robot as a log does (docs/log-format.md): ``layout``, ``mass_kg``,
``nominal``, ``dt_s``, ``lag_samples``. Each further one, with ``time_s``, ``raw`` and ``reference``, is
answered by a line, on the socket or on standard output. An empty line, or the end, ends it.

    python examples/live_loop.py tcp:9760                      # in one shell; or file:stream.jsonl
    python examples/send_log.py walk.parquet tcp:9760 --fast   # in another
"""

import argparse
import json
import socket
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from surefoot.calibration import FeetLayout, Flag, FootCalibrator, FootLayout, Parameters, Reference


def calibrator_of(robot: dict, method: str) -> FootCalibrator:
    """Make a calibrator for the robot that a description is about."""
    feet = []
    for foot in robot["layout"]:
        wrench_map, position = np.array(foot["wrench_map"]), np.array(foot["position_cell_sole_m"])
        feet.append(FootLayout(foot["name"], wrench_map, tuple(foot["channel_names"]), position))
    start = Parameters(*(np.array(robot["nominal"][key]) for key in ("scale_N_per_count", "offset_N")))
    options = {"mass": robot["mass_kg"], "dt": robot["dt_s"], "lag": robot["lag_samples"]}
    return FootCalibrator(FeetLayout(tuple(feet)), method, initial=start, **options)


def run(lines: Iterable[str], answer: Callable[[str], None], method: str = "moment") -> np.ndarray:
    """Calibrate sample by sample.

    Returns:
        Seconds from when each sample was sent (``sent_s``, if the sender shares the clock), or else was read,
        to when its answer was on its way.
    """
    stream, latency, before = iter(lines), [], None
    calibrator = calibrator_of(json.loads(next(stream)), method)
    for line in stream:
        if not line.strip():
            break
        read = time.monotonic()
        sample = json.loads(line)
        reference = Reference(
            **{key: np.array(value, dtype=bool if key in ("stance", "swing") else float)
               for key, value in sample["reference"].items()}
        )  # fmt: skip
        dt = None if before is None else sample["time_s"] - before
        before = sample["time_s"]
        estimate = calibrator.update(np.array(sample["raw"], dtype=float), reference, dt)
        found = {"time_s": before, "force_N": estimate.force.tolist(), "vgrf_N": estimate.vgrf.tolist()}
        found["cop_m"] = estimate.cop.tolist() if estimate.cop_valid else None
        found["flags"] = [str(Flag(flag).name) if flag else "" for flag in estimate.flags.tolist()]
        answer(json.dumps(found) + "\n")
        latency.append(time.monotonic() - sample.get("sent_s", read))
    return np.array(latency)


def follow(path: Path, patience: float = 5.0) -> Iterator[str]:
    """Read lines of a file that another program goes on writing; end when nothing has come for a while."""
    with path.open(encoding="utf-8") as file:
        part, since = "", time.monotonic()
        while time.monotonic() - since < patience:
            part += (got := file.readline())
            if part.endswith("\n"):
                yield part
                part, since = "", time.monotonic()
            elif not got:
                time.sleep(0.001)


def serve(listener: socket.socket, method: str = "moment") -> np.ndarray:
    """Take one connection and answer on it."""
    connection, _ = listener.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with connection, connection.makefile("r", encoding="utf-8") as lines:
        return run(lines, lambda text: connection.sendall(text.encode()), method)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Calibrate a stream as it comes.")
    parser.add_argument("source", help="tcp:PORT to listen on, or file:PATH that grows")
    parser.add_argument("--method", default="moment")
    given = parser.parse_args()
    kind, _, where = given.source.partition(":")
    if kind == "tcp":
        with closing(socket.create_server(("127.0.0.1", int(where)))) as door:
            seconds = serve(door, given.method)
    else:
        seconds = run(follow(Path(where)), sys.stdout.write, given.method)
    middle, late = 1e3 * np.percentile(seconds, (50, 99)) if len(seconds) else (np.nan, np.nan)
    print(f"{len(seconds)} samples, {middle:.3f} ms median, {late:.3f} ms 99th percentile", file=sys.stderr)
