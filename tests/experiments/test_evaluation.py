"""Evaluations: no episode is lost, taken for another, or credited to the wrong policy."""

import json
import shutil
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from _logs import run
from _refusals import refusals

from surefoot.controllers import PolicyNetwork, Stabiliser, zero_action
from surefoot.experiments.episodes import episode as episodes
from surefoot.experiments.episodes import evaluation_plan, run_episode, run_plan
from surefoot.experiments.episodes.episode import check_episode
from surefoot.experiments.episodes.plan import EpisodePlan
from surefoot.experiments.episodes.run import read_episodes, sort_episodes
from surefoot.experiments.episodes.scores import controllers_of
from surefoot.experiments.episodes.tables import score_table
from surefoot.experiments.policy.card import write_card
from surefoot.experiments.policy.controllers import controller_hash, load_controller, training_sensors
from surefoot.experiments.policy.tasks import SENSORS, TASKS, TRAINING_SEEDS, policy_file, shipped_policy
from surefoot.experiments.policy.view import make_task
from surefoot.experiments.study.store import StudyError

pytestmark = pytest.mark.filterwarnings("ignore:.*unconventional shape")

SHORT = {"stand_time": 0.1, "duration": 0.6, "payload_time": (0.1, 0.2)}
WALK = {"speeds": (0.04,), "stand_time": 0.5, "duration": 1.0, "payload_time": (0.1, 0.2)}
BALANCE = str(files("surefoot.experiments.policy") / "files" / "balance-true" / "policy.npz")


