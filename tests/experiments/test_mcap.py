"""Samples in an MCAP file, read back by the library that others read it with."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from _logs import fails, run

from surefoot.calibration import FootCalibrator
from surefoot.experiments import write_log
from surefoot.experiments.logs.columns import channel_slugs
from surefoot.experiments.logs.format import Log
from surefoot.experiments.logs.table import LogError

reader = pytest.importorskip("mcap.reader", reason="the extra mcap is not installed")


def messages(path: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """Stamps and contents of all messages, by topic."""
    found: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages():
            assert schema.encoding == "jsonschema"
            assert channel.message_encoding == "json"
            content = json.loads(message.data)
            assert list(content) == list(json.loads(schema.data)["properties"])
            found.setdefault(channel.topic, []).append((message.log_time, content))
    return found


def test_a_log_is_read_back(log: Log, tmp_path: Path) -> None:
    log.raw[7, 2] = np.nan
    walk, path = write_log(log, tmp_path / "walk.parquet"), tmp_path / "walk.mcap"
    result = run("view", "--log", walk, "--feed", "none", "--mcap", path)
    assert result.stdout == f"MCAP: {path}\n"
    pytest.importorskip("rosbags")
    fails(
        ["check", path],
        "walk.mcap: is MCAP, but no bag of ROS 2; record it by `ros2 bag`, or export a table.",
    )
    found = messages(path)
    assert set(found) == {"/readings", "/force", "/cop", "/flags"}
    names = channel_slugs(log.layout)
    calibrator = FootCalibrator(
        log.layout, "none", mass=log.mass, initial=log.nominal, dt=log.dt, lag=log.lag
    )
    for i, raw in enumerate(log.raw):
        reference = type(log.reference)(*(np.asarray(part)[i] for part in log.reference))
        estimate = calibrator.update(raw, reference)
        at = {topic: rows[i][1] for topic, rows in found.items()}
        assert {rows[i][0] for rows in found.values()} == {round(1e9 * log.time[i])}
        assert [at["/readings"][name] for name in names] == [None if np.isnan(x) else x for x in raw]
        force = np.array([at["/force"][name] for name in names], dtype=float)
        np.testing.assert_allclose(force, estimate.force, atol=1e-9)
        assert at["/force"]["vgrf_left_N"] == pytest.approx(float(estimate.vgrf[0]))
        assert [at["/flags"][name] for name in names] == estimate.flags.tolist()
        if estimate.cop_valid:
            level = [at["/cop"]["level_x_m"], at["/cop"]["level_y_m"]]
            np.testing.assert_allclose(level, estimate.cop, atol=1e-9)


def test_a_stream_is_read_back(log: Log, tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the extra view is not installed")
    from surefoot.experiments.logs.mcap import open_mcap
    from surefoot.experiments.view.stream import StreamFeet

    described = write_log(log, tmp_path / "walk.csv").with_suffix(".json")
    feet = StreamFeet(described, "tare")
    names = channel_slugs(log.layout)
    with open_mcap(tmp_path / "run.mcap", feet.layout) as feet.keep:
        for time, raw in zip(log.time[:5], log.raw, strict=False):
            row = dict(zip((f"raw_{name}_count" for name in names), raw, strict=True))
            feet.take(json.dumps({"time_s": time, **row}).encode())
        assert not (tmp_path / "run.mcap").exists()
    found = messages(tmp_path / "run.mcap")
    assert [len(rows) for rows in found.values()] == [5] * 4
    np.testing.assert_array_equal([list(one.values()) for _, one in found["/readings"]], log.raw[:5])


def test_what_cannot_be_written_is_refused_and_leaves_nothing(log: Log, tmp_path: Path) -> None:
    from surefoot.experiments.logs.mcap import write_mcap

    early = type(log)(**{**vars(log), "time": log.time - 1.0})
    with pytest.raises(
        LogError, match="The time -1 s cannot stand in an MCAP file, which counts from 0 s on"
    ):
        write_mcap(tmp_path / "walk.mcap", early, "none", log.nominal)
    assert list(tmp_path.iterdir()) == []
    result = run("view", "--mcap", tmp_path / "walk.mcap", code=2)
    assert "--mcap takes what --stream or --log shows; give one of them." in result.stderr
