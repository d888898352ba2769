"""Feet that stand, walk and are held: errors of single feet and cells by the foot calibrators.

    python benchmarks/momentum.py --out FOLDER --scenes nao/walk "g1/walk, calibrated" g1/held-20 --seeds 4
    python benchmarks/momentum.py --out FOLDER --seeds 8 --results out/results/momentum

    python benchmarks/momentum.py --out FOLDER --parts --seeds 4 --results out/results/momentum

The second makes the whole table of the pages, the third that of the worth of each part of ``moment``: each
left out in turn, on thirteen scenes. What is finished stays in the folder: an interrupted run goes
on, recordings serve until a robot, its sensors or its beliefs change, scores until any code of theirs does.

Elsewhere the total is scored; policies are shown single feet. Each scene is recorded once and played by every
method. Its map and the true one are held against each other on the same readings: the error of each foot's
centre of pressure where it bears more than 5 % of the weight, of the common one, of single cells, and how
errors agree with the covariance claimed (1 is right).

A robot of its owner's, Unitree's G1 by a published policy, comes from the folder that the variable
``SUREFOOT_STRANGERS`` names (``g1_policy.py`` beside it); without it, its scenes are left out. Cells are
the usual ones of a robot's size. In a scene ``"..., calibrated"`` they start with a perfect map and drift a
tenth as fast, in ``"..., triple"`` they are three times as bad, untold.
"""

import argparse
import os
import pickle
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")

import bench
import gymnasium as gym
import numpy as np
from scipy.stats import chi2
from strangers import Dance, make_g1

from surefoot.arrays import Floats, stack_rows, take_rows
from surefoot.calibration import FeetLayout, Flag, FootCalibrator, MomentumReference, Parameters, Reference
from surefoot.calibration.cop import cop_of_feet, sole_wrenches
from surefoot.calibration.moment import modes
from surefoot.calibration.moment.filter import MomentFilter
from surefoot.calibration.native.config import moment_constants
from surefoot.experiments.study.page import save_tables
from surefoot.experiments.study.sources import source_hash
from surefoot.experiments.study.tables import Cell, Frame, Table, decimal, table_of
from surefoot.experiments.walks.record import lift
from surefoot.experiments.walks.walkers import G1_FEET
from surefoot.native import CALIBRATION, require
from surefoot.robot.sensing.instruments import usual_cells
from surefoot.sensors import LoadCells, scaled
from surefoot.wrappers import FootSensors, SelfCalibration

METHODS = ("none", "tare", "window", "moment", "integrated")
"""``integrated`` is ``moment`` on accelerations that it adds up itself, as logs have them."""

LOADED = 0.05  # share of the weight from which on a foot's centre of pressure counts
UNLOADED = 0.01  # share of the weight below which a foot bears nothing: readings have as much noise
SOFT = 0.15  # deflection in m at which a hand bears nothing, or twice its share
HELD = 12.0, 20.0  # from when to when something lifts the robot, in s
SETTLE, DURATION = 10.0, 30.0  # from when on errors count, and how long a scene lasts, in s
HELD_OUT = 100  # seeds from this on are those of the page; constants were chosen on lower ones


class Scene(NamedTuple):
    """A robot's motion."""

    robot: str  # whose environment it is
    command: Callable[[float], tuple[float, float, float]] = lambda time: (0.0, 0.0, 0.0)
    """Forward in m/s, left in m/s and turn in rad/s at a time in s, for those who take one."""
    lifted: float = 0.0  # share of the weight that somebody takes off for a while
    hand: tuple[str, float, bool] | None = None
    """A steady hand from the fourth second on: the body on which it acts (empty for the torso), the share of
    the weight that it bears, and whether it is a wall, which also pushes back, or a rail along which the
    robot walks."""
    pushed: float = 0.0  # impulse of pushes in body weights times s, sideways every 3 s
    options: tuple[tuple[str, Any], ...] = ()  # of its environment


def _walk(*command: float) -> Callable[[float], tuple[float, float, float]]:
    return lambda time: command if time > 2.0 else (0.0, 0.0, 0.0)  # type: ignore[return-value]


G1_HAND = "left_wrist_yaw_link"

EXERCISE = "nao", "op3", "g1", "t1"  # robots of surefoot/Exercise-v0

