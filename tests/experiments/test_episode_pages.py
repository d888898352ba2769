"""Pages of both presets: what is said follows from the episodes, and none of them is lost."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from _logs import run
from _made_episodes import MEANS, episodes, frame_of
from rich.console import Console

from surefoot.experiments.episodes import Episode, EpisodePlan, figures, run_plan, tables
from surefoot.experiments.episodes.episode import row_of_failure
from surefoot.experiments.episodes.page import check_episodes, write_evaluation, write_sweep
from surefoot.experiments.episodes.scores import COMPARISONS
from surefoot.experiments.episodes.tables import score_table, two_by_two
from surefoot.experiments.policy.controllers import labels
from surefoot.experiments.study.tables import Table


def page_of(frame, folder):
    """Return the tables of an evaluation's page by name, and its text."""
    report = write_evaluation(*check_episodes(frame), folder)
    return {table.name: table for table in report.tables}, report.page.read_text(encoding="utf-8")


def test_what_was_not_run_is_left_out(tmp_path, undrawn):
    found, text = page_of(frame_of(episodes(means={"none": 50.0}, severities=(1.0,))), tmp_path)
    assert list(found) == ["scores_0"]
    assert "Feet against feet" not in text
    assert "domain randomisation" not in text
    assert text.count("data:image/svg+xml;base64,") == 2


@pytest.mark.parametrize(
    ("wild", "choice"),
    [
        ({"none": 70.0, "moment": 90.0}, "yes"),
        ({"none": 99.0, "moment": 99.9}, "yes"),
        ({"none": 97.0, "moment": 97.0}, "no"),
    ],
)
def test_the_answer_on_randomisation_follows_the_numbers(wild, choice):
    frame = frame_of(episodes(), episodes("wild", {"true": 95.0, **wild}))
    rows = {(one.what, one.severity): one for one in COMPARISONS[-1].find(frame)}
    assert len(rows) == 2 * 5 + 1
    alone = rows["calibration alone less randomisation alone", 1.0]
    assert (alone.controller, alone.clear) == ("clean", choice)
    assert alone.interval.mean == pytest.approx(97.0 - wild["none"], abs=1.0)


def test_the_page_is_one_file_with_everything(tmp_path, undrawn):
    frame = frame_of(
        episodes(),
        episodes("wild", {"true": 95.0, "none": 70.0, "moment": 90.0}),
        episodes("zero", dict.fromkeys(MEANS, 60.0), fell=3),
    )
    found, text = page_of(frame, tmp_path)
    assert text.count("data:image/svg+xml;base64,") == 2
    assert 'src="figures' not in text
    for words in (
        "Is domain randomisation enough?",
        "clean: surefoot 9, python 9",
        "Every row is of the same seeds.",
        "over the episodes of these two trained policies",
        "zero: nobody acts",
        "clean: trained on true feet",
        "3 of 20",
        "drifting less nobody",
        "zero, severity 2: on true feet 3 of 20 fall (return 58); on raw readings 3 of 20 fall (return 58)",
    ):
        assert words in text
    names = list(found)
    assert names == ["scores_0", "scores_1", "scores_2", "differences", "nobody",
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
    assert len(set(titles)) == 3 + 3
    assert len({row[0] for row in score_table(rows).rows}) == 3


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
    assert text.count("data:image/svg+xml;base64,") == 2
    assert 'src="figures' not in text
    assert "5 cases failed" in text
    assert "RuntimeError: no &lt;gains&gt;" in text
    assert len({table.name: table for table in report.tables}["half"].rows) == 4
    outcomes = pd.read_csv(tmp_path / "tables" / "outcome_stand.csv")
    fed = outcomes[(outcomes["controller"] == "stabiliser") & (outcomes["CoP fed back"] == "moment")]
    assert list(fed["falls"]) == ["0 of 4", "4 of 4"]
    # Falls are bad whatever the word.
    listed = tables.worst_table(results.finished.sort_values("time").head(5))
    assert {(row[7], row[7].good) for row in listed.rows} == {("yes", False)}


@pytest.mark.usefixtures("swept")
def test_a_study_in_which_all_fails_is_reported(tmp_path: Path) -> None:
    plan = replace(EpisodePlan(), controllers=("zero",), seeds=(2,))
    results = run_plan(plan, tmp_path)
    assert "5 cases failed" in write_sweep(results).page.read_text(encoding="utf-8")
    with pytest.raises(
        ValueError, match=r"no episodes to make a page of: all 5 failed, the first with .*no <gains>"
    ):
        check_episodes(results.rows)


def test_the_command_sweeps_and_reports(tmp_path: Path, undrawn: None) -> None:
    options = ["--controller", "zero", "--feed", "true", "--scenario", "stand", "--duration", "4.1",
               "--seeds", "2", "--first-seed", "4", "--jobs", "1", "--out", str(tmp_path)]  # fmt: skip
    assert "2 episodes run, 0 were there, 0 failed." in run("sweep", *options).stdout
    assert (tmp_path / "index.html").is_file()
    assert list(pd.read_parquet(tmp_path / "episodes.parquet")["seed"]) == [4, 5]
    assert "0 episodes run, 2 were there, 0 failed." in run("sweep", *options).stdout
    assert "hard-pushes" in run("sweep", "--scenarios").stdout
    failing = ["math:sqrt", *options[2:-1], str(tmp_path / "failing")]
    run("sweep", "--controller", *failing, code=1)
