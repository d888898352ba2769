"""What a sweep does: a grid of controllers, feeds, scenarios, severities and seeds."""

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from hashlib import sha256
from itertools import product
from math import isfinite
from pathlib import Path
from typing import Any

from surefoot.calibration._setup import method_name
from surefoot.experiments.policy.controllers import controller_hash
from surefoot.experiments.sweep.episode import Cell
from surefoot.experiments.sweep.scenarios import SWEEP_FEEDS, SweepScenario, scenario_named
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.sensors import LoadCells
from surefoot.sensors.presets import resolve

__all__ = ["SweepPlan", "plan_from_toml"]

_GRID = ("controllers", "feeds", "scenarios", "severities", "seeds")
_OWN_KEYS = ("based_on", "title", "environment", "options", "sensors", "beliefs", "methods")


@dataclass(frozen=True)
class SweepPlan:
    """A grid; every combination is one episode.

    True feet have no errors to scale: feed ``"true"`` is run once a seed, at severity 0.

    Attributes:
        controllers: Names of controllers (:mod:`surefoot.experiments.policy.controllers`).
        feeds: Of :data:`~surefoot.experiments.sweep.scenarios.SWEEP_FEEDS`.
        scenarios: Names of scenarios.
        severities: Factors of all errors of the load cells.
        seeds: Of the episodes; a number counts from 0.
        duration: Longest duration of an episode in s, standing included.
        settle: The controller is asked from this time in s on: calibrators need a quiet stand.
        cells: Name of the load cells' preset.
        own: Scenarios besides the table's, by name.

    Raises:
        ValueError: If an axis is empty or says something twice, or something in it does not exist.
    """

    controllers: tuple[str, ...] = ("zero", "stabiliser")
    feeds: tuple[str, ...] = ("true", "none", "moment")
    scenarios: tuple[str, ...] = ("speed-0.04",)
    severities: tuple[float, ...] = (1.0, 3.0)
    seeds: tuple[int, ...] = tuple(range(10))
    duration: float = STAND_TIME + 20.0
    settle: float = STAND_TIME
    cells: str = "hx711-load-cells"
    own: Mapping[str, SweepScenario] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse what cannot be done, before anything is."""
        object.__setattr__(self, "feeds", tuple(map(method_name, self.feeds)))
        for name in _GRID:
            _check_axis(name, getattr(self, name))
        if unknown := [feed for feed in self.feeds if feed not in SWEEP_FEEDS]:
            available = ", ".join(map(repr, SWEEP_FEEDS))
            raise ValueError(f"There is no feed '{unknown[0]}'. Available: {available}.")
        for severity in self.severities:
            if not (isfinite(severity) and severity >= 0.0):
                raise ValueError(f"A severity must be finite and not negative, got {severity}.")
        for seed in self.seeds:
            if seed < 0:
                raise ValueError(f"A seed must not be negative, got {seed}.")
        if not (0.0 <= self.settle < self.duration < float("inf")):
            raise ValueError(
                f"'settle' must be at least 0 s and less than 'duration', got {self.settle:g} s and "
                f"{self.duration:g} s."
            )
        resolve(self.cells, LoadCells)
        for name in self.scenarios:
            scenario_named(name, self.own)
        for name in self.controllers:
            controller_hash(name)

    @cached_property
    def grid(self) -> tuple[Cell, ...]:
        """All cells, numbered from 0 in the order of the axes; seeds vary fastest."""
        hashes = {name: controller_hash(name) for name in self.controllers}
        combinations = (
            (controller, feed, scenario, severity, seed)
            for controller, feed, scenario in product(self.controllers, self.feeds, self.scenarios)
            for severity in (self.severities if feed != "true" else (0.0,))
            for seed in self.seeds
        )
        return tuple(
            self._cell(number, controller, hashes[controller], feed, scenario, severity, seed)
            for number, (controller, feed, scenario, severity, seed) in enumerate(combinations)
        )

    @property
    def fingerprint(self) -> str:
        """Sixteen digits that any other grid, option or controller's file would change."""
        text = "\n".join(cell.to_json() for cell in self.grid)
        return sha256(text.encode()).hexdigest()[:16]

    def as_dict(self) -> dict[str, Any]:
        """The plan as plain data, for a file."""
        data: dict[str, Any] = json.loads(json.dumps(asdict(self), default=_plain))
        return data

    def title_of(self, scenario: str) -> str:
        """What to call a scenario."""
        return scenario_named(scenario, self.own).title

    def _cell(
        self, number: int, controller: str, hashed: str, feed: str, name: str, severity: float, seed: int
    ) -> Cell:
        scenario = scenario_named(name, self.own)
        made = Cell(
            number,
            controller,
            hashed,
            feed,
            name,
            scenario.environment,
            scenario.options_for(self.duration),
            self.cells,
            scenario.sensors_for(seed),
            scenario.calibration_for(feed),
            severity,
            seed,
            self.duration,
            self.settle,
        )
        # What is read back from the results must be what was run: tuples are lists from here on.
        return Cell.from_json(json.dumps(asdict(made), default=_plain))


