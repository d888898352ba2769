"""Train by the recipe of examples/sb3_balance.py, and compare with nobody.

    python benchmarks/sb3_recipe.py --steps 100000 --seeds 3

A row for nobody, who commands nothing, and one for each training. Whole episodes on fresh sensors, loads,
pushes and ground, of seeds that no training had and on which nothing was tuned; the same ones in each row.
"""

import argparse
import runpy
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

RECIPE = Path(__file__).parents[1] / "examples" / "sb3_balance.py"
EVALUATION_SEED = 40_000
REWARD_SCALE = 0.05  # of the recipe


def play(venv: Any, model: Any) -> tuple[np.ndarray, np.ndarray]:
    """Play one episode a robot, with a model or with nobody; return the rewards, and who fell."""
    venv.seed(EVALUATION_SEED)
    seen: Any = venv.reset()
    paid, playing = np.zeros(venv.num_envs), np.ones(venv.num_envs, dtype=bool)
    fell, still = ~playing, np.zeros((venv.num_envs, *venv.action_space.shape))
    while playing.any():
        action = still if model is None else model.predict(seen, deterministic=True)[0]
        seen, rewards, dones, infos = venv.step(action)
        paid += np.where(playing, rewards, 0.0)
        fell |= playing & dones & ~np.array([info.get("TimeLimit.truncated", False) for info in infos])
        playing &= ~dones
    venv.close()
    return paid / REWARD_SCALE, fell


def main() -> None:
    """Train and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--steps", type=int, default=100_000, help="decisions of all robots together")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--episodes", type=int, default=32)
    asked = parser.parse_args()
    torch.set_num_threads(1)  # small networks are faster on one
    names = runpy.run_path(str(RECIPE))
    print(
        "| | return | std | falls | more than nobody (95 %) | CPU s of training |\n|---|---|---|---|---|---|"
    )
    nobody, fell = play(names["robots"](asked.episodes), None)
    print(f"| nobody | {nobody.mean():.0f} | {nobody.std(ddof=1):.0f} | {fell.sum()} | | |", flush=True)
    for seed in range(asked.seeds):
        began = time.process_time()
        model = names["ppo"](names["robots"](8), seed)
        model.learn(asked.steps)
        took = time.process_time() - began
        paid, fell = play(names["robots"](asked.episodes), model)
        gain = paid - nobody
        margin = 1.96 * gain.std(ddof=1) / np.sqrt(len(gain))
        print(
            f"| seed {seed} | {paid.mean():.0f} | {paid.std(ddof=1):.0f} | {fell.sum()} | "
            f"{gain.mean():.0f} ± {margin:.0f} | {took:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
