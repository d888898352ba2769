"""An evaluation on the disk: what is compared, and the episodes that were run of it so far.

A folder holds one evaluation. ``evaluation.json`` says which, and with what it was made;
``episodes.parquet`` is replaced as a whole every few seconds and whenever the work ends, however it ends. The
same command goes on where it was stopped.
"""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

import surefoot
from surefoot.experiments._files import atomic_path, locked, write_text
from surefoot.experiments._frames import Frame
from surefoot.experiments.arena_walks import source_hash
from surefoot.experiments.controllers_by_name import controller_hash, load_controller
from surefoot.experiments.policy.env import FEEDS, make_feed
from surefoot.experiments.policy.evaluate import COP_INPUTS, EpisodeResult, count_episodes, run_episodes
from surefoot.experiments.policy.options import TRAINING_SEEDS
from surefoot.experiments.policy.scores import episodes_frame, in_order
from surefoot.experiments.policy.tasks import TASKS, task_named

__all__ = ["EPISODES", "Evaluation", "EvaluationFolder", "read_episodes"]

EPISODES, PLAN = "episodes.parquet", "evaluation.json"

EVERY = 10.0
"""Time in s between two replacements of the table, so that a long evaluation does not write all the time."""

_CODE = (
    *("envs", "sensors", "wrappers", "controllers", "calibration", "experiments/walkers.py"),
    *(f"experiments/policy/{name}.py" for name in ("env", "evaluate", "tasks")),
)
"""Sources that a score depends on."""

_NUMBERS = ("severity", "seed", "total", "fell", "time", "cop_error", "tracking")
_NAMES = ("controller", "feed", "cop_input")


