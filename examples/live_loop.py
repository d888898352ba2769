"""Calibrate a stream as it comes: samples from a socket or a growing file in, calibrated forces out.

Every line is JSON. The first one is a log's description (docs/log-format.md). Each further line is a sample
with ``time_s`` and

* ``joint_rad`` (in the model's order), ``gyroscope_rad_s`` and ``accelerometer_m_s2`` of encoders and IMU, if
  the description has ``motion``; or ``reference``, if it has not;
* ``raw``, the readings of the feet. Such a line is answered by a line, on the socket or on standard output.

An empty line, or the end, ends it. Without ``offset_N`` the robot is taken to stand evenly on all cells at
the first sample.

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

from surefoot.calibration import GRAVITY, Flag, FootCalibrator, Parameters, Reference
from surefoot.experiments.logs.description import Description
from surefoot.robot import RobotState


class LiveRobot:
    """The robot of a description: its state by joints and IMU, if it has a model, and its calibrator."""

    def __init__(self, description: dict, method: str, folder: Path = Path()) -> None:
        self.facts = Description.read(description, "the first line")
        motion, self.method = self.facts.motion, method
        self.dt = 1.0 / 80.0 if np.isnan(self.facts.dt_s) else self.facts.dt_s
        self.state: RobotState | None = None
        self.calibrator: FootCalibrator | None = None
        if motion is not None:
            rate = 1.0 / (self.dt if np.isnan(motion.dt_s) else motion.dt_s)
            self.state = RobotState(
                folder / motion.model, feet=motion.soles, imu=motion.imu, held=motion.held_rad, rate=rate,
                layout=self.facts.layout, mass=self.facts.mass_kg, delay=motion.delay_s,
                averaged=motion.averaged, dt=self.dt, age=motion.readings_age_s, momentum=method == "moment",
            )  # fmt: skip

    def take(self, sample: dict, dt: float | None) -> dict | None:
        """Take in one sample; return the answer to one of the feet."""
        if self.state is not None and "joint_rad" in sample:
            parts = (sample[key] for key in ("joint_rad", "gyroscope_rad_s", "accelerometer_m_s2"))
            self.state.update(*parts, sample["time_s"])
        if "raw" not in sample:
            return None
        raw = np.array(sample["raw"], dtype=float)
        if self.calibrator is None:
            self.calibrator = self._start(raw)
        if self.state is None:
            contacts = ("stance", "swing")
            parts = {k: np.array(v, bool if k in contacts else float) for k, v in sample["reference"].items()}
            reference = Reference(**parts)
        else:
            reference = self.state.reference(sample["time_s"])
        estimate = self.calibrator.update(raw, reference, dt)
        answer = {"time_s": sample["time_s"], "force_N": estimate.force.tolist()}
        answer |= {
            "vgrf_N": estimate.vgrf.tolist(),
            "cop_m": estimate.cop.tolist() if estimate.cop_valid else None,
        }
        return answer | {"flags": [str(Flag(flag).name) if flag else "" for flag in estimate.flags.tolist()]}

    def _start(self, raw: np.ndarray) -> FootCalibrator:
        """Make the calibrator, by the first reading of the feet."""
        facts, state = self.facts, self.state
        scale, offset = facts.nominal
        evenly = facts.mass_kg * GRAVITY / len(raw) - scale * np.nan_to_num(raw)
        start = Parameters(scale, np.where(np.isnan(offset), evenly, offset))
        lag = facts.lag_samples if state is None else state.lag
        return FootCalibrator(
            facts.layout, self.method, initial=start, mass=facts.mass_kg, dt=self.dt, lag=lag
        )


def run(lines: Iterable[str], answer: Callable[[str], None], method: str = "moment") -> np.ndarray:
    """Calibrate sample by sample.

    Returns:
        Seconds from when each sample was sent (``sent_s``, if the sender shares the clock), or else was read,
        to when its answer was on its way.
    """
    stream, latency, before = iter(lines), [], None
    robot = LiveRobot(json.loads(next(stream)), method)
    for line in stream:
        if not line.strip():
            break
        read = time.monotonic()
        sample = json.loads(line)
        found = robot.take(sample, None if before is None else sample["time_s"] - before)
        if found is not None:
            before = sample["time_s"]
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
