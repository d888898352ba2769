"""Episodes and sweeps: what a plan refuses, what an episode computes, and that nothing computed is lost."""

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from _logs import run
from _refusals import refusals

from surefoot.controllers.policy import PolicyNetwork
from surefoot.experiments.episodes import Episode, EpisodePlan, plan_from_toml, replay_episode, run_plan
from surefoot.experiments.episodes import episode as episodes
from surefoot.experiments.episodes.episode import episode_row, episode_steps
from surefoot.experiments.episodes.plan import walk_episode
from surefoot.experiments.episodes.run import EPISODES
from surefoot.experiments.study.store import StudyError

SHORT = EpisodePlan(
    controllers=("stabiliser",),
    feeds=("true", "none"),
    scenarios=("stand",),
    severities=(1.0, 2.0),
    seeds=(7, 8),
    duration=0.3,
    settle=0.1,
)


test_a_plan_refuses = refusals(
    lambda changes: EpisodePlan(**changes),
    ({"feeds": ()}, "'feeds' is empty, so that there is nothing to run; name at least one."),
    ({"seeds": (3, 4, 3)}, "'seeds' holds 3 twice: the same episodes would be run again."),
    ({"severities": (1, 1.0)}, "'severities' holds 1.0 twice"),
    ({"scenarios": ("uphill",)}, "There is no scenario 'uphill'. Available: speed-0.02, speed-0.04"),
    ({"scenarios": ("walking-held",)}, "There is no scenario 'walking-held'."),
    ({"feeds": ("kalman",)}, "There is no feed 'kalman'. Available: 'true', 'none'"),
    (
        {"controllers": ("pid",)},
        "There is no controller 'pid'. Available: 'zero', 'stabiliser', 'shipped', 'shipped-rand",
    ),
    ({"controllers": ("gone.npz",)}, "There is no policy file 'gone.npz'"),
    ({"controllers": ("no_module:f",)}, "'no_module:f' cannot be imported (No module named"),
    ({"controllers": ("math:no",)}, "'math:no' cannot be imported (module 'math' has no attribute 'no')"),
    ({"severities": (-1.0,)}, "A severity must be finite and not negative, got -1.0."),
    ({"severities": (float("nan"),)}, "A severity must be finite and not negative, got nan."),
    ({"severities": ("1",)}, "A severity must be finite and not negative, got '1'."),
    ({"seeds": (-1,)}, "A seed must be a whole number and not negative, got -1."),
    ({"seeds": (0.5,)}, "A seed must be a whole number and not negative, got 0.5."),
    ({"settle": 30.0}, "'settle' must be at least 0 s and less than 'duration', got 30 s and 24 s."),
    (
        {"scenarios": ("speed-0.1", "fault-dead"), "duration": 14.0},
        "In scenario 'fault-dead' a cell fails after 14 s or later: 'duration' must be longer, got 14 s.",
    ),
    ({"cells": "scales"}, "There is no LoadCells preset 'scales'"),
    plain=True,
)


def test_true_feet_have_no_severity() -> None:
    grid = SHORT.episodes
    assert [(one.feed, one.severity, one.seed) for one in grid] == [
        *(("true", 0.0, seed) for seed in (7, 8)),
        *(("none", severity, seed) for severity in (1.0, 2.0) for seed in (7, 8)),
    ]
    assert [one.number for one in grid] == list(range(6))


def test_a_fault_is_drawn_by_the_seed_and_survives_writing() -> None:
    grid = replace(SHORT, scenarios=("fault-dead", "imu-bias"), feeds=("none",), duration=15.0).episodes
    first, second = ((one.sensors or {})["faults"][0] for one in grid[:2])
    assert first["kind"] == second["kind"] == "dead"
    assert first != second
    assert all(Episode.from_json(one.to_json()) == one for one in grid)
    with pytest.raises(ValueError, match="written by another version of surefoot"):
        Episode.from_json('{"cell": 3}')


