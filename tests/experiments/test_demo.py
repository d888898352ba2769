"""The demo from end to end, small: what it writes, and that single cases of it can be repeated."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from _logs import run

from surefoot.experiments.logs.format import read_log
from surefoot.experiments.study.page import Report
from surefoot.experiments.walks.options import WalkStudyOptions, demo_options, full_options
from surefoot.experiments.walks.page import write_walks_page
from surefoot.experiments.walks.run import WalkStudyResults, choose_walk_to_film, run_walk_study
from surefoot.experiments.walks.walkers import STAND_TIME

pytestmark = pytest.mark.slow

METHODS = {"none", "tare", "quasi-static", "window", "moment"}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> WalkStudyResults:
    return run_walk_study(
        WalkStudyOptions(
            out=tmp_path_factory.mktemp("demo"),
            seeds=2,
            jobs=1,
            scenarios=("paper-0.1", "bad-start-0.1"),
            duration=STAND_TIME + 6.5,
            settle=STAND_TIME + 2.0,
            loop_duration=STAND_TIME + 1.0,
            loops={2.0: ("true", "none", "window"), 1.0: ("none",)},
        )
    )


@pytest.fixture(scope="module")
def report(results: WalkStudyResults) -> tuple[Report, str]:
    report = write_walks_page(results)
    return report, report.page.read_text(encoding="utf-8")


def log_of(results: WalkStudyResults, condition: str, seed: int) -> Path:
    (path,) = (results.options.out / "logs").glob(f"*_{condition}_seed{seed}_*.parquet")
    return path


def test_logs_hold_what_was_walked(results: WalkStudyResults) -> None:
    assert len(list((results.options.out / "logs").iterdir())) == 4
    paper, bad = (read_log(log_of(results, name, 1)) for name in ("paper", "bad-start"))
    assert paper.truth is not None
    assert bad.truth is not None
    np.testing.assert_array_equal(paper.truth.force, bad.truth.force)
    np.testing.assert_array_equal(paper.reference.com, bad.reference.com)
    assert (paper.raw != bad.raw).any()
    assert not paper.about["fell"]
    # The weights stood on the very cells that walk: their map is right to a percent, the nominal one is not.
    assert bad.calibrated is not None
    assert np.abs(bad.calibrated.scale / bad.truth.scale[0] - 1).max() < 0.02
    assert np.abs(bad.nominal.scale / bad.truth.scale[0] - 1).max() > 0.05


def test_every_method_saw_the_same_walks(results: WalkStudyResults) -> None:
    table = results.yardsticks
    assert set(table["method"]) == METHODS | {"true-map", "baseline", "reference"}
    for against in ("truth", "baseline"):
        counted = table[table["against"] == against].groupby(["condition", "method"])["seed"].nunique()
        assert (counted == 2).all()
    same = table[
        (table["condition"] == "paper") & (table["method"] == "none") & (table["against"] == "baseline")
    ]
    assert same["cop"].max() < 1e-9, "from known weights, doing nothing is the paper's baseline"


def test_the_floor_lies_below_a_bad_start(results: WalkStudyResults) -> None:
    table = results.yardsticks[
        (results.yardsticks["condition"] == "bad-start") & (results.yardsticks["against"] == "truth")
    ]
    mean = table.groupby("method")["cell"].mean()
    assert mean["true-map"] < mean["none"]
    assert mean["true-map"] == mean.min()


def test_the_loop_is_paired(results: WalkStudyResults) -> None:
    counted = results.loop.groupby(["severity", "feed"])["seed"].apply(sorted)
    assert len(counted) == 4
    assert all(seeds == [0, 1] for seeds in counted)
    assert (results.loop[results.loop["feed"] == "true"]["cop_error"] == 0).all()
    assert (results.loop[results.loop["feed"] == "none"]["cop_error"] > 0).all()


def test_the_page_is_whole(results: WalkStudyResults, report: tuple[Report, str]) -> None:
    _, html = report
    places = [
        html.index(title)
        for title in (
            "The same robot, walk and controller",
            "How far off the CoP is",
            "In short: 0.1 m/s",
            ">What was done<",
            "1. Calibrating while walking",
            "2. Gait cycles",
            "3. Closing the loop",
            "4. Repeat any part",
        )
    ]
    assert places == sorted(places)
    assert html.count("data:image/svg+xml;base64,") == html.count("<img") == 3
    assert not re.findall(r'(?:src|href)="(?!data:|#)', html), "the page needs nothing beside it"
    assert "nan" not in re.sub(r"base64,[^\"]*", "", html).lower().replace("covenant", "")
    assert "There is no film in this report: not asked for." in html
    assert "1 seeds" not in html


def test_tables_are_files_too(results: WalkStudyResults, report: tuple[Report, str]) -> None:
    for table in report[0].tables:
        found = pd.read_csv(results.options.out / "tables" / f"{table.name}.csv", dtype=str)
        assert len(found) == len(table.rows)
    # A row a foot, method and condition is on the page and in its file, not in the terminal.
    assert (results.options.out / "tables" / "gait_cycle.csv").is_file()
    assert "gait_cycle" not in [table.name for table in report[0].tables]
    saved = pd.read_csv(results.options.out / "tables" / "yardsticks.csv")
    assert len(saved) == len(results.yardsticks)


def test_one_case_repeated_by_the_command(results: WalkStudyResults, tmp_path: Path) -> None:
    log, settle = str(log_of(results, "bad-start", 1)), str(results.options.settle)
    options = ["--method", "window", "--settle", settle, "--out", str(tmp_path)]
    result = run("calibrate", "walk", log, *options)
    table = results.yardsticks.set_index(["condition", "seed", "method", "against"])
    expected = 1e3 * table.loc[("bad-start", 1, "window", "truth"), "cop"]
    shown = re.search(r"Errors[\s\S]*?calibrated\s+([\d.]+)", result.stdout)
    assert shown is not None
    assert float(shown[1]) == pytest.approx(expected, rel=6e-3)


def test_the_walk_to_film_falls_raw_and_stands_calibrated() -> None:
    ends = {"none": [5.0, 9.5, 30.0, 9.0], "moment": [30.0, 30.0, 30.0, 9.0]}
    loop = pd.DataFrame(
        {"speed": 0.1, "seed": seed, "feed": feed, "fell": time < 30.0, "time": time}
        for feed, times in ends.items()
        for seed, time in enumerate(times)
    )
    assert choose_walk_to_film(loop) == (0.1, 1)
    assert choose_walk_to_film(loop[loop["feed"] == "none"]) == (0.1, 0)


def test_the_number_of_processes_changes_nothing(results: WalkStudyResults, tmp_path: Path) -> None:
    fewer = {"scenarios": ("paper-0.1",), "loops": {2.0: ("none",)}}
    again = run_walk_study(dataclasses.replace(results.options, out=tmp_path, jobs=2, **fewer))
    walked, loop = results.yardsticks, results.loop
    walked = walked[walked["condition"] == "paper"].reset_index(drop=True)
    loop = loop[(loop["severity"] == 2.0) & (loop["feed"] == "none")].reset_index(drop=True)
    pd.testing.assert_frame_equal(again.yardsticks, walked)
    pd.testing.assert_frame_equal(again.loop, loop)


def test_the_demo_is_a_part_of_the_full_study() -> None:
    full, demo = full_options(), demo_options()
    assert len(full.scenarios) == 6
    assert set(demo.scenarios) < set(full.scenarios)
    quick = full_options(seeds=5).quickly()
    assert (quick.seeds, quick.scenarios) == (2, ("paper-0.04", "bad-start-0.04"))
