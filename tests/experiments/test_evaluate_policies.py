"""Policies of any kind in one engine: names and files, Stable-Baselines3, torch, ONNX."""

import json
import pickle
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import _biped
import gymnasium as gym
import numpy as np
import pytest

from surefoot.controllers import PolicyFileError, PolicyNetwork, Stabiliser
from surefoot.experiments.evaluate import Setup, evaluate, run_episode
from surefoot.experiments.evaluate.policies import fingerprint, load_sb3, portable
from surefoot.experiments.policy.controllers import controller_hash, load_controller
from surefoot.experiments.policy.tasks import SENSORS, TASKS, policy_file, shipped_policy
from surefoot.experiments.policy.view import make_task

SHORT = {"stand_time": 0.1, "duration": 0.6, "payload_time": (0.1, 0.2)}
WALK = {"speeds": (0.04,), "stand_time": 0.5, "duration": 1.0, "payload_time": (0.1, 0.2)}
FEW: dict[str, Any] = {"seeds": (7,), "severities": (1.0,), "feeds": ("true", "raw")}


def test_controllers_have_names(tmp_path):
    env = make_task("true", **SHORT)
    assert isinstance(load_controller("stabiliser", env), Stabiliser)
    for name, sensors in (("shipped", "true"), ("shipped-randomised", "randomised")):
        policy = load_controller(name, env)
        assert isinstance(policy, PolicyNetwork)
        assert policy.notes["options"]["sensors"] == sensors
    env.close()
    # Saved by another Python a file may have other bytes.
    (tmp_path / "mine.npz").write_bytes(policy_file("balance", "randomised").read_bytes())
    names = ("zero", "shipped", "shipped-randomised", str(tmp_path / "mine.npz"))
    hashes = {controller_hash(name, TASKS["balance"].env_id) for name in names}
    assert len(hashes) == 3, "the same policy in another file is the same policy"


def test_a_shipped_policy_is_that_of_its_task_and_fits_it():
    balance, walk = (controller_hash("shipped", TASKS[name].env_id) for name in ("balance", "walk"))
    assert balance != walk
    for task, options in {"balance": SHORT, "walk": WALK, "balance-hard": SHORT, "walk-hard": WALK}.items():
        for sensors in SENSORS:
            setup = Setup(TASKS[task].env_id, env_options=options)
            row = run_episode(setup, shipped_policy(sensors, task), "true", 1.0, 4)
            assert row["time"] == pytest.approx(options["duration"] - options["stand_time"])
            assert not row["fell"]
    # A harder task lets policies of the easier one in, which lets none of the harder one in.
    assert controller_hash("shipped", TASKS["walk-hard"].env_id) == walk
    hard = shipped_policy("true", "balance-hard")
    with pytest.raises(ValueError, match=r"made for 'surefoot/NaoBalanceHard-v0', and this is"):
        run_episode(Setup(TASKS["balance"].env_id, env_options=SHORT), hard, "true", 1.0, 4)
    # Policies from elsewhere do not say what they were made for.
    hard.notes = {"task": 7}
    assert run_episode(Setup(TASKS["balance"].env_id, env_options=SHORT), hard, "true", 1.0, 4)["time"] > 0.0


class Blind(gym.ActionWrapper):
    """A biped whose actions are small, as training has them."""

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self.action_space = gym.spaces.Box(-0.1, 0.1, (4,), np.float32)

    def action(self, action: Any) -> Any:
        return action


def make_trained(**options: Any) -> Any:
    return Blind(_biped.make(**options))


@pytest.fixture(scope="module")
def trained() -> Any:
    """A model that was trained for a moment, with statistics of its observations."""
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    envs = VecNormalize(DummyVecEnv([make_trained, make_trained]))
    model = PPO("MlpPolicy", envs, n_steps=16, batch_size=16, n_epochs=1, seed=7, device="cpu")
    return model.learn(32)


def test_a_model_acts_as_it_does_in_its_own_environment(trained):
    (row,) = evaluate(make_trained, trained, **{**FEW, "seeds": (3,), "feeds": ("true",)}).rows.to_dict(
        "records"
    )
    env, total = make_trained(), 0.0
    observation, _ = env.reset(seed=3)
    for _ in range(_biped.STEPS):
        action, _ = trained.predict(
            trained.get_vec_normalize_env().normalize_obs(observation), deterministic=True
        )
        observation, reward, *_ = env.step(action)
        total += reward
    assert row["return"] == pytest.approx(total, rel=1e-12)
    with pytest.raises(ValueError, match=r"Seed 8 was used in training \(the model's seed is 7, with 2 env"):
        evaluate(make_trained, trained, **{**FEW, "seeds": (8,)})


def test_a_models_file_is_opened_on_trust_alone_and_is_the_same_policy(trained, tmp_path):
    path = tmp_path / "model.zip"
    trained.save(path)
    trained.get_vec_normalize_env().save(str(tmp_path / "statistics.pkl"))
    with pytest.raises(PolicyFileError, match=r"pickled objects.* say --trusted, or trusted=True"):
        evaluate(make_trained, path, **FEW)
    given: Any = {"trusted": True, "statistics": tmp_path / "statistics.pkl"}
    filed = evaluate(make_trained, path, **FEW, **given)
    assert set(filed.rows["policy"]) == {"model"}
    live = evaluate(make_trained, trained, **{**FEW, "seeds": (20,)})
    again = evaluate(make_trained, path, **{**FEW, "seeds": (20,)}, **given)
    assert list(again.rows["digest"]) == list(live.rows["digest"])
    path.write_bytes(b"PK no zip")
    with pytest.raises(PolicyFileError, match="cannot be opened as a Stable-Baselines3 model"):
        load_sb3(path, trusted=True)
    with pytest.raises(ValueError, match=r"There is no policy file 'gone\.zip'"):
        portable("gone.zip", trusted=True)


