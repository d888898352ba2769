"""The evaluation engine: the same episodes on every feed, in any environment, by any policy and process."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import _biped
import gymnasium as gym
import joblib
import numpy as np
import pandas as pd
import pytest
from _refusals import refusals

import surefoot
from surefoot.controllers import Stabiliser, zero_action
from surefoot.experiments.evaluate import Setup, evaluate, grid, run_episode
from surefoot.experiments.evaluate.grid import FEEDS, Plan
from surefoot.experiments.evaluate.scenarios import Scenario
from surefoot.experiments.policy.tasks import TASKS, TRAINING_SEEDS, shipped_policy
from surefoot.experiments.policy.view import PolicyView
from surefoot.experiments.study.store import StudyError

SHORT = {"stand_time": 0.1, "duration": 0.6, "payload_time": (0.1, 0.2)}
pytestmark = [
    pytest.mark.filterwarnings("ignore:The feet of:UserWarning"),  # of an environment without seeds
    pytest.mark.filterwarnings("ignore:SelfCalibration has learnt nothing:UserWarning"),  # episodes are short
]

FEW: dict[str, Any] = {"seeds": (7, 8), "severities": (1.0,), "feeds": ("true", "raw", "moment")}


def bare_loop(env: Any, act: Any, seed: int) -> tuple[float, int]:
    """Return the return and the length of an episode without anything around the environment."""
    observation, _ = env.reset(seed=seed)
    total, length, done = 0.0, 0, False
    while not done:
        observation, reward, fell, truncated, _ = env.step(act(observation))
        total, length, done = total + float(reward), length + 1, fell or truncated
    return total, length


def test_a_policy_that_looks_at_no_feet_has_the_bare_environments_episodes_on_every_feed():
    rows = evaluate(_biped.make, _biped.swing, seeds=(7, 8), severities=(0.0, 2.0), metrics=("height",)).rows
    assert len(rows) == 2 + 3 * 2 * 2
    assert list(rows["case"]) == list(range(len(rows)))
    for seed, of_seed in rows.groupby("seed"):
        total, length = bare_loop(_biped.make(), _biped.swing, seed)
        assert set(of_seed["return"]) == {total}
        assert set(of_seed["length"]) == {length} == {_biped.STEPS}
    assert rows["height"].between(0.5, 0.7).all()
    worst = rows[rows["severity"] == 2.0]
    assert (worst["cop_error"] > 0.002).all()
    assert (worst["cop_error_left"] > 0.002).all()


def test_at_severity_0_every_feed_is_the_truth_to_the_last_bit():
    def act(observation):
        return 5.0 * np.resize(observation["cop"], 11)

    options = {"duration": 0.5}
    rows = evaluate(
        "surefoot/NaoStand-v0",
        act,
        seeds=(7,),
        severities=(0.0, 1.0),
        env_options=options,
        sensors={"measure_state": False},
    ).rows
    exact = rows[rows["severity"] == 0.0]
    assert set(exact["feed"]) == set(FEEDS)
    assert exact["digest"].nunique() == 1
    assert (exact["cop_error"] == 0.0).all()
    assert set(exact["return"]) == {bare_loop(gym.make("surefoot/NaoStand-v0", **options), act, 7)[0]}
    drifting = rows[rows["severity"] == 1.0]
    assert not set(drifting["digest"]) & set(exact["digest"])


def test_true_feet_of_any_robot_are_the_measured_truth():
    setup = Setup(_biped.make, observe=("cop", "vgrf", "wrench", "foot_load", "foot_force"))
    feet = setup.feet("true", 1.0)
    observation, info = feet.reset(seed=3)
    for _ in range(5):
        observation, *_, info = feet.step(np.zeros(4))
    truth = info["surefoot"]["truth"]
    np.testing.assert_allclose(observation["cop"], truth["cop"], atol=1e-6)
    np.testing.assert_allclose(observation["wrench"], truth["wrench_sole"], rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(observation["foot_force"].sum(), truth["vgrf"].sum(), rtol=0.05)
    np.testing.assert_allclose(
        observation["foot_load"].sum() * 10.8 * 9.81, observation["foot_force"].sum(), rtol=1e-5
    )
    assert feet.errors() == {"cop_error": 0.0, "cop_error_left": 0.0, "cop_error_right": 0.0}


def test_what_is_observed_reaches_the_policy():
    seen: list[Any] = []

    def note(observation):
        seen.append(observation)
        return np.zeros(4)

    def first(**given: Any) -> Any:
        seen.clear()
        run_episode(Setup(_biped.make, **given), note, "raw", 1.0, seed=3)
        return seen[0]

    assert first().shape == (21,)
    assert first(observe=("state", "cop", "vgrf")).shape == (25,)
    assert first(observe=_biped.cop_of).shape == (2,)
    assert set(first(wrap=lambda env: gym.wrappers.FilterObservation(env, ["cop"]))) == {"cop"}
    with pytest.raises(
        ValueError, match=r"observes 'cops', and the environment with its sensors shows \['cop'"
    ):
        first(observe=("cops",))
    # Wrappers that the environment brings along from training stay where they are.
    framed = Setup(lambda: gym.wrappers.FrameStackObservation(_biped.make(), 3))
    run_episode(framed, note, "raw", 1.0, seed=3)
    assert seen[-1].shape == (3, 21)


def test_a_task_of_the_package_counts_from_the_end_of_its_stand():
    task = TASKS["balance"]
    setup = Setup(task.env_id, env_options=SHORT)
    row = run_episode(setup, "shipped", "true", 1.0, seed=3)
    assert row["time"] == pytest.approx(0.5)
    assert (row["length"], row["fell"], row["cop_error"]) == (40, False, 0.0)
    given = run_episode(setup, shipped_policy("true", "balance"), "true", 1.0, seed=3)
    assert given["digest"] == row["digest"]
    layout = gym.make(task.env_id).unwrapped.state_layout
    named = run_episode(setup, "stabiliser", "raw", 1.0, seed=3)
    assert named["digest"] == run_episode(setup, Stabiliser(layout), "raw", 1.0, seed=3)["digest"]
    assert named["digest"] != row["digest"]
    # A policy that decides on a view of the environment holds its actions for several steps.
    view = Setup(task.env_id, env_options=SHORT, wrap=PolicyView)
    assert run_episode(view, lambda observation: np.zeros(4), "raw", 1.0, seed=3)["time"] == pytest.approx(
        0.5
    )
    with pytest.raises(
        ValueError, match=r"made for 'surefoot/NaoBalance-v0', and this is 'surefoot/NaoWalk-v0'"
    ):
        run_episode(Setup("surefoot/NaoWalk-v0"), shipped_policy("true", "balance"), "true", 1.0, seed=3)


test_what_cannot_be_run_is_refused_before_anything_is = refusals(
    lambda changes: evaluate(**{"make_env": _biped.make, "policy": _biped.swing, "seeds": 2, **changes}),
    ({"make_env": "Gone-v0"}, "There is no environment 'Gone-v0'"),
    ({"make_env": "gone:make"}, "'gone:make' cannot be imported (No module named 'gone')"),
    ({"make_env": 3}, "'make_env' must be an id of Gymnasium, a function that makes an environment"),
    ({"make_env": lambda: 3}, "'make_env' must return an environment of Gymnasium, got 3."),
    ({"make_env": _biped.make_forgetful}, "does not start the same episode again by reset(seed="),
    ({"policy": 3}, "'policy' must be a Stable-Baselines3 model, a torch module, a function"),
    ({"policy": {}}, "'policy' names no policy, so that there is nothing to run."),
    ({"policy": "pid"}, "There is no controller 'pid'. Available: 'zero', 'stabiliser'"),
    ({"policy": "gone.npz"}, "There is no policy file 'gone.npz'"),
    (
        {"policy": zero_action},
        "The policy answers with actions of shape (11,), and the environment takes (4,)",
    ),
    ({"policy": lambda state: np.full(4, np.nan)}, "first observation with numbers that are not finite"),
    ({"feeds": ("kalman",)}, "There is no feed 'kalman'. Available: 'true', 'none'"),
    ({"feeds": ()}, "'feeds' must be a list with at least one element, got ()."),
    ({"feeds": "raw"}, "'feeds' must be a list with at least one element, got 'raw'."),
    ({"severities": (-1.0,)}, "A severity must be finite and not negative, got -1.0."),
    ({"severities": (float("nan"),)}, "A severity must be finite and not negative, got nan."),
    ({"severities": (1, 1.0)}, "'severities' holds 1.0 twice"),
    ({"seeds": 0}, "'seeds' is empty, so that there is nothing to run"),
    ({"seeds": (0.5,)}, "A seed must be a whole number from 0 to 999999999, got 0.5"),
    ({"seeds": (TRAINING_SEEDS,)}, "seeds from 1000000000 on are training's."),
    ({"cells": "scales"}, "There is no foot sensor preset 'scales'"),
    ({"faults": {"explodes": 0.1}}, "explodes"),
    ({"scenario": "wind=3"}, "There is no scenario 'wind'. Available: payload, slope, friction, soft, push"),
    ({"scenario": "payload=-3"}, "The scenario's 'payload' must be 0 or more, got -3."),
    ({"settle": -1.0}, "'settle' must be a time in s from 0 on, got -1.0."),
    plain=True,
)


def test_environments_without_mujoco_or_with_true_contact_forces_are_refused():
    with pytest.raises(TypeError, match="MuJoCo"):
        evaluate("CartPole-v1", lambda state: 0, seeds=1)
    contacts = {"env_options": {"include_cfrc_ext_in_observation": True}, "sensors": {"soles": True}}
    with pytest.raises(ValueError, match="'cfrc_ext', the true forces of its contacts"):
        evaluate("Humanoid-v5", lambda state: np.zeros(17), seeds=1, **contacts)
    setup = Setup("Humanoid-v5", sensors={"soles": True})
    assert run_episode(setup, lambda state: np.zeros(17) * len(state), "raw", 1.0, seed=3)["fell"]


def test_a_folder_goes_on_and_refuses_another_study(tmp_path, monkeypatch):
    given: Any = {"policy": _biped.lean, "observe": _biped.cop_of, **FEW}
    whole = evaluate(_biped.make, **given)
    calls = []
    original = grid.Stage.row

    def stops(stage, seed):
        calls.append(seed)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return original(stage, seed)

    with monkeypatch.context() as patched:
        patched.setattr(grid.Stage, "row", stops)
        with pytest.raises(KeyboardInterrupt):
            evaluate(_biped.make, out=tmp_path, **given)
    assert calls == [7, 7, 7, 8], "seed by seed: what there is is paired"
    resumed = evaluate(_biped.make, out=tmp_path, **given)
    assert resumed.computed == 3
    assert list(resumed.rows["digest"]) == list(whole.rows["digest"])
    assert evaluate(_biped.make, out=tmp_path, **given).computed == 0
    kept = pd.read_parquet(tmp_path / "episodes.parquet")
    pd.testing.assert_frame_equal(kept, resumed.rows)
    assert len(pd.read_csv(tmp_path / "episodes.csv")) == 6
    repeated = resumed.again(5)
    assert repeated.different == repeated.other_versions == ()
    with pytest.raises(ValueError, match="There is no row of case 99; this evaluation has 6"):
        resumed.again(99)
    with pytest.raises(
        StudyError, match=r"holds another study: seeds \[7, 8\] and not \[7, 9\].* with --out"
    ):
        evaluate(_biped.make, out=tmp_path, **{**given, "seeds": (7, 9)})
    with pytest.raises(StudyError, match="holds another study: policies"):
        evaluate(_biped.make, _biped.swing, out=tmp_path, **FEW)


@pytest.mark.slow
def test_processes_change_no_digit(tmp_path):
    given: Any = {"policy": _biped.lean, "observe": _biped.cop_of, **FEW}
    alone = evaluate(_biped.make, **given).rows
    two = evaluate(_biped.make, jobs=2, **given).rows
    pd.testing.assert_frame_equal(
        alone.drop(columns="wall_time"), two.drop(columns="wall_time"), check_exact=True
    )
    with joblib.parallel_config("threading", n_jobs=2):
        assert list(evaluate(_biped.make, **given).rows["digest"]) == list(alone["digest"])


@pytest.mark.slow
def test_a_process_that_dies_costs_its_episodes_alone():
    arms = {"dies": _biped.dies, "swing": _biped.swing}
    rows = evaluate(_biped.make, arms, feeds=("true",), seeds=2, jobs=2).rows
    failed = rows[rows["error"] != ""]
    assert set(failed["policy"]) == {"dies"}
    assert failed["error"].str.startswith("The worker that ran this case died: ").all()
    assert len(failed) == 2
    assert (rows[rows["policy"] == "swing"]["error"] == "").all()


def test_an_episode_that_fails_is_a_row_with_its_traceback(tmp_path):
    results = evaluate(_biped.make, _biped.raises, seeds=6, feeds=("true",), out=tmp_path)
    assert 0 < len(results.failed) < 6
    assert results.failed["error"].str.endswith("RuntimeError: the gains are <gone>").all()
    assert "_biped.py" in results.failed["error"].iloc[0]
    again = evaluate(_biped.make, _biped.raises, seeds=6, feeds=("true",), out=tmp_path)
    assert again.computed == len(results.failed), "what failed is tried again"
    assert "the gains are &lt;gone&gt;" in results.page().read_text()


def test_an_environment_serves_one_episode_after_another_as_a_fresh_one_would():
    """Stages are kept between episodes: nothing of one may reach the next."""
    plan = Plan.of("surefoot/NaoBalance-v0", "shipped", env_options=SHORT, seeds=(3,), feeds=("moment",))
    stage = plan.stage(plan.episodes[0])
    rows = [stage.row(seed) for seed in (3, 4, 3)]
    assert rows[0]["digest"] == rows[2]["digest"] != rows[1]["digest"]
    setup = Setup(_biped.make, observe=_biped.cop_of, faults={"dies": 0.5})
    faulty = Plan.of(_biped.make, _biped.lean, observe=_biped.cop_of, faults={"dies": 0.5}, seeds=(3,))
    used = faulty.stage(faulty.episodes[-1])
    digests = [used.row(seed)["digest"] for seed in (8, 3)]
    assert digests[1] == run_episode(setup, _biped.lean, "moment", 3.0, 3)["digest"]


def test_who_does_nothing_is_run_on_true_feet_alone():
    rows = evaluate("surefoot/NaoStand-v0", "zero", seeds=2, env_options={"duration": 0.2}).rows
    assert list(rows["feed"]) == ["true", "true"]


def test_scenarios_change_the_world_below_the_sensors():
    def load(scenario: Any) -> float:
        feet = Setup(_biped.make, scenario=scenario).feet("true", 1.0)
        feet.reset(seed=3)
        for _ in range(30):
            *_, info = feet.step(np.zeros(4))
        return float(info["surefoot"]["truth"]["vgrf"].sum())

    assert load("payload=2") - load(None) == pytest.approx(2.0 * 9.81, rel=0.1)
    pushed = Setup("surefoot/NaoStand-v0", env_options={"duration": 1.5}, scenario=["push=3", "friction=0.5"])
    rows = [
        run_episode(pushed, zero_action, feed, 1.0, seed)
        for feed, seed in (("true", 3), ("raw", 3), ("raw", 4))
    ]
    assert rows[0]["return"] == rows[1]["return"] != rows[2]["return"]
    plain = run_episode(
        Setup("surefoot/NaoStand-v0", env_options={"duration": 1.5}), zero_action, "raw", 1.0, 3
    )
    assert plain["return"] != rows[1]["return"]
    slope = Scenario(slope=5.0)(Setup(_biped.make).feet("true", 1.0))
    assert slope.unwrapped.model.opt.gravity[0] > 0.5


def test_the_function_is_the_packages_own():
    assert surefoot.evaluate is evaluate


@pytest.mark.slow
def test_an_interruption_leaves_nothing_running(tmp_path):
    script = tmp_path / "run.py"
    script.write_text(
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import _biped, surefoot\n"
        "if __name__ == '__main__':\n"
        f"    out = {str(tmp_path / 'out')!r}\n"
        "    surefoot.evaluate(_biped.make, _biped.swing, seeds=4000, jobs=2, out=out)\n"
    )
    # A file and no pipe: workers of a stopped process would keep a pipe open for a while.
    with (tmp_path / "said.txt").open("wb") as said:
        process = subprocess.Popen([sys.executable, str(script)], stderr=said, stdout=said)
    journal = tmp_path / "out" / "journal.jsonl"
    for _ in range(600):
        if journal.is_file() and journal.stat().st_size:
            break
        signal.sigtimedwait([], 0.1)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=30) != 0
    assert journal.stat().st_size


@pytest.mark.slow
def test_a_cluster_gives_the_same_rows_though_a_worker_is_killed(monkeypatch):
    distributed = pytest.importorskip("distributed", reason="needs dask: pip install surefoot[dask]")
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent), prepend=os.pathsep)
    given: Any = {"policy": _biped.lean, "observe": _biped.cop_of, "seeds": 20, "severities": (1.0, 2.0)}
    here = evaluate(_biped.make, **given).rows
    options: Any = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        first, _ = client.run(os.getpid).values()
        killing = threading.Timer(3.0, os.kill, (first, signal.SIGKILL))
        killing.start()
        with joblib.parallel_config("dask"):
            there = evaluate(_biped.make, **given).rows
        killing.join()
    pd.testing.assert_frame_equal(
        here.drop(columns="wall_time"), there.drop(columns="wall_time"), check_exact=True
    )


def test_a_torso_without_mass_is_pushed_and_takes_no_payload():
    feet = Setup(_biped.make).feet("true", 1.0)
    model, torso = feet.source.model, feet.source.model.body("torso").id
    model.body_mass[torso], inertia = 0.0, model.body_inertia[torso].copy()
    Scenario(push=2.0)(feet)
    np.testing.assert_array_equal(model.body_inertia[torso], inertia)
    with pytest.raises(ValueError, match="'payload' is 1 kg on the torso 'torso', which has no mass itself"):
        Scenario(payload=1.0)(feet)


def test_seeds_may_be_an_array():
    plan = Plan.of(_biped.make, _biped.swing, seeds=np.arange(3), feeds=("true",))
    assert [one.seed for one in plan.episodes] == [0, 1, 2]
    with pytest.raises(
        ValueError, match="'seeds' must be a whole number of seeds or a list of seeds, got True"
    ):
        Plan.of(_biped.make, _biped.swing, seeds=True)