def test_a_file_says_the_same(tmp_path: Path) -> None:
    path = tmp_path / "sweep.toml"
    path.write_text(
        'controllers = ["stabiliser"]\nfeeds = ["true", "none"]\nscenarios = ["mine"]\nseverities = [1, 2]\n'
        "seeds = 2\nfirst_seed = 7\nduration = 1\nsettle = 0.1\n"
        '[scenario.mine]\nbased_on = "pushes"\noptions = { push_impulse = [0.4, 0.6] }\n'
    )
    assert plan_from_toml(path, seeds=3).seeds == (7, 8, 9)
    plan = plan_from_toml(path, duration=0.3)
    assert plan.seeds == SHORT.seeds
    assert plan.duration == 0.3
    assert plan.episodes[0].options["push_impulse"] == [0.4, 0.6]
    assert plan.episodes[0].options["speed"] == 0.04


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "severity = [1]",
            "there is no key 'severity'. Available: controllers, feeds, scenarios, severities",
        ),
        (
            '[scenario.a]\nspeed = 1\nbased_on = "stand"',
            "there is no key 'speed'. Available: based_on, title",
        ),
        ('scenarios = ["a"]\n[scenario.a]\nbased_on = "b"', "There is no scenario 'b'."),
        ('scenarios = ["a"]\n[scenario.a]\nenvironment = "No-v0"', "'No-v0', which is not registered"),
        ("seeds = [", "not TOML"),
        ("seeds = []", "'seeds' is empty"),
        ("severities = 3", "axes are lists, 'seeds' a list or how many; severities = 3."),
        ('controllers = "zero"', "controllers = 'zero'."),
        ("seeds = [1, 2]\nfirst_seed = 3", "'first_seed' needs 'seeds' that says how many, got [1, 2]."),
    ],
)
def test_a_file_is_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "sweep.toml"
    path.write_text(text)
    result = run("sweep", path, "--out", tmp_path / "out", code=2)
    assert result.stderr.startswith("surefoot: ")
    assert message in result.stderr
    assert not (tmp_path / "out").exists()


def test_an_episode_is_the_closed_loop_at_true_feet() -> None:
    plan = replace(SHORT, feeds=("true",), scenarios=("speed-0.04",), seeds=(7,), duration=4.3, settle=4.0)
    row = episode_row(plan.episodes[0])
    moments = [*episode_steps(walk_episode("true", speed=0.04, seed=7, duration=4.3))]
    assert (row["time"], row["fell"]) == (pytest.approx(moments[-1].time), moments[-1].fell)
    assert row["return"] == pytest.approx(sum(moment.reward for moment in moments))
    assert row["cop_error"] == 0.0
    assert row["tracking"] > 0.0
    assert 3.0 < row["return"] / row["steps"] < 4.0


def test_sweeping_and_repeating_an_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = run_plan(SHORT, tmp_path)
    rows = results.rows
    assert results.computed == len(rows) == 6
    assert not len(results.failed)
    assert list(rows["case"]) == list(range(6))
    assert (rows["steps"] == 24).all()
    by_severity = rows.groupby("severity")["cop_error"].mean()
    assert by_severity[0.0] == 0.0 < by_severity[1.0] < by_severity[2.0]
    replayed = replay_episode(tmp_path / EPISODES, 5)
    assert replayed.different == replayed.other_versions == ()
    assert run("replay", tmp_path, "--case", "5").stdout.endswith("Identical.\n")

    table = pd.read_parquet(tmp_path / EPISODES)
    table.loc[table["case"] == 5, "return"] = np.nextafter(rows["return"][5], np.inf)
    table.to_parquet(tmp_path / "other.parquet")
    assert run("replay", tmp_path / "other.parquet", "--case", "5", code=1).stdout.endswith("Different.\n")
    table.drop(columns="digest").to_parquet(tmp_path / "other.parquet")
    with pytest.raises(
        ValueError, match=r"lacks the column 'digest'.* an earlier version of surefoot wrote it"
    ):
        replay_episode(tmp_path / "other.parquet", 5)
    (tmp_path / "other.parquet").unlink()
    with pytest.raises(ValueError, match=r"There is no case 9 in .* it has 6, from 0 to 5"):
        replay_episode(tmp_path, 9)

    def broken(episode: Episode) -> None:
        raise AssertionError(f"episode {episode.number} is run again")

    monkeypatch.setattr(episodes, "episode_row", broken)
    again = run_plan(SHORT, tmp_path)
    assert again.computed == 0
    pd.testing.assert_frame_equal(again.rows, rows, check_exact=True)
    with pytest.raises(StudyError, match=r"holds another study: seeds \[7, 8\] and not \[7\].* with --out"):
        run_plan(replace(SHORT, seeds=(7,)), tmp_path)


@pytest.fixture
def toys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sweep_toys.py").write_text(
        "import numpy as np\n"
        "def raises(observation):\n    raise RuntimeError('the gains are gone')\n"
        "def refuses(state_layout):\n    raise ValueError('not this robot')\n"
        "class Counts:\n"
        "    def __init__(self, state_layout): self.calls = None\n"
        "    def reset(self): self.calls = 0\n"
        "    def __call__(self, observation):\n"
        "        self.calls += 1\n"
        "        return np.full(11, 0.01 * self.calls, np.float32)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("toys")
