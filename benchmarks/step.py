"""The time of a step: bare and with each layer around it, by the library and by the specification.

    python benchmarks/step.py
    python benchmarks/step.py --robots NaoBalance G1 --rounds 400
    python benchmarks/step.py --robots NaoWalk --methods none tare window moment
    python benchmarks/step.py --robots NaoWalk --faults "at t=1 s cell left/2 dies"
    python benchmarks/step.py --robots NaoBalance --launchers
    python benchmarks/step.py --write

The last one, on a machine with nothing else to do, writes the tables of docs/speed.md again, in some thirty
minutes.

All stacks of a robot take the same few steps in each round, in turn, in one process, so that whatever else
the machine does hits all of them; as many as hold whole blocks of the filter, which learns once in each. Told
are medians over the rounds: the time of one step and how many times the bare step it is, with an interval
that holds this median 19 times in 20, and last the time of a reset that keeps sensors and calibration. Time
is that of the process and its children; of many robots also the time that passes. The specification is the
Python that runs where no library is (``SUREFOOT_NATIVE=0``). G1 needs ``pip install surefoot[robots]``.

Many robots are copies in Gymnasium's ``SyncVectorEnv``, or, where MuJoCo's threads step the task, its own
vector environment. ``--launchers`` compares both with ``AsyncVectorEnv``, the first of the table. The memory
of many is that of a process of its own which has stepped them once.
"""

import argparse
import os
import platform
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager, nullcontext
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import gymnasium as gym
import numpy as np

from surefoot.envs import InstrumentedEnv
from surefoot.native import CALIBRATION, ENVS, SENSORS, cores
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
DATA = Path(__file__).parents[1] / "docs" / "data"
RESETS = 40
"""How many of them are timed."""
BLOCK = 8
"""Samples in which the filter learns once; rounds of another length hold too much or too little of that."""


@contextmanager
def specification() -> Iterator[None]:
    """Let Python do the work of the libraries."""
    with ExitStack() as stack:
        for library in (CALIBRATION, ENVS, SENSORS):
            stack.enter_context(patch.object(library, "_found", (None,)))
        yield


class Stack:
    """An environment with layers around it, which steps by the library or without."""

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


class Cost(NamedTuple):
    """What a step of one stack costs, medians over the rounds.

    Attributes:
        used: Time of the process and its children in s.
        ratio: How many times the first stack's in the same round it is.
        low, high: Where this median lies 19 times in 20.
        passed: Time that passes in s.
        passed_ratio: How many times the first stack's it is.
        added: Time that passes more than with the first stack, in s.
        reset: Time of a reset in s; NaN where none was timed.
    """

    used: float
    ratio: float
    low: float
    high: float
    passed: float
    passed_ratio: float
    added: float
    reset: float


def compare(found: dict[str, Stack], rounds: int, steps: int, resets: int = 0) -> dict[str, Cost]:
    """Step all in turns, and time some resets."""
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
    timed: dict[str, list[float]] = {name: [] for name in found}
    for _ in range(resets):
        for name, stack in found.items():
            stack.run(2)
            timed[name].append(stack.reset(None))
    bare, wall = (np.array(next(iter(times.values()))) for times in (taken, walls))
    costs = {}
    for name in found:
        busy, waited = np.array(taken[name]), np.array(walls[name])
        ratio = np.sort(busy / bare)
        # Order statistics around the median: how many of n are below it is binomial.
        middle, away = len(ratio) / 2, 0.98 * np.sqrt(len(ratio))
        low, high = (ratio[int(np.clip(middle + off, 0, len(ratio) - 1))] for off in (-away, away))
        medians = [np.median(part) for part in (waited, waited / wall, waited - wall)]
        middles = np.median(busy), np.median(ratio)
        of_reset = np.median(timed[name]) if resets else np.nan
        costs[name] = Cost(*map(float, (*middles, low, high, *medians, of_reset)))
    return costs


def print_costs(costs: dict[str, Cost], robots: int = 1) -> None:
    """Print rows of the table; of many robots in the time that passes as well."""
    for name, cost in costs.items():
        line = f"  {name:44s} {1e6 * cost.used:9.0f} {cost.ratio:6.2f}  ({cost.low:.2f} to {cost.high:.2f})"
        if np.isfinite(cost.reset):
            line += f" {1e6 * cost.reset:9.0f}"
        if robots > 1:
            line += (
                f"   wall {cost.passed_ratio:5.2f} of bare, {1e6 * cost.added / robots:6.1f} us a robot added"
            )
        print(line, flush=True)


def memory_of(name: str, count: int) -> float:
    """Return the largest memory in GB of this process, which steps robots with sensors and filter once."""
    robot = ROBOTS[name]
    bare = gym.make_vec(robot.env, count, "vector_entry_point", **robot.options)
    stack = Stack(VectorSelfCalibration(VectorFootSensors(bare, robot.config), "moment"), True)
    stack.reset()
    stack.run(1)
    # `ru_maxrss` would count what the process that started this one had taken.
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e9


