"""Train by the recipe of docs/vector.md, and compare with nobody: what is learnt, and what the policy sees.

    python benchmarks/sb3_recipe.py --steps 200000 --seeds 3

A unit of the first layer is saturated by an observation where its tanh exceeds 0.99: such a unit says the
same of all observations like it. Returns are of whole episodes on fresh sensors that training never saw.
"""

import argparse
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize

import surefoot  # noqa: F401
from surefoot.wrappers import TruthRow
from surefoot.wrappers.vector.sb3 import VecFootSensors, VecSelfCalibration

SHOW = ("foot_load", "cop_foot", "cop", "cop_valid")
SATURATED = 0.99
EVALUATION_SEED = 30_000


def robots(count: int, show: tuple[str, ...] = SHOW, **options: Any) -> VecEnv:
    """Make robots that balance on load cells that drift and are calibrated."""
    task = {"stand_time": 0.25, "duration": 8.0, "payload_time": (0.1, 1.5), "push_interval": 8.0} | options
    copies = DummyVecEnv(
        [lambda: TruthRow(gym.make("surefoot/NaoBalance-v0", action_scale=0.05, **task))] * count
    )
    return VecSelfCalibration(VecFootSensors(copies, fresh=True), show=show)


def recipe(venv: VecEnv, seed: int) -> PPO:
    """Make the model of docs/vector.md."""
    return PPO(
        "MultiInputPolicy",
        VecNormalize(venv, norm_obs=False, gamma=0.99),  # rewards alone
        n_steps=256,
        batch_size=512,
        learning_rate=5e-4,
        gamma=0.99,
        use_sde=True,  # smooth exploration: feet that shake measure nothing
        sde_sample_freq=8,
        policy_kwargs={"log_std_init": -2.5},
        seed=seed,
        device="cpu",
    )


def saturation(model: PPO, observations: dict[str, Any]) -> float:
    """Return the share of the first layer's outputs that are saturated, over units and observations."""
    policy: Any = model.policy
    with torch.no_grad():
        features = policy.extract_features(policy.obs_to_tensor(observations)[0])
        layer = policy.mlp_extractor.policy_net[:2](features)
    return float((layer.abs() > SATURATED).float().mean())


def returns(model: PPO | None, episodes: int) -> tuple[np.ndarray, dict[str, Any]]:
    """Play one episode a robot, with a policy or with nobody, and keep every 20th observation."""
    venv = robots(episodes)
    venv.seed(EVALUATION_SEED)
    seen: Any = venv.reset()
    total, playing, kept, tick = np.zeros(episodes), np.ones(episodes, dtype=bool), [], 0
    still = np.zeros((episodes, *(venv.action_space.shape or ())), dtype=np.float32)
    while playing.any():
        if tick % 20 == 0:
            kept.append(seen)
        action = still if model is None else model.predict(seen, deterministic=True)[0]
        seen, rewards, dones, _ = venv.step(action)
        total += np.where(playing, rewards, 0.0)
        playing &= ~dones
        tick += 1
    venv.close()
    return total, {key: np.concatenate([one[key] for one in kept]) for key in kept[0]}


def main() -> None:
    """Train and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--episodes", type=int, default=40)
    asked = parser.parse_args()
    torch.set_num_threads(1)  # small networks are faster on one
    nobody, _ = returns(None, asked.episodes)
    print(f"nobody: mean return {nobody.mean():.1f}", flush=True)
    for seed in range(asked.seeds):
        model = recipe(robots(8), seed)
        model.learn(asked.steps)
        paid, seen = returns(model, asked.episodes)
        gain = paid - nobody
        margin = 1.96 * gain.std(ddof=1) / np.sqrt(len(gain))
        print(
            f"seed {seed}: mean return {paid.mean():.1f}, {gain.mean():+.1f} +- {margin:.1f} (95 %) over "
            f"nobody; {100.0 * saturation(model, seen):.1f} % of the first layer saturated",
            flush=True,
        )


if __name__ == "__main__":
    main()
