"""In-situ logs of the simulated leg, and functions that spoil them; see ``_spoilt_in_situ.py``."""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from surefoot.arrays import Floats
from surefoot.calibration.in_situ import InSituOptions, InSituSet, KnownLimb
from surefoot.calibration.in_situ.data import change_motion, read_later
from surefoot.envs.leg_rig.recording import record_rig
from surefoot.sensors import Imu

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from rig import (
    SensorTruth,
    moving_sets,
    read_imu,
    read_sensor,
    sensor_config,
    static_sets,
)

SEED = 2
SOUND_SEEDS = range(50, 55)
RATE, DURATION, SPEED_DEG = 10.0, 60.0, 12.0
FITTED = 4
OFF, SIGMAS = 0.03, 3.0
"""An answer is wrong that is off by more than this share of the load and by more than so many deviations."""

IMU = Imu(accelerometer_bias_std=0.005, averaged=True)
"""That of a small robot after its zeros were taken, as in the sample log."""

POUND = 0.45359237


@dataclass(frozen=True)
class Log:
    """Input of a calibration, and the truth beside it."""

    sets: tuple[InSituSet, ...]
    factory: Floats | None
    truth: SensorTruth
    loads: Floats
    options: InSituOptions
    limb: KnownLimb | None = None


@cache
def record(seed: int, gyroscope: bool, sensor: str = "leg", **rig: Any) -> Log:
    """Return a sound log of a rig, with the factory matrix."""
    how: dict[str, Any] = {"duration": DURATION, "rate": RATE, "speed_deg": SPEED_DEG, "seed": seed} | rig
    recordings = record_rig(range(1, FITTED + 1), **how)
    unseen = record_rig(range(FITTED + 1, 9), duration=DURATION, rate=1.0, speed_deg=SPEED_DEG, seed=seed)
    config = sensor_config(sensor)
    counts, truth = read_sensor(config, sensor, recordings, seed)
    felt = read_imu(recordings, seed, IMU)
    if gyroscope:
        sets = moving_sets(sensor, recordings, counts, felt, np.zeros(3), window=7)
    else:
        sets = static_sets(sensor, recordings, counts, felt[..., :3])
    loads = np.concatenate([getattr(one, f"wrench_{sensor}") for one in unseen])
    return Log(sets, config.nominal_matrix, truth, loads, InSituOptions(code_range=config.code_range))


Change = Callable[[Log], Log]


class Spoilt(NamedTuple):
    """A thing that goes wrong, in some sizes."""

    cause: str  # words by which a message names it
    sizes: dict[str, Change | dict[str, Any]]
    """Changes of a log by the size in words; or options of the rig, where the recording is spoilt."""
    factory: tuple[bool, ...] = (False, True)  # whether it is tried without the factory matrix and with it
    gyroscope: tuple[bool, ...] = (False, True)
    unknowable: bool = False  # whether nothing in a log without a factory matrix can show it


def each(change: Callable[[InSituSet], InSituSet], chosen: tuple[int, ...] = (0, 1, 2, 3)) -> Change:
    """Change some sets of a log."""
    return lambda log: replace(
        log, sets=tuple(change(one) if j in chosen else one for j, one in enumerate(log.sets))
    )


def vectors(change: Callable[[Floats], Floats]) -> Change:
    """Change the accelerometer's readings."""
    return each(lambda one: replace(one, gravity=change(one.gravity)))


def factory(change: Callable[[Floats], Floats]) -> Change:
    """Change the factory matrix."""
    return lambda log: replace(log, factory=None if log.factory is None else change(log.factory))


def read(wrench: list[float], chosen: int, begin: float, end: float) -> Change:
    """Let a set read a wrench more between two shares of its time."""

    def change(log: Log) -> Log:
        one = log.sets[chosen]
        raw, rows = one.raw.copy(), len(one.raw)
        raw[round(begin * rows) : round(end * rows)] += log.truth.response @ wrench
        return each(lambda data: replace(data, raw=raw), (chosen,))(log)

    return change


