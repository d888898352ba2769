"""What a sweep's page says: survival, the severity at which half fall, and a page of one file."""

from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from typer.testing import CliRunner

from surefoot.experiments.cli.app import app
from surefoot.experiments.sweep import Cell, SweepPlan, run_sweep
from surefoot.experiments.sweep.episode import failed_row
from surefoot.experiments.sweep.page import SweepPage
from surefoot.experiments.sweep.statistics import HalfFall, fall_share, half_fall, survival
from surefoot.experiments.walks.score import survival_curve

RUNNER = CliRunner()
SEVERITIES = np.array([0.0, 1.0, 2.0, 4.0])


def fallen(threshold: Any, severities: Any = SEVERITIES) -> pd.DataFrame:
    """Every seed falls from a severity of its own on."""
    return pd.DataFrame(
        [
            {"seed": seed, "severity": severity, "fell": bool(severity >= limit)}
            for seed, limit in enumerate(threshold)
            for severity in severities
        ]
    )


def test_survival_agrees_with_scipy() -> None:
    rng = np.random.default_rng(3)
    time, fell = np.ceil(rng.exponential(8.0, 60)), rng.random(60) < 0.7
    curve = survival(time, fell)
    np.testing.assert_array_equal(curve.time, survival_curve(time, fell)[0])
    np.testing.assert_allclose(curve.share, survival_curve(time, fell)[1])
    known = stats.ecdf(stats.CensoredData(uncensored=time[fell], right=time[~fell])).sf
    with pytest.warns(RuntimeWarning, match="undefined at some observations"):
        band = known.confidence_interval(0.95, method="log-log")
    inside = np.isin(curve.time[1:], known.quantiles) & (curve.share[1:] > 0.0) & (curve.share[1:] < 1.0)
    at = np.isin(known.quantiles, curve.time[1:][inside])
    np.testing.assert_allclose(curve.low[1:][inside], band.low.probabilities[at], rtol=1e-9)
    np.testing.assert_allclose(curve.high[1:][inside], band.high.probabilities[at], rtol=1e-9)


def test_the_band_holds_what_it_says() -> None:
    rng, median = np.random.default_rng(5), 8.0
    held = 0
    for _ in range(400):
        time = rng.exponential(median / np.log(2.0), 40)
        curve = survival(np.minimum(time, 20.0), time < 20.0)
        k = int(np.searchsorted(curve.time, median, side="right")) - 1
        held += curve.low[k] <= 0.5 <= curve.high[k]
    assert 0.92 <= held / 400 <= 0.98


def test_half_fall_is_found_and_its_interval_too() -> None:
    threshold = np.random.default_rng(1).normal(1.5, 0.5, 40)
    found = half_fall(fallen(threshold, np.linspace(0.0, 3.0, 13)))
    assert found is not None
    assert found.severity == pytest.approx(np.median(threshold), abs=0.25)
    assert found.low < found.severity < found.high < found.low + 1.0


def test_half_fall_where_it_is_not_reached() -> None:
    beyond = half_fall(fallen([9.0] * 10))
    assert beyond is not None
    assert (beyond.severity, beyond.words()) == (inf, "not reached up to 4")
    below = half_fall(fallen([0.0] * 10))
    assert below is not None
    assert (below.severity, below.words()) == (-inf, "below 0")
    near = half_fall(fallen([1.5] * 6 + [9.0] * 5))
    assert near is not None
    assert near.high == inf
    assert near.words().endswith("to above 4)")
    assert half_fall(fallen([1.0] * 5, [2.0])) is None


def test_more_errors_may_fell_fewer() -> None:
    rows = fallen([1.0] * 6 + [9.0] * 4)
    rows.loc[(rows["severity"] == 2.0) & (rows["seed"] < 3), "fell"] = False
    found = half_fall(rows)
    assert found is not None
    # 60 % at severity 1 and 30 % at 2 are pooled to 45 %; at 4 it is 60 %.
    assert found.severity == pytest.approx(2.0 + 2.0 * 0.05 / 0.15)


