"""Print a digest of the numbers of environments, sensors, calibrators and wrappers, one line each.

Two versions of surefoot that compute the same print the same on the same machine:

    python benchmarks/digests.py > before.txt        # in a checkout of the old version
    python benchmarks/digests.py > after.txt         # in a checkout of the new one
    diff before.txt after.txt
"""

import warnings
from collections.abc import Iterator
from dataclasses import is_dataclass
from hashlib import sha256
from itertools import product
from typing import Any

import gymnasium as gym
import numpy as np

import surefoot
from surefoot.calibration import InSituSet, calibrate_accelerometer, calibrate_in_situ, fit_channels
from surefoot.calibration.in_situ import estimate_offset
from surefoot.sensors import (
    PRESETS,
    Encoders,
    ForceTorque,
    Imu,
    Link,
    LoadCells,
    StrainGauges,
    encoders,
    force_torque,
    imu,
    load_cells,
    scaled,
    strain_gauges,
)
from surefoot.sensors.transport.link import latency

METHODS = ("moment", "window", "quasi-static", "tare", "none")
"""By their names of version 0.1, which later versions take as well."""

TASKS = {
    "surefoot/NaoWalk-v0": {"speed": 0.04},
    "surefoot/NaoStand-v0": {},
    "surefoot/NaoBalance-v0": {},
    "surefoot/NaoCarry-v0": {},
    "surefoot/Exercise-v0": {"robot": "nao"},
}
STEPS = 600


class Digest:
    """The numbers of any nest of arrays, mappings and sequences, in one hash."""

    def __init__(self) -> None:
        self.hash = sha256()

    def add(self, value: Any) -> None:
        """Take a value in."""
        if isinstance(value, dict):
            self.add(list(value.values()))
        elif is_dataclass(value):
            self.add(list(vars(value).values()))
        elif isinstance(value, (list, tuple)):
            for item in value:
                self.add(item)
        elif isinstance(value, (bool, int, float, np.generic, np.ndarray)):
            self.hash.update(np.ascontiguousarray(value).tobytes())

    def __str__(self) -> str:
        return self.hash.hexdigest()[:16]


def environments() -> Iterator[tuple[str, Digest]]:
    """Run every environment bare, under random actions."""
    for name, options in TASKS.items():
        env, digest = gym.make(name, **options), Digest()
        observation, info = env.reset(seed=7)
        actions = np.random.default_rng(7)
        low, high = env.action_space.low, env.action_space.high
        for _ in range(STEPS):
            digest.add(observation)
            action = (0.1 * actions.uniform(low, high)).astype(env.action_space.dtype)
            observation, reward, terminated, truncated, info = env.step(action)
            digest.add((reward, terminated))
            digest.add(info["surefoot"]["truth"])
            if terminated or truncated:
                break
        yield f"environment {name}", digest
        env.close()


def sensors() -> Iterator[tuple[str, Digest]]:
    """Read a made-up load through every preset, at two severities."""
    makers: dict[type, tuple[int, Any]] = {
        LoadCells: (8, load_cells),
        ForceTorque: (12, force_torque),
        StrainGauges: (6, strain_gauges),
        Imu: (6, imu),
        Encoders: (5, encoders),
        Link: (5, lambda config: latency(config.delay, config.jitter)),
    }
    named = [(kind, name, config) for kind, presets in PRESETS.items() for name, config in presets.items()]
    for (kind, name, config), severity in product(named, (1.0, 2.0)):
        channels, make = makers[kind]
        chain = make(scaled(config, severity))
        time = np.arange(STEPS)[:, None] / 80
        loads = 10.0 + 8.0 * np.sin(time * (1.0 + np.arange(channels)))
        rng, digest = np.random.default_rng(3), Digest()
        state = chain.init((channels,), rng)
        for row in loads:
            row = np.tile(row, (10, 1)) if kind is LoadCells else row  # ten substeps of a block
            reading, state = chain.apply(row, state, rng, 1 / 80)
            digest.add(reading)
        yield f"sensor {name} x{severity:g} numpy", digest


def walks() -> Iterator[tuple[str, Digest]]:
    """Walk, exercise and stand behind both wrappers, by every method and on several sensors."""
    devices: tuple[dict[str, Any], ...] = (
        {"config": "hx711-load-cells"},
        {"config": "icub-ftsens"},
        {"config": "nao-fsr", "severity": 2.0, "faults": ["at t=3 s cell left/2 dies"]},
    )
    for name, device, method in product(TASKS, devices, METHODS):
        env, digest = gym.make(name, **TASKS[name]), Digest()
        try:
            env = surefoot.wrappers.FootSensors(env, **device)
            env = surefoot.wrappers.SelfCalibration(env, method)
        except (TypeError, ValueError) as error:
            env.close()
            digest.add(str(type(error)))
            yield f"wrapped {name} {device['config']} {method} ({type(error).__name__})", digest
            continue
        observation, _ = env.reset(seed=11)
        for _ in range(STEPS):
            digest.add(observation)
            observation, _, terminated, truncated, _ = env.step(np.zeros(env.action_space.shape, np.float32))
            if terminated or truncated:
                break
        yield f"wrapped {name} {device['config']} {method}", digest
        env.close()


def in_situ() -> Iterator[tuple[str, Digest]]:
    """Fit a made-up sensor in place."""
    rng = np.random.default_rng(2)
    matrix, offset = np.eye(6) + 0.05 * rng.normal(size=(6, 6)), rng.normal(size=6)
    sets = []
    for mass, place in (
        (0.0, (0, 0, 0)),
        (0.7, (0.2, 0.1, 0.0)),
        (1.2, (-0.1, 0.2, 0.1)),
        (1.2, (0.1, -0.2, 0.0)),
    ):
        gravity = rng.normal(size=(200, 3))
        gravity *= 9.81 / np.linalg.norm(gravity, axis=1, keepdims=True)
        total = 4.0 + mass
        com = (4.0 * np.array((0.0, 0.02, -0.2)) + mass * np.array(place)) / total
        wrench = np.hstack([total * gravity, np.cross(com, total * gravity)])
        raw = np.linalg.solve(matrix, wrench.T).T + offset + 1e-3 * rng.normal(size=(200, 6))
        sets.append(InSituSet(raw, gravity, added_mass=mass, added_com=place))
    fit, digest = calibrate_in_situ(sets), Digest()
    digest.add((fit.matrix, fit.offset, fit.covariance))
    yield "in situ fit", digest
    digest = Digest()
    digest.add(estimate_offset(sets[0].raw, sets[0].gravity).offset)
    yield "in situ offset", digest
    digest = Digest()
    fit = calibrate_accelerometer(1.01 * sets[0].gravity + 0.05 + 1e-3 * rng.normal(size=(200, 3)))
    digest.add((fit.bias, fit.covariance))
    yield "accelerometer", digest
    counts = np.linspace(1e5, 9e5, 12)[:, None] * np.ones(4)
    channels = fit_channels(counts + rng.normal(size=counts.shape), np.linspace(0.0, 5.0, 12))
    digest = Digest()
    digest.add((channels.value.scale, channels.value.offset))
    yield "channels", digest


def main() -> None:
    """Print all digests."""
    warnings.simplefilter("ignore")
    for part in (environments, sensors, walks, in_situ):
        for name, digest in part():
            print(f"{digest}  {name}", flush=True)


if __name__ == "__main__":
    main()