@dataclass(frozen=True)
class Evaluation:
    """What is compared.

    Raises:
        ValueError: If a name does not exist or is given twice, a controller does not fit the task, or a
            number is out of its range: before anything is run.
    """

    controllers: tuple[str, ...] = ("shipped",)
    """By name, see :mod:`surefoot.experiments.controllers_by_name`."""

    feeds: tuple[str, ...] = tuple(FEEDS)
    """What is fed back."""

    severities: tuple[float, ...] = (1.0,)
    """Factors of the errors of the feet's sensors."""

    seeds: int = 50
    """Episodes of each."""

    first_seed: int = 20_000
    """Of the first of them."""

    cop_inputs: tuple[str, ...] = COP_INPUTS[:1]
    """What is done to the centre of pressure, on the true feet."""

    task: str = next(iter(TASKS))
    """One of :data:`surefoot.experiments.policy.tasks.TASKS`."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        task_named(self.task)
        for name in ("controllers", "feeds", "severities", "cop_inputs"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise ValueError(f"'{name}' must name at least one and none twice, got {list(values)}.")
        if not (self.seeds >= 1 and 0 <= self.first_seed <= TRAINING_SEEDS - self.seeds):
            raise ValueError(
                f"Seeds must be at least one and lie in 0 to {TRAINING_SEEDS - 1}, got {self.seeds} from "
                f"{self.first_seed} on: seeds above are training's."
            )
        tried = [
            (self.controllers[0], feed, severity) for feed in self.feeds for severity in self.severities[:1]
        ]
        tried += [(self.controllers[0], self.feeds[-1], severity) for severity in self.severities[1:]]
        tried += [(name, self.feeds[0], self.severities[0]) for name in self.controllers[1:]]
        for controller, feed, severity in tried:
            env, _ = make_feed(feed, severity=severity, task=self.task)
            try:
                load_controller(controller, env)
            finally:
                env.close()

    @property
    def numbers(self) -> range:
        """The seeds."""
        return range(self.first_seed, self.first_seed + self.seeds)

    def __len__(self) -> int:
        """Count the episodes."""
        each = count_episodes(self.feeds, self.numbers, self.severities, self.cop_inputs)
        return len(self.controllers) * each

    def run(self, done: Frame | None = None, jobs: int = 1) -> Iterator[EpisodeResult]:
        """Run what is missing, controller by controller and seed by seed.

        Args:
            done: Episodes that are there already.
            jobs: Processes that work at the same time.
        """
        for controller in self.controllers:
            there: set[tuple[str, int, float, str]] = set()
            if done is not None:
                own = done[done["controller"] == controller]
                there.update(zip(own["feed"], own["seed"], own["severity"], own["cop_input"], strict=True))
            yield from run_episodes(
                controller,
                self.feeds,
                self.numbers,
                self.severities,
                cop_inputs=self.cop_inputs,
                task=self.task,
                jobs=jobs,
                done=there,
            )

    def as_dict(self) -> dict[str, Any]:
        """Hand it out as plain data, with hashes of the files behind the controllers."""
        plain: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return plain | {"files": {name: controller_hash(name) for name in self.controllers}}


class EvaluationFolder:
    """The episodes of one evaluation; use it within :meth:`opened`.

    Args:
        folder: Where they lie; ``None`` keeps them in memory alone.
        evaluation: What is compared.
    """

    def __init__(self, folder: Path | None, evaluation: Evaluation) -> None:
        self.folder = folder
        self.evaluation = evaluation
        self._results: list[EpisodeResult] = []
        self._kept: Frame | None = None

    @contextmanager
    def opened(self) -> Iterator["EvaluationFolder"]:
        """Take the folder for this evaluation, and write down what was added whatever happens.

        Raises:
            ValueError: If it holds another evaluation or files that are damaged, or is in use.
        """
        if self.folder is None:
            yield self
            return
        busy = ValueError(f"Another evaluation is at work in '{self.folder}'; wait for it.")
        with locked(self.folder, busy):
            self._claim(self.folder)
            self._written = time.monotonic()
            try:
                yield self
            finally:
                self._write(self.folder)

    @property
    def frame(self) -> Frame:
        """All episodes, see :func:`~surefoot.experiments.policy.scores.in_order`."""
        if not self._results:
            return self._kept
        added = episodes_frame(self._results)
        return added if self._kept is None else in_order(pd.concat([self._kept, added], ignore_index=True))

    @property
    def missing(self) -> int:
        """How many episodes are not there yet."""
        kept = 0 if self._kept is None else len(self._kept)
        return len(self.evaluation) - kept - len(self._results)

    def run(self, jobs: int = 1) -> Iterator[EpisodeResult]:
        """Run what is missing; what is handed out is kept.

        Args:
            jobs: Processes that work at the same time.
        """
        for result in self.evaluation.run(self._kept, jobs):
            self._results.append(result)
            if self.folder is not None and time.monotonic() - self._written > EVERY:
                self._write(self.folder)
                self._written = time.monotonic()
            yield result

    def _claim(self, folder: Path) -> None:
        plan, table = folder / PLAN, folder / EPISODES
        wanted, made_with = self.evaluation.as_dict(), _versions()
        if not table.is_file() or not plan.is_file():
            if table.is_file():
                raise ValueError(
                    f"'{folder}' holds episodes without an {PLAN}; give another folder with --out, or make a "
                    f"page of them with --page-of {table}."
                )
            write_text(plan, json.dumps({"evaluation": wanted, "versions": made_with}, indent=1) + "\n")
            return
        held, versions = _read_plan(plan)
        if other := [name for name in sorted(wanted.keys() | held) if wanted.get(name) != held.get(name)]:
            differs = "; ".join(f"{name} {held.get(name)} and not {wanted.get(name)}" for name in other)
            raise ValueError(
                f"'{folder}' holds another evaluation: {differs}. Give its options to go on, or another "
                "folder with --out."
            )
        self._kept = read_episodes(table)
        if versions != made_with and self.missing:
            differs = ", ".join(
                f"{name} {versions.get(name)}" for name, now in made_with.items() if versions.get(name) != now
            )
            raise ValueError(
                f"'{folder}' was begun with {differs}, which is not what runs now; give another folder with "
                "--out."
            )

    def _write(self, folder: Path) -> None:
        if self._results:
            frame = self.frame
            with atomic_path(folder / EPISODES) as part:
                frame.to_parquet(part, index=False)


def read_episodes(path: Path, controller: str = "") -> Frame:
    """Read the episodes of an evaluation.

    Args:
        path: An ``episodes.parquet``, or its folder.
        controller: Who acted, in place of what the file says; files of older versions say nothing.

    Raises:
        ValueError: If there are none, or the file is damaged or holds something else.
    """
    path = path / EPISODES if path.is_dir() else path
    if not path.is_file():
        raise ValueError(f"There is no file of episodes '{path}'; 'surefoot evaluate --out' writes one.")
    try:
        frame: Frame = pd.read_parquet(path)
    except Exception as error:  # Whatever a damaged file raises.
        raise ValueError(f"'{path}' is no table of Parquet, or is damaged: {error}.") from error
    if controller or "controller" not in frame or not (frame["controller"] != "").all():
        frame = frame.assign(controller=controller or "policy")
    if "task" not in frame:
        frame = frame.assign(task=next(iter(TASKS)))
    if missing := [name for name in (*_NAMES, *_NUMBERS) if name not in frame]:
        raise ValueError(f"'{path}' is no table of episodes: it lacks the column '{missing[0]}'.")
    for name in _NUMBERS:
        if not pd.api.types.is_numeric_dtype(frame[name]):
            raise ValueError(f"'{path}' is no table of episodes: its column '{name}' holds no numbers.")
    for name, known in (("feed", list(FEEDS)), ("cop_input", list(COP_INPUTS)), ("task", list(TASKS))):
        if unknown := sorted(set(map(str, frame[name])) - set(known)):
            raise ValueError(f"'{path}' holds the {name} '{unknown[0]}'. Known: {', '.join(known)}.")
    return in_order(frame.assign(fell=frame["fell"].astype(bool)))


def made_with(path: Path) -> str:
    """Say with what the episodes of a folder, or a file in one, were made, if it was written down."""
    plan = (path if path.is_dir() else path.parent) / PLAN
    if not plan.is_file():
        return ""
    return ", ".join(f"{name} {value}" for name, value in _read_plan(plan)[1].items())


def _read_plan(path: Path) -> tuple[dict[str, Any], dict[str, str]]:
    try:
        made = json.loads(path.read_text(encoding="utf-8"))
        return dict(made["evaluation"]), dict(made["versions"])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"'{path}' does not say what was evaluated ({error}); give another folder with --out."
        ) from error


@cache
def _versions() -> dict[str, str]:
    packages = {name: version(name) for name in ("numpy", "mujoco", "gymnasium")}
    return {"surefoot": surefoot.__version__, **packages, "code": source_hash(*_CODE)}
