"""An evaluation: what is compared, on which episodes, and with what."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

import surefoot
from surefoot.calibration._setup import method_name
from surefoot.experiments.policy.controllers import controller_hash, load_controller, trained_on
from surefoot.experiments.policy.env import FEEDS, make_feed
from surefoot.experiments.policy.evaluate import (
    COP_INPUTS,
    EpisodeResult,
    check_seeds,
    count_episodes,
    episode_cells,
    run_episodes,
)
from surefoot.experiments.policy.origin import Plan
from surefoot.experiments.policy.scores import in_order
from surefoot.experiments.policy.tasks import TASKS, task_named
from surefoot.experiments.study.sources import source_hash
from surefoot.experiments.study.tables import Frame

__all__ = ["Evaluation"]


@dataclass(frozen=True)
class Evaluation:
    """What is compared.

    Raises:
        ValueError: If a name does not exist or is given twice, a controller does not fit the task, or a
            number is out of its range: before anything is run.
    """

    controllers: tuple[str, ...] = ("shipped",)
    """By name, see :mod:`surefoot.experiments.policy.controllers`."""

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
        object.__setattr__(self, "feeds", tuple(map(method_name, self.feeds)))
        for name in ("controllers", "feeds", "severities", "cop_inputs"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise ValueError(f"'{name}' must name at least one and none twice, got {list(values)}.")
        for name, least in (("seeds", 1), ("first_seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise ValueError(f"'{name}' must be a whole number from {least} on, got {value!r}.")
        for severity in self.severities:
            if not (isinstance(severity, int | float) and 0.0 <= severity < float("inf")):
                raise ValueError(f"A severity must be finite and not negative, got {severity!r}.")
        check_seeds(self.first_seed, self.first_seed + self.seeds - 1, self.cop_inputs)
        tried = [
            (self.controllers[0], feed, severity) for feed in self.feeds for severity in self.severities[:1]
        ]
        tried += [(self.controllers[0], self.feeds[-1], severity) for severity in self.severities[1:]]
        tried += [(name, self.feeds[0], self.severities[0]) for name in self.controllers[1:]]
        for controller, feed, severity in tried:
            env, _ = make_feed(feed, severity=severity, task=self.task)
            try:
                load_controller(controller, env, same_task=True)
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

    def files(self) -> dict[str, str]:
        """Hash the file behind each controller, as it is now."""
        env_id = task_named(self.task).env_id
        return {name: controller_hash(name, env_id) for name in self.controllers}

    def plan(self) -> Plan:
        """Say what is compared and with what, as of now."""
        plain = json.loads(json.dumps(asdict(self))) | {"files": self.files()}
        return Plan(plain, _versions(), {name: trained_on(name) for name in self.controllers})

    def own(self, frame: Frame, source: Path) -> Frame:
        """Take over the episodes of an earlier run of it.

        Args:
            frame: The episodes.
            source: Where they are from.

        Returns:
            The episodes, with controllers in the order in which they are named now.

        Raises:
            ValueError: If one is there twice, or is none of this evaluation.
        """
        # True feet know no severity: which of them an episode on them was run at makes no difference.
        on_true = (frame["feed"] == "true") & frame["severity"].isin(self.severities)
        frame = frame.assign(severity=np.where(on_true, float(self.severities[0]), frame["severity"]))
        each = episode_cells(self.feeds, self.numbers, self.severities, self.cop_inputs)
        cells = {(name, *cell) for name in self.controllers for cell in each}
        columns = (frame[name] for name in ("controller", "feed", "seed", "severity", "cop_input"))
        seen = set()
        for cell, task in zip(zip(*columns, strict=True), frame["task"], strict=True):
            fits = cell in cells and task == self.task
            if not fits or cell in seen:
                what = "twice" if fits else f"of the task '{task}', which is none of this evaluation"
                name, feed, seed, severity, cop_input = cell
                raise ValueError(
                    f"'{source}' holds the episode of '{name}' on feed '{feed}' ({cop_input}), severity "
                    f"{severity:g}, seed {seed}, {what}; give another folder with --out."
                )
            seen.add(cell)
        order = list(self.controllers)
        return in_order(frame.sort_values("controller", key=lambda column: column.map(order.index)))


@cache
def _versions() -> dict[str, str]:
    packages = {name: version(name) for name in ("numpy", "mujoco", "gymnasium")}
    return {
        "surefoot": surefoot.__version__,
        **packages,
        "code": source_hash("surefoot.experiments.policy.evaluate"),
    }
