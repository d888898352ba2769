"""How many steps a second the bare environment makes, and how much of a step is MuJoCo's own.

Run ``python benchmarks/env_speed.py``. Plain rounds give the rate; in the rounds between them ``mj_step`` is
timed where the environment calls it. One process, in turns, so that a busy machine slows both alike; medians
over rounds.
"""

import argparse
import time
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from stepping import step

import surefoot  # noqa: F401
from surefoot.envs.nao.env import SUBSTEPS


def seconds_a_step(env: gym.Env[Any, Any], steps: int) -> float:
    return step(env, steps, time.perf_counter)


def seconds_in_mj_step(env: gym.Env[Any, Any], steps: int) -> float:
    inside = 0.0
    mj_step = mujoco.mj_step

    def timed(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        nonlocal inside
        start = time.perf_counter()
        mj_step(model, data)
        inside += time.perf_counter() - start

    mujoco.mj_step = timed
    try:
        seconds_a_step(env, steps)
    finally:
        mujoco.mj_step = mj_step
    return inside / steps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--env", default="surefoot/NaoStand-v0")
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--steps", type=int, default=100, help="control steps a round")
    arguments = parser.parse_args()

    env = gym.make(arguments.env).unwrapped
    env.reset(seed=0)
    seconds_a_step(env, arguments.steps)
    rounds = [
        (seconds_a_step(env, arguments.steps), seconds_in_mj_step(env, arguments.steps))
        for _ in range(arguments.rounds)
    ]
    whole, inside = np.median(rounds, axis=0).tolist()
    print(f"{arguments.env}: {1 / whole:.0f} steps/s, {1 / whole / 80:.0f} times real time")
    print(f"  step                {1e6 * whole:7.1f} us")
    print(f"  {SUBSTEPS} calls of mj_step {1e6 * inside:7.1f} us   {inside / whole:.0%}")
    print(f"  everything else     {1e6 * (whole - inside):7.1f} us")


if __name__ == "__main__":
    main()
