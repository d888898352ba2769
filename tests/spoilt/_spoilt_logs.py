"""Spoilt walks and weighings: is each mistake named, and is no sound log refused?

    python tests/spoilt/_spoilt_logs.py                  # both, about ten minutes
    python tests/spoilt/_spoilt_logs.py weighings        # seconds
    python tests/spoilt/_spoilt_logs.py unknown          # walks whose mistake is not on the list
    python docs/study_tables.py out/results

A walk is judged as `surefoot calibrate walk` and `surefoot check` judge it, a table of weighings as `surefoot
calibrate weights` does. Robots are the NAO at two speeds, OP3 and G1 in their own calibration motions and,
where ``SUREFOOT_STRANGERS`` names one (see ``benchmarks/momentum.py``), a G1 that walks by a published
policy.
"""

import argparse
import dataclasses
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from rich.console import Console

from surefoot.arrays import stack_rows, take_rows
from surefoot.calibration import GRAVITY
from surefoot.calibration.diagnosis import Cause, Mistake
from surefoot.calibration.layout import FeetLayout, FootLayout
from surefoot.calibration.results import Finding
from surefoot.experiments.logs.format import Log
from surefoot.experiments.study.page import save_tables
from surefoot.experiments.study.tables import Table, share
from surefoot.experiments.walking.hypotheses import hypotheses
from surefoot.experiments.walking.judge import EXPERIENCE, Judgement, judge_log
from surefoot.experiments.walking.lateness import DELAY
from surefoot.experiments.walks.record import record_walk
from surefoot.experiments.walks.replay import starting_map
from surefoot.experiments.weights.judge import Weighings, judge_weighings
from surefoot.wrappers import FootSensors, SelfCalibration

OUT = Path("out/results/spoilt/tables")

Spoiler = Callable[[Log, np.random.Generator], Log]
UP = np.array([0.0, 0.0, GRAVITY])


def believe(log: Log, **changes: Any) -> Log:
    return dataclasses.replace(log, reference=log.reference._replace(**changes))


def read(log: Log, raw: np.ndarray) -> Log:
    return dataclasses.replace(log, raw=raw)


def zero(log: Log) -> np.ndarray:
    """Return the counts of no load."""
    return np.asarray(-log.nominal.offset / log.nominal.scale)


def exchange_cells(log: Log, rng: np.random.Generator) -> Log:
    i, j = rng.choice(log.layout.channels, 2, replace=False)
    order = np.arange(log.layout.channels)
    order[[i, j]] = j, i
    return read(log, log.raw[:, order])


def turn_sign(log: Log, rng: np.random.Generator) -> Log:
    raw, i = log.raw.copy(), int(rng.integers(log.layout.channels))
    raw[:, i] = 2.0 * zero(log)[i] - raw[:, i]
    return read(log, raw)


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
    "feet": (
        "feet exchanged",
        lambda log, _: read(log, np.roll(log.raw, log.layout.feet[0].channels, axis=1)),
    ),
    "cells": ("cells exchanged", exchange_cells),
    "other cells": ("cells exchanged", exchange_cells),
    "sign": ("sign of channels", turn_sign),
    "gain 64": ("gain", lambda log, _: read(log, 0.5 * (log.raw + zero(log)))),
    "pounds": ("mass", lambda log, _: dataclasses.replace(log, mass=log.mass / 0.45359237)),
    "millimetres": ("layout in other units", lambda log, _: place(log, 1000.0)),
    "centimetres": ("layout in other units", lambda log, _: place(log, 100.0)),
    "x back": ("layout mirrored", lambda log, _: place(log, np.array([-1.0, 1.0]))),
    "late": ("feet late or early", lambda log, _: delay(log, 0.25)),
    "early": ("feet late or early", lambda log, _: delay(log, -0.4)),
    "a little late": ("feet late or early", lambda log, _: delay(log, 0.125)),
    "roles": (
        "stance and swing exchanged",
        lambda log, _: believe(log, stance=log.reference.swing, swing=log.reference.stance),
    ),
    "contacts": (
        "contacts exchanged",
        lambda log, _: believe(log, stance=log.reference.stance[:, ::-1], swing=log.reference.swing[:, ::-1]),
    ),
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