def invented_frame() -> pd.DataFrame:
    rows = [
        {"controller": "clean", "feed": feed, "scenario": "balance", "seed": seed,
         "severity": float(feed != "true"), "return": mean + seed, "fell": False, "time": 9.0,
         "cop_error": 0.01, "tracking": 0.02}
        for feed, mean in (("true", 100.0), ("none", 50.0))
        for seed in range(4)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_episodes_are_read_or_refused(tmp_path):
    frame = invented_frame()
    path = tmp_path / "episodes.parquet"
    frame.to_parquet(path)
    assert set(read_episodes(tmp_path, "shipped")["controller"]) == {"shipped"}
    assert read_episodes(path)[frame.columns].equals(frame)
    for wrong, text in (
        (frame.drop(columns="return"), "lacks the column 'return'"),
        (frame.assign(feed="sand"), "There is no feed 'sand'"),
        (frame.assign(**{"return": "much"}), "column 'return' holds what is no number"),
        (frame.assign(**{"return": np.nan}), "column 'return' holds what is no number"),
    ):
        wrong.to_parquet(path)
        with pytest.raises(ValueError, match=text):
            read_episodes(path)
    frame.assign(tracking=np.nan).to_parquet(path)
    assert read_episodes(path)[frame.columns].equals(frame.assign(tracking=np.nan))
    frame.assign(controller=["", *frame["controller"][1:]]).to_parquet(path)
    assert list(read_episodes(path)["controller"].unique()) == ["policy", "clean"]
    with pytest.raises(ValueError, match="episodes of policy, clean, which cannot all be called 'mine'"):
        read_episodes(path, "mine")
    path.write_bytes(b"PAR1 and no more")
    with pytest.raises(ValueError, match=r"no table of Parquet, or is damaged: .*[^.]\.$"):
        read_episodes(path)
    with pytest.raises(ValueError, match="There is no file of episodes"):
        read_episodes(tmp_path / "nowhere")


def test_a_folder_of_rows_alone_is_no_study_to_go_on_with(tmp_path):
    invented_frame().to_parquet(tmp_path / "episodes.parquet")
    with pytest.raises(StudyError, match=r"holds results without a study\.json; give another folder"):
        run_plan(evaluation_plan(("zero",)), tmp_path)
    assert (tmp_path / "episodes.parquet").is_file()


test_what_cannot_be_run_is_refused_before_anything_is = refusals(
    lambda changes: run_plan(evaluation_plan(**{"feeds": ("true", "none"), **changes})),
    ({"task": "dance"}, "There is no task 'dance'"),
    ({"seeds": 2.5}, "'seeds' must be a whole number from 1 on, got 2.5"),
    ({"seeds": 0}, "'seeds' must be a whole number from 1 on, got 0"),
    ({"first_seed": -1}, "'first_seed' must be a whole number from 0 on, got -1"),
    ({"first_seed": 999_999_999, "seeds": 2}, "seeds from 1000000000 on are training's"),
    ({"task": "walk", "controllers": ("zero", BALANCE)}, "made for 'surefoot/NaoBalance-v0'"),
)


def test_controllers_have_names(tmp_path):
    env, _ = make_task("true", **SHORT)
    assert isinstance(load_controller("stabiliser", env), Stabiliser)
    for name, sensors in (("shipped", "true"), ("shipped-randomised", "randomised")):
        policy = load_controller(name, env)
        assert isinstance(policy, PolicyNetwork)
        assert policy.notes["options"]["sensors"] == training_sensors(name) == sensors
    # Saved by another Python a file may have other bytes.
    (tmp_path / "mine.npz").write_bytes(policy_file("balance", "randomised").read_bytes())
    layout = env.unwrapped.state_layout
    env.close()
    assert training_sensors(str(tmp_path / "mine.npz")) == "randomised"
    assert training_sensors("zero") == training_sensors(str(tmp_path / "gone.npz")) == ""
    hashes = {
        controller_hash(name, TASKS["balance"].env_id)
        for name in ("zero", "shipped", "shipped-randomised", str(tmp_path / "mine.npz"))
    }
    # The same policy in another file is the same policy.
    assert len(hashes) == 3
    named = run_episode("stabiliser", "none", 3, **SHORT)
    assert named["controller"] == "stabiliser"
    given = run_episode(Stabiliser(layout), "none", 3, **SHORT)
    assert (given["digest"], given["tracking"], given["controller"]) == (
        named["digest"],
        named["tracking"],
        "",
    )
    assert run_episode("zero", "none", 3, **SHORT)["return"] != named["return"]


def test_an_episode_is_scored_from_the_end_of_the_stand():
    row = run_episode(zero_action, "true", 3, **SHORT)
    assert row["time"] == pytest.approx(0.5)
    assert row["cop_error"] == 0.0
    assert 40.0 < row["return"] <= 120.0
    assert row["digest"] == run_episode(zero_action, "true", 3, **SHORT)["digest"]
    drifting = run_episode(zero_action, "none", 3, 2.0, **SHORT)
    # Nobody acts on what is felt, so that nothing but the feeling differs.
    assert drifting["return"] == pytest.approx(row["return"])
    assert drifting["cop_error"] > 1e-3
    with pytest.raises(ValueError, match="are training's"):
        run_episode(zero_action, "true", TRAINING_SEEDS)

    class OfAnotherRobot(PolicyNetwork):
        def __init__(self):
            self.parts = {"state": 99}

    with pytest.raises(ValueError, match="was trained on 'state'"):
        run_episode(OfAnotherRobot(), "true", 0, **SHORT)


@pytest.mark.parametrize("terminated", [True, False])
def test_a_fall_within_the_quiet_stand_is_one_after_no_time(monkeypatch, terminated):
    class Ends(gym.Wrapper):
        """Ends with the third step."""

        left = 3

        def step(self, action):
            observation, reward, _, _, info = self.env.step(action)
            self.left -= 1
            return observation, reward, terminated and not self.left, not (self.left or terminated), info

    put_on_feet = episodes.put_on_feet

    def make(*arguments):
        env, tap = put_on_feet(*arguments)
        return Ends(env), tap

    monkeypatch.setattr(episodes, "put_on_feet", make)
    row = run_episode(zero_action, "true", 3, **SHORT)
    assert (row["fell"], row["time"], row["return"]) == (terminated, 0.0, 0.0)
    assert np.isnan(row["tracking"])


def test_a_shipped_policy_is_that_of_its_task_and_fits_it():
    balance, walk = (controller_hash("shipped", TASKS[name].env_id) for name in ("balance", "walk"))
    assert balance != walk
    assert controller_hash("shipped") not in (balance, walk)
    assert evaluation_plan(feeds=("true",), task="balance").files == {"shipped": balance}
    tasks = {"balance": SHORT, "walk": WALK, "balance-hard": SHORT, "walk-hard": WALK}
    for task, options in tasks.items():
        for sensors in SENSORS:
            policy = shipped_policy(sensors, task)
            assert policy.notes["options"]["sensors"] == sensors
            row = run_episode(policy, "true", 4, task=task, **options)
            assert row["time"] == pytest.approx(options["duration"] - options["stand_time"])
            assert not row["fell"]
    # A harder task lets policies of the easier one in, which lets none of the harder one in.
    hard, harder = shipped_policy("true", "balance-hard"), TASKS["walk-hard"].env_id
    assert controller_hash("shipped", harder) == walk
    assert hard.notes["task"] == TASKS["balance-hard"].env_id
    with pytest.raises(ValueError, match=r"made for 'surefoot/NaoBalanceHard-v0'.* --task balance-hard"):
        run_episode(hard, "true", 4, **SHORT)


def test_a_policy_of_another_task_is_refused_though_it_fits(tmp_path):
    balance, path = shipped_policy("true", "balance"), str(tmp_path / "mine.npz")
    balance.save(path)
    other = r"was made for 'surefoot/NaoBalance-v0', and this is 'surefoot/NaoCarry-v0'; .* --task balance"
    with pytest.raises(ValueError, match=other):
        run_episode(balance, "true", 3, task="walk", **WALK)
    env, _ = make_task("true", task="walk", **WALK)
    with pytest.raises(ValueError, match=f"Policy '{path}' {other}"):
        load_controller(path, env, same_task=True)
    # A sweep asks what a policy does where it was not made for.
    assert isinstance(load_controller(path, env), PolicyNetwork)
    check_episode(EpisodePlan((path,), ("true",), ("stand",), (1.0,), (0,)).episodes[0])
    # Policies from elsewhere do not say what they were made for.
    balance.notes = {"task": 7}
    balance.save(path)
    assert isinstance(load_controller(path, env, same_task=True), PolicyNetwork)
    env.close()
    balance.notes = {}
    assert run_episode(balance, "true", 3, task="walk", **WALK)["time"] > 0.0


def test_seeds_are_paired_and_nothing_is_run_twice(invented):
    plan = evaluation_plan(("zero",), ("true", "none"), (0.5, 1.0), seeds=2)
    rows = sort_episodes(run_plan(plan).rows)
    assert len(rows) == len(invented) == 2 * (1 + 2)
    assert [row[:2] for row in score_table(rows).rows] == [("true", "–"), ("none", "0.5"), ("none", "1")]


def test_the_order_of_what_is_compared_makes_no_other_evaluation(tmp_path, invented):
    first = evaluation_plan(("zero", "stabiliser"), ("true", "none"), (1.0, 2.0), seeds=2)
    run_plan(first, tmp_path)
    turned = evaluation_plan(("stabiliser", "zero"), ("none", "true"), (2.0, 1.0), seeds=2)
    results = run_plan(turned, tmp_path)
    assert results.computed == 0
    assert len(invented) == 12
    assert controllers_of(sort_episodes(results.rows, ("zero", "stabiliser"))) == ["zero", "stabiliser"]
    with pytest.raises(StudyError, match=r"controllers \['stabiliser', 'zero'\] and not \['zero'\].*; seeds"):
        run_plan(evaluation_plan(("zero",), ("true", "none"), (1.0, 2.0), seeds=3), tmp_path)


@pytest.mark.slow
def test_the_command_compares_and_makes_a_page(tmp_path, invented, undrawn):
    out = tmp_path / "out"
    arguments = ["evaluate", "zero", "shipped", "--feed", "true", "--feed", "none", "--feed", "moment",
                 "--seeds", "3", "--out", str(out)]  # fmt: skip
    run(*arguments)
    assert len(invented) == 18
    assert [len(pd.read_csv(out / "tables" / f"scores_{i}.csv")) for i in (0, 1)] == [3, 3]
    (out / "index.html").unlink()
    run(*arguments)
    assert (out / "index.html").is_file()
    assert len(invented) == 18
    assert "severities [1.0] and not [2.0]" in run(*arguments, "--severity", "2", code=2).output
    page = tmp_path / "page"
    answer = run("evaluate", "--page-of", f"shipped={out}", "--out", page, code=2)
    assert "episodes of shipped, zero, which cannot all be called 'shipped'" in answer.output
    answer = run("evaluate", *["--page-of", out] * 2, "--out", page, code=2)
    assert "is there twice; give controllers of different files different names" in answer.output
    run("evaluate", "--page-of", out, "--out", page)
    assert "shipped: trained on true feet" in (page / "index.html").read_text(encoding="utf-8")
    assert "--page-of needs a folder" in run("evaluate", "--page-of", out, code=2).output
    for option in (["zero"], ["--seeds", "50"], ["--feed", "true"], ["--task", "balance"]):
        answer = run("evaluate", "--page-of", out, "--out", page, *option, code=2)
        name = "controllers" if option == ["zero"] else option[0]
        assert f"--page-of runs nothing, and {name} says what to run" in answer.output
    run("evaluate", "zero", "--feed", "true", "--seeds", "1")


@pytest.fixture
def mine(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    shutil.copy(BALANCE, folder / "policy.npz")
    return folder


def test_what_is_shipped_has_its_card(tmp_path, undrawn):
    shipped = sorted(Path(str(files("surefoot.experiments.policy") / "files")).iterdir())
    assert {folder.name for folder in shipped} == {
        *(f"{task}-{sensors}" for task in ("balance", "walk") for sensors in SENSORS), "balance-hard-true",
    }  # fmt: skip
    for folder in shipped:
        copied = shutil.copytree(folder, tmp_path / folder.name)
        assert write_card(copied).read_text() == (folder / "card.md").read_text()


def test_a_page_says_what_a_policy_was_when_it_was_run(tmp_path, mine, invented, undrawn):
    out, policy = tmp_path / "out", str(mine / "policy.npz")
    run("evaluate", policy, "--feed", "true", "--seeds", "3", "--out", out)
    before = controller_hash(policy)
    assert before == controller_hash("shipped", TASKS["balance"].env_id)
    shipped_policy("randomised").save(policy)
    known = read_episodes(out)
    assert set(known["controller_hash"]) == {before}
    assert set(known["trained"]) == {"true"}
    answer = run("evaluate", policy, "--feed", "true", "--seeds", "3", "--out", out, code=2)
    assert "holds another study: files" in answer.output.replace("\n", " ")
    other = tmp_path / "other"
    run("evaluate", policy, "--feed", "none", "--seeds", "3", "--out", other)
    both = ["evaluate", "--page-of", str(out), "--page-of", str(other), "--out", str(tmp_path / "page")]
    assert "is not the same file everywhere" in run(*both, code=2).output
    # A page is made of rows that say nothing of it, too.
    bare = tmp_path / "bare.parquet"
    read_episodes(out)[list(invented_frame().columns)].to_parquet(bare)
    run("evaluate", "--page-of", bare, "--out", tmp_path / "bare")


def test_a_policy_that_is_changed_while_it_is_evaluated_is_not_mixed_with_another(mine, monkeypatch):
    policy = str(mine / "policy.npz")
    whole = Path(policy).read_bytes()
    ran, row = [], episodes.episode_row

    def changes(episode):
        if ran:
            shipped_policy("randomised").save(policy)
        ran.append(episode)
        return row(replace(episode, options={**episode.options, **SHORT}))

    monkeypatch.setattr(episodes, "episode_row", changes)
    results = run_plan(evaluation_plan((policy,), ("true",), seeds=3), mine)
    assert len(results.finished) == 1
    assert results.failed["error"].str.contains("is another one than the study began with; put the old").all()
    Path(policy).write_bytes(whole)
    monkeypatch.setattr(
        episodes, "episode_row", lambda one: row(replace(one, options={**one.options, **SHORT}))
    )
    assert run_plan(evaluation_plan((policy,), ("true",), seeds=3), mine).computed == 2
    assert json.loads((mine / "study.json").read_text())["plan"]["controllers"] == [policy]
