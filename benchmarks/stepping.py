"""What the benchmarks of steps have in common: stepping with a clock, in turns, and shares of the time."""

import cProfile
import pstats
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

__all__ = ["interleaved", "profiled", "shares", "step"]


def step(env: gym.Env[Any, Any], steps: int, clock: Callable[[], float] = time.process_time) -> float:
    """Step on and tell the time of one step in s."""
    action = np.zeros(env.action_space.shape or (), dtype=np.float32)
    begin = clock()
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
    return (clock() - begin) / steps


def interleaved(runs: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, list[float]]:
    """Run every candidate once a round, in turn, and collect what each tells.

    Whatever else the machine does in the meantime hits all of them.
    """
    told: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            told[name].append(run())
    return told


def profiled(run: Callable[[], Any]) -> Mapping[tuple[str, int, str], Any]:
    """Run under the profiler: for each (file, line, name) (.., calls, own, cumulative s, callers)."""
    profile = cProfile.Profile()
    profile.runcall(run)
    statistics: Mapping[tuple[str, int, str], Any] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    return statistics


def shares(run: Callable[[], Any], deepest: int = 18) -> None:
    """Print where the time of a run goes."""
    statistics = profiled(run)
    total = sum(row[2] for row in statistics.values())
    rows = sorted(statistics.items(), key=lambda row: -row[1][2])
    for (file, line, name), (_, calls, own, cumulative, _) in rows[:deepest]:
        where = f"{Path(file).parent.name}/{Path(file).name}:{line}" if line else ""
        share, whole = 100 * own / total, 100 * cumulative / total
        print(f"  {share:5.1f} % own  {whole:5.1f} % in all  {calls:7d} x  {name} {where}")
