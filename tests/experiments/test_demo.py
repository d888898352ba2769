"""The demo from end to end, small: what it writes, and that single cells of it can be repeated."""

import dataclasses
import json
import os
import re
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from surefoot.experiments.cli.app import app
from surefoot.experiments.demo import recordings_section as recordings_module
from surefoot.experiments.demo.options import DemoOptions
from surefoot.experiments.demo.page import DemoPage
from surefoot.experiments.demo.recordings_section import recordings_section
from surefoot.experiments.demo.run import DemoResults, _telling_seed, run_demo
from surefoot.experiments.logs.format import read_log
from surefoot.experiments.walks.walkers import STAND_TIME

METHODS = {"none", "tare", "quasi-static", "window", "moment"}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> DemoResults:
    return run_demo(
        DemoOptions(
            out=tmp_path_factory.mktemp("demo"),
            seeds=2,
            jobs=1,
            speeds=(0.1,),
            duration=STAND_TIME + 5.0,
            settle=STAND_TIME + 2.0,
            loop_duration=STAND_TIME + 1.0,
            loops={2.0: ("true", "none", "window"), 1.0: ("none",)},
            factors=(1.0, 5.0),
            sensitivity_seeds=1,
            film_duration=0.0,
        )
    )


@pytest.fixture(scope="module")
def page(results: DemoResults) -> tuple[DemoPage, str]:
    # The recordings have a test of their own; here they would take longer than all the rest.
    with mock.patch.dict(os.environ):
        os.environ.pop("SUREFOOT_DATA", None)
        page = DemoPage(results, recordings_section(None))
    return page, page.write().read_text(encoding="utf-8")


def test_logs_hold_what_was_walked(results: DemoResults) -> None:
    logs = sorted(path.name for path in (results.options.out / "logs").iterdir())
    assert logs == [f"{c}_0.1_seed{s}.parquet" for c in ("bad-start", "paper") for s in (0, 1)]
    paper, bad = (
        read_log(results.options.out / "logs" / f"{c}_0.1_seed1.parquet") for c in ("paper", "bad-start")
    )
    assert paper.truth is not None
    assert bad.truth is not None
    np.testing.assert_array_equal(paper.truth.force, bad.truth.force)
    np.testing.assert_array_equal(paper.reference.com, bad.reference.com)
    assert (paper.raw != bad.raw).any()
    assert not paper.about["fell"]
    # The bench was done with the very cells that walk: its map is right to a percent, the nominal one is not.
    assert bad.bench is not None
    assert np.abs(bad.bench.scale / bad.truth.scale[0] - 1).max() < 0.02
    assert np.abs(bad.nominal.scale / bad.truth.scale[0] - 1).max() > 0.05


def test_every_method_saw_the_same_walks(results: DemoResults) -> None:
    table = results.scores
    assert set(table["method"]) == METHODS | {"floor", "baseline", "reference"}
    for against in ("truth", "baseline"):
        counted = table[table["against"] == against].groupby(["condition", "method"])["seed"].nunique()
        assert (counted == 2).all()
    same = table[
        (table["condition"] == "paper") & (table["method"] == "none") & (table["against"] == "baseline")
    ]
    assert same["cop"].max() < 1e-9, "from the bench calibration, doing nothing is the paper's baseline"
    assert (table["held"].dropna() < 0.01).all()


def test_the_floor_lies_below_a_bad_start(results: DemoResults) -> None:
    table = results.scores[
        (results.scores["condition"] == "bad-start") & (results.scores["against"] == "truth")
    ]
    mean = table.groupby("method")["cell"].mean()
    assert mean["floor"] < mean["none"]
    assert mean["floor"] == mean.min()


def test_the_loop_is_paired(results: DemoResults) -> None:
    counted = results.loop.groupby(["severity", "feed"])["seed"].apply(sorted)
    assert len(counted) == 4
    assert all(seeds == [0, 1] for seeds in counted)
    assert (results.loop[results.loop["feed"] == "true"]["cop_error"] == 0).all()
    assert (results.loop[results.loop["feed"] == "none"]["cop_error"] > 0).all()


