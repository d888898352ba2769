"""Sound walk logs of a measuring chain that surefoot did not model: how often does the command do well?

    python tests/spoilt/_strangers.py --out FOLDER                  # 30 logs, about 20 minutes
    python tests/spoilt/_strangers.py --out FOLDER --logs 4 --seed 7

Robots move in MuJoCo, and ground forces are read from its contacts. Load cells on HX711 chips with clocks of
their own, encoders, an IMU, links that lose rows and a logger that starts at any moment are modelled in this
file, independently of ``surefoot.sensors`` and of surefoot's instrumented robots. Each log consists of three
tables (feet, joints, IMU) with a description, as ``docs/log-format.md`` specifies; the true map is known.
``surefoot calibrate walk`` runs on each log, and its map is compared with the true one on the second half of
the log. A foot counts as worse if the root mean square error of its centre of pressure exceeds that of
the starting map by more than 10 % and 0.1 mm.

The Unitree G1 walks by a published policy, which is found through the environment variable
``SUREFOOT_STRANGERS``; without it the logs are of the other three robots.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import gymnasium as gym
import mujoco
import numpy as np
import pandas as pd

from surefoot.arrays import Floats
from surefoot.envs import load_robot_spec
from surefoot.experiments.walks.walkers import make_g1

SIDES = ("left", "right")
CELLS = [f"{s}_{c}" for s in SIDES for c in ("front_left", "front_right", "rear_left", "rear_right")]
SHARES = (0.1, 0.4, 0.4, 0.1)
"""Shares of the last four conversions in an HX711's reading: it settles within four (data sheet)."""


class Robot(NamedTuple):
    """A robot and where its owner put the cells."""

    torso: str  # the floating body
    imu: str  # the site of the IMU
    feet: tuple[str, str]  # bodies of the feet
    sole: tuple[float, float, float]  # origin of the sole frame in the foot's frame, in m
    corners: tuple[float, float, float, float]  # front, rear, left and right cells of the left foot, in m
    plate_mass: float = 0.0  # kg of the sole plate below the cells


ROBOTS = {
    "nao": Robot(
        "torso", "imu", ("l_ankle", "r_ankle"), (0, 0, -0.04511), (0.109, -0.061, 0.0558, -0.0422), 0.05
    ),
    "g1": Robot(
        "pelvis",
        "imu_in_pelvis",
        ("left_ankle_roll_link", "right_ankle_roll_link"),
        (0.04, 0, -0.035),
        (0.085, -0.08, 0.022, -0.022),
    ),
    "t1": Robot(
        "Trunk", "imu", ("left_foot_link", "right_foot_link"), (0, 0, -0.03), (0.1, -0.1, 0.04, -0.04)
    ),
    "op3": Robot(
        "body_link",
        "torso",
        ("l_ank_roll_link", "r_ank_roll_link"),
        (0, 0, -0.03),
        (0.08, -0.03, 0.045, -0.02),
    ),
}


@dataclass(frozen=True)
class Chain:
    """The devices of a log. Forces are shares of the robot's weight. Defaults are those of hobby parts."""

    conversions: float = 80.0  # nominal conversions of a chip per second; its own clock is 8 % +- 6 % faster
    feet_rate: float = 80.0  # rows per second of the feet
    wire: float = 0.006  # s from a reading to its time stamp
    scale_std: float = 0.08  # of the cells' scales against their data sheet
    offset_std: float = 0.03
    offset_walk: float = 0.004  # random walk of the zeros in 30 s
    warming: float = 0.006  # drift of the zeros with a time constant of 60 s
    nonlinearity: float = 0.0005
    noise: float = 38.0  # counts; 90 nV (HX711 data sheet at 80 conversions per second)
    joint_rate: float = 100.0
    encoder_step: float = 2 * np.pi / 4096  # rad, 12 bits
    encoder_zero: float = np.radians(0.12)  # rad, error of the zero
    imu_rate: float = 200.0
    accelerometer_bias: float = 0.06  # m/s^2
    gyroscope_bias: float = np.radians(0.25)  # rad/s
    mounting: float = np.radians(0.5)  # rad, how far the IMU is turned about each axis
    lost: float = 0.0  # share of the rows of each table that are lost
    repeated_stamps: float = (
        0.0  # probability that a row of the feet waits and gets the stamp of the next one
    )
    age_known: bool = True  # whether the description contains ``readings_age_s``
    start: float = 3.0  # s of the motion at which the logger starts
    length: float = 28.0  # s


