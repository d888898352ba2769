"""Wrap, train and compare with the stock Stable-Baselines3 API: does a policy use its feet?

Run with ``python examples/train_balance.py``; a few minutes of training already show the difference, and
``--steps 160000`` is the length of the shipped policy's training. ``surefoot train`` does the same with
checkpoints.
"""

import argparse

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

import surefoot
from surefoot.experiments.policy.view import PolicyView

TRAINING = {"stand_time": 0.25, "duration": 8.0, "payload_time": (0.1, 1.5), "push_interval": 8.0}

CALIBRATED = {"method": "moment"}


def on_true_feet(**options):
    """Make the task itself: its observations hold the true centre of pressure."""
    return gym.make("surefoot/NaoBalance-v0", **options)


def on_drifting_feet(calibrator, **options):
    """Put load cells under the feet that nobody calibrated, and a calibrator behind them."""
    env = surefoot.wrappers.FootSensors(on_true_feet(**options), "hx711-load-cells", fresh=True)
    return surefoot.wrappers.SelfCalibration(env, **calibrator)


def train(steps, seed=0):
    """Train on true feet. PolicyView picks and scales the numbers that the policy sees and commands."""
    torch.set_num_threads(1)  # small networks are faster on one
    envs = DummyVecEnv([lambda: PolicyView(on_true_feet(**TRAINING), reward_scale=0.05)] * 8)
    model = PPO(
        "MlpPolicy",
        envs,
        n_steps=256,
        batch_size=512,
        n_epochs=8,
        gamma=0.97,
        learning_rate=1e-3,
        use_sde=True,  # smooth exploration: feet that shiver tell nothing
        sde_sample_freq=8,
        policy_kwargs={"log_std_init": -2.5},
        seed=seed,
        device="cpu",
    )
    model.learn(steps, progress_bar=False)
    envs.close()
    return model


def mean_return(model, env, seeds):
    """Score the policy, or nobody for ``None``, on episodes that training never saw."""
    view = PolicyView(env)
    totals = []
    for seed in seeds:
        observation, _ = view.reset(seed=seed)
        done, total = False, 0.0
        while not done:
            # The task leaves the robot alone during the quiet stand; so should the policy.
            waiting = model is None or view.unwrapped.data.time < view.unwrapped.stand_time
            action = np.zeros(4) if waiting else model.predict(observation, deterministic=True)[0]
            observation, reward, terminated, truncated, _ = view.step(action)
            done, total = terminated or truncated, total + reward
        totals.append(total)
    view.close()
    return np.mean(totals)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=40_000)
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--duration", type=float, default=21.5, help="of a scored episode in s")
    asked = parser.parse_args()

    policy = train(asked.steps)
    seeds, options = range(20_000, 20_000 + asked.episodes), {"duration": asked.duration}
    feet = {
        "nobody acts": (None, on_true_feet(**options)),
        "true feet": (policy, on_true_feet(**options)),
        "drifting feet": (policy, on_drifting_feet({"method": "none"}, **options)),
        "calibrated feet": (policy, on_drifting_feet(CALIBRATED, **options)),
    }
    for name, (who, env) in feet.items():
        print(f"{name:>16}: mean return {mean_return(who, env, seeds):7.1f}")