def save(folder: Path, name: str, heads: list[str], rows: list[list[str]]) -> None:
    """Write a table of a page of docs, and how it was made."""
    from surefoot.experiments.study.page import save_tables  # late: memory is measured without pandas
    from surefoot.experiments.study.tables import Table

    table = Table(name, "", tuple(heads), tuple(map(tuple, rows)))
    save_tables(folder, [table], by=f"{cores()} cores, {processor()}, load {LOAD:.1f}")


def processor() -> str:
    """Return the name of the processor."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


LOAD = os.getloadavg()[0]
"""How many processes wanted to run on the average of the minute before."""


def main() -> None:
    """Print the tables, and write them if asked to."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--methods", nargs="+", default=["moment"])
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--steps", type=int, default=3 * BLOCK, help="steps of each stack in a round")
    parser.add_argument("--many", nargs="*", type=int, help="robots of vector environments, by default 64")
    parser.add_argument("--threads", nargs="+", type=int, help="of these, by default 1, 2 and one a core")
    parser.add_argument("--memory", type=int, default=0, help="measure the memory of so many robots")
    parser.add_argument("--faults", nargs="*", default=[], help="what breaks, in words")
    parser.add_argument("--launchers", action="store_true", help="also Gymnasium's, of many robots alone")
    tables = "folder for tables, of 64, 256, 1024 and 4096 robots; by default docs/data/speed"
    parser.add_argument("--write", type=Path, nargs="?", const=DATA / "speed", help=tables)
    arguments = parser.parse_args()
    alike = [robot for robot in arguments.robots if ROBOTS[robot].batch or len(arguments.robots) == 1]
    print(f"  {'':44s} {'us/step':>9s} {'of bare':>6s} {'':14s} {'us/reset':>10s}")
    ones, more, held = times_of_one(arguments), times_of_many(arguments, alike), memory(arguments, alike)
    if arguments.write:
        save(arguments.write, "one", ["robot", "layers", "CPU µs a step", "of bare", "µs a reset"], ones)
        save(arguments.write, "many", MANY_HEADS, more)
        save(arguments.write, "memory", ["robot", "robots", "GB"], held)


def times_of_one(arguments: argparse.Namespace) -> list[list[str]]:
    """Time the layers around one robot of each kind."""
    rows = []
    for name in () if arguments.launchers else arguments.robots:
        print(f"{name}, 1 robot")
        try:
            found = stacks(ROBOTS[name], arguments.methods, arguments.faults, True)
        except ModuleNotFoundError as missing:
            print(f"  {missing}")
            continue
        found |= stacks(ROBOTS[name], arguments.methods, arguments.faults, False)
        costs = compare(found, arguments.rounds, arguments.steps, RESETS)
        print_costs(costs)
        for layer, cost in costs.items():
            ratio = f"{cost.ratio:.2f} ({cost.low:.2f} to {cost.high:.2f})"
            rows.append([name, layer, f"{1e6 * cost.used:.0f}", ratio, f"{1e6 * cost.reset:.0f}"])
    return rows


def times_of_many(arguments: argparse.Namespace, robots: list[str]) -> list[list[str]]:
    """Time the layers around many robots; rows are of the last one: sensors and the last method."""
    rows = []
    counts = arguments.many if arguments.many is not None else [64, 256, 1024] if arguments.write else [64]
    all_threads = arguments.threads or sorted({1, min(2, cores()), cores()})
    for name, count, threads in product(robots, counts, all_threads):
        print(f"{name}, {count} robots, {threads} threads")
        rest = arguments.methods, arguments.faults, threads, arguments.launchers
        rounds, steps = max(10, arguments.rounds * 8 // max(count, 64)), BLOCK * max(1, 40 // count)
        costs = compare(many(ROBOTS[name], count, *rest), rounds, steps)
        print_costs(costs, count)
        first, *_, end = costs.values()
        added = f"{1e6 * end.added / count:.1f}"
        times = f"{1e3 * first.passed:.1f}", f"{end.passed_ratio:.2f}", added, f"{end.ratio:.2f}"
        rows.append([name, f"{count:,}", str(threads), *times])
    return rows


def memory(arguments: argparse.Namespace, robots: list[str]) -> list[list[str]]:
    """Measure the memory of many robots of each kind, if asked for."""
    rows, count = [], arguments.memory or (4096 if arguments.write else 0)
    for name in robots if count else ():
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            size = pool.submit(memory_of, name, count).result()
        print(f"{name}, {count} robots with sensors and calibration: {size:.2f} GB")
        rows.append([name, f"{count:,}", f"{size:.2f}"])
    return rows


MANY_HEADS = [
    "robot", "robots", "threads", "bare, ms", "wall time of bare", "µs a robot added", "CPU time of bare",
]  # fmt: skip


if __name__ == "__main__":
    main()
