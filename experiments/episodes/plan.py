"""The plan of a study of controllers: a grid of controllers, feeds, scenarios, severities and seeds.

``surefoot evaluate`` is a preset: policies at the task that they were trained for.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from itertools import count, product
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any

from gymnasium.envs.registration import registry

from surefoot.envs.nao.env import CONTROL_STEP
from surefoot.experiments.episodes.episode import Episode, episode_row
from surefoot.experiments.policy.controllers import Controller, controller_hash, training_sensors
from surefoot.experiments.policy.tasks import TASKS, TRAINING_SEEDS, find_task
from surefoot.experiments.walks.scenarios import FAULT_AFTER, SCENARIOS, Scenario, scenario_from
from surefoot.experiments.walks.walkers import FEEDS, STAND_TIME, check_feed
from surefoot.files import read_toml
from surefoot.sensors import LoadCells
from surefoot.sensors.presets import resolve


def find_scenario(name: str, others: Mapping[str, Scenario] = MappingProxyType({})) -> Scenario:
    """Return the scenario of a closed loop by its name, of others or of all; ValueError lists them."""
    known = {n: s for n, s in SCENARIOS.items() if s.loops and s.environment in registry} | dict(others)
    if name not in known:
        raise ValueError(f"There is no scenario '{name}'. Available: {', '.join(known)}.")
    found = known[name]
    if found.environment not in registry:
        raise ValueError(
            f"Scenario '{name}' asks for the environment '{found.environment}', which is not registered; "
            "import the package that registers it, as in 'package:Name-v0'."
        )
    return found


_AXES = ("controllers", "feeds", "scenarios", "severities", "seeds")
_OWN_KEYS = ("based_on", "title", "environment", "options", "sensors", "beliefs", "methods")


@dataclass(frozen=True)
class EpisodePlan:
    """A grid of valid names; every combination is one episode. Raises ValueError at impossible plans.

    True feet have no errors to scale: feed ``"true"`` is run once a seed, at severity 0.
    """

    controllers: tuple[str, ...] = ("zero", "stabiliser")
    feeds: tuple[str, ...] = ("true", "none", "moment")
    scenarios: tuple[str, ...] = ("speed-0.04",)
    severities: tuple[float, ...] = (1.0, 3.0)  # factors of all errors of the cells
    seeds: tuple[int, ...] = tuple(range(10))
    duration: float | None = STAND_TIME + 20.0  # longest, in s, with standing; ``None`` for the environment's
    settle: float | None = STAND_TIME  # controllers are asked from this time in s on; ``None`` as above
    cells: str = "hx711-load-cells"  # name of a preset
    own: Mapping[str, Scenario] = field(default_factory=dict)  # scenarios besides the package's

    def __post_init__(self) -> None:
        """Raise ValueError at an impossible plan, before anything runs."""
        object.__setattr__(self, "feeds", tuple(map(check_feed, self.feeds)))
        for name in _AXES:
            _check_axis(name, getattr(self, name))
        for severity in self.severities:
            if not (isinstance(severity, int | float) and isfinite(severity) and severity >= 0.0):
                raise ValueError(f"A severity must be finite and not negative, got {severity!r}.")
        for seed in self.seeds:
            if not isinstance(seed, int) or seed < 0:
                raise ValueError(f"A seed must be a whole number and not negative, got {seed!r}.")
        settle = 0.0 if self.settle is None else self.settle
        if self.duration is not None and not 0.0 <= settle < self.duration < float("inf"):
            raise ValueError(
                f"'settle' must be at least 0 s and less than 'duration', got {settle:g} s and "
                f"{self.duration:g} s."
            )
        resolve(self.cells, LoadCells)
        found = [find_scenario(name, self.own) for name in self.scenarios]
        faulty = [scenario.name for scenario in found if scenario.faults]
        if faulty and self.duration is not None and self.duration <= FAULT_AFTER:
            raise ValueError(
                f"In scenario '{faulty[0]}' a cell fails after {FAULT_AFTER:g} s or later: 'duration' must "
                f"be longer, got {self.duration:g} s."
            )
        if any(scenario.of_task for scenario in found):
            check_seeds(min(self.seeds), max(self.seeds))
        for name in self.controllers:
            controller_hash(name)

    @cached_property
    def episodes(self) -> tuple[Episode, ...]:
        """All episodes, numbered from 0 in the order of the axes; seeds vary fastest."""
        return tuple(self._episodes())

    @property
    def files(self) -> dict[str, str]:
        """Hashes of the files behind the controllers."""
        return {episode.controller: episode.controller_hash for episode in self.episodes}

    def as_dict(self) -> dict[str, Any]:
        """Return the plan as plain data."""
        data: dict[str, Any] = json.loads(json.dumps(asdict(self), default=dict))
        return data | {"files": self.files}

    def _episodes(self) -> Iterator[Episode]:
        numbers = count()
        for controller, feed, name in product(self.controllers, self.feeds, self.scenarios):
            scenario, on_true = find_scenario(name, self.own), FEEDS[feed] is None
            hashed, trained = controller_hash(controller, scenario.environment), training_sensors(controller)
            severities = (0.0,) if on_true else self.severities
            for severity, seed in product(severities, self.seeds):
                made = Episode(
                    number=next(numbers),
                    controller=controller,
                    controller_hash=hashed,
                    trained=trained,
                    feed=feed,
                    scenario=name,
                    environment=scenario.environment,
                    options=scenario.options_for(self.duration),
                    cells=self.cells,
                    sensors=scenario.sensors_for(feed, severity, seed),
                    calibration=scenario.calibration_for(feed),
                    severity=severity,
                    seed=seed,
                    duration=self.duration,
                    settle=self.settle,
                    of_task=scenario.of_task,
                )
                # What is read back from the results must be what was run: tuples are lists from here on.
                yield Episode.from_json(made.to_json())


def check_seeds(first: int, last: int) -> None:
    """Raise ValueError if seeds reach those of training."""
    if not 0 <= first <= last < TRAINING_SEEDS:
        given = str(first) if first == last else f"{first} to {last}"
        raise ValueError(
            f"'seed' must lie in 0 to {TRAINING_SEEDS - 1}, got {given}: seeds from {TRAINING_SEEDS} on are "
            "training's."
        )


def plan_from_toml(path: Path | None = None, **changes: Any) -> EpisodePlan:
    """Return a plan from a file as in docs/sweep.md, if any, with changes as there; raise ValueError."""
    given = {**({} if path is None else read_toml(path)), **changes}
    known = [f.name for f in fields(EpisodePlan) if f.name != "own"]
    _check_keys(f"{path}", given, (*known, "first_seed", "scenario"))
    own = {name: _own_scenario(path, name, table) for name, table in given.pop("scenario", {}).items()}
    first, seeds = given.pop("first_seed", 0), given.pop("seeds", 10)
    if isinstance(seeds, int):
        seeds = range(first, first + seeds)
    elif first:
        raise ValueError(f"{path}: 'first_seed' needs 'seeds' that says how many, got {seeds!r}.")
    given["seeds"] = seeds
    for name in set(given).intersection(_AXES):
        if isinstance(given[name], str) or not isinstance(given[name], Sequence):
            raise ValueError(f"{path}: axes are lists, 'seeds' a list or how many; {name} = {given[name]!r}.")
    kinds: dict[str, Any] = {"duration": float, "settle": float, "severities": lambda v: tuple(map(float, v))}
    try:
        given = {name: kinds.get(name, tuple if name in _AXES else str)(v) for name, v in given.items()}
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}; axes are lists of numbers or of names.") from error
    return EpisodePlan(**given, own=own)


def _own_scenario(path: Path | None, name: str, table: Any) -> Scenario:
    if not isinstance(table, Mapping):
        raise ValueError(f"{path}: [scenario.{name}] must be a table.")
    _check_keys(f"{path}, [scenario.{name}]", table, _OWN_KEYS)
    for feed in table.get("methods", {}):
        check_feed(feed)
    own = {key: value for key, value in table.items() if key != "based_on"}
    return scenario_from(name, own, find_scenario(table["based_on"]) if "based_on" in table else None)


def _check_keys(where: str, given: Mapping[str, Any], known: Sequence[str]) -> None:
    if unknown := [key for key in given if key not in known]:
        raise ValueError(f"{where}: there is no key '{unknown[0]}'. Available: {', '.join(known)}.")


def _check_axis(name: str, values: Sequence[Any]) -> None:
    if not values:
        raise ValueError(f"'{name}' is empty, so that there is nothing to run; name at least one.")
    twice = [value for i, value in enumerate(values) if value in values[:i]]
    if twice:
        raise ValueError(f"'{name}' holds {twice[0]!r} twice: the same episodes would be run again.")


EVALUATED = ("true", "none", "weights", "quasi-static", "window", "moment")  # feeds of an evaluation
EVALUATED_TASK = "balance-hard"  # where good feet matter: where nobody acts, a third of the robots falls


def evaluation_plan(
    controllers: tuple[str, ...] = ("shipped",),
    feeds: tuple[str, ...] = EVALUATED,
    severities: tuple[float, ...] = (1.0,),
    *,
    seeds: int = 50,
    first_seed: int = 20_000,
    task: str = EVALUATED_TASK,
) -> EpisodePlan:
    """Return the plan of an evaluation, whatever order things are named in; ValueError at a wrong one."""
    for name, value, least in (("seeds", seeds, 1), ("first_seed", first_seed, 0)):
        if not isinstance(value, int) or isinstance(value, bool) or value < least:
            raise ValueError(f"'{name}' must be a whole number from {least} on, got {value!r}.")
    found = find_task(task)
    return EpisodePlan(
        tuple(sorted(controllers)),
        tuple(sorted(map(check_feed, feeds), key=[*FEEDS, *feeds].index)),
        (task,),
        tuple(sorted(severities, key=str)),
        tuple(range(first_seed, first_seed + seeds)),
        duration=None,
        settle=None,
        own={task: Scenario(found.name, found.name, environment=found.env_id, of_task=True)},
    )


def walk_episode(feed: str, *, speed: float, seed: int, duration: float, severity: float = 1.0) -> Episode:
    """Return an episode of the stabilised walk at a speed in m/s, for a duration in s, standing included."""
    walk = scenario_from("walk", {"options": {"speed": speed}})
    plan = EpisodePlan(
        ("stabiliser",),
        (feed,),
        (walk.name,),
        (severity,),
        (seed,),
        duration=max(duration, STAND_TIME + CONTROL_STEP),
        own={walk.name: walk},
    )
    return replace(plan.episodes[0], duration=duration)


def run_episode(
    controller: Controller | str,
    feed: str,
    seed: int,
    severity: float = 1.0,
    *,
    task: str = next(iter(TASKS)),
    **env_options: Any,
) -> dict[str, Any]:
    """Run an episode of a task; return the row of :func:`~surefoot.experiments.episodes.episode.episode_row`.

    Args:
        controller: A name, a :class:`~surefoot.controllers.PolicyNetwork`, a stabiliser, or any function of
            observations; if it has a ``reset``, it is called when the quiet stand is over.
        feed: One of :data:`~surefoot.experiments.walks.walkers.FEEDS`.
        seed: Of the episode and its sensors, none of training's.
        severity: Factor of all errors of the feet's sensors.
        task: One of :data:`surefoot.experiments.policy.tasks.TASKS`.
        **env_options: Of the task's environment.

    Raises:
        ValueError: If a name does not exist, a seed is one of training's, or the controller does not fit or
            was made for another task.
    """
    name = controller if isinstance(controller, str) else "zero"
    plan = evaluation_plan((name,), (feed,), (severity,), seeds=1, first_seed=seed, task=task)
    (episode,) = plan.episodes
    episode = replace(episode, options={**episode.options, **env_options})
    if isinstance(controller, str):
        return episode_row(episode)
    return episode_row(replace(episode, controller=""), controller)