def test_shares_have_intervals() -> None:
    assert fall_share([True] * 5).low > 0.5
    assert fall_share([True] * 5).high == pytest.approx(1.0)
    assert np.isnan(fall_share([]).share)
    assert HalfFall(1.0, 1.0, 1.0, 0.0, 2.0).words() == "1"


def made(cell: Cell) -> dict[str, Any]:
    if cell.controller == "zero" and cell.seed == 2:
        return failed_row(cell, "Traceback\nRuntimeError: no <gains>")
    fell = cell.severity > 1.0 + 0.5 * cell.seed
    outcome = {"return": 50.0 - cell.severity, "time": 12.0 - 2.0 * fell, "fell": fell, "cop_error": 0.01}
    return failed_row(cell, "") | outcome | {"cop_tracking": 0.02, "digest": "0"}


def test_the_page_is_one_file_with_everything(tmp_path: Path) -> None:
    plan = SweepPlan(scenarios=("stand",), severities=(1.0, 3.0), seeds=tuple(range(4)))
    results = run_sweep(plan, tmp_path, backend="here", job=made)
    page = SweepPage(results)
    text = page.write().read_text(encoding="utf-8")
    assert text.count("data:image/png;base64,") == 3
    assert 'src="data:' in text
    assert 'src="figures' not in text
    assert "5 cells failed" in text
    assert "RuntimeError: no &lt;gains&gt;" in text
    assert page.half is not None
    assert len(page.half.rows) == 4
    outcomes = pd.read_csv(tmp_path / "tables" / "outcome_stand.csv")
    fed = outcomes[(outcomes["controller"] == "stabiliser") & (outcomes["feed"] == "moment")]
    assert list(fed["fell (%)"].str.split().str[0].astype(int)) == [0, 100]
    assert list(fed["episodes"]) == [4, 4]


def test_a_sweep_in_which_all_fails_has_a_page(tmp_path: Path) -> None:
    plan = replace(SweepPlan(), controllers=("zero",), seeds=(2,))
    page = SweepPage(run_sweep(plan, tmp_path, backend="here", job=made))
    assert "5 cells failed" in page.write().read_text(encoding="utf-8")


def test_the_worst_are_filmed_or_it_says_why(tmp_path: Path) -> None:
    plan = SweepPlan(("stabiliser",), ("none",), ("stand",), (1.0, 2.0), seeds=(3,), duration=0.5, settle=0.1)
    page = SweepPage(run_sweep(plan, tmp_path, backend="here"), films=1)
    text = page.write().read_text(encoding="utf-8")
    films = list((tmp_path / "films").glob("*.mp4")) if (tmp_path / "films").is_dir() else []
    # Where nothing can be drawn there is a reason in its place.
    assert (
        ("data:video/mp4;base64," in text)
        == bool(films)
        != ("There is no film: nothing can be drawn" in text)
    )
    assert text.count("on film</h2>") == 1


def test_the_command_sweeps_and_reports(tmp_path: Path) -> None:
    options = [
        "--controller",
        "zero",
        "--feed",
        "true",
        "--scenario",
        "stand",
        "--seeds",
        "2",
        "--first-seed",
        "4",
    ]
    options += ["--duration", "4.1", "--backend", "here", "--out", str(tmp_path)]
    said = RUNNER.invoke(app, ["sweep", *options])
    assert said.exit_code == 0, said.output
    assert "2 cells run, 0 were there, 0 failed." in said.stdout
    assert (tmp_path / "report.html").is_file()
    assert list(pd.read_parquet(tmp_path / "results.parquet")["seed"]) == [4, 5]
    said = RUNNER.invoke(app, ["sweep", *options])
    assert "0 cells run, 2 were there, 0 failed." in said.stdout
    assert "hard-pushes" in RUNNER.invoke(app, ["sweep", "--scenarios"]).stdout
