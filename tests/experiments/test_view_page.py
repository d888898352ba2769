"""The page does what a browser asks for, and nothing else. A real browser asks too."""

import json
import shutil
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pandas as pd
import pytest
from _logs import fails, redescribe

from surefoot.experiments.logs.format import Log, read_log, write_log
from surefoot.experiments.logs.table import LogError
from surefoot.experiments.view.rows import LogFeet, RowSocket, StreamFeet
from surefoot.experiments.view.session import Session
from surefoot.experiments.view.shown import WAYS
from surefoot.experiments.walks.replay import replay_log, starting_map

pytest.importorskip("viser", reason="the extra 'view' (viser) is not installed")
from surefoot.experiments.view.page import LivePage, Page
from surefoot.experiments.view.scene import close_server, open_server

STAND = "surefoot/NaoStand-v0"


@pytest.fixture
def server() -> Iterator[Any]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    opened = open_server("127.0.0.1", port, "surefoot")
    yield opened
    close_server(opened)


@pytest.fixture
def page(server: Any, tmp_path: Path) -> Iterator[Any]:
    made = LivePage(server, Session(STAND, seed=1), folder=tmp_path / "made")
    yield made
    made.session.close()


def test_wrong_arguments_end_in_one_line() -> None:
    fails(
        ["view", "--log", "gone.parquet"],
        "gone.parquet: no such file; 'surefoot demo' records logs under out/demo/logs.",
    )
    fails(
        ["view", "--feed", "weights"],
        "'weights' is a feed of evaluations; the page begins on the nominal map.",
    )
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        fails(
            ["view", STAND, "--port", port],
            f"port {port} of 127.0.0.1 is in use or not yours; choose another with --port {port + 1}.",
        )


def test_it_serves_the_loopback_and_no_files(page: Any) -> None:
    address = f"http://127.0.0.1:{page.server.get_port()}"
    assert page.server.get_host() == "127.0.0.1"
    assert b"<html" in urlopen(address, timeout=10).read()
    for path in ("/../../../../../../etc/passwd", "/%2e%2e/%2e%2e/__init__.py", "//etc/passwd"):
        with pytest.raises(HTTPError):
            urlopen(address + path, timeout=10)
    assert page.server.request_share_url() is None  # the library would open a tunnel