def test_the_page_is_whole(results: DemoResults, page: tuple[DemoPage, str]) -> None:
    _, html = page
    for title in (
        "In short",
        "On the bench",
        "Calibrating while walking",
        "Closing the loop",
        "How much hangs on the weights",
        "Real recordings",
        "Repeat any single cell",
    ):
        assert title in html
    assert html.count("data:image/png;base64,") == html.count("<img") == 9
    assert not re.findall(r'(?:src|href)="(?!data:|#)', html), "the page needs nothing beside it"
    assert "nan" not in re.sub(r"base64,[^\"]*", "", html).lower().replace("covenant", "")
    assert "There is no film in this report: not asked for." in html
    stored = json.loads((results.options.out / "results.json").read_text())
    assert stored["options"]["seeds"] == 2
    assert stored["window_update_ms"] > 0


def test_tables_are_files_too(results: DemoResults, page: tuple[DemoPage, str]) -> None:
    for table in page[0].tables:
        found = pd.read_csv(results.options.out / "tables" / f"{table.name}.csv", dtype=str)
        assert len(found) == len(table.rows)
    assert len(pd.read_csv(results.options.out / "tables" / "scores.csv")) == len(results.scores)


def test_one_cell_repeated_by_the_command(results: DemoResults, tmp_path: Path) -> None:
    log = results.options.out / "logs" / "bad-start_0.1_seed1.parquet"
    settle = str(results.options.settle)
    arguments = [
        "calibrate",
        "walking",
        str(log),
        "--method",
        "window",
        "--settle",
        settle,
        "--out",
        str(tmp_path),
    ]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    table = results.scores.set_index(["condition", "seed", "method", "against"])
    expected = 1e3 * table.loc[("bad-start", 1, "window", "truth"), "cop"]
    shown = re.search(r"Errors[\s\S]*?calibrated\s+([\d.]+)", result.stdout)
    assert shown is not None
    assert float(shown[1]) == pytest.approx(expected, rel=6e-3)


def test_without_recordings_the_page_says_how_to_get_them(page: tuple[DemoPage, str]) -> None:
    assert "Set SUREFOOT_DATA to a folder that holds foot/wii_board_18min.npz" in page[1]


def test_recordings_are_laid_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    rows = [
        {
            "recording": "plate",
            "method": method,
            "injected": injected,
            "cop_ml_mm": 10.0 if method == "none" else cop,
            "cop_ap_mm": 10.0,
            "vgrf_n": 1.0,
            "cell_n": 1.0,
            "sentence": "Nothing changes.",
        }
        for method, cop in (("none", 10.0), ("window", 2.0), ("tare", 20.0))
        for injected in ("nothing", "both")
    ]
    monkeypatch.setattr(recordings_module, "recordings_folder", lambda: tmp_path)
    monkeypatch.setattr(recordings_module, "study", lambda folder: rows)
    section = recordings_section(tmp_path)
    assert [len(table.rows) for table in section.tables] == [3, 3]
    assert len(pd.read_csv(tmp_path / "tables" / "real_recordings.csv")) == 6
    assert "window: of 4 errors" in section.findings[0]
    assert (
        "2 are more than 10 % smaller than the readings' own, and 0 more than 10 % larger"
        in section.findings[0]
    )
    assert (
        "0 are more than 10 % smaller than the readings' own, and 2 more than 10 % larger"
        in section.findings[1]
    )


def test_the_walk_to_film_falls_raw_and_stands_calibrated() -> None:
    ends = {"none": [5.0, 9.5, 30.0, 9.0], "moment": [30.0, 30.0, 30.0, 9.0]}
    loop = pd.DataFrame(
        {"speed": 0.1, "seed": seed, "feed": feed, "fell": time < 30.0, "time": time}
        for feed, times in ends.items()
        for seed, time in enumerate(times)
    )
    assert _telling_seed(loop) == (0.1, 1)
    assert _telling_seed(loop[loop["feed"] == "none"]) == (0.1, 0)


@pytest.mark.slow
def test_the_number_of_processes_changes_nothing(results: DemoResults, tmp_path: Path) -> None:
    again = run_demo(dataclasses.replace(results.options, out=tmp_path, jobs=2))
    pd.testing.assert_frame_equal(again.scores, results.scores)
    pd.testing.assert_frame_equal(again.loop, results.loop)
    pd.testing.assert_frame_equal(again.sensitivity, results.sensitivity)


def test_options_without_meaning_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^'seeds' must be at least 1, got 0\.$"):
        DemoOptions(seeds=0)
    with pytest.raises(
        ValueError, match=r"^'settle' must lie between 4 s of standing and the walk's end at 34 s"
    ):
        DemoOptions(settle=40.0)
    quick = DemoOptions(seeds=5).quick()
    assert (quick.seeds, quick.speeds) == (2, (0.04,))
