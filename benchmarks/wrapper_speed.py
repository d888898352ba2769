"""What sensors and calibrators cost: steps of bare and of wrapped environments, interleaved in one process.

    python benchmarks/wrapper_speed.py --steps 400 --rounds 7
    python benchmarks/wrapper_speed.py --env Humanoid-v5 --config icub-ftsens

Each round steps every environment for a while, in turn, so that whatever else the machine does hits all of
them; the medians over rounds are compared. Time is that of the process, and of one thread.
"""

import argparse
import cProfile
import pstats
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

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


def step(env: gym.Env[Any, Any], steps: int) -> float:
    """Step on and tell the time of one step in s."""
    action = np.zeros(env.action_space.shape or (), dtype=np.float32)
    begin = time.process_time()
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
    return (time.process_time() - begin) / steps


def shares(run: Callable[[], Any], deepest: int = 18) -> None:
    """Print where the time of a run goes."""
    profile = cProfile.Profile()
    profile.runcall(run)
    statistics = pstats.Stats(profile)
    total = sum(row[2] for row in statistics.stats.values())  # type: ignore[attr-defined]
    rows = sorted(statistics.stats.items(), key=lambda row: -row[1][2])  # type: ignore[attr-defined]
    for (file, line, name), (_, calls, own, cumulative, _) in rows[:deepest]:
        where = f"{Path(file).parent.name}/{Path(file).name}:{line}" if line else ""
        share, whole = 100 * own / total, 100 * cumulative / total
        print(f"  {share:5.1f} % own  {whole:5.1f} % in all  {calls:7d} x  {name} {where}")


def main() -> None:
    """Print a table of step times, and where the time goes."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("--steps", type=int, default=400, help="steps of each environment in a round")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--env", default="surefoot/NaoWalk-v0", help="for instance Humanoid-v5")
    parser.add_argument("--config", default="hx711-load-cells", help="the feet's sensors")
    parser.add_argument("--speed", type=float, default=0.04, help="walking speed in m/s")
    parser.add_argument("--methods", nargs="+", default=["none", "tare", "window", "surefoot"])
    parser.add_argument("--shares", action="store_true", help="also profile the last environment")
    arguments = parser.parse_args()

    envs = stacks(arguments.env, arguments.speed, arguments.config, arguments.methods)
    for env in envs.values():
        env.reset(seed=0)
        step(env, 200)
    times: dict[str, list[float]] = {name: [] for name in envs}
    for _ in range(arguments.rounds):
        for name, env in envs.items():
            times[name].append(step(env, arguments.steps))
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
