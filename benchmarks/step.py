"""The time of a step: bare and with each layer around it, by the library and by the specification.

    python benchmarks/step.py
    python benchmarks/step.py --robots NaoBalance G1 --rounds 400
    python benchmarks/step.py --robots NaoWalk --methods none tare window moment --shares
    python benchmarks/step.py --robots NaoWalk --faults "at t=1 s cell left/2 dies"
    python benchmarks/step.py --robots NaoBalance --launchers

All stacks of a robot take the same few steps in each round, in turn, in one process, so that whatever else
the machine does hits all of them. Told are medians over the rounds: the time of one step and how many times
the bare step it is, with an interval that holds this median 19 times in 20, and last the time of a reset that
keeps sensors and calibration. Time is that of the process and its children; of many robots also the time
that passes. The specification is the Python that runs where no library is (``SUREFOOT_NATIVE=0``). G1 needs
``pip install surefoot[robots]``.

Many robots are copies in Gymnasium's ``SyncVectorEnv``, or, where MuJoCo's threads step the task, its own
vector environment. ``--launchers`` compares both with ``AsyncVectorEnv``, the first of the table.
"""

import argparse
import cProfile
import os
import pstats
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import gymnasium as gym
import numpy as np

import surefoot  # noqa: F401
from surefoot.calibration.native import NATIVE as CALIBRATION
from surefoot.envs import InstrumentedEnv
from surefoot.native import cores
from surefoot.sensors.native import NATIVE as SENSORS
from surefoot.wrappers import FootSensors, SelfCalibration
from surefoot.wrappers.vector.foot_sensors import VectorFootSensors
from surefoot.wrappers.vector.self_calibration import VectorSelfCalibration
from surefoot.wrappers.vector.truth_row import TruthRow

CELLS, ANKLES = "hx711-load-cells", "icub-force-torque"


class Robot(NamedTuple):
    """An environment, its options, and the instruments under the robot's feet."""

    env: str
    options: dict[str, Any]
    config: str | None
    batch: bool = False  # whether MuJoCo's threads step many of them


ROBOTS = {
    "NaoBalance": Robot("surefoot/NaoBalance-v0", {}, CELLS, True),
    "NaoWalk": Robot("surefoot/NaoWalk-v0", {"speed": 0.04, "duration": 120.0}, CELLS, True),
    "Humanoid": Robot("Humanoid-v5", {}, ANKLES),
    "G1": Robot("surefoot/Exercise-v0", {"robot": "g1"}, None),
}
RESETS = 40
"""How many of them are timed."""


@contextmanager
def specification() -> Iterator[None]:
    """Let Python do the work of the libraries."""
    with patch.object(CALIBRATION, "_found", (None,)), patch.object(SENSORS, "_found", (None,)):
        yield


class Stack:
    """An environment with layers around it, which steps by the library or without.

    Args:
        env: The environment.
        native: Whether it steps by the library.
    """

    def __init__(self, env: Any, native: bool) -> None:
        self.env, self._way = env, nullcontext if native else specification
        shape = env.action_space.shape or ()
        self._action = np.zeros(shape, np.float32)

    def reset(self, seed: int | None = 0) -> float:
        """Begin an episode, the same in all stacks; return the time that it took in s."""
        with self._way():
            begin = time.process_time()
            self.env.reset(seed=seed)
            return time.process_time() - begin

    def run(self, steps: int) -> tuple[float, float, bool]:
        """Step on; return a step's time of the process and of the wall in s, and whether an episode ended."""
        done, taken, end = False, 0, False
        with self._way():
            begin, start = self._busy(), time.perf_counter()
            while taken < steps and not end:
                _, _, terminated, truncated, _ = self.env.step(self._action)
                taken, done = taken + 1, terminated | truncated
                end = bool(np.any(done))
            used, passed = self._busy() - begin, time.perf_counter() - start
        return used / taken, passed / taken, end

    def _busy(self) -> float:
        """Time for which this process and those of the environment have worked, in s."""
        children = [process.pid for process in getattr(self.env.unwrapped, "processes", ())]
        stats = [Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split() for child in children]
        theirs = sum(int(stat[11]) + int(stat[12]) for stat in stats)
        return time.process_time() + theirs / os.sysconf("SC_CLK_TCK")


def stacks(robot: Robot, methods: list[str], faults: list[str], native: bool) -> dict[str, Stack]:
    """Make the wrappers around an environment, each layer around one of its own."""

    def bare() -> gym.Env[Any, Any]:
        return gym.make(robot.env, disable_env_checker=True, **robot.options)

    def with_sensors() -> gym.Env[Any, Any]:
        return FootSensors(bare(), robot.config, faults=faults)

    found: dict[str, gym.Env[Any, Any]] = {}
    if native:
        found["bare"] = bare()
        if not robot.env.startswith("surefoot/"):
            found["InstrumentedEnv"] = InstrumentedEnv(bare())
    with nullcontext() if native else specification():
        found["FootSensors"] = with_sensors()
        for method in methods:
            found[f"+ SelfCalibration({method})"] = SelfCalibration(with_sensors(), method)
    return {name + ("" if native else ", specification"): Stack(env, native) for name, env in found.items()}


def make_copies(robot: Robot, count: int, launcher: Any, *wrappers: Callable[[Any], Any]) -> Any:
    """Make many of an environment by one of Gymnasium's launchers."""

    def one() -> gym.Env[Any, Any]:
        env = gym.make(robot.env, disable_env_checker=True, **robot.options)
        for wrapper in wrappers:
            env = wrapper(env)
        return env

    return launcher([one] * count)


