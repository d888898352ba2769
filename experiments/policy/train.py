"""Train a policy: PPO of Stable-Baselines3, on checkpoints that hold numbers only (``weights_only=True``).

At each checkpoint every source of randomness is seeded again from the seed and the number of updates done: a
training that was stopped and resumed ends with the same policy, to the last digit, as one that was not.
"""

import json
import shutil
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

from surefoot.controllers.policy import PolicyNetwork
from surefoot.experiments.policy.tasks import REWARD_SCALE, TrainOptions, find_task
from surefoot.experiments.policy.view import PolicyView, make_task, network_of
from surefoot.files import atomic_path, lock_folder, read_json, write_text

CHECKPOINT, OPTIONS, CURVE, POLICY = "checkpoint.pt", "options.json", "curve.csv", "policy.npz"
"""What a training leaves in its folder."""

BOARD = "tensorboard"  # where in it TensorBoard finds its events, if they are wanted


Progress = Callable[[int, dict[str, float]], None]  # after each update: how many there were, and the row


class TrainingError(ValueError):
    """A folder cannot be trained in, or a checkpoint cannot be read; the message says why."""


class Trainer:
    """A training in a folder, which is its alone until closed; it goes on from the folder's checkpoint.

    ``curve`` has a row an update: steps, mean return and length of the episodes that ended, share that fell,
    standard deviation of the actions. Raises TrainingError if the folder is in use, holds another training,
    or a damaged checkpoint.
    """

    def __init__(self, out: Path, options: TrainOptions, *, restart: bool = False) -> None:
        self.out, self.options = out, options
        self.updates = 0
        self.curve: list[dict[str, float]] = []
        busy = TrainingError(f"Another training is at work in '{out}'; wait for it.")
        with ExitStack() as claimed:
            claimed.enter_context(lock_folder(out, busy))
            if restart:
                remove_training(out)
            self._claim()
            self._model = self._ppo()
            self._envs = self._model.env
            if (out / CHECKPOINT).exists():
                self._restore()
            self._claimed = claimed.pop_all()

    def _ppo(self) -> Any:
        """Return the model, with an environment for each severity."""
        import torch
        from stable_baselines3 import PPO
        from stable_baselines3.common.monitor import Monitor
        from stable_baselines3.common.vec_env import DummyVecEnv

        torch.set_num_threads(1)
        options, task = self.options, find_task(self.options.task)

        def make(severity: float) -> gym.Env[Any, Any]:
            feed = "true" if options.sensors == "true" else "raw"
            env = make_task(feed, severity=severity, task=task.name, **task.training)
            return Monitor(PolicyView(env, task.name, reward_scale=REWARD_SCALE))

        hidden = [options.hidden] * 2
        return PPO(
            "MlpPolicy",
            DummyVecEnv([partial(make, severity) for severity in options.severities()]),
            use_sde=True,
            sde_sample_freq=options.explore,
            n_steps=options.rollout,
            batch_size=options.batch,
            n_epochs=options.epochs,
            gamma=options.discount,
            learning_rate=lambda _: options.learning_rate * max(1.0 - self.updates / options.updates, 0.05),
            policy_kwargs={
                "net_arch": {"pi": hidden, "vf": hidden},
                "activation_fn": torch.nn.Tanh,
                "log_std_init": options.initial_log_std,
            },
            seed=options.seed,
            device="cpu",
        )

    @property
    def view(self) -> PolicyView:
        """One of the environments, as the policy sees it."""
        view: Any = self._envs.envs[0]
        while not isinstance(view, PolicyView):
            view = view.env
        return view

    def run(self, progress: Progress | None = None, *, board: bool = False) -> PolicyNetwork:
        """Train to the end, with checkpoints; return the policy, which lies in the folder as well.

        ``progress`` is told of each update; with ``board`` the curve and PPO's own figures are written for
        TensorBoard, which must be there.
        """
        options = self.options
        if board:
            from stable_baselines3.common.logger import configure

            # One for all segments: each would begin its own, and lose PPO's figures of its last update.
            self._model.set_logger(configure(str(self.out / BOARD), ["tensorboard"]))
        while self.updates < options.updates:
            self._reseed()
            until = min(self.updates + options.every, options.updates)
            self._model.learn(
                (until - self.updates) * options.steps_per_update,
                callback=_curve_keeper(self, progress),
                reset_num_timesteps=False,
            )
            self._checkpoint()
        if board:
            self._model.logger.close()
        network = network_of(self._model, self.view, self._notes())
        network.save(self.out / POLICY)
        self._claimed.close()
        return network

    def close(self) -> None:
        """Close the environments, and let others train in the folder."""
        self._envs.close()
        self._claimed.close()

    def _claim(self) -> None:
        """Make the folder this training's, or raise TrainingError if it holds another one."""
        mine = asdict(self.options)
        path = self.out / OPTIONS
        if not path.exists():
            if (self.out / CHECKPOINT).exists():
                raise TrainingError(
                    f"'{self.out}' holds a checkpoint without its {OPTIONS}; give another folder."
                )
            write_text(path, json.dumps(mine, indent=2) + "\n")
            return
        try:
            theirs = dict(read_json(path))
        except (ValueError, TypeError) as error:
            raise TrainingError(f"'{path}' is damaged: {error}; give another folder.") from error
        if theirs != mine:
            changed = {
                name: (theirs.get(name), value) for name, value in mine.items() if theirs.get(name) != value
            }
            raise TrainingError(
                f"'{self.out}' holds another training; (there, asked for) differ in {changed}. Give another "
                "folder with --out, or the same options to go on with it."
            )

    def _reseed(self) -> None:
        from stable_baselines3.common.utils import set_random_seed

        seed = self.options.segment_seed(self.updates)
        set_random_seed(seed)
        self._envs.seed(seed)
        self._model._last_obs = None
        self._model.ep_info_buffer = None
        # Without observations, learn() resets the environments.
        self._model._last_episode_starts = None

    def _checkpoint(self) -> None:
        import torch

        with atomic_path(self.out / CURVE) as part:
            pd.DataFrame(self.curve).to_csv(part, index=False)
        held = {
            "parameters": self._model.get_parameters(),
            "updates": self.updates,
            "steps": int(self._model.num_timesteps),
            "curve": self.curve,
        }
        # Given a path, torch reports a full disk as an error of its own.
        buffer = BytesIO()
        torch.save(held, buffer)
        with atomic_path(self.out / CHECKPOINT) as part:
            part.write_bytes(buffer.getvalue())

    def _restore(self) -> None:
        import torch

        path = self.out / CHECKPOINT
        try:
            held = torch.load(path, weights_only=True, map_location="cpu")
            self._model.set_parameters(held["parameters"], device="cpu")
            self.updates, self._model.num_timesteps = int(held["updates"]), int(held["steps"])
            self.curve = [dict(row) for row in held["curve"]]
        except Exception as error:  # Whatever a damaged archive raises.
            raise TrainingError(
                f"'{path}' cannot be read as a checkpoint of this training: {error}. Restore it from a copy, "
                "or delete it to start again."
            ) from error

    def _notes(self) -> dict[str, Any]:
        from importlib.metadata import version

        packages = ("surefoot", "gymnasium", "mujoco", "numpy", "stable_baselines3", "torch")
        return {
            "task": self.view.task.env_id,
            "options": asdict(self.options),
            "steps": int(self._model.num_timesteps),
            "versions": {name: version(name) for name in packages},
        }


