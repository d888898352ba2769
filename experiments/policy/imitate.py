"""Train a linear policy to imitate an expert that knows the true state (privileged learning).

The policy sees its feet through the sensors of the training, and the expert the truth. The expert acts in the
first round, the policy in all others, and each round fits the policy to the expert's actions in all states
that were visited so far (DAgger; Ross, Gordon and Bagnell, 2011). With a linear policy the fit is a ridge
regression, so that a training takes seconds, and policies on different feet differ in nothing else.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

from surefoot.arrays import Floats
from surefoot.calibration.checks import check_counts
from surefoot.controllers.policy import PolicyNetwork
from surefoot.experiments.policy.tasks import LARGEST_SEVERITY, SENSORS, TRAINING_SEEDS, find_task
from surefoot.experiments.policy.view import PolicyView, Traces, export, make_task
from surefoot.files import atomic_path

FEET = (*SENSORS, "history", "blind")
"""Feet to train on: also randomised ones with :class:`Traces` of past readings, and none."""

CURVE, POLICY = "curve.csv", "policy.npz"  # files in the folder of a training, as those of train.py
NOISE = 0.2  # standard deviation of the expert's actions in the first round, so that errors occur
RIDGE = 1e-3  # weight of the squared coefficients, per decision
FALLING = 5.0  # expert's action beyond which the robot is falling, and no longer imitated


@dataclass(frozen=True)
class Imitation:
    """A training; the same options give the same policy. ValueError names an option that is out of range."""

    task: str = "lean"
    sensors: str = "true"
    steps: int = 6_000  # decisions in all rounds together, at least
    seed: int = 0  # 0 to 999
    rounds: int = 4

    def __post_init__(self) -> None:
        """Raise ValueError at a training that is not possible."""
        if not find_task(self.task).imitates:
            raise ValueError(f"The task '{self.task}' has no expert to imitate.")
        if self.sensors not in FEET:
            raise ValueError(f"'sensors' must be one of {FEET}, got {self.sensors!r}.")
        check_counts(self, "steps", "rounds")
        if not 0 <= self.seed < 1000:
            raise ValueError(f"'seed' must lie in 0 to 999, got {self.seed}.")

    def make(self) -> PolicyView:
        """Make the environment on the feet of the training, as the policy sees it."""
        task = find_task(self.task)
        drifting, history = self.sensors in ("randomised", "history"), self.sensors == "history"
        # Traces need a robot that has lifted its feet.
        options = {**task.training, **({"marches": 1} if history else {})}
        severity: Any = (0.0, LARGEST_SEVERITY) if drifting else 1.0
        env: gym.Env[Any, Any] = make_task(
            "raw" if drifting else "true", severity=severity, task=task.name, **options
        )
        return PolicyView(Traces(env) if history else env, task.name, blind=self.sensors == "blind")


def imitate(
    out: Path, options: Imitation, progress: Callable[[int, dict[str, float]], None] | None = None
) -> PolicyNetwork:
    """Train a policy; it is written into the folder together with a table with one row per round."""
    view, rng, began = options.make(), np.random.default_rng(options.seed), 0
    expert: Any = view.unwrapped
    inputs, labels, curve = list[Floats](), list[Floats](), list[dict[str, float]]()
    weight, bias = np.zeros((2, len(view.inputs))), np.zeros(2)
    for k in range(options.rounds):
        returns, fell = list[float](), list[bool]()
        while not returns or len(inputs) < options.steps * (k + 1) / options.rounds:
            seen, _ = view.reset(seed=TRAINING_SEEDS + options.seed * 1_000_000 + began)
            began, total, done, fallen = began + 1, 0.0, False, False
            while not done:
                label = expert.expert_action
                if np.abs(label).max() < FALLING:
                    inputs.append(seen.astype(np.float64))
                    labels.append(label)
                action = weight @ seen + bias if k else label + rng.normal(0.0, NOISE, 2)
                seen, reward, fallen, truncated, _ = view.step(action)
                total, done = total + reward, fallen or truncated
            returns.append(total)
            fell.append(fallen)
        weight, bias = fit(np.array(inputs), np.array(labels))
        row = {
            "steps": float(len(inputs)),
            "episodes": float(len(returns)),
            "return": float(np.mean(returns)),
        }
        curve.append({**row, "fell": float(np.mean(fell))})
        if progress is not None:
            progress(k + 1, curve[-1])
    view.close()
    packages = ("surefoot", "gymnasium", "mujoco", "numpy")
    notes = {
        "task": find_task(options.task).env_id,
        "options": asdict(options),
        "steps": len(inputs),
        "versions": {name: version(name) for name in packages},
    }
    network = export([weight], [bias], view, notes)
    out.mkdir(parents=True, exist_ok=True)
    with atomic_path(out / CURVE) as part:
        pd.DataFrame(curve).to_csv(part, index=False)
    network.save(out / POLICY)
    return network


def fit(inputs: Floats, labels: Floats) -> tuple[Floats, Floats]:
    """Return weights and biases of a ridge regression, shapes (2, N) and (2,); the bias is not shrunk."""
    mean, middle = inputs.mean(axis=0), labels.mean(axis=0)
    x, y = inputs - mean, labels - middle
    weight: Floats = np.linalg.solve(x.T @ x + RIDGE * len(x) * np.eye(x.shape[1]), x.T @ y).T
    return weight, middle - weight @ mean
