"""Controllers held against each other: what is said follows from the episodes, and none of them is lost."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from surefoot.controllers import PolicyNetwork, Stabiliser
from surefoot.experiments.cli import app
from surefoot.experiments.controllers_by_name import controller_hash, load_controller, trained_on
from surefoot.experiments.policy import evaluation as evaluations
from surefoot.experiments.policy.env import make_feed
from surefoot.experiments.policy.evaluate import EpisodeResult, run_episode
from surefoot.experiments.policy.evaluation import Evaluation, EvaluationFolder, made_with, read_episodes
from surefoot.experiments.policy.findings import controller_findings, target_table
from surefoot.experiments.policy.page import EvaluationPage
from surefoot.experiments.policy.randomisation import AS_GOOD, BETTER, WORSE, answers
from surefoot.experiments.policy.scores import episodes_frame, score_table, won_back

pytestmark = pytest.mark.filterwarnings("ignore:.*unconventional shape")

RUNNER = CliRunner()
SHORT = {"stand_time": 0.1, "duration": 0.6, "payload_time": (0.1, 0.2)}
MEANS = {"true": 100.0, "none": 50.0, "quasi-static": 70.0, "window": 80.0, "surefoot": 97.0}
TRAINED = {"clean": "true", "wild": "randomised"}


def episodes(controller="clean", means=MEANS, severities=(1.0, 2.0), fell=0, cop_inputs=(), seeds=20):
    """Episodes whose returns differ by seed, alike for all feeds, and by little besides."""
    rng = np.random.default_rng(7)
    base, rows = rng.normal(0.0, 5.0, seeds), []
    for feed, mean in means.items():
        for severity in severities[:1] if feed == "true" else severities:
            for cop_input in ("felt", *cop_inputs) if feed == "true" else ("felt",):
                totals = mean + base + rng.normal(0.0, 0.5, seeds) - 40.0 * (cop_input != "felt")
                for seed, total in enumerate(totals):
                    ending = (seed < fell, 9.0 if seed < fell else 18.0)
                    outcome = (total, *ending, 0.01, 0.02, controller)
                    rows.append(EpisodeResult(feed, cop_input, severity, seed, *outcome))
    return rows


def frame_of(*parts):
    return episodes_frame([result for part in parts for result in part])


def reached(frame, controller="clean", found=()):
    return {row[0]: row[-1] for row in target_table(frame, controller, found).rows}


def test_targets_are_met_or_not_by_the_numbers():
    good = reached(frame_of(episodes(cop_inputs=("shuffled",))))
    assert set(good.values()) == {"yes"}
    assert len(good) == 1 + 2 * 4 + 1
    bad = {"true": 100.0, "none": 98.5, "quasi-static": 99.6, "window": 99.5, "surefoot": 99.4}
    assert set(reached(frame_of(episodes(means=bad, fell=2))).values()) == {"no"}
    met = reached(frame_of(episodes(means=bad, fell=2)))
    assert met["survives on true CoP"] == "no"
    assert met["severity 1: return on drifting CoP below that on true CoP"] == "no"
    assert met["severity 1: of the loss won back by surefoot"] == "no"
    assert met["severity 1: surefoot less Han"] == "no"
    assert reached(frame_of(episodes(fell=1)))["survives on true CoP"] == "yes"


def test_what_was_not_run_is_left_out(tmp_path):
    rows = reached(frame_of(episodes(means={"true": 100.0, "surefoot": 97.0})))
    assert list(rows) == ["survives on true CoP"]
    assert reached(frame_of(episodes(means={"none": 50.0, "window": 60.0}))) == {}
    page = EvaluationPage(frame_of(episodes(means={"none": 50.0}, severities=(1.0,))))
    assert [table.name for table in page.tables] == ["scores_0"]
    text = page.write(tmp_path).read_text(encoding="utf-8")
    assert "Feet against feet" not in text
    assert "domain randomisation" not in text
    assert text.count("data:image/png;base64,") == 2
    only_true = EvaluationPage(frame_of(episodes("zero", {"true": 100.0})))
    assert "zero, true CoP: return" in only_true.write(tmp_path).read_text(encoding="utf-8")
    assert only_true.commands() == [
        "surefoot evaluate zero --task balance --feed true --severity 1 --seeds 20 --first-seed 0"
    ]


@pytest.mark.parametrize(
    ("wild", "enough", "both"),
    [
        ({"none": 70.0, "surefoot": 90.0}, "is not enough", WORSE),
        ({"none": 70.0, "surefoot": 99.0}, "is not enough", BETTER),
        ({"none": 70.0, "surefoot": 97.0}, "is not enough", AS_GOOD),
        ({"none": 99.0, "surefoot": 99.9}, "is enough", BETTER),
        ({"none": 97.0, "surefoot": 97.0}, "cannot be told from calibration alone", AS_GOOD),
    ],
)
def test_the_answer_on_randomisation_follows_the_numbers(wild, enough, both):
    frame = frame_of(episodes(), episodes("wild", {"true": 95.0, **wild}))
    found = answers(frame, "clean", "wild")
    assert [answer.severity for answer in found] == [1.0, 2.0]
    assert {answer.enough for answer in found} == {enough}
    assert {answer.both for answer in found} == {both}
    words = found[0].words()
    assert f"randomisation {enough}" in words
    assert f"Both together are {both}" in words
    assert found[0].choice.mean == pytest.approx(97.0 - wild["none"], abs=1.0)
    target = reached(frame, found=found)
    assert {target[name] for name in target if "either alone" in name} == {"no" if both == WORSE else "yes"}


def test_a_loss_that_is_none_is_not_won_back():
    flat = dict.fromkeys(MEANS, 100.0)
    frame = frame_of(episodes("zero", flat))
    assert won_back(frame, "surefoot", 1.0) is None
    assert all(row[3] == "" for row in score_table(frame).rows)
    said = controller_findings(frame, "zero")
    assert "no clear loss" in said[1]
    assert "nothing to win back" in said[1]
    # Exactly the same returns on all feet: no division by nothing.
    same = frame.assign(total=100.0)
    assert won_back(same, "window", 2.0) is None
    assert "surefoot wins 94." in controller_findings(frame_of(episodes()), "clean")[1]


def test_the_page_is_one_file_with_everything(tmp_path):
    frame = frame_of(
        episodes(cop_inputs=("frozen", "swapped", "shuffled")),
        episodes("wild", {"true": 95.0, "none": 70.0, "surefoot": 90.0}),
        episodes("zero", dict.fromkeys(MEANS, 60.0), fell=3),
    )
    page = EvaluationPage(frame, TRAINED, "surefoot 9.9")
    text = page.write(tmp_path).read_text(encoding="utf-8")
    assert text.count("data:image/png;base64,") == 5
    assert 'src="figures' not in text
    for words in (
        "randomisation is not enough",
        "The episodes were made with surefoot 9.9",
        "zero: nobody acts",
        "clean: trained on true feet",
        "3 of 20",
        "drifting less nobody",
        "felt less shuffled",
    ):
        assert words in text
    names = [table.name for table in page.tables]
    assert names == ["targets", "scores_0", "scores_1", "scores_2", "differences", "nobody", "inputs",
                     "randomisation", "randomisation_differences"]  # fmt: skip
    assert sorted(path.stem for path in (tmp_path / "tables").iterdir()) == sorted(names)
    cells = pd.read_csv(tmp_path / "tables" / "randomisation.csv")
    assert list(cells["trained on"]) == ["true feet", "randomised feet"]
    assert float(cells["drifting, 2"][1].split(" ± ")[0]) == pytest.approx(70.0, abs=3.0)
    whole = "--feed true --feed none --feed quasi-static --feed window --feed surefoot"
    some = "--feed true --feed none --feed surefoot"
    rest = "--severity 1 --severity 2 --seeds 20 --first-seed 0"
    assert page.commands() == [
        f"surefoot evaluate clean --task balance {whole} {rest} --uses-cop",
        f"surefoot evaluate wild --task balance {some} {rest}",
        f"surefoot evaluate zero --task balance {whole} {rest}",
    ]


def test_hostile_names_are_only_names(tmp_path):
    hostile = "<script>alert(1)</script> $\\frac{"
    frame = frame_of(episodes(hostile), episodes("a/same.npz"), episodes("b/same.npz"))
    page = EvaluationPage(frame)
    text = page.write(tmp_path).read_text(encoding="utf-8")
    assert "<script>" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt; $\\frac{" in text
    assert "surefoot evaluate &#39;&lt;script&gt;" in text
    assert {row[0] for table in page.tables if table.name == "differences" for row in table.rows} == {
        hostile, "a/same.npz", "b/same.npz",
    }  # fmt: skip


def test_a_page_of_what_does_not_belong_together_is_refused():
    frame = frame_of(episodes())
    with pytest.raises(
        ValueError, match=r"'clean', feed 'true', severity 0, seed 0 is there twice.*NAME=FILE"
    ):
        EvaluationPage(pd.concat([frame, frame[frame["feed"] == "true"].assign(severity=2.0)]))
    with pytest.raises(ValueError, match="tasks balance, walk cannot share a page"):
        EvaluationPage(pd.concat([frame, frame.assign(task="walk")]))
    with pytest.raises(ValueError, match="no episodes"):
        EvaluationPage(frame[:0])


def test_episodes_are_read_or_refused(tmp_path):
    frame = frame_of(episodes())
    path = tmp_path / "episodes.parquet"
    frame.drop(columns=["controller", "task"]).to_parquet(path)
    assert set(read_episodes(path)["controller"]) == {"policy"}
    assert set(read_episodes(tmp_path, "shipped")["controller"]) == {"shipped"}
    frame.to_parquet(path)
    assert read_episodes(path).equals(frame)
    for wrong, text in (
        (frame.drop(columns="total"), "lacks the column 'total'"),
        (frame.assign(feed="sand"), "holds the feed 'sand'. Known: true, none"),
        (frame.assign(total="much"), "'total' holds no numbers"),
    ):
        wrong.to_parquet(path)
        with pytest.raises(ValueError, match=text):
            read_episodes(path)
    path.write_bytes(b"PAR1 and no more")
    with pytest.raises(ValueError, match="no table of Parquet, or is damaged"):
        read_episodes(path)
    with pytest.raises(ValueError, match="There is no file of episodes"):
        read_episodes(tmp_path / "nowhere")


@pytest.fixture
def invented(monkeypatch):
    """Episodes that take no time, and a note of each that was run."""
    ran = []

    def run(controller, feeds, numbers, severities, *, cop_inputs, task, jobs, done):
        for seed in numbers:
            for feed in feeds:
                cell = (feed, seed, severities[0], cop_inputs[0])
                if cell not in done:
                    ran.append((controller, *cell))
                    total = MEANS[feed] + np.sin(seed + len(feed))
                    yield EpisodeResult(feed, "felt", severities[0], seed, total, False, 18.0, 0.0, 0.0,
                                        controller, task)  # fmt: skip

    monkeypatch.setattr(evaluations, "run_episodes", run)
    return ran


def stop_after(count, folder):
    with folder.opened():
        for number, _ in enumerate(folder.run(), 1):
            if number == count:
                raise KeyboardInterrupt


COMPARED = Evaluation(("zero", "stabiliser"), ("true", "none"), seeds=5)


def test_an_evaluation_that_was_stopped_goes_on(tmp_path, invented, monkeypatch):
    folder = EvaluationFolder(tmp_path, COMPARED)
    assert len(COMPARED) == folder.missing == 20
    with pytest.raises(KeyboardInterrupt):
        stop_after(13, folder)
    assert len(read_episodes(tmp_path)) == 13
    again = EvaluationFolder(tmp_path, COMPARED)
    with again.opened():
        assert again.missing == 7
        assert len(list(again.run())) == 7
    assert len(invented) == len(set(invented)) == 20
    whole = EvaluationFolder(None, COMPARED)
    with whole.opened():
        list(whole.run())
    pd.testing.assert_frame_equal(read_episodes(tmp_path), whole.frame)
    assert made_with(tmp_path).startswith("surefoot ")
    # What is whole is not run again, whatever made it.
    monkeypatch.setattr(evaluations, "_versions", lambda: {"surefoot": "another"})
    with (done := EvaluationFolder(tmp_path, COMPARED)).opened():
        assert list(done.run()) == []
    assert len(done.frame) == 20


def test_a_full_disk_costs_only_what_was_not_yet_written(tmp_path, invented, monkeypatch):
    monkeypatch.setattr(evaluations, "EVERY", -1.0)
    write, written = pd.DataFrame.to_parquet, []

    def full(frame, path, **options):
        written.append(path)
        if len(written) > 6:
            Path(path).write_bytes(b"half")
            raise OSError(28, "No space left on device")
        return write(frame, path, **options)

    monkeypatch.setattr(pd.DataFrame, "to_parquet", full)
    folder = EvaluationFolder(tmp_path, COMPARED)
    with pytest.raises(OSError, match="No space left"), folder.opened():
        list(folder.run())
    assert len(read_episodes(tmp_path)) == 6
    assert sorted(path.name for path in tmp_path.glob("[!.]*")) == ["episodes.parquet", "evaluation.json"]
    answer = RUNNER.invoke(
        app, ["evaluate", "zero", "--feed", "true", "--seeds", "2", "--out", str(tmp_path / "b")]
    )
    assert answer.exit_code == 2
    assert "No space left on device; give another folder with --out, or make room." in answer.output


def test_a_folder_that_holds_something_else_is_refused(tmp_path, invented, monkeypatch):
    first = EvaluationFolder(tmp_path, COMPARED)
    with first.opened():
        next(iter(first.run()))
    other = Evaluation(("zero",), ("true", "none"), seeds=6)
    with pytest.raises(
        ValueError, match=r"controllers \['zero', 'stabiliser'\] and not \['zero'\].*seeds 5 and not 6"
    ):
        EvaluationFolder(tmp_path, other).opened().__enter__()
    monkeypatch.setattr(evaluations, "_versions", lambda: {"surefoot": "another"})
    with pytest.raises(ValueError, match=r"was begun with surefoot [\d.]+, which is not what runs now"):
        EvaluationFolder(tmp_path, COMPARED).opened().__enter__()
    (tmp_path / "evaluation.json").write_text("{}")
    with pytest.raises(ValueError, match="does not say what was evaluated"):
        EvaluationFolder(tmp_path, COMPARED).opened().__enter__()
    (tmp_path / "evaluation.json").unlink()
    with pytest.raises(ValueError, match=r"episodes without an evaluation.json; .*--page-of"):
        EvaluationFolder(tmp_path, COMPARED).opened().__enter__()
    assert len(read_episodes(tmp_path)) == 1


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"feeds": ("sand",)}, "There is no feed 'sand'"),
        ({"feeds": ("true", "true")}, "'feeds' must name at least one and none twice"),
        ({"controllers": ("best",)}, "no controller 'best'. Available: 'zero', 'stabiliser', 'shipped'"),
        ({"controllers": ("none.npz",)}, "There is no policy file 'none.npz'"),
        ({"task": "dance"}, "There is no task 'dance'"),
        ({"severities": (1.0, -1.0)}, "severity"),
        ({"first_seed": 999_999_999, "seeds": 2}, "seeds above are training's"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_is(changes, text):
    with pytest.raises(ValueError, match=text):
        Evaluation(**{"feeds": ("true", "none"), **changes})


def test_controllers_have_names(tmp_path):
    env, _ = make_feed("true", **SHORT)
    assert isinstance(load_controller("stabiliser", env), Stabiliser)
    for name, sensors in (("shipped", "true"), ("shipped-randomised", "randomised")):
        policy = load_controller(name, env)
        assert isinstance(policy, PolicyNetwork)
        assert policy.notes["options"]["sensors"] == trained_on(name) == sensors
    policy.save(tmp_path / "mine.npz")
    env.close()
    assert trained_on(str(tmp_path / "mine.npz")) == "randomised"
    assert trained_on("zero") == trained_on(str(tmp_path / "gone.npz")) == ""
    hashes = {
        controller_hash(name)
        for name in ("zero", "shipped", "shipped-randomised", str(tmp_path / "mine.npz"))
    }
    # The same policy in another file is the same policy.
    assert len(hashes) == 3
    named = run_episode("stabiliser", "none", 3, **SHORT)
    assert named.controller == "stabiliser"
    env, _ = make_feed("none", **SHORT)
    given = run_episode(Stabiliser(env.unwrapped.state_layout), "none", 3, **SHORT)
    env.close()
    assert (given.total, given.tracking, given.controller) == (named.total, named.tracking, "")
    assert run_episode("zero", "none", 3, **SHORT).total != named.total


def test_the_command_compares_and_makes_a_page(tmp_path, invented):
    out = tmp_path / "out"
    arguments = ["evaluate", "zero", "shipped", "--feed", "true", "--feed", "none", "--feed", "surefoot",
                 "--seeds", "3", "--out", str(out)]  # fmt: skip
    answer = RUNNER.invoke(app, arguments)
    assert answer.exit_code == 0, answer.output
    assert len(invented) == 18
    assert (out / "index.html").is_file()
    assert json.loads((out / "evaluation.json").read_text())["evaluation"]["controllers"] == [
        "zero",
        "shipped",
    ]
    assert list(pd.read_csv(out / "evaluation.csv")["controller"].unique()) == ["zero", "shipped"]
    (out / "index.html").unlink()
    assert RUNNER.invoke(app, arguments).exit_code == 0
    assert (out / "index.html").is_file()
    assert len(invented) == 18
    answer = RUNNER.invoke(app, [*arguments, "--severity", "2"])
    assert answer.exit_code == 2
    assert "severities [1.0] and not [2.0]" in answer.output
    page = tmp_path / "page"
    answer = RUNNER.invoke(app, ["evaluate", "--page-of", f"shipped={out}", "--out", str(page)])
    assert answer.exit_code == 2
    assert "is there twice; give controllers of different files different names" in answer.output
    answer = RUNNER.invoke(app, ["evaluate", "--page-of", str(out), "--out", str(page)])
    assert answer.exit_code == 0, answer.output
    assert "shipped: trained on true feet" in (page / "index.html").read_text(encoding="utf-8")
    answer = RUNNER.invoke(app, ["evaluate", "--page-of", str(out)])
    assert "--page-of needs a folder" in answer.output


def test_one_evaluation_at_a_time_works_in_a_folder(tmp_path):
    busy = r"Another evaluation is at work in '.*'; wait for it\."
    with EvaluationFolder(tmp_path, COMPARED).opened(), pytest.raises(ValueError, match=busy):
        EvaluationFolder(tmp_path, COMPARED).opened().__enter__()
    with EvaluationFolder(tmp_path, COMPARED).opened():
        pass
