"""The demo from end to end, small: what it writes, and that its parts can be repeated."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from _logs import run

from surefoot.experiments.demo import FEEDS, choose_walk_to_film, run_demo
from surefoot.experiments.logs.format import read_log
from surefoot.experiments.study.page import Report


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    return run_demo(tmp_path_factory.mktemp("demo"), seeds=2, jobs=1, quick=True)


@pytest.mark.slow
def test_the_page_needs_nothing_but_the_film_beside_it(report: Report) -> None:
    html = report.page.read_text(encoding="utf-8")
    places = [
        html.index(title) for title in ("<video", "In closed loop", "On recorded walks", "Who falls when")
    ]
    assert places == sorted(places)
    assert set(re.findall(r'(?:src|href)="(?!data:|#)([^"]*)"', html)) == {"walk.mp4"}
    assert "nan" not in re.sub(r"base64,[^\"]*", "", html).lower()
    folder = report.page.parent
    assert (folder / "walk.mp4").stat().st_size > 10_000
    for table in report.tables:
        assert len(pd.read_csv(folder / "tables" / f"{table.name}.csv")) == len(table.rows)


@pytest.mark.slow
def test_all_feeds_and_methods_get_the_same_walks_and_calibration_pays(report: Report) -> None:
    lead, scores = ({row[0]: row[1:] for row in table.rows} for table in report.tables)
    assert len(lead) == len(FEEDS)
    assert all(row[0].endswith("of 2") for row in lead.values())
    assert float(scores["moment"][0].partition(" ")[0]) < float(scores["raw (none)"][0].partition(" ")[0])


@pytest.mark.slow
def test_a_recorded_walk_is_a_log_that_the_command_takes(report: Report, tmp_path: Path) -> None:
    path = report.page.parent / "logs" / "walk_seed1.parquet"
    log = read_log(path)
    assert log.truth is not None
    assert log.calibrated is not None
    # The weights stood on the very cells that walk: their map is right to 2 %, the nominal one is not.
    assert np.abs(log.calibrated.scale / log.truth.scale[0] - 1).max() < 0.02
    assert np.abs(log.nominal.scale / log.truth.scale[0] - 1).max() > 0.05
    assert "Errors" in run("calibrate", "walk", path, "--settle", "9", "--out", tmp_path).stdout


@pytest.mark.slow
def test_what_is_finished_is_not_run_again(report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    def must_not_run(*_: object) -> None:
        raise AssertionError("this is kept")

    monkeypatch.setattr("surefoot.experiments.demo.record_walk", must_not_run)
    monkeypatch.setattr("surefoot.experiments.walks.loop.run_episode", must_not_run)
    again = run_demo(report.page.parent, seeds=2, jobs=1, quick=True)
    assert [table.rows for table in again.tables] == [table.rows for table in report.tables]


def test_the_walk_to_film_falls_raw_and_stands_calibrated() -> None:
    ends = {"none": [5.0, 9.5, 30.0, 9.0], "moment": [30.0, 30.0, 30.0, 9.0]}
    loop = pd.DataFrame(
        {"seed": seed, "feed": feed, "fell": time < 30.0, "time": time}
        for feed, times in ends.items()
        for seed, time in enumerate(times)
    )
    assert choose_walk_to_film(loop) == 1
    assert choose_walk_to_film(loop[loop["feed"] == "none"]) == 0
