"""The command: what it says, and that it says it in one line with a cure when something is wrong."""

import ast
import importlib.util
import io
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import typer
from _logs import fails, run, run_for_json
from rich.console import Console
from typer.testing import CliRunner

import surefoot
from surefoot import __main__
from surefoot.experiments.cli.app import app
from surefoot.experiments.logs.format import Log, write_log
from surefoot.experiments.study import progress
from surefoot.experiments.study.tables import Table, decimal, number
from surefoot.names import page

COMMANDS = ("demo", "view", "check", "calibrate", "train", "evaluate")


def test_version_and_help() -> None:
    assert run("--version").stdout == f"surefoot {surefoot.__version__}\n"
    shown = run("--help").stdout
    places = [shown.find(f"│ {command} ") for command in COMMANDS]
    assert places == sorted(places)
    assert places[0] > 0


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "from surefoot.__main__ import main\n"
        "sys.argv = ['surefoot', '--help']\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print(sorted({name.partition('.')[0] for name in sys.modules}), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"numpy", "scipy", "pandas", "pyarrow", "matplotlib", "jinja2", "joblib", "gymnasium", "mujoco"}
    assert heavy & set(ast.literal_eval(done.stderr)) == set()
    assert "calibrate" in done.stdout


def test_a_calibrated_walk_as_json(log: Log, tmp_path: Path, undrawn: None) -> None:
    path = write_log(log, tmp_path / "walk.parquet")
    new = tmp_path / "new"
    said = run_for_json("calibrate", "walk", path, "--method", "tare", "--out", new)
    ends = {"calibrated walk": "parquet", "parameters": "json", "report": "html"}
    assert said["files"] == {what: str(new / f"walk.tare.{end}") for what, end in ends.items()}
    first = said["tables"]["parameters"]["rows"][0]
    assert first["cell"] == "left, front-left"
    assert (first["offset (N)"], first["offset changed by (N)"]) == (-160.0, 0.0)
    assert said["tables"]["flags"]["rows"][0]["on"] is None
    scores = said["tables"]["score"]["rows"]
    walk = pd.read_parquet(new / "walk.tare.parquet")
    assert log.truth is not None
    assert scores[0]["single cell (N)"] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(walk["force_right_rear_right_N"], log.truth.force[:, 7], atol=1e-6)
    np.testing.assert_allclose(walk["vgrf_left_N"], log.truth.force[:, :4].sum(axis=1), atol=1e-6)


def test_weights_as_json(tmp_path: Path) -> None:
    load = np.array([0.0, 0.01, 0.05, 0.2, 1.0])
    table = pd.DataFrame({"load_kg": load, "raw_left_front_left_count": 8.3e6 - 4e5 * load})
    table.to_csv(tmp_path / "scales.csv", index=False)
    said = run_for_json("calibrate", "weights", tmp_path / "scales.csv")
    (row,) = said["tables"]["weighings"]["rows"]
    assert row["scale (1e-6 N/count), ± one sigma"]["value"] == pytest.approx(-9.81 / 0.4, rel=1e-12)
    files = {"map": "scales.map.json", "report": "scales.map.html"}
    assert said["files"] == {name: str(tmp_path / file) for name, file in files.items()}
    found = json.loads((tmp_path / "scales.map.json").read_text())
    assert found["channels"] == ["left_front_left"]
    assert found["scale_N_per_count"][0] == pytest.approx(-9.81 / 4e5)


def test_every_command_that_prints_a_table_prints_json() -> None:
    def named(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
        for name, inner in getattr(command, "commands", {}).items():
            yield from named(inner, (*path, name))
        if not hasattr(command, "commands"):
            yield path, command

    options = {
        path: {option for parameter in command.params for option in parameter.opts}
        for path, command in named(typer.main.get_command(app))
    }
    assert {path for path, known in options.items() if "--json" not in known} == {("train",), ("view",)}
    assert run("calibrate", "weights", "gone.csv", "--json", code=2).stdout == ""


def test_headings_that_are_twice_there_are_numbered_in_json() -> None:
    table = Table("t", "T", ("what", "paper", "paper"), (("a", number(1), decimal(np.inf)),))
    assert table.to_plain()["rows"] == [{"what": "a", "paper": 1, "paper (2)": None}]


def test_progress_is_shown_on_a_terminal_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    for terminal in (True, False):
        seen = io.StringIO()
        shown = Console(file=seen, force_terminal=terminal, width=100)
        monkeypatch.setattr(progress, "Console", lambda stderr, shown=shown: shown)
        assert list(progress.each("counting", range(3))) == [0, 1, 2]
        with progress.working("thinking") as then:
            then("writing")
        words = {word for word in ("counting", "3/3", "writing") if word in seen.getvalue()}
        assert words == ({"counting", "3/3", "writing"} if terminal else set())


def test_without_a_terminal_a_line_is_said_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "EVERY", 0.0)
    with progress.bars("{task.fields[said]}") as shown:
        task = shown.add_task("Episodes", total=3, said="")
        for done in range(1, 4):
            shown.update(task, advance=1, said=f"{done} fell")
    lines = capsys.readouterr().err.splitlines()
    assert [line.rpartition(", ")[0] or line for line in lines][1:] == [
        "Episodes: 2 of 3, 2 fell",
        "Episodes: 3 of 3, 3 fell",
    ]
    assert lines[0].startswith("Episodes: 1 of 3, 1 fell")


