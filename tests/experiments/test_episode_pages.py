"""Pages of both presets: what is said follows from the episodes, and none of them is lost."""

from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from typer.testing import CliRunner

from surefoot.experiments.cli.app import app
from surefoot.experiments.episodes import Episode, EpisodePlan, figures, run_plan, tables
from surefoot.experiments.episodes.episode import VERSIONS, row_of_failure
from surefoot.experiments.episodes.page import check_episodes, write_evaluation, write_sweep
from surefoot.experiments.episodes.run import sort_episodes
from surefoot.experiments.episodes.scores import (
    COMPARISONS,
    HalfFall,
    Run,
    difference,
    half_fall,
    recovery_share,
)
from surefoot.experiments.episodes.tables import (
    difference_table,
    outcome_table,
    score_table,
    target_table,
    two_by_two,
)
from surefoot.experiments.policy.controllers import labels
from surefoot.experiments.study.statistics import fall_share, survival
from surefoot.experiments.study.tables import Table, Verdict

RUNNER = CliRunner()

MEANS = {"true": 100.0, "none": 50.0, "quasi-static": 70.0, "window": 80.0, "moment": 97.0}
TRAINED = {"clean": "true", "wild": "randomised"}


def episodes(controller="clean", means=MEANS, severities=(1.0, 2.0), fell=0, cop_inputs=(), seeds=20):
    """Episodes whose returns differ by seed, alike for all feeds, and by little besides."""
    rng = np.random.default_rng(7)
    base, rows = rng.normal(0.0, 5.0, seeds), []
    for feed, mean in means.items():
        for severity in severities[:1] if feed == "true" else severities:
            for cop_input in ("given", *cop_inputs) if feed == "true" else ("given",):
                totals = mean + base + rng.normal(0.0, 0.5, seeds) - 40.0 * (cop_input != "given")
                for seed, total in enumerate(totals):
                    rows.append(row(feed, seed, total, controller, severity, cop_input, fell=seed < fell))
    return rows


def row(
    feed: str, seed: int, total: float, controller="clean", severity=1.0, cop_input="given", *, fell=False
) -> dict[str, Any]:
    """A row as an evaluation makes it."""
    made_with = dict.fromkeys(VERSIONS, "9") | {"controller_hash": controller, "error": ""}
    which = {"controller": controller, "feed": feed, "cop_input": cop_input, "scenario": "balance"}
    which |= {"severity": 0.0 if feed == "true" else severity, "seed": seed}
    outcome = {
        "return": total,
        "fell": fell,
        "time": 9.0 if fell else 18.0,
        "cop_error": 0.01,
        "tracking": 0.02,
    }
    return which | outcome | made_with | {"trained": TRAINED.get(controller, "")}


def frame_of(*parts):
    return sort_episodes(pd.DataFrame([result for part in parts for result in part]))


def reached(frame):
    return {row[0]: row[-1] for row in target_table(frame).rows}


def page_of(frame, folder):
    """Return the tables of an evaluation's page by name, and its text."""
    report = write_evaluation(*check_episodes(frame), folder)
    return {table.name: table for table in report.tables}, report.page.read_text(encoding="utf-8")


def test_targets_are_met_or_not_by_the_numbers():
    good = reached(frame_of(episodes(cop_inputs=("shuffled",))))
    assert set(good.values()) == {"yes"}
    assert len(good) == 1 + 2 * 4 + 1
    bad = {"true": 100.0, "none": 98.5, "quasi-static": 99.6, "window": 99.5, "moment": 99.4}
    assert set(reached(frame_of(episodes(means=bad, fell=2))).values()) == {"no"}
    met = reached(frame_of(episodes(means=bad, fell=2)))
    assert met["survives on true CoP (%)"] == "no"
    assert met["severity 1: return on drifting CoP below that on true CoP"] == "no"
    assert met["severity 1: of the loss won back by moment (%)"] == "no"
    assert met["severity 1: moment less quasi-static"] == "no"
    assert reached(frame_of(episodes(fell=1)))["survives on true CoP (%)"] == "yes"