SCENES = {
    f"{robot}/{name}": scene._replace(robot=robot)
    for robot in ("g1", "g1-fastsac")
    for name, scene in {
        "walk": Scene("", _walk(0.4, 0.0, 0.0)),
        "turn": Scene("", _walk(0.3, 0.0, 0.4)),
        "sideways": Scene("", _walk(0.0, 0.3, 0.0)),
        "stop-and-go": Scene("", lambda time: (0.4, 0.0, 0.0) if time % 6.0 > 3.0 else (0.0, 0.0, 0.0)),
        "pushes": Scene("", _walk(0.3, 0.0, 0.0), pushed=0.02),
        "held-5": Scene("", lifted=0.05),
        "held-20": Scene("", lifted=0.2),
        "held-35": Scene("", lifted=0.35),
        "held-50": Scene("", lifted=0.5),
        "held-walk": Scene("", _walk(0.3, 0.0, 0.0), lifted=0.2),
        "stand": Scene(""),
        "mat": Scene("", _walk(0.4, 0.0, 0.0), options=(("ground", "mat"),)),
        "stairs": Scene("", _walk(0.4, 0.0, 0.0), options=(("ground", "stairs"),)),
        "rail-5": Scene("", _walk(0.4, 0.0, 0.0), hand=(G1_HAND, 0.05, False)),
        "rail-10": Scene("", _walk(0.4, 0.0, 0.0), hand=(G1_HAND, 0.1, False)),
        "wall": Scene("", hand=(G1_HAND, 0.05, True)),
    }.items()
} | {
    "g1/dance": Scene("g1-dancing"),
    "nao/rail-10": Scene("surefoot/NaoWalk-v0", hand=("", 0.1, False)),
    "nao/wall": Scene("surefoot/NaoStand-v0", options=(("sway", (0.02, 0.02)),), hand=("", 0.05, True)),
    "t1/wall": Scene("surefoot/Exercise-v0", options=(("robot", "t1"),), hand=("", 0.05, True)),
    "nao/walk": Scene("surefoot/NaoWalk-v0"),
    "nao/walk-0.02": Scene("surefoot/NaoWalk-v0", options=(("speed", 0.02),)),
    "nao/walk-0.1": Scene("surefoot/NaoWalk-v0", options=(("speed", 0.1),)),
    "nao/balance": Scene("surefoot/NaoBalance-v0"),
    "nao/stand": Scene("surefoot/NaoStand-v0"),
    "nao/sway": Scene("surefoot/NaoStand-v0", options=(("sway", (0.02, 0.02)),)),
    "nao/held-20": Scene("surefoot/NaoStand-v0", lifted=0.2),
    "nao/held-walk": Scene("surefoot/NaoWalk-v0", lifted=0.15),
    **{f"exercise/{own}": Scene("surefoot/Exercise-v0", options=(("robot", own),)) for own in EXERCISE},
}

PAGE = (*SCENES, *(f"{robot}/walk, {start}" for start in ("triple", "calibrated") for robot in ("g1", "nao")))
"""Scenes of the table of the pages, some with other cells to start with."""

PARTS_PAGE = (
    "g1/walk", "g1/stop-and-go", "g1/held-20", "g1/stand", "g1-fastsac/walk", "g1-fastsac/held-5", "nao/walk",
    "nao/walk, triple", "nao/walk, calibrated", "nao/held-walk", "nao/balance", "exercise/op3", "exercise/t1",
)  # fmt: skip
"""Scenes on which parts of ``moment`` are left out."""


def _begin_sure_of(part: str) -> Callable[[MomentFilter], dict[str, Any]]:
    """Return a change of the first variances that takes some unknowns for known."""

    def change(core: MomentFilter) -> dict[str, Any]:
        variance = core.first_variance.copy()
        variance[getattr(core.columns, part)] = 0.0
        return {"first_variance": variance}

    return change


def _without(mode: modes.Mode) -> dict[str, Any]:
    """Return constants of the modes by which one is never believed."""
    rates, chance, at = modes.RATES.copy(), modes.FIRST_CHANCE.copy(), modes.MODES.index(mode)
    rates[:, at], chance[at] = 0.0, 1e-12
    return {"rates": rates, "first_chance": chance / chance.sum(), "least_chance": 1e-12}