def test_requests_are_done(page: Any) -> None:
    for severity in (3.0, 2.0):
        page.request("severity", severity)
    page.request("scale", (1, 0.5))
    page.request("scale", (2, 0.1))
    page.request("fault", "left/2 dies")
    page.run(0.5)
    session = page.session
    assert session.settings["severity"] == 2.0
    assert session.errors.scale.tolist() == [0.0, 0.5, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert page.message == "Broken: left/2 dies"
    assert session.steps > 5
    # Only the last value of a slider counts.
    assert [change.what for change in session.changes].count("severity") == 2
    page.request("pause", True)
    page.run(0.1)
    steps = session.steps
    page.request("step")
    page.run(0.2)
    assert session.steps == steps + 1
    page.request("power_up", 7)
    page.run(0.1)
    assert (session.seed, session.steps, session.errors.faults) == (7, 0, ())
    assert not session.errors.scale.any()


def test_nonsense_is_reported_and_nothing_breaks(page: Any) -> None:
    nonsense = [("severity", "<b>"), ("severity", None), ("scale", 1), ("fault", 5), ("power_up", "x")]
    for what, value in [*nonsense, ("rm", "-rf"), ("push", 1)]:
        page.message = ""
        page.request(what, value)
        page.run(0.1)
        assert page.message
    assert page.session.steps > 0


def test_a_fallen_robot_is_reset(page: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("surefoot.experiments.view.page.LYING", 0.1)
    page.request("push", (4.0, 0.0))
    for _ in range(100):
        page.run(0.1)
        if any(change.what == "reset" for change in page.session.changes):
            break
    assert page.session.changes[-1].what == "reset"
    assert not page.session.fell


def test_recordings_go_into_the_folder_of_the_command(page: Any, tmp_path: Path) -> None:
    for _ in range(2):
        page.request("record", "/tmp/elsewhere.parquet")
        page.run(0.4)
        page.request("record")
        page.run(0.1)
    files = sorted((tmp_path / "made").iterdir())
    assert [file.name for file in files] == ["naostand-v0-seed1-1.parquet", "naostand-v0-seed1-2.parquet"]
    assert len(read_log(files[1])) > 5
    assert f"surefoot view --log {files[1]}" in page.commands.content


def test_a_log_is_played(server: Any, log: Log) -> None:
    # Browsers draw with single precision, in which times since 1970 would be equal.
    feet = LogFeet(replace(log, time=1.75e9 + log.time), "none")
    page = Page(server, feet)
    page.run(0.4)
    assert 5 < feet.rows <= len(log)
    assert log.truth is not None
    assert feet.shown is not None
    np.testing.assert_allclose(feet.shown.readings["raw"].force, log.truth.force[feet.rows - 1], atol=1e-6)
    assert feet.shown.cop_error("raw") < 1e-3
    time, *forces = page.meters.columns()
    assert (np.diff(time.astype(np.float32)) > 0.0).all()
    assert np.isfinite(forces[WAYS.index("raw")]).all()
    page.request("method", "tare")
    page.run(0.1)
    assert (feet.method, feet.rows < 30) == ("tare", True)
    page.request("method", "guess")
    page.run(0.1)
    assert page.message.startswith("Method 'guess' does not exist.")


def test_one_plate_is_shown_as_a_log_and_as_a_stream(tmp_path: Path) -> None:
    time = np.arange(400) / 100.0
    load = 500.0 * (time > 1.5)[:, None] * [0.3, 0.2, 0.5]
    counts = np.rint(1e3 * load + 2e4 + np.random.default_rng(0).normal(0.0, 30.0, load.shape))
    table = pd.DataFrame(counts, columns=[f"raw_plate_{cell}_count" for cell in "abc"])
    table.insert(0, "time_s", time)
    table.to_csv(tmp_path / "plate.csv", index=False)
    places: dict[str, Any] = {"name": "plate", "channel_names": ["a", "b", "c"]}
    places |= {"position_cell_sole_m": [[0.2, 0.1], [0.2, -0.1], [-0.2, 0.0]]}
    facts: dict[str, Any] = {
        "format": "surefoot-log",
        "format_version": 1,
        "lag_samples": 0,
        "mass_kg": 51.0,
        "dt_s": 0.01,
    }
    facts |= {"layout": [places], "nominal": {"scale_N_per_count": [1e-3] * 3, "offset_N": [-20.0] * 3}}
    (tmp_path / "plate.json").write_text(json.dumps(facts))
    played = LogFeet(read_log(tmp_path / "plate.csv", feet_alone=True), "tare")
    played.advance(10.0)
    with pytest.raises(LogError, match="'moment' needs a robot's motion"):
        played.choose("moment")
    stream = StreamFeet(tmp_path / "plate.json", "tare")
    for row in table.to_dict("records"):
        stream.take_line(json.dumps(row).encode())
    for feet in (played, stream):
        assert feet.shown is not None
        assert feet.shown.readings["calibrated"].vgrf == pytest.approx([500.0], abs=1.0)


def rows_of(log: Log, count: int) -> list[bytes]:
    """Make the stream of a log: its columns, row by row."""
    frame = log.to_pandas().iloc[:count]
    frame = frame[[name for name in frame if not name.startswith("truth_")]]
    return [line.encode() for line in frame.to_json(orient="records", lines=True).splitlines()]


@pytest.fixture
def described(log: Log, tmp_path: Path) -> Path:
    write_log(log, tmp_path / "walk.csv")
    return tmp_path / "walk.json"


def test_a_log_and_its_stream_are_calibrated_as_in_a_replay(log: Log, described: Path) -> None:
    played, stream = LogFeet(log, "tare"), StreamFeet(described, "tare")
    for line in rows_of(log, 40):
        stream.take_line(line)
    played.advance(39.5 * log.dt)
    estimate = replay_log(log, "tare", starting_map(log, "nominal"))
    for feet in (played, stream):
        assert feet.rows == 40
        assert feet.shown is not None
        for way, force in (("calibrated", estimate.force[39]), ("raw", starting_map(log).force(log.raw[39]))):
            np.testing.assert_allclose(feet.shown.readings[way].force, force, atol=1e-5)
        np.testing.assert_allclose(feet.shown.position_sole, log.reference.position_sole[39])


def test_a_stream_of_feet_alone(log: Log, described: Path) -> None:
    feet = StreamFeet(described, "moment")
    rows = [
        json.dumps({k: v for k, v in json.loads(line).items() if not k.startswith("reference_")}).encode()
        for line in rows_of(log, 20)
    ]
    with pytest.raises(LogError, match="'moment' needs a robot's motion, and these rows are of feet alone"):
        feet.take_line(rows[0])
    assert feet.shown is None
    feet.choose("tare")
    for row in rows:
        feet.take_line(row)
    assert feet.shown is not None
    assert np.isfinite(feet.shown.readings["calibrated"].cop_world).all()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"{", "The row"),
        (b"[1]", "The row must be a JSON object of columns, got list."),
        (b'{"time_s": "now"}', "'time_s' must be a number or null, got 'now'."),
        (b'{"time_s": null}', "'time_s' must be a number, got null."),
        (b'{"raw_left": 1}', "The row lacks 'time_s'; it has 1 columns."),
    ],
)
def test_an_invalid_row_is_refused(log: Log, described: Path, line: bytes, message: str) -> None:
    feet = StreamFeet(described, "tare")
    feet.take_line(rows_of(log, 1)[0])
    with pytest.raises(LogError) as refused:
        feet.take_line(line)
    assert str(refused.value).startswith(message)
    assert feet.rows == 1


