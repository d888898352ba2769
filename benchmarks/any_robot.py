"""What calibration brings on other robots than the NAO, which squat, sway and lift one foot after the other.

    python benchmarks/any_robot.py --robots g1 t1 op3 --seeds 10

The cells are those of ``hx711-load-cells``, sized for the robot's weight: gains 12 % off, zeros 3 N per 100 N
of weight, drifting by 2 % of gain and 2 N per 100 N in a root minute. Errors count from ``--settle`` on, of
the centre of pressure of both feet together against the contacts of the simulation, where they bear weight.
"""

import argparse
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import surefoot  # noqa: F401
from surefoot.calibration import GRAVITY
from surefoot.sensors import sized
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers import FootSensors, SelfCalibration


def placed(force: NDArray[np.float64], cells: NDArray[np.float64], truth: Any) -> NDArray[np.float64]:
    """Find the centre of pressure in the world that forces of cells stand for, under the true soles."""
    soles, R = truth.position_sole[-1], truth.R_world_sole[-1]
    places = soles[:, None] + np.einsum("fij,fkj->fki", R, cells)
    loads = force.reshape(places.shape[:2])
    return np.asarray((loads[..., None] * places)[..., :2].sum(axis=(0, 1)) / loads.sum())


def run(robot: str, seed: int, method: str, duration: float, settle: float) -> tuple[float, float, float]:
    """Exercise once: RMS errors of the centre of pressure, raw and calibrated, in m, and of the force."""
    env = gym.make("surefoot/Exercise-v0", robot=robot, duration=duration)
    body: Any = env.unwrapped
    weight = float(body.model.body_subtreemass[0]) * GRAVITY
    cells = replace(sized(HX711_LOAD_CELLS, weight), initial_offset_std=0.03 * weight)
    sensed = FootSensors(env, cells)
    calibrated = SelfCalibration(sensed, method)
    calibrated.reset(seed=seed)
    nominal, places = sensed.instruments.nominal, sensed.source.drawing.position_cell_sole
    assert places is not None
    still = np.zeros(env.action_space.shape or (), dtype=np.float32)
    errors, done = [], False
    while not done:
        _, _, terminated, done, _ = calibrated.step(still)
        if terminated:
            raise RuntimeError(f"{robot} fell at {sensed.time:.1f} s with seed {seed}.")
        truth = sensed.source.truth
        cop = truth.cop_world()
        if sensed.time < settle or not np.isfinite(cop).all():
            continue
        raw = nominal.scale * sensed.raw + nominal.offset
        force = np.asarray(calibrated.estimate.force)
        off = [np.linalg.norm(placed(one, places, truth) - cop) for one in (raw, force)]
        errors.append([*off, force.sum() - truth.force_cell[-1].sum()])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    return float(rms[0]), float(rms[1]), float(rms[2])


def main() -> None:
    """Print a line a robot and seed, and the means."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("--robots", nargs="+", default=["g1", "t1", "op3"])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--method", default="moment")
    parser.add_argument("--duration", type=float, default=60.0, help="s")
    parser.add_argument("--settle", type=float, default=20.0, help="s from which errors count")
    arguments = parser.parse_args()
    for robot in arguments.robots:
        rows = []
        for seed in range(arguments.seeds):
            rows.append(run(robot, seed, arguments.method, arguments.duration, arguments.settle))
            raw, cop, force = rows[-1]
            told = f"CoP {1e3 * raw:6.2f} -> {1e3 * cop:5.2f} mm, force {force:5.2f} N"
            print(f"{robot:5s} seed {seed:2d}  {told}", flush=True)
        mean = np.mean(rows, axis=0)
        half = 1.96 * np.std(rows, axis=0, ddof=1) / np.sqrt(len(rows)) if len(rows) > 1 else mean * np.nan
        print(
            f"{robot:5s} mean     CoP {1e3 * mean[0]:6.2f} -> {1e3 * mean[1]:5.2f} +- {1e3 * half[1]:.2f} mm "
            f"(worst {1e3 * max(row[1] for row in rows):.2f}), force {mean[2]:.2f} +- {half[2]:.2f} N\n"
        )


if __name__ == "__main__":
    main()