class Motion(NamedTuple):
    """A robot's motion at each of N steps of the physics."""

    robot: str
    joint_names: list[str]
    mass: float
    time: Floats  # (N,)
    joint: Floats  # hinge angles in rad, (N, J)
    angular_velocity: Floats  # of the torso in its own frame, (N, 3)
    specific_force: Floats  # at the IMU in the torso's frame, (N, 3)
    wrench_sole: Floats  # of the ground on each foot, in the sole frame, (N, 2, 6)
    position_sole: Floats  # in the world, (N, 2, 3)
    R_world_sole: Floats  # (N, 2, 3, 3)


def cell_positions(robot: str) -> Floats:
    """Return the places of the eight cells in the sole frames in m, shape (8, 2)."""
    front, rear, left, right = ROBOTS[robot].corners
    own = np.array([[front, left], [front, right], [rear, left], [rear, right]])
    return np.concatenate([own, own[[1, 0, 3, 2]] * (1, -1)])


def robot_model(robot: str) -> str:
    """Return the robot's MJCF without meshes, with inertias as numbers and a site for each sole."""
    if robot == "g1":
        folder = Path(os.environ["SUREFOOT_STRANGERS"])
        spec = mujoco.MjSpec.from_file(str(folder / "holosoma/data/robots/g1/g1_29dof.xml"))
        for pair in list(spec.pairs):  # they name a floor that the file lacks
            spec.delete(pair)
    else:
        spec = load_robot_spec(robot)
    if robot == "nao":  # it has no meshes, and sites of its own
        return str(spec.to_xml())
    model = spec.compile()
    for side, foot in zip(SIDES, ROBOTS[robot].feet, strict=True):
        spec.body(foot).add_site(name=f"{side}_sole", pos=ROBOTS[robot].sole)
    for body in spec.bodies:
        number = model.body(body.name).id
        if number and model.body_mass[number] > 0:
            body.mass, body.ipos = model.body_mass[number], model.body_ipos[number]
            body.iquat, body.inertia = model.body_iquat[number], model.body_inertia[number]
            body.fullinertia, body.explicitinertial = [np.nan] * 6, True
    for geom in list(spec.geoms):
        if geom.meshname:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    spec.compile()
    return str(spec.to_xml())


def rotation(vector: Any) -> Floats:
    """Return the matrix of a rotation vector in rad."""
    angle = float(np.linalg.norm(vector))
    quaternion, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quaternion, np.asarray(vector, float) / max(angle, 1e-12), angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def ground_wrench(model: Any, data: Any, bodies: set[int], origin: Floats) -> Floats:
    """Return force and torque about a point that all contacts exert on some bodies, in world axes."""
    wrench, own = np.zeros(6), np.zeros(6)
    for number in range(data.ncon):
        contact = data.contact[number]
        first, second = (model.geom_bodyid[g] in bodies for g in (contact.geom1, contact.geom2))
        if first == second:
            continue
        mujoco.mj_contactForce(model, data, number, own)
        sign = 1 if second else -1  # MuJoCo gives the force on the second geom
        force, torque = sign * (own.reshape(2, 3) @ contact.frame.reshape(3, 3))
        wrench += np.concatenate([force, torque + np.cross(contact.pos - origin, force)])
    return wrench


def record(robot: str, seed: int, seconds: float) -> Motion:
    """Let a robot walk, or do exercises, and record each step of the physics."""
    rng = np.random.default_rng(seed)
    if robot == "nao":
        speed, turn = rng.uniform(-0.04, 0.07), rng.uniform(-0.1, 0.1)
        walk: dict[str, Any] = {"duration": seconds, "speed": speed, "turn_rate": turn}
        env: Any = gym.make("surefoot/NaoWalk-v0", **walk).unwrapped
    elif robot == "g1":
        env = make_g1("ppo_g1_29dof").unwrapped
    else:
        env = gym.make("surefoot/Exercise-v0", robot=robot, duration=seconds).unwrapped
    command = np.array([rng.uniform(0.2, 0.5), 0.0, rng.uniform(-0.4, 0.4)])
    env.reset(seed=seed)
    model, data, parts = env.model, env.data, ROBOTS[robot]
    torso, feet = model.body(parts.torso).id, [model.body(name).id for name in parts.feet]
    bodies = [{f, *(b for b in range(model.nbody) if model.body_weldid[b] == f)} for f in feet]
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    imu = model.site_pos[model.site(parts.imu).id]
    rows: list[tuple[Any, ...]] = []
    step = mujoco.mj_step

    def step_and_record(model: Any, data: Any, count: int = 1) -> None:
        for _ in range(count):
            joint, spin = data.qpos[model.jnt_qposadr[hinges]].copy(), data.qvel[3:6].copy()
            time = data.time
            step(model, data)  # contacts and poses are then those of the step's beginning, as the copies are
            R = data.xmat[torso].reshape(3, 3)
            force = R.T @ (data.qacc[:3] - model.opt.gravity) + np.cross(data.qacc[3:6], imu)
            turns = [data.xmat[f].reshape(3, 3).copy() for f in feet]
            origins = [data.xpos[f] + turn @ parts.sole for f, turn in zip(feet, turns, strict=True)]
            wrenches = []
            for own, turn, origin in zip(bodies, turns, origins, strict=True):
                wrench = ground_wrench(model, data, own, origin)
                wrenches.append((wrench.reshape(2, 3) @ turn).ravel())
            force += np.cross(spin, np.cross(spin, imu))
            rows.append((time, joint, spin, force, wrenches, origins, turns))

    with patch.object(mujoco, "mj_step", step_and_record):
        while data.time < seconds:
            if robot == "g1":
                action = env.policy(env.state(), command if data.time > 1.5 else np.zeros(3))
            else:
                action = np.zeros(env.action_space.shape, np.float32)
            _, _, fallen, truncated, _ = env.step(action)
            if fallen or truncated:
                break
    columns: list[Any] = [np.array(column) for column in zip(*rows, strict=True)]
    names = [model.joint(number).name for number in hinges]
    return Motion(robot, names, float(model.body_subtreemass[torso]), *columns)