def test_a_description_without_a_step_is_refused(described: Path) -> None:
    redescribe(described, dt_s=None)
    with pytest.raises(LogError, match="a stream needs 'dt_s'"):
        StreamFeet(described, "tare")


def test_rows_arrive_by_udp(server: Any, log: Log, described: Path) -> None:
    rows = RowSocket("127.0.0.1", 0)
    with pytest.raises(OSError, match=f"UDP port {rows.port} of 127.0.0.1 cannot be opened"):
        RowSocket("127.0.0.1", rows.port)
    feet = StreamFeet(described, "none", rows)
    page = Page(server, feet)
    page.run(0.05)
    assert feet.status.startswith("Waiting for rows")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        for line in [*rows_of(log, 10), b"junk"]:
            robot.sendto(line, ("127.0.0.1", rows.port))
        page.run(0.2)
    assert feet.rows == 10
    assert page.message.startswith("The row")
    rows.close()


@pytest.mark.slow
def test_in_a_browser(page: Any) -> None:
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    options = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    thread = threading.Thread(target=page.run, daemon=True)
    with api.sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=found, args=options)
        except api.Error as error:
            pytest.skip(f"no browser can be started: {error}")
        thread.start()
        try:
            # A small page, because a frame takes seconds without a graphics card.
            tab = browser.new_page(viewport={"width": 1000, "height": 800}, device_scale_factor=0.4)
            tab.set_default_timeout(90_000)
            tab.goto(f"http://127.0.0.1:{page.server.get_port()}")
            tab.wait_for_selector("text=flagged: nothing")
            # The second number is that of the severity, after the pace and the seed.
            number = tab.get_by_label("severity").first
            number.fill("3")
            number.press("Enter")
            tab.get_by_role("button", name="break it").click()
            tab.wait_for_selector("text=left/front-left dead, lost")
            browser.close()
            # The robot continues after the browser has left.
            steps = page.session.steps
            thread.join(2.0)
        finally:
            page.stop()
            thread.join(10.0)
    assert page.session.steps > steps
    assert page.session.errors.faults == ("left/front-left dies",)