@pytest.mark.parametrize("module", ["typer", "mujoco._specs", "surefoot.experiments.evaluate.command"])
def test_an_interruption_ends_in_one_line(tmp_path: Path, module: str) -> None:
    """Ctrl-C comes when a module is about to be imported, of Python or of C, before or in the command."""
    code = (
        "import os, signal, sys\n"
        "from surefoot.__main__ import main\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it\n"
        "def heard(event, given):\n"
        f"    if event == 'import' and given[0] == {module!r}: os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.addaudithook(heard)\n"
        f"sys.argv = ['surefoot', 'evaluate', 'surefoot/NaoStand-v0', 'zero', '--out', {str(tmp_path)!r}]\n"
        "main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (done.stderr, done.stdout) == ("Stopped.\n", "")
    # CPython may end by the signal itself, which a shell calls 130 as well.
    assert done.returncode in (130, -signal.SIGINT)


def test_shells_complete_commands() -> None:
    asked = {"_SUREFOOT_COMPLETE": "complete_bash", "COMP_WORDS": "surefoot calibrate w", "COMP_CWORD": "2"}
    assert CliRunner().invoke(app, [], prog_name="surefoot", env=asked).stdout.split() == ["walk", "weights"]


@pytest.mark.parametrize(
    ("home", "address"),
    [
        ("https://github.com/OWNER/surefoot", "docs/weights.md"),
        ("https://some.where/surefoot", "https://some.where/surefoot/blob/v1.2/docs/weights.md"),
    ],
)
def test_a_page_has_an_address_as_soon_as_the_project_has_one(
    monkeypatch: pytest.MonkeyPatch, home: str, address: str
) -> None:
    about = {"Project-URL": f"Homepage, {home}", "Version": "1.2"}
    monkeypatch.setattr("surefoot.names.metadata", lambda name: about)
    assert page("weights") == address


def test_help_names_the_address_of_a_page() -> None:
    shown = run("calibrate", "weights", "--help").stdout
    assert page("weights") in "".join(shown.split())


def test_wrong_arguments_end_in_one_line(log: Log, tmp_path: Path) -> None:
    path = write_log(log, tmp_path / "walk.parquet")
    walk = ["calibrate", "walk"]
    fails(
        [*walk, "gone.parquet"],
        "gone.parquet: no such file; 'surefoot demo' records logs under out/demo/logs.",
    )
    fails(
        [*walk, path, "--method", "kalman"],
        "Method 'kalman' does not exist. Available: 'moment', 'window', 'quasi-static', 'tare', 'none'.",
    )
    fails(
        [*walk, path, "--start", "calibrated"],
        "The log's description has no 'calibrated' map; start from 'nominal', or add the map.",
    )
    fails([*walk, path, "--settle", "99"], "--settle must be shorter than the log's 0.7375 s, got 99.")
    fails(
        ["calibrate", "ft", "--sample", "--accept", " "],
        "--accept needs the reason to continue, which is stored in every file.",
    )
    fails(
        ["view", "--feed", "guess"],
        "There is no feed 'guess'. Available: 'true', 'none', 'weights', 'tare', 'quasi-static', 'window', "
        "'moment'.",
    )


BAD_WEIGHINGS = {
    "no weights": (
        {"raw_a_count": [1, 2]},
        "needs one column of weights, 'load_kg' or 'load_N', and has neither; there are 'raw_a_count' (if "
        "the separator is none of ',', ';' and tab, say csv.separator). Other names go under [columns] in "
        "scales.toml.",
    ),
    "two weights": (
        {"load_kg": [0, 1], "load_N": [0, 9.81], "raw_a_count": [1, 2]},
        "needs one column of weights, 'load_kg' or 'load_N', and has both; there are 'load_kg', 'load_N', "
        "'raw_a_count'. Other names go under [columns] in scales.toml.",
    ),
    "no readings": (
        {"load_kg": [0, 1], "cell": [1, 2]},
        "has no column 'raw_<cell>_count'; name each cell's readings so, e.g. 'raw_left_front_left_count'. "
        "Other names go under [columns] in scales.toml.",
    ),
    "words": (
        {"load_kg": [0, 1], "raw_a_count": ["x", "y"]},
        "column 'raw_a_count' holds 'x' at row 0, which is no number; leave the cell empty where no sample "
        "arrived, and check the separator and the decimal point.",
    ),
}


@pytest.mark.parametrize(("columns", "message"), BAD_WEIGHINGS.values(), ids=BAD_WEIGHINGS)
def test_bad_weighings_are_refused(tmp_path: Path, columns: dict[str, float], message: str) -> None:
    pd.DataFrame(columns).to_csv(tmp_path / "scales.csv", index=False)
    fails(["calibrate", "weights", tmp_path / "scales.csv"], f"scales.csv: {message}")


def test_one_weight_is_no_line(tmp_path: Path) -> None:
    pd.DataFrame({"load_N": [1.0, 1.0], "raw_a_count": [5, 6]}).to_csv(tmp_path / "scales.csv", index=False)
    result = run("calibrate", "weights", tmp_path / "scales.csv", code=3)
    assert result.stderr.startswith("surefoot: scales.csv: The cell 'a' saw only the load 1 N, and")


def test_without_viser_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("surefoot.experiments.view.")]:
        if name.rpartition(".")[2] not in ("session", "world"):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "viser", None)
    fails(
        ["view"],
        'the page needs viser; install it with `pip install "surefoot[view]"`.',
    )


def test_without_the_extra_the_command_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(__main__, "find_spec", lambda name: None if name in ("typer", "rich") else find(name))
    with pytest.raises(SystemExit) as ended:
        __main__.main()
    assert ended.value.code == 2
    assert 'the command needs typer, rich; install it with `pip install "surefoot[experiments]"`' in (
        capsys.readouterr().err
    )
