"""The page: what a browser asks for is done, and nothing else; a real one is asked too."""

import dataclasses
import json
import shutil
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pandas as pd
import pytest
from _logs import fails, redescribe

from surefoot.experiments.logs.format import Log, LogError, read_log, write_log
from surefoot.experiments.view.session import Session
from surefoot.experiments.walks.replay import replay_log, starting_map

pytest.importorskip("viser", reason="the extra 'view' (viser) is not installed")
from surefoot.experiments.view.page import Page
from surefoot.experiments.view.player import LogFeet, LogPage
from surefoot.experiments.view.server import address_of, close_server, open_server
from surefoot.experiments.view.shown import WAYS
from surefoot.experiments.view.stream import RowSocket, StreamFeet, StreamPage

STAND = "surefoot/NaoStand-v0"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@pytest.fixture
def server() -> Iterator[Any]:
    opened = open_server("127.0.0.1", free_port(), "surefoot")
    yield opened
    close_server(opened)


@pytest.fixture
def page(server: Any, tmp_path: Path) -> Iterator[Any]:
    made = Page(server, Session(STAND, seed=1), folder=tmp_path / "made")
    yield made
    made.session.close()


def test_wrong_arguments_end_in_one_line(log: Log, tmp_path: Path) -> None:
    fails(
        ["view", "--log", "gone.parquet"],
        "gone.parquet: no such file; 'surefoot demo' records logs under out/demo/logs.",
    )
    fails(["view", "--feed", "weights"], "'weights' is a feed of films; the page begins on the nominal map.")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        fails(
            ["view", STAND, "--port", port],
            f"port {port} of 127.0.0.1 is in use or not yours; choose another with --port {port + 1}.",
        )


def test_it_is_bound_to_the_loopback_and_serves_no_files(page: Any) -> None:
    address = address_of(page.server)
    assert address == f"http://127.0.0.1:{page.server.get_port()}"
    assert b"<html" in urlopen(address, timeout=10).read()
    for path in ("/../../../../../../etc/passwd", "/%2e%2e/%2e%2e/__init__.py", "//etc/passwd"):
        with pytest.raises(HTTPError):
            urlopen(address + path, timeout=10)
    # The library would open a tunnel for whoever asks.
    assert page.server.request_share_url() is None