def cell_forces(motion: Motion, rng: np.random.Generator) -> Floats:
    """Share the load of each sole among four springs of slightly different stiffness, shape (N, 8)."""
    parts, places, dt = ROBOTS[motion.robot], cell_positions(motion.robot), motion.time[1] - motion.time[0]
    forces = []
    for foot in range(2):
        velocity = np.gradient(motion.position_sole[:, foot], dt, axis=0)
        plate = np.array([0, 0, -9.81]) - np.gradient(velocity, dt, axis=0)
        inertia = np.einsum("nji,nj->ni", motion.R_world_sole[:, foot], plate)
        inertia[:, 2] += 9.81  # a plate that hangs at rest is the preload, not a force
        force = motion.wrench_sole[:, foot, :3] + parts.plate_mass * inertia
        x, y = places[4 * foot : 4 * foot + 4].T
        A = np.stack([np.ones(4), y, -x])
        stiffness = np.diag(rng.uniform(0.85, 1.15, 4))
        share = stiffness @ A.T @ np.linalg.inv(A @ stiffness @ A.T)
        forces.append(np.column_stack([force[:, 2], motion.wrench_sole[:, foot, 3:5]]) @ share.T)
    return np.concatenate(forces, axis=1)


def interval_means(values: Floats, time: Floats, ends: Floats, length: float) -> Floats:
    """Return the means of columns over intervals that end at some times."""
    dt = time[1] - time[0]
    integral = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0) * dt])
    edges = np.append(time, time[-1] + dt)

    def at(when: Floats) -> Floats:
        return np.column_stack([np.interp(when, edges, column) for column in integral.T])

    means: Floats = (at(ends) - at(ends - length)) / length
    return means