def test_functions_of_the_users(tmp_path: Path) -> None:
    plan = replace(SHORT, controllers=("sweep_toys:Counts", "sweep_toys:raises", "zero"), feeds=("true",))
    results = run_plan(plan, tmp_path / "out")
    assert list(results.failed["case"]) == [2, 3]
    assert results.failed["error"].str.endswith("RuntimeError: the gains are gone").all()
    assert "sweep_toys.py" in results.failed["error"].iloc[0]
    digests = results.finished.groupby("seed")["digest"].nunique()
    assert (digests == 2).all()
    assert run_plan(plan, tmp_path / "out").computed == 2, "what failed is tried again"
    assert replay_episode(tmp_path / "out", 2).now["error"].endswith("RuntimeError: the gains are gone")
    with pytest.raises(
        ValueError, match="'stand' with controller 'sweep_toys:refuses' cannot be run: not this"
    ):
        run_plan(replace(plan, controllers=("sweep_toys:refuses",)), tmp_path / "no")
    (tmp_path / "sweep_toys.py").write_text("def raises(observation):\n    return None\n")
    with pytest.raises(ValueError, match="is another one than the study began with"):
        episode_row(plan.episodes[2])


def policy_file(path: Path, state_size: int) -> str:
    parts = {"state": state_size, "cop": 2, "cop_valid": 3}
    policy = PolicyNetwork(
        parts,
        [np.full((2, sum(parts.values())), 0.1)],
        [np.zeros(2)],
        posture_matrix=np.eye(11)[:, [4, 5]],
        posture_speed=0.5,
        posture_memory=2.0,
        hold=4,
        dt=1.0 / 80.0,
    )
    policy.save(path)
    return str(path)


def test_a_policy_file_is_a_controller(tmp_path: Path) -> None:
    path = policy_file(tmp_path / "policy.npz", 63)
    plan = replace(SHORT, controllers=("zero", path), feeds=("true", "none"), severities=(1.0,), seeds=(7,))
    results = run_plan(plan, tmp_path / "out")
    assert not len(results.failed)
    assert results.rows["digest"].nunique() == 4
    assert replay_episode(tmp_path / "out", 3).different == ()
    policy_file(tmp_path / "policy.npz", 60)
    assert {"digest", "error"} < set(replay_episode(tmp_path / "out", 3).different)
    with pytest.raises(StudyError, match="holds another study: files"):
        run_plan(replace(plan), tmp_path / "out")
    with pytest.raises(ValueError, match=r"cannot be run: The policy was trained on 'state' of 60 numbers"):
        run_plan(replace(plan), tmp_path / "other")
    with zipfile.ZipFile(tmp_path / "sb3.zip", "w") as archive:
        archive.writestr("data", "{}")
    with pytest.raises(ValueError, match=r"is a Stable-Baselines3 zip, which holds pickled objects"):
        run_plan(replace(plan, controllers=(str(tmp_path / "sb3.zip"),)), tmp_path / "third")


def test_a_plan_is_taken_up_again_by_the_same_versions_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, invented: list[Episode]
) -> None:
    row = episodes.episode_row

    def stops(episode: Episode) -> dict[str, Any]:
        if len(invented) == 4:
            raise KeyboardInterrupt
        return row(episode)

    with monkeypatch.context() as patched:
        patched.setattr(episodes, "episode_row", stops)
        with pytest.raises(KeyboardInterrupt):
            run_plan(SHORT, tmp_path)
    # Seed by seed: what is there is paired.
    assert [one.seed for one in invented] == [7, 7, 7, 8]
    with monkeypatch.context() as patched:
        patched.setattr("surefoot.experiments.episodes.run.versions", lambda: {"numpy": "1.0"})
        with pytest.raises(StudyError, match=r"was started with numpy [\d.]+, which is not what runs now"):
            run_plan(SHORT, tmp_path)
        assert run_plan(SHORT, tmp_path, any_version=True).computed == 2
        # What is whole is not run again, whatever made it.
        assert run_plan(SHORT, tmp_path).computed == 0
    assert sorted(one.number for one in invented) == list(range(6))
    (tmp_path / "study.json").unlink()
    with pytest.raises(StudyError, match=r"holds results without a study\.json"):
        run_plan(SHORT, tmp_path)


def test_another_robot_is_swept_with_its_own_actions_and_steps(tmp_path: Path) -> None:
    table = '[scenario.mine]\nenvironment = "surefoot/Exercise-v0"\noptions = { robot = "op3" }\n'
    path = tmp_path / "sweep.toml"
    path.write_text(
        'controllers = ["zero"]\nfeeds = ["true"]\nscenarios = ["mine"]\nduration = 0.4\nsettle = 0.2\n'
        + table
    )
    plan = plan_from_toml(path, seeds=[0])
    assert episode_row(plan.episodes[0])["steps"] == 20
    with pytest.raises(ValueError, match=r"moves a NAO's 11 leg motors, .* shape \(12,\) here; name 'zero'"):
        episode_row(plan_from_toml(path, seeds=[0], controllers=["stabiliser"]).episodes[0])