# ------------------------------------------------------------------------------------------------- weighings

SHAPES = {
    "one cell": (1, (0.0, 0.5, 1.0, 2.0, 3.0, 5.0), 5),
    "four cells": (4, (0.0, 0.5, 1.0, 2.0, 3.0, 5.0), 5),
    "single readings": (1, (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 4.0), 1),
    "four loads": (2, (0.0, 1.0, 2.0, 4.0), 3),
}
"""Cells, weights in kg, and readings of each."""


def weigh(shape: str, seed: int) -> Weighings:
    """Weigh sound cells."""
    cells, loads, repeats = SHAPES[shape]
    rng, load = np.random.default_rng(seed), np.repeat(loads, repeats)
    slope, level = 1e5 * rng.uniform(0.8, 1.2, cells), 84000 + 3e4 * rng.standard_normal(cells)
    code = level + slope * rng.choice([-1, 1], cells) * load[:, None]
    code = np.rint(code + 30.0 * rng.standard_normal(code.shape))
    names = tuple(f"raw_c{i}_count" for i in range(cells))
    return Weighings(load * GRAVITY, code, names, "load_kg", GRAVITY)


def count(table: Weighings, rows: Any, values: Any) -> Weighings:
    code = table.code.copy()
    code[rows, 0] = values
    return dataclasses.replace(table, code=code)


def weigh_off(table: Weighings, rng: np.random.Generator) -> Weighings:
    row = int(rng.integers(len(table.code)))
    return count(table, row, table.code[row, 0] + 5000)


def exchange_labels(table: Weighings, rng: np.random.Generator) -> Weighings:
    a, b = rng.choice(np.unique(table.load), 2, replace=False)
    load = table.load
    return dataclasses.replace(table, load=np.where(load == a, b, np.where(load == b, a, load)))


def bend(table: Weighings, rng: np.random.Generator) -> Weighings:
    code = 84000 + 4e5 * (1.0 - np.exp(-table.load / 30.0)) + 30.0 * rng.standard_normal(len(table.load))
    return count(table, slice(None), np.rint(code))


def clip(table: Weighings, rng: np.random.Generator) -> Weighings:
    return count(table, int(rng.integers(len(table.code))), 8388607)


def weigh_in(factor: float) -> Callable[[Weighings, np.random.Generator], Weighings]:
    """Give loads in another unit."""
    return lambda table, _: dataclasses.replace(table, load=factor * table.load)


WEIGHING_SPOILERS: dict[str, tuple[set[str], bool, Callable[[Weighings, np.random.Generator], Weighings]]] = {
    "rail": ({"outliers"}, False, clip),
    "off": ({"outliers"}, False, weigh_off),
    "labels": ({"labels"}, True, exchange_labels),
    "dead": (
        {"dead cell"},
        True,
        lambda table, rng: count(table, slice(None), np.rint(rng.normal(84000, 30, len(table.code)))),
    ),
    "grams": ({"units"}, True, weigh_in(1000.0)),
    "curve": ({"curve", "scatter"}, False, bend),
    "newtons": ({"newtons"}, True, weigh_in(GRAVITY)),
}
"""Each with the kinds that its finding may have, and whether it refuses."""


# ----------------------------------------------------------------------------------------------------- walks


def exercise(robot: str, sensors: str | None, seed: int) -> Log:
    """Log a robot's own calibration motion."""
    env = gym.make("surefoot/Exercise-v0", robot=robot, duration=None)
    return log_of(FootSensors(env, sensors), seed)


def policy_walk(forward: float, seed: int) -> Log:
    """Log the G1 that walks by a published policy, at a speed in m/s."""
    sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
    from momentum import Scene, make  # needs SUREFOOT_STRANGERS

    base, act = make(Scene("g1", lambda time: (forward, 0.0, 0.0)))
    return log_of(FootSensors(base, feet=("left_ankle_roll_link", "right_ankle_roll_link")), seed, act)


