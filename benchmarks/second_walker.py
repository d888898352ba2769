"""The foot calibrators on a walker that they were not made on.

    python benchmarks/second_walker.py --seeds 4 --out FOLDER

A judge, on which no option of a method is to be tuned. The biped, its gait and its controller are those of
``biped.py``; its beliefs are made here, in another way than the package's wrappers make them:

* the upright comes from the accelerometer (Mahony, Hamel and Pflimlin, 2008), not from the soles, so that an
  accelerometer's bias tilts the level frame and the soles do not lie flat in it;
* rates are slopes of parabolas over 70 ms (Savitzky and Golay, 1964), which makes their noise coloured;
* contacts are the plan's, less a margin.

The sizes of all errors are the usual ones: the IMU and the encoders of a NAO, a centre of mass off by 3 mm, a
mass off by 0.5 %, telemetry 20 +- 4 ms late. Commands change at 100 Hz and the feet are read at 80 Hz, at
instants: the servos' stairs show up as a ripple at 20 Hz that no reference has (15 mm along y).

Logs that are not in the folder are recorded first.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import biped
import mujoco
import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d
from scipy.signal import lfilter, savgol_filter

from surefoot.calibration import GRAVITY, FeetLayout, FootLayout, Parameters, Reference
from surefoot.experiments.logs.format import Log, LogTruth, read_log, write_log
from surefoot.experiments.walks.play import Stream, play
from surefoot.experiments.walks.run_score import score_run
from surefoot.robot.beliefs.errors import USUAL
from surefoot.robot.beliefs.nominal import NominalModel
from surefoot.sensors import Encoders, Imu, Link, LoadCells, encoders, imu, scaled
from surefoot.sensors.devices.load_cells import load_cells, true_map
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE

Floats = NDArray[np.float64]

SPEEDS = (0.02, 0.04, 0.1)
METHODS = ("none", "tare", "window", "moment")


class Start(NamedTuple):
    """The cells that the robot walks on.

    Attributes:
        cells: The cells; methods start from their nominal map.
        stairs: Whether the servos' commands are stairs.
    """

    cells: LoadCells
    stairs: bool = True


BAD = LoadCells(rate=None)
CALIBRATED = replace(BAD, initial_scale_std=USUAL.scale, initial_offset_std=USUAL.offset)
BENCH = replace(
    BAD,
    initial_scale_std=0.0,
    initial_offset_std=0.0,
    scale_drift=0.1 * BAD.scale_drift,
    offset_drift=0.1 * BAD.offset_drift,
)
STARTS = {
    "bad": Start(BAD),
    "bench": Start(BENCH),
    "weights": Start(
        replace(CALIBRATED, scale_drift=0.005 * PER_SQRT_MINUTE, offset_drift=0.2 * PER_SQRT_MINUTE)
    ),
    "triple": Start(scaled(BAD, 3.0)),
    "smooth": Start(BAD, stairs=False),
    "smooth-bench": Start(BENCH, stairs=False),
    "smooth-triple": Start(scaled(BAD, 3.0), stairs=False),
    "chips": Start(HX711_LOAD_CELLS, stairs=False),
}
"""By name: never calibrated; a perfect map with a tenth of the drift; calibrated from weights, with the CoP
paper's drift; three times as bad as the first; three of these on servos without stairs; and the first on such
servos and the chips' own clocks (on stairs an older reading is of another step, whatever a method does)."""

STAND, DURATION, SETTLE = 4.0, 34.0, 14.0
"""How long the robot stands first, how long a walk is with that, and from when on errors count, in s."""

BLOCK = 10
"""Moments of the simulation from sample to sample: 80 Hz."""

DT, PERIOD = BLOCK * biped.SUBSTEP, biped.COMMAND * biped.SUBSTEP
"""Time between samples of the feet, and between packets of telemetry, in s."""

HALF = 3
"""Packets on either side from which a rate is taken."""

LAG = ceil((Link().delay + 2.0 * Link().jitter + (HALF + 2) * PERIOD) / DT)
"""Samples after which the packets that a reference needs have almost always come."""

CLOCK = 200
"""Packets over which the lateness is averaged."""

SKEW = 1e-4
"""By how much the robot's clock may be faster or slower than the host's."""

MARGIN = 0.06
"""Time in s by which a planned stance or swing must hold before and after one to be sure of it."""

UPRIGHT, GYROSCOPE, REST = 0.5, 0.02, 10.0
"""Gains of the tilt in 1/s and of the gyroscope's bias in 1/s^2; and the time in s over which the vertical
specific force is g."""

