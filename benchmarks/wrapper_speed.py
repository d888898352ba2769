"""What sensors and calibrators cost: steps of bare and of wrapped environments, interleaved in one process.

    python benchmarks/wrapper_speed.py --steps 400 --rounds 7
    python benchmarks/wrapper_speed.py --env Humanoid-v5 --config icub-ftsens

Each round steps every environment for a while, in turn, so that whatever else the machine does hits all of
them; the medians over rounds are compared. Time is that of the process, and of one thread.
"""

import argparse
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from stepping import interleaved, shares, step

import surefoot  # noqa: F401
from surefoot.envs import InstrumentedEnv
from surefoot.wrappers import FootSensors, SelfCalibration


def bare(name: str, speed: float) -> gym.Env[Any, Any]:
    options: dict[str, Any] = {"speed": speed, "duration": 120.0} if name == "surefoot/NaoWalk-v0" else {}
    return gym.make(name, disable_env_checker=True, **options)


def stacks(name: str, speed: float, config: str, methods: list[str]) -> dict[str, gym.Env[Any, Any]]:
    """Make an environment and what is wrapped around it, each anew."""

    def sensed() -> gym.Env[Any, Any]:
        return FootSensors(bare(name, speed), config)

    found: dict[str, gym.Env[Any, Any]] = {"bare": bare(name, speed)}
    if not name.startswith("surefoot/"):
        found["InstrumentedEnv"] = InstrumentedEnv(bare(name, speed))
    found["FootSensors"] = sensed()
    for method in methods:
        found[f"+ SelfCalibration({method})"] = SelfCalibration(sensed(), method)
    return found


def main() -> None:
    """Print a table of step times, and where the time goes."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("--steps", type=int, default=400, help="steps of each environment in a round")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--env", default="surefoot/NaoWalk-v0", help="for instance Humanoid-v5")
    parser.add_argument("--config", default="hx711-load-cells", help="the feet's sensors")
    parser.add_argument("--speed", type=float, default=0.04, help="walking speed in m/s")
    parser.add_argument("--methods", nargs="+", default=["none", "tare", "window", "moment"])
    parser.add_argument("--shares", action="store_true", help="also profile the last environment")
    arguments = parser.parse_args()

    envs = stacks(arguments.env, arguments.speed, arguments.config, arguments.methods)
    for env in envs.values():
        env.reset(seed=0)
        step(env, 200)
    runs = {name: partial(step, env, arguments.steps) for name, env in envs.items()}
    times = interleaved(runs, arguments.rounds)
    median = {name: float(np.median(taken)) for name, taken in times.items()}
    print(f"{'environment':34s} {'us/step':>9s} {'of bare':>9s} {'added us':>9s}")
    for name, taken in median.items():
        ratio = taken / median["bare"]
        print(f"{name:34s} {1e6 * taken:9.1f} {100 * ratio:7.1f} % {1e6 * (taken - median['bare']):9.1f}")
    if arguments.shares:
        name, env = list(envs.items())[-1]
        print(f"\nShares of the time of {name}, as the profiler sees it:")
        shares(lambda: step(env, arguments.steps))


if __name__ == "__main__":
    main()