def test_what_was_not_run_is_left_out(tmp_path, undrawn):
    rows = reached(frame_of(episodes(means={"true": 100.0, "moment": 97.0})))
    assert list(rows) == ["survives on true CoP (%)"]
    assert reached(frame_of(episodes(means={"none": 50.0, "window": 60.0}))) == {}
    found, text = page_of(frame_of(episodes(means={"none": 50.0}, severities=(1.0,))), tmp_path)
    assert list(found) == ["scores_0"]
    assert "Feet against feet" not in text
    assert "domain randomisation" not in text
    assert text.count("data:image/svg+xml;base64,") == 2


@pytest.mark.parametrize(
    ("wild", "choice", "both"),
    [
        ({"none": 70.0, "moment": 90.0}, "yes", "no"),
        ({"none": 70.0, "moment": 99.0}, "yes", "yes"),
        ({"none": 99.0, "moment": 99.9}, "yes", "yes"),
        ({"none": 97.0, "moment": 97.0}, "no", "yes"),
    ],
)
def test_the_answer_on_randomisation_follows_the_numbers(wild, choice, both):
    frame = frame_of(episodes(), episodes("wild", {"true": 95.0, **wild}))
    rows = {(one.what, one.severity): one for one in COMPARISONS[-1].find(frame)}
    assert len(rows) == 2 * 5 + 1
    alone = rows["calibration alone less randomisation alone", 1.0]
    assert (alone.controller, alone.clear) == ("clean", choice)
    assert alone.interval.mean == pytest.approx(97.0 - wild["none"], abs=1.0)
    target = reached(frame)
    assert {target[name] for name in target if "either alone" in name} == {both}


def test_a_loss_that_is_none_is_not_won_back():
    flat = dict.fromkeys(MEANS, 100.0)
    frame = frame_of(episodes("zero", flat))
    assert recovery_share(frame, "moment", 1.0) is None
    assert all(row[3] == "" for row in score_table(frame).rows)
    # Exactly the same returns on all feet: no division by nothing.
    same = frame.assign(**{"return": 100.0})
    assert recovery_share(same, "window", 2.0) is None
    won = {row[:2]: row[3] for row in score_table(frame_of(episodes())).rows}
    assert won["moment", "1"].startswith("94.")


def test_the_page_is_one_file_with_everything(tmp_path, undrawn):
    frame = frame_of(
        episodes(cop_inputs=("frozen", "swapped", "shuffled")),
        episodes("wild", {"true": 95.0, "none": 70.0, "moment": 90.0}),
        episodes("zero", dict.fromkeys(MEANS, 60.0), fell=3),
    )
    found, text = page_of(frame, tmp_path)
    assert text.count("data:image/svg+xml;base64,") == 6
    assert 'src="figures' not in text
    for words in (
        "Is domain randomisation enough?",
        "clean: surefoot 9, python 9",
        "Every row is of the same seeds.",
        "over the episodes of these two trained policies",
        "are judged by the number itself",
        "zero: nobody acts",
        "clean: trained on true feet",
        "3 of 20",
        "drifting less nobody",
        "given less shuffled",
    ):
        assert words in text
    names = list(found)
    assert names == ["targets", "scores_0", "scores_1", "scores_2", "differences", "nobody", "inputs",
                     "randomisation", "randomisation_differences"]  # fmt: skip
    assert sorted(path.stem for path in (tmp_path / "tables").glob("*.csv")) == sorted(names)
    assert "these are 16." in found["differences"].note
    cells = pd.read_csv(tmp_path / "tables" / "randomisation.csv")
    assert list(cells["trained on"]) == ["true feet", "randomised feet"]
    assert float(cells["drifting, 2"][1].split(" ± ")[0]) == pytest.approx(70.0, abs=3.0)