PARTS: dict[str, Mapping[str, Any] | Callable[[MomentFilter], dict[str, Any]]] = {
    "hands that move": _without(modes.HELD),
    "steady hands and loads": _without(modes.STEADY),
    "severity by evidence": {"severities": np.ones(4), "first_rate": 1.0},
    "drift's rate by tares": {"rate_share": 0.0, "stated_rate": 1e12, "first_rate": 1.0},
    "zeros of a robot that stands still": {"least_still": 2.0},
    "ripple within a sample": {"ripple": 0.0},
    "memory of a zero's drift": {"product_time": 0.0},
    "error of the centre of mass": _begin_sure_of("com"),
    "error of the mass": _begin_sure_of("mass"),
    "delay": _begin_sure_of("delay"),
    "tare in swing": {"tare_share": 2.0},
    "suspects": {"sure": 1e12, "contrast": 1e12},
}
"""Constants, by their names in C, by which a part of ``moment`` brings nothing."""


def _change_constants(part: str) -> Any:
    """Return a patch that leaves a part out of every filter that is made; none without a name."""
    change = PARTS.get(part, {})

    def constants(core: MomentFilter) -> tuple[Any, ...]:
        changed = change(core) if callable(change) else change
        unknown = changed.keys() - set(require(CALIBRATION.installed()).places["moment_config"])
        if unknown:
            raise KeyError(f"No constant of the filter has the name {', '.join(unknown)}.")
        return changed, *moment_constants(core)

    return patch("surefoot.calibration.native.config.moment_constants", constants)


class Stream(NamedTuple):
    """One scene: N samples of K channels on F feet."""

    layout: FeetLayout  # the feet
    mass: float  # as the robot believes it in kg
    initial: Parameters  # the map to start from
    dt: float  # time between samples in s
    lag: int  # by how many samples references are late
    age: Any  # mean age of a reading in s
    raw: Floats  # readings, shape (N, K)
    accelerations: Reference  # references, N first in each field
    momenta: MomentumReference  # the same as momentum
    true: Parameters  # the map that undoes the readings' errors, shape (N, K) each
    sole: Floats  # soles in m in the world, shape (N, F, 3)
    R: Floats  # their rotations, shape (N, F, 3, 3)
    fell: bool  # whether the robot fell


def make(scene: Scene) -> tuple[gym.Env[Any, Any], Callable[[float], Any]]:
    """Make a scene's environment, and its controller."""
    if scene.robot.startswith("g1"):
        policy = {"g1": "ppo_g1_29dof", "g1-fastsac": "fastsac_g1_29dof"}.get(
            scene.robot, "ppo_g1_29dof_dancing"
        )
        env = make_g1(policy, **dict(scene.options))
        base: Any = env.unwrapped
        if isinstance(env, Dance):
            return env, lambda time: env.act()
        return env, lambda time: base.policy(base.state(), np.array(scene.command(time), float))
    env = gym.make(scene.robot, disable_env_checker=True, **dict(scene.options))
    still = np.zeros(env.action_space.shape or ())
    return env, lambda time: still


def cells_of(start: str, usual: LoadCells) -> LoadCells:
    """Return the cells of a start."""
    if start == "calibrated":
        drift = {name: 0.1 * getattr(usual, name) for name in ("scale_drift", "offset_drift")}
        return replace(usual, initial_scale_std=0.0, initial_offset_std=0.0, **drift)
    return scaled(usual, 3.0) if start == "triple" else usual