def many(
    robot: Robot, count: int, methods: list[str], faults: list[str], threads: int, launchers: bool
) -> dict[str, Stack]:
    """Make the same of many robots, perhaps beside other launchers."""

    def bare(*wrappers: Callable[[Any], Any]) -> Any:
        if robot.batch:
            return gym.make_vec(robot.env, count, "vector_entry_point", threads=threads, **robot.options)
        return make_copies(robot, count, gym.vector.SyncVectorEnv, *wrappers)

    def with_sensors() -> Any:
        feet = VectorFootSensors(bare(TruthRow), robot.config, faults=faults)
        feet.sensors.threads = threads
        return feet

    found: dict[str, Any] = {}
    if launchers:
        kinds = gym.vector.AsyncVectorEnv, gym.vector.SyncVectorEnv
        found = {f"bare, {kind.__name__}": make_copies(robot, count, kind) for kind in kinds}
    found["bare"] = bare()
    if not robot.batch:
        found["TruthRow"] = bare(TruthRow)
    found["VectorFootSensors"] = with_sensors()
    for method in methods:
        found[f"+ VectorSelfCalibration({method})"] = VectorSelfCalibration(with_sensors(), method)
    return {name: Stack(env, True) for name, env in found.items()}


def compare(found: dict[str, Stack], rounds: int, steps: int, robots: int = 1) -> None:
    """Step all in turns and print their rows of the table; of many robots in the wall's time as well."""
    taken: dict[str, list[float]] = {name: [] for name in found}
    walls: dict[str, list[float]] = {name: [] for name in found}
    for number in range(-3, rounds):
        ended = number == -3
        if ended:
            for stack in found.values():
                stack.reset()
        for name, stack in found.items():
            used, passed, end = stack.run(steps)
            ended |= end
            if number >= 0:
                taken[name].append(used)
                walls[name].append(passed)
        if ended and number > -3:
            for stack in found.values():
                stack.reset()
    resets: dict[str, list[float]] = {name: [] for name in found}
    for _ in range(RESETS):
        for name, stack in found.items():
            stack.run(2)
            resets[name].append(stack.reset(None))
    bare, wall = (np.array(next(iter(times.values()))) for times in (taken, walls))
    for name, times in taken.items():
        ratio = np.sort(np.array(times) / bare)
        # Order statistics around the median: how many of n are below it is binomial.
        middle, away = len(ratio) / 2, 0.98 * np.sqrt(len(ratio))
        low, high = (ratio[int(np.clip(middle + off, 0, len(ratio) - 1))] for off in (-away, away))
        told = f"{1e6 * np.median(times):9.0f} {np.median(ratio):6.2f}"
        reset = 1e6 * np.median(resets[name])
        line = f"  {name:44s} {told}  ({low:.2f} to {high:.2f}) {reset:9.0f}"
        if robots > 1:
            passed = np.array(walls[name])
            added = 1e6 * np.median(passed - wall) / robots
            line += f"   wall {np.median(passed / wall):5.2f} of bare, {added:6.1f} us a robot added"
        print(line, flush=True)


def print_shares(run: Callable[[], Any], deepest: int = 18) -> None:
    """Print where the time of a run goes, as the profiler sees it."""
    profile = cProfile.Profile()
    profile.runcall(run)
    statistics: dict[tuple[str, int, str], Any] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    total = sum(row[2] for row in statistics.values())
    rows = sorted(statistics.items(), key=lambda row: -row[1][2])
    print("Shares of the time, as the profiler sees it:")
    for (file, line, name), (_, calls, own, cumulative, _) in rows[:deepest]:
        where = f"{Path(file).parent.name}/{Path(file).name}:{line}" if line else ""
        share, whole = 100 * own / total, 100 * cumulative / total
        print(f"  {share:5.1f} % own  {whole:5.1f} % in all  {calls:7d} x  {name} {where}")


def main() -> None:
    """Print the table, and where the time of the last stack goes."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--methods", nargs="+", default=["moment"])
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--steps", type=int, default=20, help="steps of each stack in a round")
    parser.add_argument("--many", nargs="*", type=int, default=[64], help="robots of vector environments")
    parser.add_argument("--threads", nargs="+", type=int, default=[1, cores()], help="of vector environments")
    parser.add_argument("--faults", nargs="*", default=[], help="what breaks, in words")
    parser.add_argument("--launchers", action="store_true", help="also Gymnasium's, of many robots alone")
    parser.add_argument("--shares", action="store_true", help="also profile the last stack")
    arguments = parser.parse_args()

    print(f"  {'':44s} {'us/step':>9s} {'of bare':>6s} {'':14s} {'us/reset':>10s}")
    for name in () if arguments.launchers else arguments.robots:
        print(f"{name}, 1 robot")
        try:
            found = stacks(ROBOTS[name], arguments.methods, arguments.faults, True)
        except ModuleNotFoundError as missing:
            print(f"  {missing}")
            continue
        found |= stacks(ROBOTS[name], arguments.methods, arguments.faults, False)
        compare(found, arguments.rounds, arguments.steps)
        if arguments.shares:
            last = found[f"+ SelfCalibration({arguments.methods[-1]})"]
            print_shares(partial(last.run, 1000))
    of_batches = [robot for robot in arguments.robots if ROBOTS[robot].batch or len(arguments.robots) == 1]
    for name, count, threads in product(of_batches, arguments.many, arguments.threads):
        print(f"{name}, {count} robots, {threads} threads")
        rest = arguments.methods, arguments.faults, threads, arguments.launchers
        compare(many(ROBOTS[name], count, *rest), max(20, arguments.rounds // 8), 5, count)


if __name__ == "__main__":
    main()
