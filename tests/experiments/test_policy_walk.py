"""The walking task through the same mill as the balance task: view, options, folders, cards, scores."""

import dataclasses
import json

import numpy as np
import pytest

from surefoot.controllers import PolicyNetwork, zero_action
from surefoot.experiments.policy.card import write_card
from surefoot.experiments.policy.controllers import load_controller
from surefoot.experiments.policy.env import PolicyView, input_names, make_feed
from surefoot.experiments.policy.evaluate import run_episode, run_episodes
from surefoot.experiments.policy.options import TrainOptions
from surefoot.experiments.policy.shipped import SHIPPED, shipped_policy
from surefoot.experiments.policy.tasks import TASKS, task_named
from surefoot.experiments.policy.train import Trainer, TrainingError
from surefoot.experiments.sweep.episode import check_cell
from surefoot.experiments.sweep.plan import SweepPlan
from surefoot.experiments.sweep.scenarios import scenario_named

SMALL = TrainOptions(task="walk", steps=16, environments=1, rollout=8, batch=8, epochs=1, every=2, hidden=8)
SHORT = {"speeds": (0.04,), "stand_time": 0.5, "duration": 1.0, "payload_time": (0.1, 0.2)}


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    pytest.importorskip("stable_baselines3")
    out = tmp_path_factory.mktemp("walk")
    trainer = Trainer(out, SMALL)
    network = trainer.run()
    trainer.close()
    return out, network


def test_a_walking_policy_sees_the_gait_as_well():
    env, tap = make_feed("true", task="walk", **SHORT)
    view = PolicyView(env, "walk")
    env.reset(seed=1)
    for _ in range(60):
        observation, *_ = env.step(np.zeros(11))
    seen, layout = view.seen(observation), env.unwrapped.state_layout
    # Twelve joints, the parts of the state in their order, then the feet.
    parts = np.concatenate(
        [observation["state"][layout[name]] / scale for name, scale in TASKS["walk"].scales.items()]
    )
    np.testing.assert_allclose(seen[12:-7], parts, rtol=1e-5, atol=1e-6)
    assert {"stance", "phase", "com_reference"} <= set(input_names(view.task))
    assert not {"stance", "phase"} & set(input_names(TASKS["balance"]))
    error = observation["cop"] - observation["state"][layout["cop_reference"]]
    np.testing.assert_allclose(seen[[-6, -4]], 100.0 * error, rtol=1e-3, atol=1e-4)
    np.testing.assert_array_equal(observation["cop"], tap.seen["cop"])
    env.close()


def test_a_training_says_which_task_it_is_for(trained):
    out, network = trained
    assert network.notes["task"] == TASKS["walk"].env_id
    assert network.drive.speed == TASKS["walk"].speed
    text = write_card(out).read_text()
    assert "surefoot train --task walk --sensors true --seed 0 --steps 16" in text
    assert text.startswith("# A walking policy for `surefoot/NaoCarry-v0`")
    with pytest.raises(TrainingError, match=r"'task': \('walk', 'balance'\)"):
        Trainer(out, dataclasses.replace(SMALL, task="balance"))
    result = run_episode(network, "true", 3, task="walk", **SHORT)
    assert result.time == pytest.approx(0.5)


def test_a_folder_that_names_no_task_is_one_of_balance(trained, tmp_path):
    balance = dataclasses.replace(SMALL, task="balance")
    old = {name: value for name, value in balance.to_json().items() if name != "task"}
    (tmp_path / "options.json").write_text(json.dumps(old))
    Trainer(tmp_path, balance).close()
    with pytest.raises(TrainingError, match=r"'task': \('balance', 'walk'\)"):
        Trainer(tmp_path, SMALL)


def test_a_task_that_does_not_exist_is_refused():
    for refused in (
        lambda: task_named("run"),
        lambda: TrainOptions(task="run"),
        lambda: run_episode(zero_action, "true", 0, task="run"),
        lambda: shipped_policy("true", "run"),
    ):
        with pytest.raises(ValueError, match=r"no task 'run'\. Available: 'balance', 'walk'"):
            refused()
    with pytest.raises(ValueError, match="no shipped policy 'best' for the task 'walk'"):
        shipped_policy("best", "walk")


def test_what_is_shipped_for_walking_fits_the_task():
    for sensors in SHIPPED["walk"]:
        policy = shipped_policy(sensors, "walk")
        assert policy.notes["options"]["task"] == "walk"
        assert policy.notes["options"]["sensors"] == sensors
        (result,) = run_episodes(policy, ["true"], [4], task="walk", **(SHORT | {"duration": 3.0}))
        assert result.time == pytest.approx(2.5)
        assert not result.fell


def test_the_sweep_knows_the_task():
    scenario = scenario_named("carry")
    assert scenario.environment == TASKS["walk"].env_id
    assert scenario.calibration_for("moment")["mass_change"] > 0.0
    assert "mass_change" not in scenario.calibration_for("window")


def test_a_policy_of_another_task_is_refused_though_it_fits(tmp_path):
    balance, path = shipped_policy("true", "balance"), str(tmp_path / "mine.npz")
    balance.save(path)
    other = r"was made for 'surefoot/NaoBalance-v0', and this is 'surefoot/NaoCarry-v0'; .* --task balance"
    for policy in (balance, path):
        with pytest.raises(ValueError, match=other):
            run_episode(policy, "true", 3, task="walk", **SHORT)
    env, _ = make_feed("true", task="walk", **SHORT)
    with pytest.raises(ValueError, match=f"Policy '{path}' {other}"):
        load_controller(path, env, same_task=True)
    # A sweep asks what a policy does where it was not made for.
    assert isinstance(load_controller(path, env), PolicyNetwork)
    plan = SweepPlan((path,), ("true",), ("stand", "hard-pushes", "carry"), (1.0,), (0,))
    for cell in plan.grid:
        check_cell(cell)
    # Policies from elsewhere do not say what they were made for.
    balance.notes = {"task": 7}
    balance.save(path)
    assert isinstance(load_controller(path, env, same_task=True), PolicyNetwork)
    env.close()
    balance.notes = {}
    assert run_episode(balance, "true", 3, task="walk", **SHORT).time > 0.0