def record(name: str, seed: int, start: str = "", seconds: float = DURATION) -> Stream:
    """Play a scene once."""
    scene = SCENES[name]
    base, act = make(scene)
    feet = G1_FEET if name.startswith("g1") else None
    usual = usual_cells(FootSensors(make(scene)[0], feet=feet).source.drawing)
    assert isinstance(usual, LoadCells)
    sensors = FootSensors(base, cells_of(start, usual), feet=feet)
    # In Python both kinds of beliefs are made.
    with patch("surefoot.robot.calibration.native_beliefs", lambda beliefs, library: beliefs):
        env = SelfCalibration(sensors, "moment")
        env.reset(seed=seed)
    robot, source, core = env.robot, sensors.source, sensors.robot
    model, data = env.unwrapped.model, env.unwrapped.data  # type: ignore[attr-defined]
    torso, rows, dt = model.body(source.drawing.torso).id, [], float(source.dt)
    hand = Hand(scene, model, torso) if scene.hand else None
    fell, weight = False, source.drawing.weight
    for k in range(round(seconds / dt)):
        data.xfrc_applied[torso, :3] = _outside(scene, k * dt, weight)
        if hand:
            hand.push(data, k * dt, weight)
        _, _, fell, over, _ = env.step(act(k * dt))
        truth = source.truth
        both: Any = robot.beliefs
        contacts = {"stance": both.believed.stance, "swing": both.believed.swing}
        believed = both.beliefs.believed._replace(**contacts), both.believed
        places = truth.position_sole[-1].copy(), truth.R_world_sole[-1].copy()
        rows.append((core.raw.copy(), *believed, core.true_parameters(), *places))
        if fell or over:
            break
    raw, accelerations, momenta, true, sole, R = zip(*rows, strict=True)
    return Stream(
        layout=env.layout, mass=robot.model.mass, initial=robot.initial, dt=dt, lag=robot.late,
        age=robot.calibrator.setup.age, raw=np.stack(raw), accelerations=stack_rows(accelerations),
        momenta=stack_rows(momenta), true=stack_rows(true),
        sole=np.stack(sole), R=np.stack(R), fell=fell,
    )  # fmt: skip


def _outside(scene: Scene, time: float, weight: float) -> Floats:
    """Return the outside force on the torso in N."""
    force = np.zeros(3)
    force[2] = weight * lift(time, scene.lifted, *HELD)
    if scene.pushed and time % 3.0 < 0.1:
        force[1] = scene.pushed * weight / 0.1 * (1.0 if int(time / 3.0) % 2 else -1.0)
    return force


class Hand:
    """A spring and a damper between a body and a rail or a wall, which bear a share of the weight."""

    def __init__(self, scene: Scene, model: Any, torso: int) -> None:
        assert scene.hand is not None
        name, self._share, wall = scene.hand
        self._body = model.body(name).id if name else torso
        self._along = np.array([-0.8, 0.0, 0.6]) if wall else np.array([0.0, 0.0, 1.0])
        self._held = np.array([1.0, 1.0, 1.0]) if wall else np.array([0.0, 1.0, 1.0])
        self._place: Floats | None = None

    def push(self, data: Any, time: float, weight: float) -> None:
        """Set the force on the body at a time in s, which grows within half a second."""
        if time < 4.0:
            return
        place = data.xipos[self._body].copy()
        self._place = place if self._place is None else self._place
        force, velocity = self._share * weight, data.cvel[self._body, 3:]
        pull = np.clip((self._place - place - 0.02 * velocity) / SOFT, -1.0, 1.0)
        share = min(2.0 * (time - 4.0), 1.0)
        data.xfrc_applied[self._body, :3] = share * force * (self._along + self._held * pull)


def stream(folder: Path, name: str, seed: int) -> Stream:
    """Read a recorded scene, or record it by the code of now; a filter changes no recording."""
    code = source_hash(
        "surefoot.envs", "surefoot.sensors", "surefoot.robot.beliefs", "surefoot.robot.sensing"
    )
    path = folder / f"{re.sub('[/, ]+', '_', name)}_{seed}_{code}.pickle"
    if not path.is_file():
        scene, _, start = name.partition(", ")
        path.write_bytes(pickle.dumps(record(scene, seed, start)))
    found: Stream = pickle.loads(path.read_bytes())
    return found


def play(one: Stream, method: str, **options: Any) -> Iterator[Any]:
    """Yield the estimates of a stream by a method, or by ``"moment without PART"``."""
    method, _, part = method.partition(" without ")
    beliefs: Any = one.momenta if method == "moment" else one.accelerations
    name = "moment" if method == "integrated" else method
    with _change_constants(part):
        calibrator = FootCalibrator(
            one.layout, name, mass=one.mass, initial=one.initial, dt=one.dt, lag=one.lag,
            age=one.age, **options,
        )  # fmt: skip
    for k, raw in enumerate(one.raw):
        yield calibrator.update(raw, take_rows(beliefs, k))


