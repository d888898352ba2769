"""A balance policy from training to its scores: small trainings, short episodes."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from _logs import run
from _refusals import refusals

from surefoot.controllers import PolicyFileError, PolicyNetwork
from surefoot.experiments.evaluate import Setup, run_episode
from surefoot.experiments.policy.card import write_card
from surefoot.experiments.policy.tasks import TASKS, TRAINING_SEEDS, TrainOptions, find_task, shipped_policy
from surefoot.experiments.policy.train import Trainer, TrainingError, remove_training
from surefoot.experiments.policy.view import PARTS, PolicyView, export_zip, input_names, make_task, network_of
from surefoot.experiments.walks.walkers import FEEDS

pytest.importorskip("stable_baselines3")
pytestmark = pytest.mark.filterwarnings("ignore:.*unconventional shape")

SMALL = TrainOptions(steps=48, environments=2, rollout=8, batch=8, epochs=1, every=1, hidden=8)
SHORT = {"stand_time": 0.1, "duration": 0.6, "payload_time": (0.1, 0.2)}


class StoppedError(Exception):
    """What a power cut looks like."""


def weights(network):
    return np.concatenate([np.ravel(part) for part in (*network.weights, *network.biases)])


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    out = tmp_path_factory.mktemp("trained")
    trainer = Trainer(out, SMALL)
    network = trainer.run()
    yield out, trainer, network
    trainer.close()


def test_a_training_that_was_stopped_goes_on_to_the_same_policy(trained, tmp_path):
    def stop(update, row):
        if update == 3:
            raise StoppedError

    first = Trainer(tmp_path, SMALL)
    with pytest.raises(StoppedError):
        first.run(stop)
    first.close()
    seen = []
    second = Trainer(tmp_path, SMALL)
    assert second.updates == 2
    network = second.run(lambda update, row: seen.append((update, row["steps"])))
    second.close()
    assert seen == [(3, 48.0)]
    np.testing.assert_array_equal(weights(network), weights(trained[2]))
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "curve.csv"), pd.read_csv(trained[0] / "curve.csv"))
    other = Trainer(tmp_path / "seed", dataclasses.replace(SMALL, seed=1, steps=16))
    assert not np.array_equal(weights(other.run()), weights(network))
    other.close()


@pytest.mark.slow
def test_tensorboard_is_given_the_curve_and_ppos_own_figures(trained, tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    trainer = Trainer(tmp_path, SMALL)
    network = trainer.run(board=True)
    trainer.close()
    np.testing.assert_array_equal(weights(network), weights(trained[2]))
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [event.step for event in events.Scalars("curve/action_std")] == [16, 32, 48]
    stored = [event.value for event in events.Scalars("curve/action_std")]
    np.testing.assert_allclose(stored, [row["action_std"] for row in trainer.curve], rtol=1e-6)
    assert [event.step for event in events.Scalars("train/approx_kl")] == [32, 48]
    remove_training(tmp_path)
    assert not (tmp_path / "tensorboard").exists()


def test_one_training_at_a_time_works_in_a_folder(trained, tmp_path):
    first = Trainer(tmp_path, SMALL)
    kept = (tmp_path / "options.json").read_bytes()
    (tmp_path / "policy.npz").write_bytes((trained[0] / "policy.npz").read_bytes())
    for restart in (False, True):
        with pytest.raises(TrainingError, match=r"Another training is at work in '.*'; wait for it\."):
            Trainer(tmp_path, dataclasses.replace(SMALL, seed=1), restart=restart)
    assert (tmp_path / "options.json").read_bytes() == kept
    assert (tmp_path / "policy.npz").exists()
    first.close()
    again = Trainer(tmp_path, dataclasses.replace(SMALL, seed=1), restart=True)
    assert not (tmp_path / "policy.npz").exists()
    again.close()


def test_a_full_disk_costs_only_what_came_after_the_checkpoint(trained, tmp_path, monkeypatch):
    write, written = Path.write_bytes, []

    def full(path, content):
        written.append(path)
        if len(written) == 2:
            write(path, content[:100])
            raise OSError(28, "No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    first = Trainer(tmp_path, SMALL)
    with pytest.raises(OSError, match="No space left"):
        first.run()
    first.close()
    second = Trainer(tmp_path, SMALL)
    assert second.updates == 1
    np.testing.assert_array_equal(weights(second.run()), weights(trained[2]))
    second.close()
    assert sorted(path.name for path in tmp_path.glob("[!.]*")) == [
        "checkpoint.pt", "curve.csv", "options.json", "policy.npz",
    ]  # fmt: skip


def test_a_folder_of_another_training_and_a_damaged_checkpoint_are_refused(trained, tmp_path):
    with pytest.raises(TrainingError, match=r"holds another training.*'seed': \(0, 1\)"):
        Trainer(trained[0], dataclasses.replace(SMALL, seed=1))
    whole = (trained[0] / "checkpoint.pt").read_bytes()
    (tmp_path / "options.json").write_text((trained[0] / "options.json").read_text())
    (tmp_path / "checkpoint.pt").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(TrainingError, match="cannot be read as a checkpoint"):
        Trainer(tmp_path, SMALL)
    (tmp_path / "options.json").write_text("{")
    with pytest.raises(TrainingError, match="is damaged"):
        Trainer(tmp_path, SMALL)
    (tmp_path / "options.json").unlink()
    with pytest.raises(TrainingError, match="a checkpoint without its"):
        Trainer(tmp_path, SMALL)
    (tmp_path / "mine.txt").write_text("kept")
    remove_training(tmp_path)
    assert [path.name for path in tmp_path.glob("[!.]*")] == ["mine.txt"]


def test_the_file_and_stable_baselines_give_the_same_actions(trained, tmp_path):
    model, view = trained[1]._model, trained[1].view
    loaded = PolicyNetwork.load(trained[0] / "policy.npz")
    exact = network_of(model, view)
    env = make_task("true", **SHORT)
    looking = PolicyView(env)
    observation, _ = env.reset(seed=2)
    largest = 0.0
    for _ in range(40):
        theirs = model.predict(looking.inputs_of(observation), deterministic=True)[0]
        np.testing.assert_allclose(exact.speeds(observation), theirs, atol=1e-6)
        np.testing.assert_allclose(loaded.speeds(observation), theirs, atol=1e-6)
        largest = max(largest, float(np.abs(theirs).max()))
        observation, *_ = env.step(np.zeros(11))
    assert largest > 1e-4
    env.close()
    assert loaded.notes["options"] == dataclasses.asdict(SMALL)


def test_a_zip_is_opened_only_on_trust(tmp_path):
    import torch
    from stable_baselines3 import PPO

    env = PolicyView(make_task("true", **SHORT))
    model = PPO("MlpPolicy", env, seed=0, device="cpu", policy_kwargs={"activation_fn": torch.nn.Tanh})
    model.save(str(tmp_path / "model"))
    with pytest.raises(PolicyFileError, match="--trusted"):
        export_zip(tmp_path / "model.zip", tmp_path / "p.npz")
    assert not (tmp_path / "p.npz").exists()
    exported = export_zip(tmp_path / "model.zip", tmp_path / "p.npz", trusted=True)
    np.testing.assert_allclose(weights(exported), weights(network_of(model, env)), rtol=1e-12)
    assert exported.notes == {"from": "model.zip", "task": "surefoot/NaoBalance-v0"}
    with pytest.raises(PolicyFileError, match="Stable-Baselines3 zip"):
        PolicyNetwork.load(tmp_path / "model.zip")
    (tmp_path / "bad.zip").write_bytes(b"PK\x03\x04")
    with pytest.raises(PolicyFileError, match="cannot be opened"):
        export_zip(tmp_path / "bad.zip", tmp_path / "p.npz", trusted=True)


def test_the_view_and_the_network_act_alike(trained):
    model, network = trained[1]._model, network_of(trained[1]._model, trained[1].view)
    first, second = (make_task("true", **SHORT) for _ in range(2))
    view = PolicyView(first)
    seen, _ = view.reset(seed=5)
    observation, _ = second.reset(seed=5)
    for _ in range(8):
        seen, *_ = view.step(model.predict(seen, deterministic=True)[0])
        for _ in range(view.hold):
            observation, *_ = second.step(network(observation))
    np.testing.assert_allclose(view.inputs_of(observation), seen, atol=1e-3)
    assert len(input_names(view.task)) > 4
    assert set(PARTS) <= set(second.observation_space.spaces)


def test_feeds_differ_by_nothing_but_the_feet():
    states, cops = {}, {}
    for feed in FEEDS:
        env = make_task(feed, **SHORT)
        env.reset(seed=7)
        for _ in range(20):
            observation, *_ = env.step(np.zeros(11))
        states[feed], cops[feed] = observation["state"], observation["cop"]
        np.testing.assert_array_equal(states[feed], states["true"])
        if feed == "true":
            assert env.errors()["cop_error"] == 0.0
        env.close()
    assert np.linalg.norm(cops["none"] - cops["true"]) > 1e-4
    with pytest.raises(ValueError, match="no feed 'sand'"):
        make_task("sand")


def test_a_card_says_how_it_was_made(trained):
    text = write_card(trained[0]).read_text()
    assert "surefoot train --sensors true --seed 0 --steps 48" in text
    assert "surefoot evaluate surefoot/NaoBalance-v0 policy.npz --feed true" in text
    assert (trained[0] / "curve.png").stat().st_size > 5000


test_a_training_that_makes_no_sense_is_refused = refusals(
    lambda changes: TrainOptions(**changes),
    ({"sensors": "some"}, "'sensors'"),
    ({"steps": 0}, "'steps'"),
    ({"seed": 1000}, "'seed'"),
)


def test_seeds_of_training_are_no_seeds_of_evaluation_and_never_twice_the_same():
    seeds = set()
    for seed in (0, 999):
        options = TrainOptions(seed=seed)
        for update in range(options.updates):
            block = range(options.segment_seed(update), options.segment_seed(update) + options.environments)
            assert min(block) >= TRAINING_SEEDS
            assert seeds.isdisjoint(block)
            seeds.update(block)
    assert max(seeds) < 2**32
    assert TrainOptions(sensors="randomised").severities()[-1] == 2.0


def test_the_commands(trained, tmp_path):
    assert "another training" in run("train", "--out", trained[0], "--seed", 1, code=2).output
    answer = run("train", "--export", tmp_path / "no.zip", "--out", tmp_path, code=2)
    assert "There is no file" in answer.output
    (tmp_path / "bad.npz").write_bytes(b"no policy")
    assert (
        "cannot be read as a policy file"
        in run("evaluate", TASKS["balance"].env_id, tmp_path / "bad.npz", code=2).output
    )
    answer = run("evaluate", TASKS["balance"].env_id, trained[0] / "policy.npz", "--feed", "sand", code=2)
    assert "There is no feed 'sand'" in answer.output


WALK = TrainOptions(task="walk", steps=16, environments=1, rollout=8, batch=8, epochs=1, every=2, hidden=8)
WALKED = {"speeds": (0.04,), "stand_time": 0.5, "duration": 1.0, "payload_time": (0.1, 0.2)}


def test_a_walking_policy_sees_the_gait_as_well():
    env = make_task("true", task="walk", **WALKED)
    view = PolicyView(env, "walk")
    env.reset(seed=1)
    for _ in range(60):
        observation, *_ = env.step(np.zeros(11))
    seen, layout = view.inputs_of(observation), env.unwrapped.state_layout
    # Twelve joints, the parts of the state in their order, then the feet.
    parts = np.concatenate(
        [observation["state"][layout[name]] / scale for name, scale in TASKS["walk"].scales.items()]
    )
    np.testing.assert_allclose(seen[12:-7], parts, rtol=1e-5, atol=1e-6)
    assert {"stance", "phase", "com_reference"} <= set(input_names(view.task))
    assert not {"stance", "phase"} & set(input_names(TASKS["balance"]))
    error = observation["cop"] - observation["state"][layout["cop_reference"]]
    np.testing.assert_allclose(seen[[-6, -4]], 100.0 * error, rtol=1e-3, atol=1e-4)
    assert env.errors()["cop_error"] == 0.0
    env.close()


def test_a_training_says_which_task_it_is_for(tmp_path):
    trainer = Trainer(tmp_path, WALK)
    network = trainer.run()
    trainer.close()
    assert network.notes["task"] == TASKS["walk"].env_id
    assert network.drive.speed == TASKS["walk"].speed
    text = write_card(tmp_path).read_text()
    assert "surefoot train --task walk --sensors true --seed 0 --steps 16" in text
    assert text.startswith("# A walking policy for `surefoot/NaoCarry-v0`")
    balance = dataclasses.replace(WALK, task="balance")
    with pytest.raises(TrainingError, match=r"'task': \('walk', 'balance'\)"):
        Trainer(tmp_path, balance)
    walk = Setup(TASKS["walk"].env_id, env_options=WALKED)
    assert run_episode(walk, network, "true", 1.0, 3)["time"] == pytest.approx(0.5)


def test_a_task_that_does_not_exist_is_refused():
    for refused in (
        lambda: find_task("run"),
        lambda: TrainOptions(task="run"),
        lambda: shipped_policy("true", "run"),
    ):
        with pytest.raises(ValueError, match=r"no task 'run'\. Available: 'balance', 'walk'"):
            refused()
    with pytest.raises(ValueError, match="no shipped policy 'best' for the task 'walk'"):
        shipped_policy("best", "walk")
