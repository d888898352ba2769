"""Vertical force of the feet that are found on robots of other people, against MuJoCo's own contacts.

Each robot is given as an MJCF file, ``module:file`` inside an installed package, or the name of an
environment that runs on MuJoCo. It is put into its standing pose, falls onto its feet with its actuators at
zero or at its keyframe's controls, and is compared for some hundred steps: the feet's vertical force by the
sensors in its model and by what is computed beside it, against the sum of all contacts of the feet.

    python benchmarks/robots_feet.py scene.xml dm_control:suite/humanoid_CMU.xml Humanoid-v5

A file without a floor gets one. Robots that are refused are listed with the reason.
"""

import argparse
from importlib.resources import files
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np

from surefoot.envs import instrument
from surefoot.envs.instrumentation.feet import standing_pose
from surefoot.envs.instrumentation.geometry import below, lowest_points
from surefoot.envs.instrumentation.reader import FeetReader

STEPS = 400


def robot_file(given: str) -> str:
    """Find the MJCF file of a robot: a path, module:path, or an environment's own."""
    if Path(given).exists():
        return given
    if ":" in given:
        module, path = given.split(":", 1)
        return str(files(module) / path)
    return str(gym.make(given).unwrapped.fullpath)


def with_floor(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Give a robot a floor below its feet if nothing is fixed in its world."""
    model = spec.copy().compile()
    if (model.body_weldid[model.geom_bodyid] == 0).any():
        return spec
    lowest = lowest_points(model, standing_pose(model))
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5.0, 5.0, 0.1], pos=[0.0, 0.0, lowest.min()]
    )
    return spec


def ground_force(model: mujoco.MjModel, data: mujoco.MjData, foot: str) -> float:
    """Sum the vertical forces in N of contacts between what hangs on a foot and everything else."""
    inside, total, wrench = below(model, model.body(foot).id), 0.0, np.zeros(6)
    for k in range(data.ncon):
        first, second = (inside[model.geom_bodyid[geom]] for geom in data.contact.geom[k])
        if first != second:
            mujoco.mj_contactForce(model, data, k, wrench)
            total += (1.0 if second else -1.0) * float(wrench[:3] @ data.contact.frame[k][2::3])
    return total


def compare(path: str, steps: int) -> str:
    """Describe how a robot's feet compare, as a row of the table, or why it is refused."""
    spec = with_floor(mujoco.MjSpec.from_file(path))
    try:
        made = instrument(spec)
    except ValueError as refusal:
        return f"refused: {refusal}"
    model = made.spec.compile()
    data = mujoco.MjData(model)
    pose = standing_pose(model)
    data.qpos[:], data.ctrl[:] = pose.qpos, pose.ctrl
    reader = FeetReader(model, data, [foot.body for foot in made.feet])
    worst, load = np.zeros(2), []
    for _ in range(steps):
        mujoco.mj_step1(model, data)
        mujoco.mj_step2(model, data)
        mujoco.mj_forward(model, data)
        truth = [ground_force(model, data, foot.body) for foot in made.feet]
        seen = [made.read(model, data).force_world[..., 2], reader.now().force_world[0, :, 2]]
        weight = model.body_subtreemass[0] * np.linalg.norm(model.opt.gravity)
        error = [np.abs(one - truth).max() / max(np.abs(truth).max(), weight) for one in seen]
        worst = np.maximum(worst, error)
        load.append(sum(truth) / weight)
    inside = [int((below(model, model.body(foot.body).id)).sum()) for foot in made.feet]
    return (
        f"{', '.join(foot.body for foot in made.feet)} | {inside[0]} + {inside[1]} | {np.max(load):.2f} | "
        f"{worst[0]:.1e} | {worst[1]:.1e}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="+")
    parser.add_argument("--steps", type=int, default=STEPS)
    arguments = parser.parse_args()
    print("| robot | feet | bodies | most load / weight | error in the model | error beside it |")
    print("|---|---|---|---|---|---|")
    for given in arguments.robots:
        print(f"| {Path(given).stem} | {compare(robot_file(given), arguments.steps)} |", flush=True)


if __name__ == "__main__":
    main()