COLUMNS = {
    "cop": ("CoP, mm", 1e3),
    "end": ("CoP of the last 10 s, mm", 1e3),
    "vgrf": ("vGRF, N", 1.0),
    "nees": ("NEES a parameter", 1.0),
    "nees_end": ("NEES at the end", 1.0),
    "nis": ("NIS a row", 1.0),
}
"""What is printed of a score, as means over the seeds: its heading and its unit."""

_STREAM = 0x2B1BED


class Telemetry(NamedTuple):
    """M packets and when they came.

    Attributes:
        arrival: In s of the host's clock, shape (M,).
        joint: Encoder readings in rad, shape (M, 12).
        felt: Specific force in m/s^2 and angular velocity in rad/s, means since the packet before, (M, 6).
    """

    arrival: Floats
    joint: Floats
    felt: Floats


def send_telemetry(run: biped.Run, skew: float, rng: np.random.Generator) -> Telemetry:
    """Measure joints and IMU at every command, and send them over a late link.

    Packet m leaves at the time m * :data:`PERIOD` of the robot, whose clock is slow by ``skew``.
    """
    every, link = biped.COMMAND, Link()
    joint = run.joint[::every]
    mean = run.inertial[: len(joint) * every].reshape(-1, every, 6).mean(axis=1)
    mean = np.vstack([mean[:1], mean[:-1]])
    coder, chip = encoders(Encoders()), imu(Imu())
    coded, chipped = coder.init((12,), rng), chip.init((6,), rng)
    read, felt = np.empty_like(joint), np.empty_like(mean)
    for m in range(len(joint)):
        read[m], coded = coder.apply(joint[m], coded, rng, PERIOD)
        felt[m], chipped = chip.apply(mean[m], chipped, rng, PERIOD)
    late = np.maximum(link.delay + link.jitter * rng.standard_normal(len(joint)), 0.0)
    return Telemetry(np.maximum.accumulate(PERIOD * (1.0 + skew) * np.arange(len(joint)) + late), read, felt)


def believe(telemetry: Telemetry, model: NominalModel, time: Floats) -> Reference:
    """Beliefs of the robot at times of the host, of the samples :data:`LAG` before, once it can.

    Stance and swing are left empty.
    """
    rows = _rows(telemetry, model)
    number = np.arange(len(rows))
    late = telemetry.arrival - Link().delay - PERIOD * number
    past = np.cumsum(np.concatenate([[0.0], late]))
    first = np.maximum(number + 1 - CLOCK, 0)
    clock = (past[number + 1] - past[first]) / (number + 1 - first)
    newest = np.searchsorted(telemetry.arrival, time, side="right") - 1
    at = (time - LAG * DT - clock[newest]) / PERIOD
    at = np.clip(at, 2.0, np.maximum(newest - HALF - 1, 2.0))
    low = np.minimum(at.astype(int), len(rows) - 2)
    part = (at - low)[:, None, None]
    rows = (1.0 - part) * rows[low] + part * rows[low + 1]
    com, acceleration, spin, left, right = rows[:, :5].swapaxes(0, 1)
    R = rows[:, 5:11].reshape(-1, 2, 3, 3).swapaxes(2, 3)
    ahead = R[:, :, :2, 0].sum(axis=1)
    x, y = (ahead / np.linalg.norm(ahead, axis=1, keepdims=True)).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    level = np.moveaxis(np.array([[x, y, zero], [-y, x, zero], [zero, zero, one]]), -1, 0)
    origin = 0.5 * (left + right)
    origin[:, 2] = np.minimum(left[:, 2], right[:, 2])
    return Reference(
        com=_turn(level, com - origin),
        com_acceleration=_turn(level, acceleration),
        angular_momentum_rate=_turn(level, spin),
        position_sole=np.stack([_turn(level, left - origin), _turn(level, right - origin)], axis=1),
        R_level_sole=level[:, None] @ R,
        stance=np.zeros((len(time), 2), dtype=bool),
        swing=np.zeros((len(time), 2), dtype=bool),
        accelerometer=rows[:, 11],
        gyroscope=rows[:, 12],
    )


def _turn(R: Floats, vector: Floats) -> Floats:
    return np.einsum("nij,nj->ni", R, vector)


