"""Evaluations: no episode is lost, taken for another, or credited to the wrong policy."""

import json
from importlib.resources import files
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from surefoot.controllers import PolicyNetwork, Stabiliser, zero_action
from surefoot.experiments.cli.app import app
from surefoot.experiments.policy import evaluate, evaluation_folder
from surefoot.experiments.policy import evaluation as evaluations
from surefoot.experiments.policy.controllers import controller_hash, load_controller, trained_on
from surefoot.experiments.policy.env import make_feed
from surefoot.experiments.policy.episodes import read_episodes
from surefoot.experiments.policy.evaluate import DONOR, EpisodeResult, run_episode, run_episodes
from surefoot.experiments.policy.evaluation import Evaluation
from surefoot.experiments.policy.evaluation_folder import EvaluationFolder
from surefoot.experiments.policy.options import TRAINING_SEEDS
from surefoot.experiments.policy.origin import origins_of
from surefoot.experiments.policy.scores import episodes_frame, score_table
from surefoot.experiments.policy.tasks import TASKS

pytestmark = pytest.mark.filterwarnings("ignore:.*unconventional shape")

RUNNER = CliRunner()
SHORT = {"stand_time": 0.1, "duration": 0.6, "payload_time": (0.1, 0.2)}


def made_up():
    means = {"true": 100.0, "none": 50.0}
    return episodes_frame(
        [
            EpisodeResult(feed, "felt", 1.0, seed, mean + seed, False, 9.0, 0.01, 0.02, "clean")
            for feed, mean in means.items()
            for seed in range(4)
        ]
    )


def test_episodes_are_read_or_refused(tmp_path):
    frame = made_up()
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
        (frame.assign(controller=7), "column 'controller' holds 7 and not a name"),
        (frame.assign(feed=[None, *frame["feed"][1:]]), "column 'feed' holds (None|nan) and not a name"),
        (frame.assign(total=np.nan), "holds nan in its column 'total', which must be a finite number"),
        (frame.assign(total=-np.inf), "holds -inf in its column 'total'"),
        (frame.assign(seed=frame["seed"] + 0.5), "'seed', which must be a whole number from 0"),
        (frame.assign(seed=-1), "'seed', which must be a whole number from 0"),
        (frame.assign(time=-1.0), "'time', which must be a finite number and not negative"),
        (frame.assign(severity=np.inf), "'severity', which must be a finite number and not negative"),
        (frame.assign(fell=2), "'fell', which must be true or false"),
        (frame.assign(tracking=np.inf), "'tracking', which must be a finite number and not negative"),
    ):
        wrong.to_parquet(path)
        with pytest.raises(ValueError, match=text):
            read_episodes(path)
    frame.assign(tracking=np.nan, seed=frame["seed"].astype(float), fell=0).to_parquet(path)
    assert read_episodes(path).equals(frame.assign(tracking=np.nan))
    frame.assign(controller=["", *frame["controller"][1:]]).to_parquet(path)
    assert list(read_episodes(path)["controller"].unique()) == ["policy", "clean"]
    with pytest.raises(ValueError, match="episodes of policy, clean, which cannot all be called 'mine'"):
        read_episodes(path, "mine")
    path.write_bytes(b"PAR1 and no more")
    with pytest.raises(ValueError, match="no table of Parquet, or is damaged"):
        read_episodes(path)
    with pytest.raises(ValueError, match="There is no file of episodes"):
        read_episodes(tmp_path / "nowhere")


def stop_after(count, folder):
    with folder.opened():
        for number, _ in enumerate(folder.run(), 1):
            if number == count:
                raise KeyboardInterrupt


BALANCE = str(files("surefoot.experiments.policy") / "files" / "balance-true" / "policy.npz")
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
    known = origins_of(tmp_path, ["zero"])["zero"]
    assert known.versions.startswith("surefoot ")
    assert known.runs
    # What is whole is not run again, whatever made it.
    monkeypatch.setattr(evaluations, "_versions", lambda: {"surefoot": "another"})
    with (done := EvaluationFolder(tmp_path, COMPARED)).opened():
        assert list(done.run()) == []
    assert len(done.frame) == 20