def test_a_model_of_another_observation_is_refused(trained):
    with pytest.raises(
        ValueError, match=r"was trained on observations of shape \(21,\), and is shown one of"
    ):
        evaluate(make_trained, trained, **{**FEW, "seeds": (3,)}, observe=("cop",))


def test_a_torch_module_answers_one_observation():
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    module = torch.nn.Sequential(torch.nn.Linear(2, 4), torch.nn.Tanh())
    rows = evaluate(_biped.make, module, observe=("cop",), **FEW).rows
    assert rows["digest"].nunique() == 2
    other = torch.nn.Sequential(torch.nn.Linear(2, 4), torch.nn.Tanh())
    assert fingerprint(portable(module)) != fingerprint(portable(other))


class Session:
    """onnxruntime's session of a network that adds its inputs, of which a file holds the sizes by name."""

    def __init__(self, path: str, providers: list[str]) -> None:
        try:
            self.sizes = json.loads(Path(path).read_text())
        except ValueError as error:
            raise Unreadable("no protobuf") from error

    def get_inputs(self) -> list[Any]:
        return [SimpleNamespace(name=name, shape=["batch", size]) for name, size in self.sizes.items()]

    def run(self, _: None, batch: dict[str, np.ndarray]) -> list[np.ndarray]:
        assert set(batch) == set(self.sizes)
        return [sum(part[:, :1] for part in batch.values()) * np.ones(4)]


class Unreadable(Exception):  # noqa: N818 - as onnxruntime's, whose errors are no RuntimeError
    pass


@pytest.fixture
def onnxruntime(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand in for the package, which is large and not needed for anything else."""
    errors = dict.fromkeys(("Fail", "InvalidGraph", "InvalidProtobuf", "NotImplemented"), Unreadable)
    inner = SimpleNamespace(onnxruntime_pybind11_state=SimpleNamespace(**errors))
    monkeypatch.setitem(sys.modules, "onnxruntime", SimpleNamespace(InferenceSession=Session, capi=inner))
    monkeypatch.setitem(sys.modules, "onnxruntime.capi", inner)


@pytest.mark.usefixtures("onnxruntime")
def test_an_onnx_network_gets_one_vector_or_parts_by_name(tmp_path: Path) -> None:
    vector, named = tmp_path / "vector.onnx", tmp_path / "named.onnx"
    vector.write_text('{"observation": 2}')
    named.write_text('{"cop": 2, "vgrf": null}')
    assert evaluate(_biped.make, vector, observe=("cop",), **FEW).rows["digest"].nunique() == 2
    policy = pickle.loads(pickle.dumps(portable(named)))
    seen = {"cop": np.array([0.25, 0.0]), "vgrf": np.array([0.5, 0.0]), "state": np.zeros(3)}
    np.testing.assert_array_equal(policy(seen), 0.75 * np.ones(4))
    before = fingerprint(portable(named))
    named.write_text('{"cop": 2}')
    assert fingerprint(portable(named)) != before
    with pytest.raises(ValueError, match=r"takes 'cop' of shape \[2\], and the observation has shape \[3\]"):
        portable(named)({"cop": np.zeros(3)})
    with pytest.raises(ValueError, match="the observation has no 'cop'; give its parts these names"):
        portable(named)({"state": np.zeros(3)})
    named.write_text("no network")
    with pytest.raises(ValueError, match="cannot be opened as an ONNX network: no protobuf"):
        portable(named)
    with pytest.raises(ValueError, match=r"There is no policy file 'gone\.onnx'"):
        portable("gone.onnx")


def test_an_onnx_network_names_the_package_that_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "model.onnx"
    path.write_text("{}")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ValueError, match=r"needs onnxruntime .*: pip install onnxruntime"):
        portable(path)


def test_functions_that_differ_have_other_hashes():
    def scaled(gain):
        return lambda state: gain * np.ones(4)

    assert fingerprint(scaled(0.1)) == fingerprint(scaled(0.1)) != fingerprint(scaled(0.2))
    assert fingerprint(_biped.swing) != fingerprint(_biped.lean)


def test_policies_of_several_trainings_are_compared_by_their_means(tmp_path):
    arms = {
        "swing": [_biped.swing, lambda state: 1.1 * _biped.swing(state)],
        "still": lambda state: np.zeros(4),
    }
    results = evaluate(_biped.make, arms, seeds=3, feeds=("true", "raw"), severities=(1.0,), out=tmp_path)
    counted = results.rows.groupby(["policy", "training"]).size()
    assert counted.to_dict() == {("still", 0): 6, ("swing", 0): 6, ("swing", 1): 6}
    text = results.page().read_text()
    assert "2 trainings, 3 paired episodes" in text
    assert "One training seed, 3 paired episodes" in text
    assert Path(tmp_path / "tables" / "policies.csv").is_file()