def read_chips(motion: Motion, chain: Chain, rng: np.random.Generator) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Return the table of the feet, and its truth."""
    weight, time = motion.mass * 9.81, motion.time
    force, dt = cell_forces(motion, rng), time[1] - time[0]
    nominal = 4.2e-7 * weight  # N per count: a cell of about three weights on a range of 24 bits
    scale = nominal * (1 + chain.scale_std * rng.standard_normal(8))
    walk = np.cumsum(rng.standard_normal(force.shape), axis=0) * np.sqrt(dt / 30) * chain.offset_walk
    warming = chain.warming * rng.standard_normal(8) * (1 - np.exp(-time / 60))[:, None]
    offset = weight * (chain.offset_std * rng.standard_normal(8) - 0.03 + walk + warming)
    counts = (force * (1 + chain.nonlinearity * force / weight) - offset) / scale
    rows = np.arange(chain.start + rng.uniform(0, 0.01), motion.time[-1] - 0.2, 1 / chain.feet_rate)
    rows = rows[rows < chain.start + chain.length]
    readings, ages = np.empty((len(rows), 8)), np.empty((len(rows), 8))
    for cell in range(8):
        period = 1 / (chain.conversions * (1.08 + 0.06 * rng.standard_normal()))
        ends = np.arange(rng.uniform(period, 2 * period), time[-1], period)
        conversions = interval_means(counts[:, [cell]], time, ends, period)[:, 0]
        settled = np.convolve(conversions, SHARES)[: len(ends)] + chain.noise * rng.standard_normal(len(ends))
        newest = np.searchsorted(ends, rows, side="right") - 1
        readings[:, cell], ages[:, cell] = settled[newest], rows - ends[newest] + 2 * period + chain.wire
    stamps = rows + chain.wire + 0.0006 * abs(rng.standard_normal(len(rows)))
    for row in np.flatnonzero(rng.uniform(size=len(rows) - 1) < chain.repeated_stamps):
        stamps[row] = stamps[row + 1]
    age, readings = float(ages.mean()), np.rint(readings)
    table = pd.DataFrame(readings, columns=[f"raw_{name}_count" for name in CELLS])
    table.insert(0, "time_s", stamps)
    then = [np.interp(rows - age + chain.wire, time, column) for column in offset.T]
    truth = {"time": stamps, "counts": readings, "offset": np.column_stack(then)}
    return table, truth | {"scale": scale, "nominal": nominal, "age": age}


def read_joints(motion: Motion, chain: Chain, rng: np.random.Generator) -> pd.DataFrame:
    """Return the table of the encoders."""
    rows = np.arange(
        chain.start - 0.1, min(chain.start + chain.length, motion.time[-1]), 1 / chain.joint_rate
    )
    angle = np.column_stack([np.interp(rows, motion.time, column) for column in motion.joint.T])
    angle += chain.encoder_zero * rng.standard_normal(angle.shape[1])
    angle = np.rint(angle / chain.encoder_step) * chain.encoder_step
    table = pd.DataFrame(angle, columns=[f"joint_{name}_rad" for name in motion.joint_names])
    table.insert(0, "time_s", rows + 0.001 + 0.0004 * abs(rng.standard_normal(len(rows))))
    return table


def read_imu(motion: Motion, chain: Chain, rng: np.random.Generator) -> pd.DataFrame:
    """Return the table of the IMU, whose rows are means since the row before."""
    rows = np.arange(chain.start - 0.1, min(chain.start + chain.length, motion.time[-1]), 1 / chain.imu_rate)
    mounting = rotation(chain.mounting * rng.standard_normal(3))
    both = np.column_stack([motion.specific_force @ mounting, motion.angular_velocity @ mounting])
    both = interval_means(both, motion.time, rows, 1 / chain.imu_rate)
    both *= 1 + 0.004 * rng.standard_normal(6)
    both += np.repeat([chain.accelerometer_bias, chain.gyroscope_bias], 3) * rng.standard_normal(6)
    both += np.repeat([0.03, 0.0014], 3) * rng.standard_normal(both.shape)
    names = [f"{n}_{a}_{u}" for n, u in (("accelerometer", "m_s2"), ("gyroscope", "rad_s")) for a in "xyz"]
    table = pd.DataFrame(both, columns=names)
    table.insert(0, "time_s", rows + 0.0005)
    return table


def write_log(
    folder: Path, motion: Motion, model: str, chain: Chain, rng: np.random.Generator
) -> dict[str, Any]:
    """Write a log with its description, and return the truth."""
    feet, truth = read_chips(motion, chain, rng)
    tables = {"feet": feet, "joints": read_joints(motion, chain, rng), "imu": read_imu(motion, chain, rng)}
    for name, table in tables.items():
        kept = table[rng.uniform(size=len(table)) >= chain.lost]
        kept.to_csv(folder / f"{name}.csv", index=False, float_format="%.6f")
    parts, places = ROBOTS[motion.robot], cell_positions(motion.robot).round(5).tolist()
    described: dict[str, Any] = {
        "model": "robot.xml",
        "torso": parts.torso,
        "imu": parts.imu,
        "soles": [f"{side}_sole" for side in SIDES],
        "averaged": True,
    }
    if chain.age_known:
        described["readings_age_s"] = round(truth["age"], 3)
    layout = [{"name": s, "position_cell_sole_m": places[4 * i : 4 * i + 4]} for i, s in enumerate(SIDES)]
    description = {
        "format": "surefoot-log",
        "format_version": 1,
        "layout": layout,
        "mass_kg": round(motion.mass * (1 + 0.002 * rng.standard_normal()), 3),
        "nominal": {"scale_N_per_count": [truth["nominal"]] * 8},
        "motion": described,
    }
    (folder / "feet.json").write_text(json.dumps(description, indent=1))
    (folder / "feet.toml").write_text('[tables."joints.csv"]\n[tables."imu.csv"]\n')
    (folder / "robot.xml").write_text(model)
    return truth | {"positions": cell_positions(motion.robot), "weight": motion.mass * 9.81}


def foot_errors(scale: Floats, offset: Floats, truth: dict[str, Any], rows: Any) -> list[float]:
    """Return the root mean square error of each foot's centre of pressure by a map, in mm."""
    counts = truth["counts"][rows]
    force, true = scale * counts + offset, truth["scale"] * counts + truth["offset"][rows]
    errors = []
    for foot in (slice(0, 4), slice(4, 8)):
        total, load = force[:, foot].sum(axis=1, keepdims=True), true[:, foot].sum(axis=1, keepdims=True)
        loaded = (np.arange(len(rows)) > len(rows) // 2) & (load[:, 0] > 0.25 * truth["weight"])
        cop = force[:, foot] @ truth["positions"][foot] / total
        gap = cop - true[:, foot] @ truth["positions"][foot] / load
        errors.append(1e3 * float(np.sqrt(np.mean(np.sum(gap[loaded] ** 2, axis=1)))))
    return errors


def score(folder: Path, truth: dict[str, Any]) -> dict[str, Any]:
    """Run the command on a log, and compare its map and the starting one with the truth."""
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "surefoot", "calibrate", "walk", "feet.csv", "--out", out]
        run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        made = list(Path(out).rglob("*.moment.parquet"))
        last = next((line for line in reversed(run.stderr.splitlines()) if line.strip()), "")
        result: dict[str, Any] = {
            "status": run.returncode,
            "crash": "Traceback" in run.stderr,
            "message": last,
        }
        if not made or run.returncode:
            return result
        table = pd.read_parquet(made[0])
    scale, offset = (
        table[[f"{what}_{cell}_{unit}" for cell in CELLS]].to_numpy()
        for what, unit in (("scale", "N_per_count"), ("offset", "N"))
    )
    rows = abs(truth["time"][None, :] - table["time_s"].to_numpy()[:, None]).argmin(axis=1)
    learnt = foot_errors(scale, offset, truth, rows)
    start = foot_errors(scale[0], offset[0], truth, rows)
    return result | {"learnt": learnt, "start": start}


