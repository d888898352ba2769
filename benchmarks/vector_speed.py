"""What sensors and calibrators of many robots cost: vector steps, bare and wrapped, in one process.

    python benchmarks/vector_speed.py --envs 64 --rounds 7 --steps 32

Each round steps every stack for a while, in turn, so that whatever else the machine does hits all of them;
medians over rounds of their ratios are told. Time is that of the process, and of one thread. All stacks get
the same actions and seeds: their robots do the same.

Humanoid-v5 has spheres for feet, and so sensors at its ankles; its robots are reset when they fall, which
with small random actions is every half second or so.

    python benchmarks/vector_speed.py --launchers --robot surefoot/NaoBalance-v0

compares the launchers of a NAO task: Gymnasium's copies in one process and in one process each, and the
environment that MuJoCo's threads step, bare and with sensors and a calibrator. It tells the time that passes
and the time of all processes and threads together. Where others use the machine too, 64 processes get more of
it than two threads, so it also tells what a step takes at least where nobody does: the time of the thread
that all wait for, or the share of each core of all that is done, whichever is longer.
"""

import argparse
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from stepping import shares

import surefoot  # noqa: F401
from surefoot.envs import InstrumentedEnv
from surefoot.wrappers.vector.foot_sensors import VectorFootSensors
from surefoot.wrappers.vector.self_calibration import VectorSelfCalibration
from surefoot.wrappers.vector.truth_row import TruthRow

VectorEnv = gym.vector.VectorEnv[Any, Any, Any]

SENSORS = {
    "Humanoid-v5": "icub-force-torque",
    "surefoot/NaoBalance-v0": "hx711-load-cells",
    "surefoot/NaoWalk-v0": "hx711-load-cells",
}


def robot(name: str) -> gym.Env[Any, Any]:
    return gym.make(name, disable_env_checker=True)


def stacks(name: str, count: int, methods: list[str]) -> dict[str, VectorEnv]:
    def copies(*wrappers: Callable[[Any], Any]) -> VectorEnv:
        def one() -> gym.Env[Any, Any]:
            env = robot(name)
            for wrapper in wrappers:
                env = wrapper(env)
            return env

        return gym.vector.SyncVectorEnv([one] * count)

    found: dict[str, VectorEnv] = {"bare": copies()}
    if "Humanoid" in name:
        found["InstrumentedEnv alone"] = copies(InstrumentedEnv)
    found["TruthRow alone"] = copies(TruthRow)
    felt = partial(VectorFootSensors, config=SENSORS[name])
    found["VectorFootSensors"] = felt(copies(TruthRow))
    for method in methods:
        found[f"+ VectorSelfCalibration({method})"] = VectorSelfCalibration(felt(copies(TruthRow)), method)
    return found


def step(env: VectorEnv, steps: int, seed: int) -> float:
    """Step on and tell the time of one vector step in s."""
    rng = np.random.default_rng(seed)
    shape = env.action_space.shape or ()
    actions = (0.05 * rng.standard_normal((steps, *shape))).astype(np.float32)
    begin = time.process_time()
    for action in actions:
        env.step(action)
    return (time.process_time() - begin) / steps


def launchers(name: str, count: int, methods: list[str]) -> dict[str, VectorEnv]:
    def batch() -> VectorEnv:
        return gym.make_vec(name, count, "vector_entry_point")

    one = partial(robot, name)
    found = {
        "AsyncVectorEnv": gym.vector.AsyncVectorEnv([one] * count),
        "SyncVectorEnv": gym.vector.SyncVectorEnv([one] * count),
        "BatchVectorEnv": batch(),
    }
    for method in methods:
        felt = VectorFootSensors(batch(), SENSORS[name])
        found[f"+ sensors, calibration ({method})"] = VectorSelfCalibration(felt, method)
    return found


def busy(env: VectorEnv) -> float:
    """Tell how long this process and those of an environment have been busy, in s."""
    children = [process.pid for process in getattr(env.unwrapped, "processes", ())]
    stats = [Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split() for child in children]
    theirs = sum(int(stat[11]) + int(stat[12]) for stat in stats)
    return time.process_time() + theirs / os.sysconf("SC_CLK_TCK")


def compare_launchers(envs: dict[str, VectorEnv], steps: int, rounds: int) -> None:
    """Print steps a second, and how many times those of AsyncVectorEnv."""
    clocks: tuple[Callable[[VectorEnv], float], ...] = (lambda _: time.perf_counter(), busy, waited_for)
    taken: dict[str, list[list[float]]] = {name: [] for name in envs}
    for turn in range(rounds):
        for name, env in envs.items():
            begin = [clock(env) for clock in clocks]
            step(env, steps, 1 + turn)
            now = [(clock(env) - start) / steps for clock, start in zip(clocks, begin, strict=True)]
            now[2] = max(now[2], now[1] / (os.cpu_count() or 1))
            taken[name].append(now)
    print(f"{'':36s} {'passed':>14s} {'of all cores':>14s} {'at least':>14s}   (ms, times AsyncVectorEnv)")
    for name, times in taken.items():
        ms = 1e3 * np.median(times, axis=0)
        faster = np.median(np.array(taken["AsyncVectorEnv"]) / times, axis=0)
        print(f"{name:36s}", *(f"{one:8.2f} {ratio:5.2f}" for one, ratio in zip(ms, faster, strict=True)))


def waited_for(env: VectorEnv) -> float:
    """Tell how long this thread, for which all others wait, has been busy, in s."""
    return time.thread_time()


def main() -> None:
    """Print a table of step times, and where the time goes."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("--robot", default="Humanoid-v5", choices=sorted(SENSORS))
    parser.add_argument("--envs", type=int, default=64, help="number of robots")
    parser.add_argument("--steps", type=int, default=32, help="steps of each stack in a round")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--methods", nargs="+", default=["moment"])
    parser.add_argument("--launchers", action="store_true", help="compare launchers of a NAO task")
    parser.add_argument("--shares", action="store_true", help="also profile the last stack")
    arguments = parser.parse_args()

    make = launchers if arguments.launchers else stacks
    envs = make(arguments.robot, arguments.envs, arguments.methods)
    for env in envs.values():
        env.reset(seed=0)
        step(env, 48, 0)
    if arguments.launchers:
        compare_launchers(envs, arguments.steps, arguments.rounds)
        for env in envs.values():
            env.close()
        return
    times: dict[str, list[float]] = {name: [] for name in envs}
    for turn in range(arguments.rounds):
        for name, env in envs.items():
            times[name].append(step(env, arguments.steps, 1 + turn))
    bare = np.array(times["bare"])
    print(f"{arguments.envs} x {arguments.robot}")
    print(f"{'stack':36s} {'ms/step':>8s} {'added':>9s} {'added us/robot':>15s}")
    for name, taken in times.items():
        added = np.median(np.array(taken) / bare) - 1.0
        extra = float(np.median(taken) - np.median(bare))
        per_robot = 1e6 * extra / arguments.envs
        print(f"{name:36s} {1e3 * np.median(taken):8.2f} {100 * added:7.1f} % {per_robot:15.2f}")
    if arguments.shares:
        name, env = list(envs.items())[-1]
        print(f"\nShares of the time of {name}, as the profiler sees it:")
        shares(lambda: step(env, arguments.steps, 0), 30)


if __name__ == "__main__":
    main()