def _rows(telemetry: Telemetry, model: NominalModel) -> Floats:
    """Return for every packet in upright axes that turn with the gyroscope, shape (M, 13, 3).

    Rows are the centre of mass from the torso's origin, its acceleration, the rate of the angular momentum,
    both soles, the axes of both, and specific force and angular velocity in the IMU's own axes.
    """
    count = len(telemetry.joint)
    middle = 0.5 * (telemetry.felt + np.roll(telemetry.felt, -1, axis=0))
    velocity = np.gradient(telemetry.joint, PERIOD, axis=0)
    # Centre of mass, IMU, soles, their axes, angular momentum, specific force.
    local = np.empty((count, 12, 3))
    upright, turned = np.array([[1.0, 0.0, 0.0, 0.0]] * 2)  # with the accelerometer; by the gyroscope
    bias, flat = np.zeros(3), np.empty(9)
    R, R_gyroscope = np.empty((2, count, 3, 3))
    for m in range(count):
        force, spin = telemetry.felt[m, :3], telemetry.felt[m, 3:]
        mujoco.mju_quat2Mat(flat, upright)
        error = np.cross(flat[6:], force / np.linalg.norm(force))
        bias += GYROSCOPE * PERIOD * error
        mujoco.mju_quatIntegrate(upright, spin - bias - UPRIGHT * error, PERIOD)
        mujoco.mju_quatIntegrate(turned, spin, PERIOD)
        for rotation, quaternion in ((R, upright), (R_gyroscope, turned)):
            mujoco.mju_quat2Mat(flat, quaternion)
            rotation[m] = flat.reshape(3, 3)
        com, momentum, sites, axes = model.evaluate(telemetry.joint[m], velocity[m], middle[m, 3:])
        local[m] = np.vstack([com, sites, axes, momentum, middle[m, :3]])
    level = local @ R.swapaxes(1, 2)
    # What the accelerometer does to the tilt is no motion: rates are those of axes that it does not turn.
    moved = local @ R_gyroscope.swapaxes(1, 2)
    back = R @ R_gyroscope.swapaxes(1, 2)
    slope = {"window_length": 2 * HALF + 1, "polyorder": 2, "delta": PERIOD, "axis": 0}
    acceleration = level[:, 11] + _turn(back, savgol_filter(moved[:, 0] - moved[:, 1], deriv=2, **slope))
    share = PERIOD / REST
    acceleration[:, 2] -= lfilter([share], [1.0, share - 1.0], level[:, 11, 2] - GRAVITY) + GRAVITY
    momentum = _turn(back, savgol_filter(moved[:, 10], deriv=1, **slope))
    own = middle.reshape(count, 2, 3)
    whole = np.stack([level[:, 0], acceleration, momentum], axis=1)
    return np.concatenate([whole, level[:, 2:10], own], axis=1)