def log_of(
    env: FootSensors, seed: int, act: Callable[[float], Any] | None = None, duration: float = 16.0
) -> Log:
    """Log a robot; without a function of the time its actions are zeros."""
    own = SelfCalibration(env, "none")
    own.reset(seed=seed)
    setup, raw, references = own.calibrator.setup, [], []
    still = np.zeros(env.action_space.shape or (), dtype=np.float32)
    for k in range(round(duration / setup.dt)):
        own.step(still if act is None else act(k * setup.dt))
        raw.append(env.raw.copy())
        references.append(own.reference)
    reference = take_rows(stack_rows(references), slice(16, None))
    time = setup.dt * np.arange(16, len(raw))
    known: Any = {"layout": setup.layout, "mass": setup.mass, "nominal": setup.initial, "dt": setup.dt}
    known |= {
        "lag": setup.lag,
        "seed": seed,
        "about": {"sample_age_s": float(np.mean(np.asarray(setup.age)))},
    }
    return Log(time.astype(np.float64), np.array(raw)[16:], reference, calibrated=None, **known)


def break_cell(log: Log, fault: str) -> Log:
    """Break a cell as filters cope with it: such a log is sound."""
    raw, rng, i, half = log.raw.copy(), np.random.default_rng(3), 5, len(log) // 2
    if fault == "dies":
        raw[half:, i] = raw[half, i]
    elif fault == "dead":
        raw[:, i] = raw[0, i]
    elif fault == "leaps":
        raw[half:, i] += 0.1 * log.mass * GRAVITY / log.nominal.scale[i]
    elif fault == "missing":
        raw[rng.random(raw.shape) < 0.1] = np.nan
    return read(log, raw)


def spoilt_walks() -> dict[str, Log]:
    """Record the walks that mistakes are put into."""
    walks = {
        f"NAO, {speed:g} m/s": record_walk(speed, 101 + i, 20.0)["bad-start"]
        for i, speed in enumerate((0.03, 0.06))
    }
    walks |= {f"{robot.upper()}, its own motion": exercise(robot, None, 107) for robot in ("op3", "g1")}
    if "SUREFOOT_STRANGERS" in os.environ:
        walks |= {f"G1 by a policy, {speed:g} m/s": policy_walk(speed, 109) for speed in (0.3, 0.6)}
    return walks


def sound_walks() -> list[Log]:
    """Record sound walks of four robots, some with a broken cell."""
    sound: list[Log] = []
    for seed, speed in enumerate((0.02, 0.03, 0.05, 0.06, 0.08)):
        sound += record_walk(speed, 100 + seed, 20.0).values()
    for robot in ("nao", "g1", "op3", "t1"):
        sound += [exercise(robot, kind, 100 + i) for i, kind in enumerate((None, "icub-force-torque") * 2)]
    if "SUREFOOT_STRANGERS" in os.environ:
        sound += [policy_walk(speed, 100 + i) for i, speed in enumerate((0.0, 0.2, 0.5, 0.8))]
    chosen = sound[1:20:6]
    return sound + [
        break_cell(log, fault) for log in chosen for fault in ("dies", "leaps", "missing", "dead")
    ]


# ---------------------------------------------------------------------------------------------------- counts


class Outcome(NamedTuple):
    """The findings about one spoilt log, and the kinds that are right."""

    log: str
    mistake: str
    right: set[str]
    findings: Sequence[Finding]

    @property
    def named(self) -> str:
        """The kind that stands first, or nothing."""
        return self.findings[0].name if self.findings else "nothing"

    @property
    def is_right(self) -> bool:
        """Whether the true cause stands first."""
        return self.named in self.right


def walk_outcomes() -> Iterator[Outcome]:
    """Judge walks with every mistake."""
    for number, (name, log) in enumerate(spoilt_walks().items()):
        for i, (mistake, (kind, spoil)) in enumerate(SPOILERS.items()):
            spoilt = spoil(log, np.random.default_rng([number, i]))
            findings = judge_log(spoilt, starting_map(spoilt)).findings
            yield Outcome(name, mistake, {kind}, findings)


def weighing_outcomes() -> Iterator[Outcome]:
    """Judge tables of weighings with every mistake, each twice."""
    for shape in SHAPES:
        for mistake, (right, _, spoil) in WEIGHING_SPOILERS.items():
            for seed in range(2):
                table = spoil(weigh(shape, seed), np.random.default_rng(seed))
                yield Outcome(f"{shape}, {seed}", mistake, right, judge_weighings(table).findings)