def plan_from_toml(path: Path, **changes: Any) -> SweepPlan:
    """Read a sweep from a file.

    Args:
        path: The file; docs/sweep.md describes it.
        **changes: Attributes of :class:`SweepPlan` to put in the place of the file's.

    Raises:
        ValueError: If the file is none, or says what there is not.
    """
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ValueError(f"{path}: no such file.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not TOML: {error}.") from error
    known = [f.name for f in fields(SweepPlan) if f.name != "own"]
    _known_keys(f"{path}", given, (*known, "first_seed", "scenario"))
    own = {name: _own_scenario(path, name, table) for name, table in given.pop("scenario", {}).items()}
    first = given.pop("first_seed", 0)
    seeds = given.pop("seeds", 10)
    try:
        options: dict[str, Any] = {
            **{name: tuple(value) if name in _GRID else value for name, value in given.items()},
            "seeds": tuple(range(first, first + seeds)) if isinstance(seeds, int) else tuple(seeds),
        }
        for name, kind in (("severities", float), ("seeds", int)):
            if name in options:
                options[name] = tuple(map(kind, options[name]))
        for name in ("duration", "settle"):
            if name in options:
                options[name] = float(options[name])
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}; axes are lists, 'seeds' a list or how many.") from error
    return SweepPlan(**{**options, **changes, "own": own})


def _own_scenario(path: Path, name: str, table: Any) -> SweepScenario:
    if not isinstance(table, Mapping):
        raise ValueError(f"{path}: [scenario.{name}] must be a table.")
    _known_keys(f"{path}, [scenario.{name}]", table, _OWN_KEYS)
    base = scenario_named(table["based_on"]) if "based_on" in table else SweepScenario(name, name)
    return replace(
        base,
        name=name,
        title=table.get("title", name),
        environment=table.get("environment", base.environment),
        options={**base.options, **table.get("options", {})},
        sensors={**base.sensors, **table.get("sensors", {})},
        beliefs={**base.beliefs, **table.get("beliefs", {})},
        methods={**base.methods, **table.get("methods", {})},
    )


def _known_keys(where: str, given: Mapping[str, Any], known: Sequence[str]) -> None:
    if unknown := [key for key in given if key not in known]:
        raise ValueError(f"{where}: there is no key '{unknown[0]}'. Available: {', '.join(known)}.")


def _check_axis(name: str, values: Sequence[Any]) -> None:
    if not values:
        raise ValueError(f"'{name}' is empty, so that there is nothing to sweep; name at least one.")
    twice = [value for i, value in enumerate(values) if value in values[:i]]
    if twice:
        raise ValueError(f"'{name}' holds {twice[0]!r} twice: the same cells would be run again.")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} cannot be written.")