def record(
    speed: float, seed: int, duration: float, starts: Sequence[str], *, stairs: bool = True
) -> dict[str, Log]:
    """Walk once, and log the readings of each start's cells.

    Args:
        speed: In m/s.
        seed: Of everything random.
        duration: Standing included, in s.
        starts: Keys of :data:`STARTS`.
        stairs: As all of these have it.
    """
    rng, mind = (np.random.default_rng([_STREAM, seed, role]) for role in range(2))
    run = biped.walk(speed, duration, STAND, rng, stairs=stairs)
    model = NominalModel(mujoco.MjSpec.from_string(biped.robot_xml()), USUAL)
    model.draw(mind)
    # The host's samples begin at any phase of the robot's commands, and its clock is not the robot's.
    skew = SKEW * mind.uniform(-1.0, 1.0)
    end = len(run.force) * (1.0 + skew) - 1.0
    time = biped.SUBSTEP * np.arange(int(mind.integers(BLOCK)) + BLOCK, end, BLOCK)
    at = np.rint(time / (biped.SUBSTEP * (1.0 + skew))).astype(int)
    kept = slice(np.searchsorted(time, 0.5), None)
    reference = believe(send_telemetry(run, skew, mind), model, time)
    near = 2 * round(MARGIN / PERIOD) + 1
    then = np.clip((at - LAG * BLOCK) // biped.COMMAND, 0, len(run.down) - 1)
    stance, swing = (minimum_filter1d(held, near, axis=0)[then] for held in (run.down, ~run.down))
    reference = Reference(*(part[kept] for part in reference._replace(stance=stance, swing=swing)))
    poses = run.position_sole[at][kept], run.R_world_sole[at][kept]
    about = {"start": "nominal", "walker": "second", "speed_m_s": speed, "fell": run.fell}
    logs = {}
    for start in starts:
        cells = STARTS[start].cells
        raw, scale, offset = _read(cells, run.force, at, np.random.default_rng([_STREAM, seed, 2]))
        logs[start] = Log(
            time=time[kept],
            raw=raw[kept],
            reference=reference,
            layout=LAYOUT,
            mass=model.masses.mass.sum(),
            nominal=Parameters(cells.nominal_scale, cells.nominal_offset),
            calibrated=None,
            dt=DT,
            lag=LAG,
            seed=seed,
            truth=LogTruth(run.force[at][kept], *poses, scale[kept], offset[kept]),
            about={**about, "cells": start},
        )
    return logs


LAYOUT = FeetLayout(
    tuple(
        FootLayout.load_cells(name, cells, mass_below=biped.PLATE_MASS, com_below_sole=biped.PLATE_COM)
        for name, cells in zip(("left", "right"), biped.POSITION_CELL_SOLE, strict=True)
    )
)


def _read(
    cells: LoadCells, force: Floats, at: NDArray[np.int64], rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Return readings in counts and the true maps' scales and offsets at samples, shape (N, 8) each."""
    device = load_cells(cells)
    state = device.init((8,), rng)
    raw, scale, offset = (np.empty((len(at), 8)) for _ in range(3))
    if cells.rate is not None:  # every chip has delivered once before
        _, state = device.apply(force[:1], state, rng, 1.0 / cells.rate[0])
    for k, i in enumerate(at):
        raw[k], state = device.apply(force[i + 1 - BLOCK : i + 1], state, rng, DT)
        scale[k], offset[k] = true_map(cells, state)
    return raw, scale, offset


def log_path(folder: Path, start: str, speed: float, seed: int, duration: float = DURATION) -> Path:
    """Name the file of a log."""
    length = "" if duration == DURATION else f"_{duration:g}s"
    return folder / f"{start}_v{speed:g}{length}_seed{seed}.parquet"


def record_missing(folder: Path, speed: float, seed: int, duration: float, starts: Sequence[str]) -> None:
    """Record the logs of a walk that are not in a folder."""
    paths = {start: log_path(folder, start, speed, seed, duration) for start in starts}
    for stairs in (True, False):
        missing = [s for s, path in paths.items() if STARTS[s].stairs == stairs and not path.is_file()]
        for start, log in (record(speed, seed, duration, missing, stairs=stairs) if missing else {}).items():
            write_log(log, paths[start])


def stream(path: Path) -> Stream:
    """Read a log for :func:`~surefoot.experiments.walks.play.play`, and the judged samples."""
    log = read_log(path)
    return Stream(log, log.seed or 0, log.time >= SETTLE, STAND, fell=bool(log.about["fell"]))


def score(path: Path, method: str, **options: Any) -> dict[str, Any]:
    """Play a method on a log and score it, as the study of walks does."""
    one = stream(path)
    return score_run(one, play([one], method, **options)[0])


def main() -> None:
    """Record the missing walks, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the logs")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--speeds", type=float, nargs="+", default=SPEEDS)
    parser.add_argument("--starts", nargs="+", default=tuple(STARTS), choices=STARTS)
    parser.add_argument("--methods", nargs="+", default=METHODS)
    parser.add_argument("--duration", type=float, default=DURATION, help="of a walk in s, such as 1800")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    parallel = Parallel(given.jobs)
    seeds, duration = range(given.seeds), given.duration
    parallel(
        delayed(record_missing)(given.out, speed, seed, duration, given.starts)
        for speed, seed in product(given.speeds, seeds)
    )
    cases = list(product(given.starts, given.speeds, given.methods))
    rows = parallel(
        delayed(score)(log_path(given.out, start, speed, seed, duration), method)
        for (start, speed, method), seed in product(cases, seeds)
    )
    head = ["start", "m/s", "method", *(name for name, _ in COLUMNS.values()), "worse than start"]
    print("|", " | ".join(head), "|")
    print("|---" * len(head) + "|")
    for i, (start, speed, method) in enumerate(cases):
        of = rows[i * len(seeds) : (i + 1) * len(seeds)]
        means = (factor * np.mean([row[key] for row in of]) for key, (_, factor) in COLUMNS.items())
        told = " | ".join(f"{mean:.2f}" for mean in means)
        print(f"| {start} | {speed:g} | {method} | {told} | {sum(row['worse'] for row in of)} of {len(of)} |")


if __name__ == "__main__":
    main()
