"""The study of robots that others made: its tables, the claim that no robot is made worse, and its page."""

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

from surefoot.envs import load_robot_spec
from surefoot.experiments.study.figures import look_of
from surefoot.experiments.study.page import (
    Report,
    Section,
    Words,
    failure_section,
    publish,
    repeat_section,
    save_frames,
)
from surefoot.experiments.study.runner import runner
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.store import Case, Store
from surefoot.experiments.study.tables import (
    Cell,
    Claim,
    Frame,
    Table,
    at_most,
    claim_table,
    laid_out,
    plural,
    with_interval,
)
from surefoot.experiments.walks.robots import METHODS, MOTIONS, SENSORS, Motion, run_robot

_say = Words("walks", "robots")
_KEYS = ["robot", "name"]


@dataclass(frozen=True)
class RobotOptions:
    """How much the study does."""

    out: Path = Path("out/compare-robots")
    seeds: int = 5  # of each robot, motion and kind of sensor
    jobs: int = 2
    duration: float = 20.0  # of a run in s
    motions: tuple[Motion, ...] = MOTIONS

    def quickly(self) -> "RobotOptions":
        """Return the same with two seeds and short runs, to see whether all works."""
        return replace(self, seeds=min(self.seeds, 2), duration=3.0)


def compare_robots(options: RobotOptions) -> Report:
    """Run the study and write its page; without the package of robots it has the others, and says so."""
    motions, without = options.motions, ""
    try:
        load_robot_spec("g1")
    except ModuleNotFoundError as error:
        motions, without = tuple(motion for motion in motions if not motion.packaged), str(error)
    chosen = product(motions, SENSORS, range(options.seeds))
    cases = [
        Case(f"{m.robot}, {m.name}, {on}, seed {seed}", run_robot, (m, on, seed, options.duration))
        for m, on, seed in chosen
    ]
    seconds: dict[str, float] = {}
    store = Store(options.out / "results")
    with store.opened(), runner(options.jobs, seconds) as run:
        run.run("robots", cases, store)
    scores, failures = store.rows("scores", cases), store.failures(cases)
    claims = claim_table(claims_of(scores), note=_say("claim")) if len(scores) else None
    tables = tuple(robot_table(scores, sensors) for sensors in SENSORS if len(scores))
    summary = (*tables, *(() if claims is None else (claims,)))
    left_out = (f"Robots of the package are left out: {without}",) if without else ()
    amount = f"{plural(options.seeds, 'seed')} of each, runs of {options.duration:g} s."
    command = f"surefoot compare robots --seeds {options.seeds} --out {options.out}"
    sections = (
        Section("robots", "Robots, motions and sensors", findings=left_out, tables=summary),
        *failure_section(failures),
        repeat_section(_say("repeat"), (command,), seconds),
    )
    save_frames(options.out / "tables", {"scores": scores}, (".csv",))
    title = "Calibrators on robots that others made"
    return publish(options.out, title, (_say("introduction"), amount, *left_out), sections)


def claims_of(scores: Frame) -> list[Claim]:
    """Return for each method the claim that its errors exceed those of raw readings nowhere."""
    runs, claims = scores.set_index([*_KEYS, "sensors", "seed", "method"]), []
    for column, what in (("cop", "CoP"), ("vgrf", "vGRF")):
        errors = runs[column].unstack()
        for method in METHODS[1:]:
            off = (errors[method] - errors["none"]).groupby(level=[0, 1, 2])
            found = [mean_interval(part) for _, part in off]
            worse = sum(one.apart and one.mean > 0.0 for one in found)
            said = f"{worse} of {len(found)} ({sum(one.mean > 0.0 for one in found)} in the mean)"
            name = f"{look_of(method).label}: {what} worse than raw by more than the interval"
            claims.append(at_most(name, worse, 0.0, said))
    return claims


def robot_table(scores: Frame, sensors: str) -> Table:
    """Return the table of one kind of sensors, named after it, a row a robot and motion."""

    def error(column: str, method: str, factor: float) -> Cell:
        return lambda runs: with_interval(runs[runs["method"] == method][column], factor)

    columns: dict[str, Cell] = {
        "robot": lambda runs: str(runs["robot"].iloc[0]),
        "motion": lambda runs: str(runs["name"].iloc[0]),
        "falls a run": lambda runs: f"{runs['falls'].mean():.0f}",
        **{f"CoP (mm): {look_of(method).label}": error("cop", method, 1e3) for method in METHODS},
        **{f"vGRF (N): {look_of(m).label}": error("vgrf", m, 1.0) for m in ("none", "moment")},
    }
    parts = [part for _, part in scores[scores["sensors"] == sensors].groupby(_KEYS, sort=False)]
    return laid_out(sensors.replace(" ", "_"), f"Feet with {sensors}", columns, parts)
