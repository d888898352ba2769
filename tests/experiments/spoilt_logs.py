"""Mistakes put into sound logs, by the kind that a verdict is to name."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from surefoot.calibration import GRAVITY
from surefoot.calibration.layout import FeetLayout, FootLayout
from surefoot.experiments.logs.format import Log

Spoiler = Callable[[Log, np.random.Generator], Log]
UP = np.array([0.0, 0.0, GRAVITY])


def believe(log: Log, **changes: Any) -> Log:
    return dataclasses.replace(log, reference=log.reference._replace(**changes))


def read(log: Log, raw: np.ndarray) -> Log:
    return dataclasses.replace(log, raw=raw)


def zero(log: Log) -> np.ndarray:
    """Return the counts of no load."""
    return -log.nominal.offset / log.nominal.scale


def exchange_feet(log: Log, _: np.random.Generator) -> Log:
    return read(log, np.roll(log.raw, log.layout.feet[0].channels, axis=1))


def exchange_cells(log: Log, rng: np.random.Generator) -> Log:
    i, j = rng.choice(log.layout.channels, 2, replace=False)
    order = np.arange(log.layout.channels)
    order[[i, j]] = j, i
    return read(log, log.raw[:, order])


def turn_sign(log: Log, rng: np.random.Generator) -> Log:
    raw, i = log.raw.copy(), int(rng.integers(log.layout.channels))
    raw[:, i] = 2.0 * zero(log)[i] - raw[:, i]
    return read(log, raw)


def halve_gain(log: Log, _: np.random.Generator) -> Log:
    return read(log, zero(log) + 0.5 * (log.raw - zero(log)))


def place(log: Log, factor: Any) -> Log:
    feet = [
        FootLayout.load_cells(foot.name, factor * foot.position_cell_sole[:, :2], foot.channel_names)
        for foot in log.layout.feet
        if foot.position_cell_sole is not None
    ]
    return dataclasses.replace(log, layout=FeetLayout(tuple(feet)))


def delay(log: Log, seconds: float) -> Log:
    k = round(seconds / log.dt)
    rows = np.clip(np.arange(len(log)) - k, 0, len(log) - 1)
    return read(log, log.raw[rows])


def exchange_roles(log: Log, _: np.random.Generator) -> Log:
    return believe(log, stance=log.reference.swing, swing=log.reference.stance)


def exchange_contacts(log: Log, _: np.random.Generator) -> Log:
    stance, swing = log.reference.stance, log.reference.swing
    return believe(log, stance=stance[:, ::-1], swing=swing[:, ::-1])


def accelerate(log: Log, change: Callable[[Any], Any]) -> Log:
    return believe(log, com_acceleration=change(log.reference.com_acceleration))


def mirror(log: Log, _: np.random.Generator) -> Log:
    S, r = np.diag([1.0, -1.0, 1.0]), log.reference
    return believe(
        log,
        com=r.com @ S,
        com_acceleration=r.com_acceleration @ S,
        position_sole=r.position_sole @ S,
        R_level_sole=S @ r.R_level_sole @ S,
        angular_momentum_rate=r.angular_momentum_rate * (-1.0, 1.0, -1.0),
    )


def turn(log: Log, R: np.ndarray) -> Log:
    r, middle = log.reference, np.zeros_like(log.reference.com)
    middle[:, :2] = r.position_sole[:, :, :2].mean(axis=1)
    return believe(log, com=middle + (r.com - middle) @ R.T, com_acceleration=r.com_acceleration @ R.T)


EXCHANGED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

SPOILERS: dict[str, tuple[str, Spoiler]] = {
    "feet": ("feet exchanged", exchange_feet),
    "cells": ("cells exchanged", exchange_cells),
    "other cells": ("cells exchanged", exchange_cells),
    "sign": ("sign of channels", turn_sign),
    "gain 64": ("gain", halve_gain),
    "pounds": ("mass", lambda log, _: dataclasses.replace(log, mass=log.mass / 0.45359237)),
    "millimetres": ("layout in other units", lambda log, _: place(log, 1000.0)),
    "centimetres": ("layout in other units", lambda log, _: place(log, 100.0)),
    "x back": ("layout mirrored", lambda log, _: place(log, np.array([-1.0, 1.0]))),
    "late": ("feet late or early", lambda log, _: delay(log, 0.25)),
    "early": ("feet late or early", lambda log, _: delay(log, -0.4)),
    "a little late": ("feet late or early", lambda log, _: delay(log, 0.125)),
    "roles": ("stance and swing exchanged", exchange_roles),
    "contacts": ("contacts exchanged", exchange_contacts),
    "mirror": ("references mirrored", mirror),
    "negated": ("acceleration negated", lambda log, _: accelerate(log, lambda a: -a)),
    "gravity": ("acceleration with gravity", lambda log, _: accelerate(log, lambda a: a + UP)),
    "twice": ("acceleration with gravity", lambda log, _: accelerate(log, lambda a: a - UP)),
    "in g": ("acceleration in g", lambda log, _: accelerate(log, lambda a: a / GRAVITY)),
    "IMU about z": ("IMU turned", lambda log, _: accelerate(log, lambda a: a * (-1.0, -1.0, 1.0))),
    "IMU about x": ("IMU turned", lambda log, _: accelerate(log, lambda a: (a + UP) * (1, -1, -1) - UP)),
    "accelerometer": ("accelerometer negated", lambda log, _: accelerate(log, lambda a: -a - 2 * UP)),
    "x and y": ("axes exchanged", lambda log, _: turn(log, EXCHANGED)),
    "half turn": ("references turned", lambda log, _: turn(log, np.diag([-1.0, -1.0, 1.0]))),
    "another origin": ("centre of mass off", lambda log, _: believe(log, com=log.reference.com + 0.05)),
}
"""Each with the kind that its verdict is to name."""