def test_a_full_disk_costs_only_what_was_not_yet_written(tmp_path, invented, monkeypatch):
    monkeypatch.setattr(evaluation_folder, "EVERY", -1.0)
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
        ({"severities": (1.0, -1.0)}, "severity must be finite and not negative, got -1.0"),
        ({"severities": (float("nan"),)}, "severity must be finite and not negative, got nan"),
        ({"severities": ("1",)}, "severity must be finite and not negative, got '1'"),
        ({"cop_inputs": ("felt", "guessed")}, "'cop_input' must be one of .*, got 'guessed'"),
        ({"seeds": 2.5}, "'seeds' must be a whole number from 1 on, got 2.5"),
        ({"seeds": 0}, "'seeds' must be a whole number from 1 on, got 0"),
        ({"first_seed": -1}, "'first_seed' must be a whole number from 0 on, got -1"),
        ({"first_seed": 999_999_999, "seeds": 2}, "seeds from 1000000000 on are training's"),
        (
            {"first_seed": TRAINING_SEEDS - DONOR - 1, "seeds": 2, "cop_inputs": ("felt", "swapped")},
            "'swapped' takes an episode 500000 further on",
        ),
        ({"task": "walk", "controllers": ("zero", BALANCE)}, "made for 'surefoot/NaoBalance-v0'"),
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
        controller_hash(name, TASKS["balance"].env_id)
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
    arguments = ["evaluate", "zero", "shipped", "--feed", "true", "--feed", "none", "--feed", "moment",
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
    assert "episodes of zero, shipped, which cannot all be called 'shipped'" in answer.output
    answer = RUNNER.invoke(app, ["evaluate", *["--page-of", str(out)] * 2, "--out", str(page)])
    assert answer.exit_code == 2
    assert "is there twice; give controllers of different files different names" in answer.output
    answer = RUNNER.invoke(app, ["evaluate", "--page-of", str(out), "--out", str(page)])
    assert answer.exit_code == 0, answer.output
    assert "shipped: trained on true feet" in (page / "index.html").read_text(encoding="utf-8")
    answer = RUNNER.invoke(app, ["evaluate", "--page-of", str(out)])
    assert "--page-of needs a folder" in answer.output
    for option in (["zero"], ["--seeds", "50"], ["--feed", "true"], ["--uses-cop"], ["--task", "balance"]):
        answer = RUNNER.invoke(app, ["evaluate", "--page-of", str(out), "--out", str(page), *option])
        assert answer.exit_code == 2
        name = "controllers" if option == ["zero"] else option[0]
        assert f"--page-of runs nothing, and {name} says what to run" in answer.output
    assert RUNNER.invoke(app, ["evaluate", "zero", "--feed", "true", "--seeds", "1"]).exit_code == 0


def test_one_evaluation_at_a_time_works_in_a_folder(tmp_path):
    busy = r"Another evaluation is at work in '.*'; wait for it\."
    with EvaluationFolder(tmp_path, COMPARED).opened(), pytest.raises(ValueError, match=busy):
        EvaluationFolder(tmp_path, COMPARED).opened().__enter__()
    with EvaluationFolder(tmp_path, COMPARED).opened():
        pass


def test_the_order_of_what_is_compared_makes_no_other_evaluation(tmp_path, invented):
    first = Evaluation(("zero", "stabiliser"), ("true", "none"), (1.0, 2.0), seeds=2)
    with (folder := EvaluationFolder(tmp_path, first)).opened():
        for number, _ in enumerate(folder.run(), 1):
            if number == 8:
                break
    turned = Evaluation(("stabiliser", "zero"), ("none", "true"), (2.0, 1.0), seeds=2)
    with (again := EvaluationFolder(tmp_path, turned)).opened():
        assert again.missing == 4
        list(again.run())
    assert len(invented) == 12
    frame = read_episodes(tmp_path)
    assert list(frame["controller"].unique()) == ["stabiliser", "zero"]
    assert set(frame[frame["feed"] == "true"]["severity"]) == {2.0}
    assert len(score_table(frame).rows) == 2 * 3
    assert json.loads((tmp_path / "evaluation.json").read_text())["evaluation"]["severities"] == [2.0, 1.0]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"seed": 7}, "seed 7, of the task 'balance', which is none of this evaluation"),
        ({"severity": 3.0}, "severity 3, seed 20000"),
        ({"controller": "shipped"}, "'shipped' on feed 'true'"),
        ({"task": "walk"}, "of the task 'walk'"),
        ({}, "seed 20000, twice"),
    ],
)
def test_episodes_that_are_none_of_the_evaluation_are_refused(tmp_path, invented, change, text):
    with (folder := EvaluationFolder(tmp_path, COMPARED)).opened():
        list(folder.run())
    frame = read_episodes(tmp_path)
    row = frame[(frame["feed"] == "true") & (frame["seed"] == 20_000)].iloc[:1]
    pd.concat([frame, row.assign(**change)]).to_parquet(tmp_path / "episodes.parquet")
    with pytest.raises(ValueError, match=text):
        EvaluationFolder(tmp_path, COMPARED).opened().__enter__()


def test_what_is_done_is_not_run_again():
    done = [("true", 1, 0.5, "felt"), ("none", 2, 1.0, "felt")]
    results = run_episodes(zero_action, ["true", "none"], [1, 2], [0.5, 1.0], done=done, **SHORT)
    assert [(one.feed, one.seed, one.severity) for one in results] == [
        ("none", 1, 0.5), ("none", 1, 1.0), ("true", 2, 0.5), ("none", 2, 0.5),
    ]  # fmt: skip


@pytest.mark.parametrize("terminated", [True, False])
def test_a_fall_within_the_quiet_stand_is_one_after_no_time(monkeypatch, terminated):
    class Ends(gym.Wrapper):
        """Ends with the third step."""

        left = 3

        def step(self, action):
            observation, reward, _, _, info = self.env.step(action)
            self.left -= 1
            return observation, reward, terminated and not self.left, not (self.left or terminated), info

    def make(*arguments, **options):
        env, tap = make_feed(*arguments, **options)
        return Ends(env), tap

    monkeypatch.setattr(evaluate, "make_feed", make)
    result = run_episode(zero_action, "true", 3, **SHORT)
    assert (result.fell, result.time, result.total) == (terminated, 0.0, 0.0)
    assert np.isnan(result.tracking)


def test_the_episode_that_is_taken_is_none_of_trainings():
    with pytest.raises(ValueError, match="'shuffled' takes an episode 500000 further on"):
        run_episode(zero_action, "true", TRAINING_SEEDS - DONOR, cop_input="shuffled", **SHORT)
    last = run_episode(zero_action, "true", TRAINING_SEEDS - 1, cop_input="frozen", **SHORT)
    assert last.time == pytest.approx(0.5)


def test_a_shipped_policy_is_that_of_its_task():
    balance, walk = (controller_hash("shipped", TASKS[name].env_id) for name in ("balance", "walk"))
    assert balance != walk
    assert controller_hash("shipped") not in (balance, walk)
    assert Evaluation(feeds=("true",)).files() == {"shipped": balance}
