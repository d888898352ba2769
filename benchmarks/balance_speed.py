"""What one step of the balance task costs with sensors and calibration, against the mj_step calls in it.

    python benchmarks/balance_speed.py --steps 400 --rounds 9 --shares
    python benchmarks/balance_speed.py --robots 16 64

One process and one thread, process time, in turns; medians over rounds. ``mj_step`` is what the robot's own
simulation costs: it makes the moves of the bare environment once more from the same states, with the same
targets and pushes and under the same load, ten calls a step and nothing else.

With ``--robots`` vectors of so many environments are stepped as well, where sensors and calibrators serve all
of them at once; times are those of one robot.
"""

import argparse
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from stepping import interleaved, profiled, step
from vector_speed import step as vector_step

import surefoot
from surefoot.envs.nao.env import SUBSTEPS
from surefoot.experiments.policy.view import make_task
from surefoot.wrappers import FootSensors, SelfCalibration
from surefoot.wrappers.vector.foot_sensors import VectorFootSensors
from surefoot.wrappers.vector.self_calibration import VectorSelfCalibration
from surefoot.wrappers.vector.truth_row import TruthRow

TASK = "surefoot/NaoBalance-v0"

CELLS = "hx711-load-cells"

STATE = mujoco.mjtState.mjSTATE_INTEGRATION

LAYERS = {
    "envs": "environment",
    "sensors": "sensors",
    "calibration": "calibrator",
    "calibration/front_end": "calibrator's front end",
    "robot": "beliefs and views",
    "robot/sensing": "sensors",
    "wrappers": "beliefs and views",
    "wrappers/foot_sensors.py": "sensors",
    "sensors/telemetry": "telemetry",
    **{f"sensors/{name}.py": "telemetry" for name in ("devices/imu", "devices/encoders", "transport/link")},
}
"""Which layer of a step a file or a folder belongs to."""


def bare() -> gym.Env[Any, Any]:
    return gym.make(TASK, disable_env_checker=True, duration=120.0)


def sensed() -> gym.Env[Any, Any]:
    return FootSensors(bare(), CELLS)


def stacks() -> dict[str, gym.Env[Any, Any]]:
    """Make the task and what is wrapped around it, each anew."""
    return {
        "environment": bare(),
        "FootSensors": sensed(),
        "SelfCalibration(none)": SelfCalibration(sensed(), "none"),
        "SelfCalibration(moment)": SelfCalibration(sensed(), "moment"),
        "a policy's feed, moment": make_task("moment", duration=120.0)[0],
    }


class Replay:
    """Makes the same moves again with ``mj_step`` alone."""

    def __init__(self) -> None:
        self.env = bare()
        self.env.reset(seed=0)
        step(self.env, 200)

    def __call__(self, steps: int) -> float:
        """Move on, and tell the time of one step of the same moves in s."""
        robot: Any = self.env.unwrapped
        model, data = robot.model, robot.data
        start = np.empty(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, data, start, STATE)
        moves = []
        for _ in range(steps):
            step(self.env, 1)
            moves.append((data.ctrl.copy(), data.xfrc_applied.copy()))
        again = mujoco.MjData(model)
        mujoco.mj_setState(model, again, start, STATE)
        begin = time.process_time()
        for ctrl, pushes in moves:
            again.ctrl[:], again.xfrc_applied[:] = ctrl, pushes
            for _ in range(SUBSTEPS):
                mujoco.mj_step(model, again)
        return (time.process_time() - begin) / steps


def vectors(robots: int) -> dict[str, Any]:
    """Make vectors of the task, bare and wrapped."""

    def copies(*wrappers: Callable[[Any], Any]) -> Any:
        def one() -> gym.Env[Any, Any]:
            env = bare()
            for wrapper in wrappers:
                env = wrapper(env)
            return env

        return gym.vector.SyncVectorEnv([one] * robots)

    felt = partial(VectorFootSensors, config=CELLS)
    return {
        "environment": copies(),
        "FootSensors": felt(copies(TruthRow)),
        "SelfCalibration(none)": VectorSelfCalibration(felt(copies(TruthRow)), "none"),
        "SelfCalibration(moment)": VectorSelfCalibration(felt(copies(TruthRow)), "moment"),
    }


def layer_of(file: str, name: str) -> str | None:
    """Tell which layer a function belongs to; ``None`` for one that works for whoever calls it."""
    if "mj_step" in name:
        return "mj_step"
    place, root = Path(file), Path(surefoot.__file__).parent
    if not place.is_relative_to(root):
        return None
    place = place.relative_to(root)
    return next((LAYERS[str(part)] for part in (place, *place.parents) if str(part) in LAYERS), None)


def shares_by_layer(run: Callable[[], Any]) -> dict[str, float]:
    """Share out the time of a run; what NumPy and Python do counts where they were called from."""
    statistics = profiled(run)
    totals: dict[str, float] = {}

    def credit(function: tuple[str, int, str], seconds: float, depth: int = 0) -> None:
        layer = layer_of(function[0], function[2])
        callers = statistics[function][4]
        spent = sum(row[3] for row in callers.values())
        if layer is not None or not spent or depth == 8:
            totals[layer or "others"] = totals.get(layer or "others", 0.0) + seconds
            return
        for caller, row in callers.items():
            credit(caller, seconds * row[3] / spent, depth + 1)

    for function, row in statistics.items():
        credit(function, row[2])
    whole = sum(totals.values())
    return {layer: seconds / whole for layer, seconds in sorted(totals.items(), key=lambda item: -item[1])}


def report(title: str, times: Mapping[str, list[float]], robots: int = 1) -> None:
    """Print medians, what each layer adds to the one before, and ratios to mj_step."""
    print(f"\n{title:34s} {'us/step':>8s} {'added':>8s} {'of mj_step':>11s}")
    base = np.array(times["mj_step"])
    before = 0.0
    for name, taken in times.items():
        each = np.array(taken) / (1 if name == "mj_step" else robots)
        median, ratio = 1e6 * float(np.median(each)), float(np.median(each / base))
        print(f"{name:34s} {median:8.1f} {median - before:8.1f} {ratio:11.2f}")
        before = median


def main() -> None:
    """Print tables of step times, and where the time goes."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("--steps", type=int, default=400, help="steps of each stack in a round")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--robots", type=int, nargs="*", default=[], help="sizes of vectors to step as well")
    parser.add_argument("--shares", action="store_true", help="also profile the last stack, layer by layer")
    arguments = parser.parse_args()

    envs = stacks()
    for env in envs.values():
        env.reset(seed=0)
        step(env, 200)
    simulation = partial(Replay(), arguments.steps)
    runs = {"mj_step": simulation} | {n: partial(step, env, arguments.steps) for n, env in envs.items()}
    report("one robot", interleaved(runs, arguments.rounds))
    for robots in arguments.robots:
        steps = max(1, arguments.steps // robots)
        many: dict[str, Callable[[], float]] = {"mj_step": simulation}
        for name, env in vectors(robots).items():
            env.reset(seed=0)
            vector_step(env, 200, 0)
            many[name] = partial(vector_step, env, steps, 0)
        report(f"{robots} robots, one of them", interleaved(many, arguments.rounds), robots)
    if arguments.shares:
        name, env = list(envs.items())[-1]
        print(f"\nShares of a step of '{name}', as the profiler sees them (it slows Python, not MuJoCo):")
        for layer, share in shares_by_layer(lambda: step(env, arguments.steps)).items():
            print(f"  {100.0 * share:5.1f} %  {layer}")


if __name__ == "__main__":
    main()