def score(one: Stream, method: str, **options: Any) -> dict[str, float]:
    """Play a method on a stream, and score it from :data:`SETTLE` on."""
    weight, first = 9.81 * one.mass, round(SETTLE / one.dt)
    kept: dict[str, list[float]] = {key: [] for key in COLUMNS}
    every, accused = round(1.0 / one.dt), False
    for k, estimate in enumerate(play(one, method, **options)):
        accused = accused or bool((estimate.flags & ACCUSED).any())
        if k < first:
            continue
        # Both maps on the same readings: how old these are is no error of a calibration.
        true_force = take_rows(one.true, k).force(one.raw[k])
        force = Parameters(estimate.scale, estimate.offset).force(one.raw[k])
        if not np.isfinite(true_force).all():
            continue
        truth, guess = sole_wrenches(true_force, one.layout), sole_wrenches(force, one.layout)
        cop = cop_of_feet(truth, one.sole[k], one.R[k])
        off = cop_of_feet(guess, one.sole[k], one.R[k]) - cop
        kept["total"].append(float(np.sum(off**2)))
        error = force - true_force
        kept["cell"].append(float(np.mean((error / weight) ** 2)))
        kept["vgrf"].append(float(((guess - truth)[:, 2].sum() / weight) ** 2))
        kept["held"].append(float(bool((estimate.flags & int(Flag.HELD)).any())))
        if estimate.contact_probability is not None:
            share, thought = truth[:, 2] / weight, estimate.contact_probability > 0.5
            clear = (share > LOADED) | (share < UNLOADED)
            kept["contact"] += (100.0 * (thought != (share > LOADED)))[clear].tolist()
        for foot in range(len(truth)):
            if truth[foot, 2] < LOADED * weight:
                continue
            centre, seen = ((-w[foot, 4] / w[foot, 2], w[foot, 3] / w[foot, 2]) for w in (truth, guess))
            apart = np.subtract(seen, centre)
            kept["foot"].append(float(np.sum(np.minimum(apart**2, 1.0))))
            if estimate.covariance is not None and k % every == 0:
                nees = _nees_foot(one, estimate, k, foot, apart, guess[foot, 2])
                kept["nees foot"].append(nees)
                for share in COVERED:
                    kept[f"in {share:.0%}"].append(100.0 * (2.0 * nees < chi2.ppf(share, 2)))
        if estimate.covariance is not None and k % every == 0:
            a, b = Parameters(estimate.scale, estimate.offset).relative_to(one.initial)
            a_true, b_true = take_rows(one.true, k).relative_to(one.initial)
            error = np.r_[a - a_true, b - b_true]
            kept["nees"].append(float(error @ np.linalg.pinv(estimate.covariance) @ error) / error.size)
        if estimate.nis is not None and np.isfinite(estimate.nis) and estimate.nis_rows > 0:
            kept["nis"].append(float(estimate.nis / estimate.nis_rows))
    kept["accused"] = [100.0 * accused]
    return {
        key: float(factor * np.sqrt(np.mean(values)) if factor else np.mean(values)) if values else np.nan
        for (key, factor), values in zip(COLUMNS.items(), kept.values(), strict=True)
    }


ACCUSED = int(Flag.LOST | Flag.DEAD | Flag.STUCK | Flag.FLIPPED | Flag.SWAPPED)
"""Flags of channels that are thought to be faulty."""

COVERED = 0.5, 0.9, 0.95  # chances of ellipses of a foot's CoP

COLUMNS = {
    "foot": 1e3, "total": 1e3, "cell": 100.0, "vgrf": 100.0, "nees": 0.0, "nees foot": 0.0,
    **{f"in {share:.0%}": 0.0 for share in COVERED}, "nis": 0.0, "held": 0.0, "contact": 0.0, "accused": 0.0,
}  # fmt: skip
"""Root mean squares: of a foot's CoP and of the common one in mm, of cells and of the vertical force in
percent of the weight. Means (0): NEES a parameter and of a foot's CoP, how often that lies in the ellipses
claimed in percent, NIS a row, share of time held, how often (percent) a foot that bears more than
:data:`LOADED` or less than :data:`UNLOADED` is thought not to, or to, bear load, and of how many runs
(percent) a channel is accused, of which all are sound."""


def _nees_foot(one: Stream, estimate: Any, k: int, foot: int, apart: Floats, load: float) -> float:
    """Return the squared error of a foot's CoP by the covariance claimed, over its number."""
    F0 = one.initial.force(one.raw[k])
    wrench = one.layout.wrench_map[foot]
    at = np.array([-wrench[4], wrench[3]])
    force = Parameters(estimate.scale, estimate.offset).force(one.raw[k])
    row = (at - (at @ force)[:, None] / load * wrench[2]) / load
    J = np.hstack([row * F0, row])
    return float(apart @ np.linalg.pinv(J @ estimate.covariance @ J.T) @ apart) / 2.0


