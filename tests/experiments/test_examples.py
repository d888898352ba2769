"""The examples of a live loop: a log sent over a socket or a growing file comes out as a replay has it."""

import json
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import surefoot
from surefoot.calibration import GRAVITY, replay
from surefoot.experiments.logs.format import Log


@pytest.fixture
def examples(load_script: Callable[[str], ModuleType]) -> tuple[ModuleType, ...]:
    return tuple(load_script(f"examples/{name}.py") for name in ("live_loop", "send_log"))


def expected(log: Log, method: str) -> np.ndarray:
    steps = np.diff(log.time, prepend=log.time[0] - log.dt)
    options = {"mass": log.mass, "initial": log.nominal, "lag": log.lag}
    return replay(log.layout, method, log.raw, log.reference, steps, **options).force


def test_a_socket_carries_a_log_there_and_back(examples: Any, log: Log) -> None:
    live_loop, send_log = examples
    with socket.create_server(("127.0.0.1", 0)) as door:
        seconds: list[np.ndarray] = []
        server = threading.Thread(target=lambda: seconds.append(live_loop.serve(door, "tare")))
        server.start()
        answers: list[dict] = []
        with socket.create_connection(door.getsockname()) as link, link.makefile("r") as lines:
            sent = send_log.send(
                log,
                lambda text: link.sendall(text.encode()),
                lambda: answers.append(json.loads(lines.readline())),
                fast=True,
            )
        server.join(timeout=30.0)
    assert sent == len(log)
    assert len(seconds[0]) == len(log)
    assert (seconds[0] > 0.0).all()
    np.testing.assert_allclose([a["force_N"] for a in answers], expected(log, "tare"), atol=1e-9)
    assert [a["time_s"] for a in answers] == log.time.tolist()


def test_a_missing_reading_is_answered_with_its_flag(examples: Any, log: Log) -> None:
    live_loop, send_log = examples
    log.raw[5, 2] = np.nan
    lines: list[str] = []
    send_log.send(log, lines.append, lambda: None, fast=True)
    answers: list[str] = []
    live_loop.run(lines, answers.append, "none")
    found = json.loads(answers[5])
    assert found["flags"] == ["", "", "MISSING", "", "", "", "", ""]
    assert np.isfinite(found["force_N"]).all()


def test_a_file_is_followed_as_it_grows_even_in_pieces_of_lines(
    examples: Any, log: Log, tmp_path: Path
) -> None:
    live_loop, send_log = examples
    lines: list[str] = []
    send_log.send(log, lines.append, lambda: None, fast=True)
    text = "".join(lines)
    path = tmp_path / "stream.jsonl"
    path.touch()

    def write() -> None:
        with path.open("a", encoding="utf-8", buffering=1) as file:
            for piece in range(0, len(text), 5000):
                file.write(text[piece : piece + 5000])
                file.flush()
                time.sleep(0.001)

    writer = threading.Thread(target=write)
    writer.start()
    answers: list[str] = []
    seconds = live_loop.run(live_loop.follow(path), answers.append, "none")
    writer.join(timeout=30.0)
    assert len(seconds) == len(log)
    np.testing.assert_allclose([json.loads(a)["force_N"] for a in answers], expected(log, "none"), atol=1e-9)


def test_a_file_that_stops_growing_ends_the_loop(examples: Any, tmp_path: Path) -> None:
    live_loop, _ = examples
    path = tmp_path / "stream.jsonl"
    path.write_text("one\ntwo\nthr")
    assert list(live_loop.follow(path, patience=0.02)) == ["one\n", "two\n"]


def test_the_smallest_description_is_enough(examples: Any, tmp_path: Path) -> None:
    """A NAO that stands on cells that read from another zero: a model, joints, an IMU and counts."""
    live_loop, _ = examples
    nao = Path(surefoot.__file__).parents[1] / "envs" / "robots" / "nao.xml"
    x, y = np.array([0.109, 0.109, -0.061, -0.061]), np.array([0.05, -0.05, 0.05, -0.05])
    places = np.column_stack([x, y]).tolist()
    description = {
        "format": "surefoot-log", "format_version": 1, "mass_kg": 5.3,
        "layout": [{"name": name, "position_cell_sole_m": places} for name in ("left", "right")],
        "nominal": {"scale_N_per_count": [2e-5] * 8},
        "motion": {"model": str(nao), "torso": "torso", "imu": "imu", "soles": ["left_sole", "right_sole"],
                   "dt_s": 0.01},
    }  # fmt: skip
    lines = [json.dumps(description)]
    for k in range(200):
        imu = {"gyroscope_rad_s": [0.0] * 3, "accelerometer_m_s2": [0.0, 0.0, GRAVITY]}
        lines.append(json.dumps({"time_s": 0.01 * k, "joint_rad": [0.0] * 24, **imu}))
        if k % 2:
            lines.append(json.dumps({"time_s": 0.01 * k, "raw": [700000.0] * 8}))
    answers: list[str] = []
    live_loop.run(lines, answers.append)
    found = json.loads(answers[-1])
    assert len(answers) == 100
    assert sum(found["vgrf_N"]) == pytest.approx(5.3 * GRAVITY, rel=0.02)
    assert found["cop_m"] is not None