def refusals(kind: str) -> list[str]:
    """Judge sound logs: the first finding that refuses each, or an empty text."""
    if kind == "walks":
        found = [list(judge_log(log, starting_map(log)).findings) for log in sound_walks()]
    else:
        judged = [judge_weighings(weigh(shape, 100 + seed)) for shape in SHAPES for seed in range(10)]
        found = [list(one.findings) for one in judged]
    return [next((one.name for one in findings if one.refuses), "") for findings in found]


def unknown_table() -> Table:
    """Judge walks with the kind of their mistake taken off the list: how often is another cause named?"""
    judged: list[Judgement] = []
    for number, log in enumerate(spoilt_walks().values()):
        for i, (kind, spoil) in enumerate(SPOILERS.values()):
            if kind == DELAY:
                continue  # a parameter of the fit
            spoilt = spoil(log, np.random.default_rng([number, i]))

            def others(layout: FeetLayout, kind: str = kind) -> list[Mistake]:
                return [one for one in hypotheses(layout) if one.kind != kind]

            judged.append(judge_log(spoilt, starting_map(spoilt), others))
    best = [one.causes[0] for one in judged if one.causes and one.as_it_is.size > 1.0]
    sizes = np.log([judge_log(log, starting_map(log)).as_it_is.size for log in sound_walks()])
    rows = (
        ("walks that contradict themselves", str(len(best))),
        (
            "mimicked down to the median of sound walks",
            share(*_count(best, lambda one: one.size < EXPERIENCE.size)),
        ),
        ("another cause at more than 50 %", share(*_count(best, lambda one: one.probability > 0.5))),
        ("another cause at more than 90 %", share(*_count(best, lambda one: one.probability > 0.9))),
        ("size of sound walks, median", f"{np.exp(np.median(sizes)):.2f}"),
        ("size of sound walks, std of the logarithm", f"{sizes.std():.2f}"),
    )
    return Table("unknown", "Walks whose mistake is not on the list", ("what", "measured"), rows)


def _count(causes: Sequence[Cause], holds: Callable[[Cause], bool]) -> tuple[int, int]:
    return sum(map(holds, causes)), len(causes)


def mistakes_table(kind: str, outcomes: Sequence[Outcome]) -> Table:
    """Show what was named first, a row a mistake and a column a log."""
    logs = list(dict.fromkeys(one.log for one in outcomes))
    cells = {(one.mistake, one.log): "right" if one.is_right else one.named for one in outcomes}
    rows = tuple(
        (mistake, *(cells[mistake, log] for log in logs))
        for mistake in dict.fromkeys(one.mistake for one in outcomes)
    )
    return Table(kind, f"Spoilt {kind}: the cause that is named first", ("mistake", *logs), rows)


def main() -> None:
    """Print the tables, and save them for the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*", default=["walks", "weighings"])
    console, rows, tables = Console(width=200), [], []
    for kind in parser.parse_args().kinds:
        if kind == "unknown":
            tables.append(unknown_table())
            console.print(tables[-1].to_rich())
            continue
        outcomes = list(walk_outcomes() if kind == "walks" else weighing_outcomes())
        refused = refusals(kind)
        silent = sum(not one.findings for one in outcomes)
        right = sum(one.is_right for one in outcomes)
        sound = share(sum(map(bool, refused)), len(refused))
        rows.append((kind, str(len(outcomes)), str(silent), share(right, len(outcomes)), sound))
        tables.append(mistakes_table(kind, outcomes))
        console.print(tables[-1].to_rich())
        console.print(f"sound {kind} refused: {[name for name in refused if name] or 'none'}")
    if not rows:
        return
    heads = ("logs", "spoilt", "of them without a word", "the true cause first", "sound ones refused")
    tables.append(Table("counts", "Spoilt and sound logs", heads, tuple(rows)))
    console.print(tables[-1].to_rich())
    save_tables(OUT, tables)


if __name__ == "__main__":
    main()