def test_what_is_asked_for_is_done(page: Any) -> None:
    page._asked.put(("severity", 3.0))
    page._asked.put(("severity", 2.0))
    page._asked.put(("scale", (1, 0.5)))
    page._asked.put(("scale", (2, 0.1)))
    page._asked.put(("fault", "left/2 dies"))
    page.run(0.5)
    session = page.session
    assert session.settings["severity"] == 2.0
    assert session.errors.scale.tolist() == [0.0, 0.5, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert page._told == "Broken: left/2 dies"
    assert session.steps > 5
    # Of a slider that is drawn only the last value counts.
    assert [change.what for change in session.changes].count("severity") == 2

    page._asked.put(("pause", True))
    page.run(0.1)
    steps = session.steps
    page._asked.put(("step", None))
    page.run(0.2)
    assert session.steps == steps + 1
    page._asked.put(("power_up", 7))
    page.run(0.1)
    assert (session.seed, session.steps, session.errors.faults) == (7, 0, ())
    assert not session.errors.scale.any()


@pytest.mark.parametrize(
    ("what", "value"),
    [
        ("severity", "<b>"),
        ("severity", None),
        ("scale", 1),
        ("fault", 5),
        ("power_up", "x"),
        ("rm", "-rf"),
        ("push", 1),
    ],
)
def test_nonsense_is_told_and_nothing_breaks(page: Any, what: str, value: Any) -> None:
    page._asked.put((what, value))
    page.run(0.15)
    assert page._told
    assert "<b>" not in page._meters._table.content
    assert page.session.steps > 0


def test_a_robot_that_fell_gets_up_again(page: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("surefoot.experiments.view.page.LYING", 0.1)
    page._asked.put(("push", (4.0, 0.0)))
    for _ in range(100):
        page.run(0.1)
        if any(change.what == "reset" for change in page.session.changes):
            break
    assert page.session.changes[-1].what == "reset"
    assert not page.session.fell


def test_a_recording_goes_into_the_folder_of_the_command(page: Any, tmp_path: Path) -> None:
    for _ in range(2):
        page._asked.put(("record", "/tmp/elsewhere.parquet"))
        page.run(0.4)
        page._asked.put(("record", None))
        page.run(0.1)
    files = sorted((tmp_path / "made").iterdir())
    assert [file.name for file in files] == ["naostand-v0-seed1-1.parquet", "naostand-v0-seed1-2.parquet"]
    assert len(read_log(files[1])) > 5
    assert f"surefoot view --log {files[1]}" in page._panel.commands.content


def test_a_log_is_played_and_searched(server: Any, log: Log) -> None:
    feet = LogFeet(log, "none")
    shown = feet.state_to_draw(30)
    assert log.truth is not None
    np.testing.assert_allclose(shown.readings["raw"].force, log.truth.force[30], atol=1e-6)
    assert shown.cop_error("raw") < 1e-3
    page = LogPage(server, feet)
    page.run(0.2)
    played = page._drawn
    assert played > 5
    page._play.value = False
    page._asked.put(("time", float(log.time[2])))
    page._asked.put(("method", "tare"))
    page.run(0.1)
    assert page._drawn == 2
    assert feet.method == "tare"
    page._asked.put(("method", "guess"))
    page.run(0.1)
    assert page._told.startswith("Method 'guess' does not exist.")


def test_a_log_with_times_since_1970_is_drawn(server: Any, log: Log) -> None:
    """Browsers draw with single precision, in which two of these times are the same."""
    late = dataclasses.replace(log, time=1.75e9 + log.time)
    page = LogPage(server, LogFeet(late, "none"))
    page._play.value = False
    for i in range(12):
        page._now = float(log.time[i])
        page.draw()
    time, *forces = page._meters._columns()
    assert len(time) > 2
    assert (np.diff(time.astype(np.float32)) > 0.0).all()
    assert np.isfinite(forces[WAYS.index("raw")]).all()


def test_one_plate_is_shown_as_a_log_and_as_a_stream(server: Any, tmp_path: Path) -> None:
    time = np.arange(400) / 100.0
    load = 500.0 * (time > 1.5)[:, None] * [0.3, 0.2, 0.5]
    counts = np.rint(1e3 * load + 2e4 + np.random.default_rng(0).normal(0.0, 30.0, load.shape))
    table = pd.DataFrame(counts, columns=[f"raw_plate_{cell}_count" for cell in "abc"])
    table.insert(0, "time_s", time)
    table.to_csv(tmp_path / "plate.csv", index=False)
    places = {"name": "plate", "channel_names": ["a", "b", "c"]}
    places |= {"position_cell_sole_m": [[0.2, 0.1], [0.2, -0.1], [-0.2, 0.0]]}
    told = {"format": "surefoot-log", "format_version": 1, "lag_samples": 0, "mass_kg": 51.0, "dt_s": 0.01}
    told |= {"layout": [places], "nominal": {"scale_N_per_count": [1e-3] * 3, "offset_N": [-20.0] * 3}}
    (tmp_path / "plate.json").write_text(json.dumps(told))
    feet = LogFeet(read_log(tmp_path / "plate.csv", feet_alone=True), "tare")
    LogPage(server, feet).run(0.1)
    assert feet.state_to_draw(399).readings["calibrated"].vgrf == pytest.approx([500.0], abs=1.0)
    with pytest.raises(LogError, match="'moment' needs a robot's motion"):
        feet.choose("moment")
    stream = StreamFeet(tmp_path / "plate.json", "none")
    for row in table.to_dict("records"):
        stream.take(json.dumps(row).encode())
    assert stream.shown is not None
    assert stream.shown.readings["raw"].vgrf == pytest.approx([500.0], abs=1.0)


def rows_of(log: Log, count: int) -> list[bytes]:
    """Make the stream of a log: its columns, row by row."""
    frame = log.to_pandas().iloc[:count]
    frame = frame[[name for name in frame if not name.startswith("truth_")]]
    return [line.encode() for line in frame.to_json(orient="records", lines=True).splitlines()]


@pytest.fixture
def described(log: Log, tmp_path: Path) -> Path:
    write_log(log, tmp_path / "walk.csv")
    return tmp_path / "walk.json"


def test_a_stream_is_read_as_the_log_is(log: Log, described: Path) -> None:
    feet = StreamFeet(described, "tare")
    for line in rows_of(log, 40):
        feet.take(line)
    estimate = replay_log(log, "tare", starting_map(log, "nominal"))
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
        feet.take(rows[0])
    assert feet.shown is None
    feet.choose("tare")
    for row in rows:
        feet.take(row)
    assert feet.shown is not None
    assert np.isfinite(feet.shown.readings["calibrated"].cop_world).all()


@pytest.mark.parametrize(
    ("line", "told"),
    [
        (b"{", "The row"),
        (b"[1]", "The row must be a JSON object of columns, got list."),
        (b'{"time_s": "now"}', "'time_s' must be a number or null, got 'now'."),
        (b'{"time_s": null}', "'time_s' must be a number, got null."),
        (b'{"raw_left": 1}', "The row lacks 'time_s'; it has 1 columns."),
    ],
)
def test_a_row_that_is_none_is_told(log: Log, described: Path, line: bytes, told: str) -> None:
    feet = StreamFeet(described, "tare")
    feet.take(rows_of(log, 1)[0])
    with pytest.raises(LogError) as refused:
        feet.take(line)
    assert str(refused.value).startswith(told)
    assert feet.rows == 1


def test_a_description_without_a_step_is_refused(described: Path) -> None:
    redescribe(described, dt_s=None)
    with pytest.raises(LogError, match="a stream needs 'dt_s'"):
        StreamFeet(described, "tare")


def test_rows_come_by_udp(server: Any, log: Log, described: Path) -> None:
    rows = RowSocket("127.0.0.1", 0)
    with pytest.raises(OSError, match=f"UDP port {rows.port} of 127.0.0.1 cannot be listened to"):
        RowSocket("127.0.0.1", rows.port)
    page = StreamPage(server, StreamFeet(described, "none"), rows)
    page.run(0.05)
    assert page._told.startswith("Waiting for rows")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        for line in [*rows_of(log, 10), b"junk"]:
            robot.sendto(line, ("127.0.0.1", rows.port))
        page.run(0.2)
    assert page.feet.rows == page._drawn == 10
    assert page._told.startswith("The row")
    page._asked.put(("method", "tare"))
    page.run(0.1)
    assert page.feet.method == "tare"
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
            # Few pixels: where there is no graphics card, a frame takes seconds.
            ask_as_a_user(
                browser.new_page(viewport={"width": 1000, "height": 800}, device_scale_factor=0.4),
                f"http://127.0.0.1:{page.server.get_port()}",
            )
            browser.close()
            # The browser has left, and the robot goes on.
            steps = page.session.steps
            thread.join(2.0)
        finally:
            page.stop()
            thread.join(10.0)
    assert page.session.steps > steps
    # Words are drawn into the picture, where no browser can be asked for them.
    label = page._board._labels[0]
    assert (label.visible, label.text) == (True, "left/front-left: dead, lost")
    assert page.session.errors.faults == ("left/front-left dies",)
    assert page.session.settings["severity"] == 3.0


def ask_as_a_user(tab: Any, address: str) -> None:
    tab.set_default_timeout(90_000)
    tab.goto(address)
    tab.wait_for_selector("text=flagged: nothing")
    tab.get_by_role("tab", name="Sensors").click()
    # The number at the slider of the severity, the first of this tab.
    number = tab.locator("input[type=text]").filter(visible=True).first
    number.fill("3")
    number.press("Enter")
    tab.get_by_role("button", name="break it").click()
    tab.wait_for_selector("text=left/front-left dead, lost")