def clip(share: float, chosen: int, channel: int) -> Change:
    """Let a channel of a set end below the converter's rail."""

    def change(raw: Floats, _: InSituSet, __: Log, j: int) -> Floats:
        top = np.quantile(raw[:, channel], 1.0 - share)
        return column(raw, channel, np.minimum(raw[:, channel], top)) if j == chosen else raw

    return readings(change)


def turn(angles: list[float]) -> Change:
    """Let the IMU be built in turned, by degrees about x, y and z."""
    R = Rotation.from_euler("xyz", angles, degrees=True).as_matrix().T
    return each(lambda one: change_motion(one, lambda values: values @ R))


def scale_masses(mass: float, place: float = 1.0, chosen: tuple[int, ...] = (0, 1, 2, 3)) -> Change:
    """Scale the added masses, and their places."""
    return each(
        lambda one: replace(one, added_mass=mass * one.added_mass, added_com=place * one.added_com), chosen
    )


def move(step: list[float], chosen: int) -> Change:
    return each(lambda one: replace(one, added_com=one.added_com + step), (chosen,))


def swap(i: int, j: int) -> Change:
    """Exchange the added masses of two sets."""

    def change(log: Log) -> Log:
        sets = list(log.sets)
        for to, of in ((i, j), (j, i)):
            it = log.sets[of]
            sets[to] = replace(sets[to], added_mass=it.added_mass, added_com=it.added_com)
        return replace(log, sets=tuple(sets))

    return change


def entry(row: int, column: int, factor: float) -> Change:
    def change(matrix: Floats) -> Floats:
        spoilt = matrix.copy()
        spoilt[row, column] *= factor
        return spoilt

    return factory(change)


def readings(change: Callable[[Floats, InSituSet, Log, int], Floats], first: int = 0) -> Change:
    """Change the readings of all sets from one on, by (raw, set, log, index)."""
    return lambda log: replace(
        log,
        sets=tuple(
            replace(one, raw=change(one.raw, one, log, j)) if j >= first else one
            for j, one in enumerate(log.sets)
        ),
    )


def weigh(mass: float, place: list[float], first: int, last: int = FITTED) -> Change:
    """Let a mass in kg more hang at a place in some sets, which nobody noted."""

    def change(raw: Floats, one: InSituSet, log: Log, j: int) -> Floats:
        load = np.concatenate([mass * one.gravity, np.cross(place, mass * one.gravity)], axis=1)
        return raw + load @ log.truth.response.T * (first <= j < last)

    return readings(change)


def late_readings(delay: float) -> Change:
    def change(raw: Floats, one: InSituSet, _: Log, __: int) -> Floats:
        assert one.time is not None
        return np.stack([np.interp(np.abs(one.time - delay), one.time, column) for column in raw.T], axis=1)

    return readings(change)


def low_pass(values: Floats, seconds: float) -> Floats:
    share = 1.0 / (1.0 + RATE * seconds)
    return np.asarray(lfilter([share], [1.0, share - 1.0], values, axis=0, zi=(1.0 - share) * values[:1])[0])


def spikes(raw: Floats, rows: int, size: float) -> Floats:
    """Let one channel of so many samples leap."""
    rng, spoilt = np.random.default_rng(SEED), raw.copy()
    spoilt[rng.integers(0, len(raw), rows), rng.integers(0, raw.shape[1], rows)] += size
    return spoilt


def pull(size: float, friction: bool) -> Change:
    """Let a cable pull with the angle of the limb, or drag against its turning, by so many N."""
    along = np.array([[1.0, 0.0, 0.5, 0.0, 0.1, 0.0], [0.0, 0.7, -0.3, 0.1, 0.0, 0.0]])

    def change(raw: Floats, one: InSituSet, log: Log, _: int) -> Floats:
        angle = np.arcsin(np.clip(one.gravity[:, :2] / 9.81, -1.0, 1.0))
        if friction:
            angle = np.sign(np.gradient(low_pass(angle, 0.5), axis=0))
        return np.asarray(raw + size * angle @ along @ log.truth.response.T)

    return readings(change)