def _score(folder: Path, name: str, seed: int, methods: Sequence[str]) -> dict[str, list[dict[str, Any]]]:
    warnings.simplefilter("ignore")
    one = stream(folder, name, seed)
    return {"scores": [{"scene": name, "method": method, **score(one, method)} for method in methods]}


SHOWN = {"foot": "foot (mm)", "cell": "cell (%)", "nees": "NEES"}
"""Columns of the pages, of each method; NEES of those that claim a covariance."""


def _mean_of_scene(scene: str, runs: Frame) -> str:
    return "{foot:.2f} ({nees:.1f})".format(**runs.loc[runs["scene"] == scene, ["foot", "nees"]].mean())


def _mean_of_method(method: str, key: str, runs: Frame) -> str:
    return decimal(float(runs[runs["method"] == method][key].mean()), ".2f")


def table_of_parts(scores: Frame) -> Table:
    """Return a table of a foot's error (mm) and NEES, a line a part that is left out, a column a scene."""
    columns: dict[str, Cell] = {
        "left out": lambda runs: str(runs["method"].iloc[0]).partition(" without ")[2] or "nothing",
        **{scene: partial(_mean_of_scene, scene) for scene in scores["scene"].unique()},
    }
    parts = [part for _, part in scores.groupby("method", sort=False)]
    return table_of("parts", "Parts of moment, each left out in turn", columns, parts)


def table_of_feet(scores: Frame, seeds: int) -> Table:
    """Return the table of the pages, a line a scene."""
    columns: dict[str, Cell] = {
        "scene": lambda runs: str(runs["scene"].iloc[0]),
        "seeds": lambda runs: str(seeds),
        **{
            f"{method}: {SHOWN[key]}": partial(_mean_of_method, method, key)
            for key in SHOWN
            for method in scores["method"].unique()
            if key != "nees" or method == "moment"
        },
    }
    parts = [part for _, part in scores.groupby("scene", sort=False)]
    return table_of("feet", "Feet by policy, walking, standing and held", columns, parts)


def main() -> None:
    """Record and score what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of recorded scenes and scores")
    parser.add_argument("--parts", action="store_true", help="leave each part of moment out in turn")
    parser.add_argument("--scenes", nargs="+")
    parser.add_argument("--methods", nargs="+")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=HELD_OUT, help="first seed")
    parser.add_argument("--jobs", type=int, default=1, help="processes that work at the same time")
    parser.add_argument("--results", type=Path, help="folder for the table of the pages")
    given = parser.parse_args()
    parts = ("moment", *(f"moment without {part}" for part in PARTS))
    given.scenes = given.scenes or (PARTS_PAGE if given.parts else PAGE)
    given.methods = given.methods or (parts if given.parts else METHODS)
    given.out.mkdir(parents=True, exist_ok=True)
    strange = "SUREFOOT_STRANGERS" in os.environ
    names = [name for name in given.scenes if strange or not name.startswith("g1")]
    seeds = range(given.first, given.first + given.seeds)
    cases = [(given.out, name, seed, tuple(given.methods)) for name in names for seed in seeds]
    scores = bench.run(given.out, "play", _score, cases, jobs=given.jobs, depends=lambda _, *case: case)[
        "scores"
    ]
    print("|", " | ".join(["scene", "method", *COLUMNS, "worse than raw"]), "|")
    print("|---" * (len(COLUMNS) + 3) + "|")
    for (name, method), runs in scores.groupby(["scene", "method"], sort=False):
        raw = scores[(scores["scene"] == name) & (scores["method"] == given.methods[0])]["foot"]
        means = " | ".join(f"{runs[key].mean():.2f}" for key in COLUMNS)
        worse = int((runs["foot"].to_numpy() > 1.02 * raw.to_numpy()).sum())
        print(f"| {name} | {method} | {means} | {worse} of {len(runs)} |", flush=True)
    if given.results:
        table = table_of_parts(scores) if given.parts else table_of_feet(scores, given.seeds)
        save_tables(given.results / "tables", [table])


if __name__ == "__main__":
    bench.start(__file__)