@pytest.mark.slow
def test_hostile_names_are_only_names(tmp_path):
    """Drawn for once: a figure is where a name could be taken for mathematics."""
    few = {"true": 100.0, "none": 50.0}
    hostile = "<script>alert(1)</script> $\\frac{"
    frame = frame_of(*(episodes(who, few, (1.0,), seeds=3) for who in (hostile, "a/same.npz", "b/same.npz")))
    found, text = page_of(frame, tmp_path)
    assert "<script>" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt; $\\frac{" in text
    assert {row[0] for row in found["differences"].rows} == {
        hostile, "a/same.npz", "b/same.npz",
    }  # fmt: skip


def test_a_page_of_what_does_not_belong_together_is_refused():
    frame = frame_of(episodes())
    with pytest.raises(
        ValueError, match=r"'clean', feed 'true', severity 0, seed 0 is there twice.*NAME=FILE"
    ):
        check_episodes(pd.concat([frame, frame[frame["feed"] == "true"]]))
    with pytest.raises(ValueError, match="tasks balance, walk cannot share a page"):
        check_episodes(pd.concat([frame, frame.assign(scenario="walk")]))
    with pytest.raises(ValueError, match="no episodes"):
        check_episodes(frame[:0])


def test_rows_of_other_seeds_are_not_called_paired(tmp_path, undrawn):
    clean, wild = episodes(), episodes("wild", {"true": 95.0, "none": 70.0, "moment": 90.0})
    few = [result for result in wild if result["seed"] >= 12]
    frame = frame_of(clean, few)
    found, text = page_of(frame, tmp_path)
    assert "Not all rows are of the same seeds" in text
    assert "Every row is of the same seeds" not in text
    paired = [score_table(frame_of(*parts)).note for parts in ((clean, few), (clean, wild))]
    assert ["paired" in note for note in paired] == [False, True]
    seeds = {(row[0], row[-2]) for row in found["differences"].rows}
    assert seeds == {("clean", "20"), ("wild", "8")}
    pairs = COMPARISONS[-1].find(frame)
    assert {one.interval.n for one in pairs if "both clean" not in one.what} == {8}
    # The policy that was run on more seeds is shown on those that both have.
    cells = found["randomisation"].rows[0]
    own = frame[(frame["controller"] == "clean") & (frame["severity"] == 2.0)]
    drifting = own[own["feed"] == "none"].set_index("seed")["return"]
    assert float(cells[4].split(" ± ")[0]) == pytest.approx(drifting[12:].mean(), abs=0.01)
    assert drifting[12:].mean() != pytest.approx(drifting.mean(), abs=0.1)
    assert "drifting, 2: 8" in found["randomisation"].note
    apart = [result for result in episodes("wild", seeds=40) if result["seed"] >= 20]
    assert two_by_two(frame_of(clean, apart), "clean", "wild").rows[0][:2] == ("true feet", "–")


def test_the_loss_and_what_is_won_of_it_are_over_the_same_seeds():
    # Where all three feeds were run, drifting feet cost nothing; they do only where moment was not run.
    rng = np.random.default_rng(3)
    noise = rng.normal(0.0, 1.0, (3, 30))
    cost = np.where(np.arange(30) < 15, 0.0, 100.0)
    totals = {"true": noise[0], "none": noise[1] - cost, "moment": noise[2][:15]}
    frame = frame_of([row(feed, seed, total) for feed, of in totals.items() for seed, total in enumerate(of)])
    assert recovery_share(frame, "moment", 1.0) is None


@pytest.mark.slow
def test_names_stay_apart(tmp_path, monkeypatch, undrawn):
    ending = "/a/very/long/path/that/two/policies/share/policy.npz"
    controllers = [f"{first}{ending}" for first in "ab"] + ["c/policy.npz", "price$\\frac{"]
    drawn = labels(controllers)
    assert len(set(drawn.values())) == 4
    crossed = ["policy.npz.npz", "policy.npz", "a/policy.npz"]
    assert len(set(labels(crossed).values())) == 3
    titles = []
    monkeypatch.setattr("matplotlib.axes.Axes.set_title", lambda axes, title, **_: titles.append(title))
    frame = frame_of(*(episodes(name, severities=(1.0,), seeds=3) for name in controllers[:3]))
    rows = frame.assign(scenario="x", case=0)
    figures.against_severity(tmp_path / "a.png", rows)
    assert len(set(titles)) == 3
    figures.survival_curves(tmp_path / "b.png", rows)
    figures.heat_maps(tmp_path / "c.png", rows, {"x": "X"})
    assert len(set(titles)) == 3 + 3 + 3 * 5
    assert len({row[0] for row in outcome_table(rows, "x", "X").rows}) == 3
    titles.clear()
    figures.forest(tmp_path / "f.png", COMPARISONS[0].find(frame))
    assert {title.partition(",")[0] for title in titles} == {drawn[name] for name in controllers[:3]}


def test_brackets_and_colons_in_names_are_text_in_a_terminal():
    names = ("[red]a[/red]", "b:zap:", "[/oops]")
    table = Table("t", "[b]of[/b]", ("[i]who",), tuple((name,) for name in names), "[u]note")
    console = Console(width=60, record=True, file=None, quiet=False)
    with console.capture() as shown:
        console.print(table.to_rich())
    for text in (*names, "[b]of[/b]", "[i]who", "[u]note"):
        assert text in shown.get()


def test_versions_are_said_of_each_controller(tmp_path, undrawn):
    few = {"true": 100.0, "none": 50.0}
    frame = frame_of(*(episodes(name, few, (1.0,)) for name in ("clean", "zero")))
    frame = frame.assign(surefoot=frame["controller"].map({"clean": "1", "zero": ""}))
    text = page_of(frame, tmp_path)[1]
    assert "clean: surefoot 1, python 9" in text
    assert "zero: surefoot unknown, python 9" in text
    assert "(0 to 19)" in text


def test_targets_are_those_of_a_policy():
    def targets_of(*controllers):
        few = {"true": 100.0, "none": 50.0}
        return target_table(frame_of(*(episodes(name, few) for name in controllers)))

    assert targets_of("zero", "stabiliser") is None
    assert targets_of("zero", "wild", "clean").title == "Set out to reach, by clean"
    assert targets_of("zero", "mine").title.endswith("by mine")


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


@pytest.fixture
def swept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Episodes that take no time, and of which some fail."""

    def made(episode: Episode) -> dict[str, Any]:
        if episode.controller == "zero" and episode.seed == 2:
            raise RuntimeError("no <gains>")
        fell = episode.severity > 1.0 + 0.5 * episode.seed
        outcome = {
            "return": 50.0 - episode.severity,
            "time": 12.0 - 2.0 * fell,
            "fell": fell,
            "cop_error": 0.01,
        }
        return row_of_failure(episode, "") | outcome | {"tracking": 0.02, "digest": "0"}

    monkeypatch.setattr("surefoot.experiments.episodes.episode.episode_row", made)
    monkeypatch.setattr("surefoot.experiments.episodes.run.check_episode", lambda episode: None)


@pytest.mark.slow
@pytest.mark.usefixtures("swept")
def test_a_sweeps_page_is_one_file_with_everything(tmp_path: Path) -> None:
    plan = EpisodePlan(scenarios=("stand",), severities=(1.0, 3.0), seeds=tuple(range(4)))
    results = run_plan(plan, tmp_path)
    report = write_sweep(results)
    text = report.page.read_text(encoding="utf-8")
    assert text.count("data:image/svg+xml;base64,") == 3
    assert 'src="figures' not in text
    assert "5 episodes failed" in text
    assert "RuntimeError: no &lt;gains&gt;" in text
    assert len({table.name: table for table in report.tables}["half"].rows) == 4
    outcomes = pd.read_csv(tmp_path / "tables" / "outcome_stand.csv")
    fed = outcomes[(outcomes["controller"] == "stabiliser") & (outcomes["feed"] == "moment")]
    assert list(fed["fell (%)"].str.split().str[0].astype(int)) == [0, 100]
    assert list(fed["episodes"]) == [4, 4]
    # Falls are bad whatever the word.
    listed = tables.worst_table(results.finished.sort_values("time").head(5))
    assert {(row[7], row[7].good) for row in listed.rows} == {("yes", False)}


@pytest.mark.usefixtures("swept")
def test_a_study_in_which_all_fails_is_reported(tmp_path: Path) -> None:
    plan = replace(EpisodePlan(), controllers=("zero",), seeds=(2,))
    results = run_plan(plan, tmp_path)
    assert "5 episodes failed" in write_sweep(results).page.read_text(encoding="utf-8")
    with pytest.raises(
        ValueError, match=r"no episodes to make a page of: all 5 failed, the first with .*no <gains>"
    ):
        check_episodes(results.rows)


@pytest.mark.slow
def test_the_worst_are_filmed_or_it_says_why(tmp_path: Path, undrawn: None) -> None:
    plan = EpisodePlan(
        ("stabiliser",), ("none",), ("stand",), (1.0, 2.0), seeds=(3,), duration=0.3, settle=0.1
    )
    text = write_sweep(run_plan(plan, tmp_path), films=1).page.read_text(encoding="utf-8")
    films = list((tmp_path / "films").glob("*.mp4")) if (tmp_path / "films").is_dir() else []
    # Where nothing can be drawn there is a reason in its place.
    assert (
        ("data:video/mp4;base64," in text)
        == bool(films)
        != ("There is no film: nothing can be drawn" in text)
    )
    assert text.count("on film</h2>") == 1


def test_the_command_sweeps_and_reports(tmp_path: Path, undrawn: None) -> None:
    options = ["--controller", "zero", "--feed", "true", "--scenario", "stand", "--duration", "4.1",
               "--seeds", "2", "--first-seed", "4", "--backend", "here", "--out", str(tmp_path)]  # fmt: skip
    shown = RUNNER.invoke(app, ["sweep", *options])
    assert shown.exit_code == 0, shown.output
    assert "2 episodes run, 0 were there, 0 failed." in shown.stdout
    assert (tmp_path / "index.html").is_file()
    assert list(pd.read_parquet(tmp_path / "episodes.parquet")["seed"]) == [4, 5]
    shown = RUNNER.invoke(app, ["sweep", *options])
    assert "0 episodes run, 2 were there, 0 failed." in shown.stdout
    assert "hard-pushes" in RUNNER.invoke(app, ["sweep", "--scenarios"]).stdout
    refused = RUNNER.invoke(app, ["sweep", *options, "--backend", "slurm", "--out", str(tmp_path / "no")])
    assert refused.exit_code == 2
    assert "There is no backend 'slurm'. Available: 'local', 'dask', 'ray', 'here'." in refused.output


def test_a_clear_loss_is_not_good_and_a_cost_is_no_merit() -> None:
    rows = frame_of(episodes(means=MEANS | {"moment": 40.0}, severities=(1.0,)))
    compared = COMPARISONS[0].find(rows)
    cells = {row[1]: row[-1] for row in difference_table(compared, "differences", "Differences").rows}
    assert isinstance(cells["moment less drifting"], Verdict)
    assert (cells["moment less drifting"], cells["moment less drifting"].good) == ("yes", False)
    assert cells["true less moment"] == "yes"
    assert not isinstance(cells["true less moment"], Verdict)


def test_the_loss_won_back_is_the_share_of_the_means_and_its_interval_holds_it() -> None:
    rng = np.random.default_rng(0)
    base, gap = rng.normal(100.0, 30.0, 60), rng.uniform(5.0, 15.0, 60)
    noisy = base + 0.5 * gap + rng.normal(0.0, 3.0, 60)
    totals = {"true": base + gap, "none": base, "moment": base + 0.8 * gap, "window": noisy}
    frame = frame_of([row(feed, seed, total) for feed, of in totals.items() for seed, total in enumerate(of)])
    assert recovery_share(frame, "moment", 1.0) == pytest.approx((0.8, 0.8, 0.8))
    won, low, high = recovery_share(frame, "window", 1.0)
    assert low < won < high
    assert low < 0.5 < high
    interval = difference(frame, Run("true"), Run("none"), 1.0)
    assert interval.mean == pytest.approx(gap.mean())
    assert interval.half < 1.0
    assert recovery_share(frame, "tare", 1.0) is None
    assert difference(frame, Run("true"), Run("tare")) is None
    with pytest.raises(ValueError, match="was run more than once with the same seed"):
        difference(pd.concat([frame, frame]), Run("true"), Run("none"))