def column(raw: Floats, channel: int, values: Floats | float) -> Floats:
    spoilt = raw.copy()
    spoilt[:, channel] = values
    return spoilt


def hold(values: Floats, rows: int) -> Floats:
    return values[np.arange(len(values)) // rows * rows]


def cut(raw: Floats, one: InSituSet, log: Log, j: int) -> Floats:
    """Take the added mass off after two thirds of the last set."""
    load = np.concatenate([one.gravity, np.cross(one.added_com, one.gravity)], axis=1) * one.added_mass
    after = np.arange(len(raw)) > len(raw) * 2 / 3
    return raw - (load @ log.truth.response.T) * (after & (j == FITTED - 1))[:, None]


def touch_floor(raw: Floats, one: InSituSet, log: Log, _: int) -> Floats:
    """Let the end of the limb, half a metre away, stand on a springy floor in its lowest fifth."""
    foot = 0.5 * log.truth.limb.com / np.linalg.norm(log.truth.limb.com)
    up = -one.gravity / np.linalg.norm(one.gravity, axis=1, keepdims=True)
    height = up @ foot
    force = 2000.0 * np.maximum(np.quantile(height, 0.2) - height, 0.0)[:, None] * up
    return raw + np.hstack([force, np.cross(foot, force)]) @ log.truth.response.T


def relabel(log: Log) -> Log:
    """Let the first 6 s of each set be the last of the one before."""
    rows, sets = round(6.0 * RATE), list(log.sets)
    for before, one in enumerate(log.sets[1:]):
        names = [name for name in ("raw", "gravity", *MOTION) if getattr(one, name) is not None]
        ends = {name: getattr(log.sets[before], name)[-rows:] for name in names}
        sets[before + 1] = replace(
            one,
            **{name: np.concatenate([ends[name], getattr(one, name)[:-rows]]) for name in names},  # type: ignore[arg-type]
        )
    return replace(log, sets=tuple(sets))


def rotate_wrench(angle: float) -> Floats:
    """Return the rotation of a wrench about z by degrees, shape (6, 6)."""
    return np.kron(np.eye(2), Rotation.from_euler("z", angle, degrees=True).as_matrix())


def spin(change: Callable[[Floats], Floats]) -> Change:
    """Change a gyroscope's readings."""
    return each(
        lambda one: replace(one, **{name: change(getattr(one, name)) for name in MOTION if one.moves})  # type: ignore[arg-type]
    )


def mix_channels(log: Log) -> Floats:
    """Return how another sensor of that kind would read, shape (6, 6)."""
    other = record(SEED + 1, False).truth.response
    return np.asarray(other @ np.linalg.inv(log.truth.response))


def noisy(size: float) -> Callable[[Log, int], Log]:
    """Add white noise, m/s^2 a sample, to the accelerometer's readings."""

    def change(log: Log, seed: int) -> Log:
        rng = np.random.default_rng([0x501D, seed])
        return vectors(lambda g: g + size * rng.standard_normal(g.shape))(log)

    return change


def late(delay: float) -> Callable[[Log, int], Log]:
    """Let the IMU's readings come late by a time in s."""
    change = each(lambda one: change_motion(one, lambda values: read_later(values, one, -delay)))
    return lambda log, _: change(log)


def rows(stride: int, times: bool) -> Callable[[Log, int], Log]:
    """Keep one row in so many; without times in any order."""

    def change(log: Log, seed: int) -> Log:
        rng = np.random.default_rng([0x501E, seed])

        def one_in(one: InSituSet) -> InSituSet:
            kept = np.arange(len(one.raw))[::stride]
            kept = kept if times else rng.permutation(kept)
            columns = {name: getattr(one, name) for name in ("raw", "gravity", *MOTION)}
            columns = {name: None if each is None else each[kept] for name, each in columns.items()}
            return replace(one, time=one.time[kept] if times and one.time is not None else None, **columns)

        return each(one_in)(log)

    return change


MOTION = ("angular_velocity", "angular_acceleration")