def _curve_keeper(trainer: Trainer, progress: Progress | None) -> Any:
    """Return the callback of one segment: it adds a row to the curve before each update."""
    from stable_baselines3.common.callbacks import BaseCallback

    class CurveKeeper(BaseCallback):
        def __init__(self) -> None:
            super().__init__()
            self.ended: list[tuple[float, int, bool]] = []

        def _on_step(self) -> bool:
            for info in self.locals["infos"]:
                if "episode" in info:
                    kept = info["episode"]
                    fell = not info.get("TimeLimit.truncated", False)
                    self.ended.append((kept["r"] / REWARD_SCALE, kept["l"], fell))
            return True

        def _on_rollout_end(self) -> None:
            frame = pd.DataFrame(self.ended, columns=["return", "length", "fell"]).astype(float)
            self.ended, mean = [], frame.mean()
            policy: Any = self.model.policy
            row = {
                "steps": float(self.model.num_timesteps),
                "episodes": float(len(frame)),
                "return": float(mean["return"]),
                "reward_per_decision": float(frame["return"].sum() / (frame["length"].sum() or np.nan)),
                "fell": float(mean["fell"]),
                "action_std": float(policy.log_std.detach().exp().mean()),
            }
            for name, value in row.items():
                self.logger.record(f"curve/{name}", value)
            trainer.curve.append(row)
            trainer.updates += 1
            if progress is not None:
                progress(trainer.updates, row)

    return CurveKeeper()


def remove_training(out: Path) -> None:
    """Remove the files of a training in a folder, and nothing else."""
    for name in (CHECKPOINT, OPTIONS, CURVE, POLICY):
        (out / name).unlink(missing_ok=True)
    shutil.rmtree(out / BOARD, ignore_errors=True)