def draw_chain(rng: np.random.Generator, robot: str) -> Chain:
    """Draw the devices of a log."""
    chain = Chain(
        wire=rng.uniform(0.001, 0.03),
        lost=float(rng.choice([0.0, 0.005, 0.01, 0.02])),
        repeated_stamps=float(rng.choice([0.0, 0.0, 0.01])),
        age_known=bool(rng.uniform() < 0.6),
        joint_rate=float(rng.choice([100, 100, 200])),
        imu_rate=float(rng.choice([100, 200, 400])),
        scale_std=rng.uniform(0.04, 0.12),
        start=rng.uniform(0.3, 13.0),
    )
    slow = robot in ("t1", "op3") and rng.uniform() < 0.2
    return replace(chain, conversions=10.0, feet_rate=10.0) if slow else chain


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, required=True, help="folder of the logs")
    parser.add_argument("--logs", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    robots = [name for name in ROBOTS if name != "g1" or "SUREFOOT_STRANGERS" in os.environ]
    models = {robot: robot_model(robot) for robot in robots}
    results = []
    for number in range(given.logs):
        rng = np.random.default_rng([given.seed, number])
        robot = robots[number % len(robots)]
        folder = given.out / f"{number:02d}_{robot}"
        folder.mkdir(parents=True, exist_ok=True)
        motion = record(robot, 1000 * given.seed + number, 32.0 if robot == "g1" else 44.0)
        truth = write_log(folder, motion, models[robot], draw_chain(rng, robot), rng)
        result = score(folder, truth)
        if "learnt" in result:
            pairs = list(zip(result["learnt"], result["start"], strict=True))
            result["worse"] = [learnt > 1.1 * start + 0.1 for learnt, start in pairs]
            feet = ", ".join(f"{a:.1f} mm (start {b:.1f})" for a, b in pairs)
            print(f"{folder.name}: {feet}{'  WORSE' if any(result['worse']) else ''}")
        else:
            print(f"{folder.name}: {'CRASH' if result['crash'] else 'REFUSED'}: {result['message'][:200]}")
        results.append({"log": folder.name} | result)
    (given.out / "results.json").write_text(json.dumps(results, indent=1))
    answered = [result for result in results if "learnt" in result]
    crashes, worse = sum(one["crash"] for one in results), sum(any(one["worse"]) for one in answered)
    refused = len(results) - len(answered) - crashes
    print(f"{len(results)} sound logs: {crashes} crashes, {refused} refused, {worse} with a foot 10 % worse")
    return int(len(answered) < len(results) or worse > 0)


if __name__ == "__main__":
    sys.exit(main())
