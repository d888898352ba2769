"""The request of ``surefoot evaluate`` as plain data, which a file may hold."""

import json
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from surefoot.experiments.evaluate.grid import FEEDS, FIRST_SEED, SEVERITIES, Evaluation, Plan, evaluate
from surefoot.experiments.evaluate.scenarios import scenario_of
from surefoot.files import read_json, read_toml, write_text

CONFIG = "evaluation.json"  # in the folder of an evaluation: how it was asked for


@dataclass(frozen=True)
class Wanted:
    """Everything that decides the results, as a file names it. See :func:`surefoot.evaluate`."""

    env: str
    policies: Any  # a name, a list of names or of NAME=POLICY, or a table of names
    feeds: Sequence[str] = FEEDS
    severities: Sequence[float] = SEVERITIES
    seeds: Any = 50
    first_seed: int = FIRST_SEED
    faults: Any = ()
    cells: Any = None
    soles: bool = False
    sensors: Mapping[str, Any] = field(default_factory=dict)
    calibration: Mapping[str, Any] = field(default_factory=dict)
    env_options: Any = field(default_factory=dict)
    scenario: Sequence[str] = ()
    observe: Any = None
    wrap: str | None = None
    statistics: str | None = None
    settle: float | None = None
    duration: float | None = None
    metrics: Any = ()

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> "Wanted":
        """Return it from plain data; ValueError at an unknown or a missing key."""
        known = [one.name for one in fields(cls)]
        if unknown := [name for name in given if name not in known]:
            raise ValueError(f"There is no key '{unknown[0]}'. Available: {', '.join(known)}.")
        for name, example in (("env", "Humanoid-v5"), ("policies", "model.zip")):
            if not given.get(name):
                raise ValueError(
                    f"'{name}' is missing: surefoot evaluate ENV POLICY, or {name} = '{example}' in a file."
                )
        for name in ("feeds", "severities"):
            if isinstance(given.get(name, ()), str | int | float):
                raise ValueError(f"'{name}' must be a list, got {given[name]!r}.")
        return cls(**given)

    def plan(self, *, trusted: bool = False) -> Plan:
        """Return the grid; ValueError if something is refused."""
        return Plan.of(self.env, self._arms, trusted=trusted, **self._options)

    def run(self, out: Path, *, trusted: bool = False, **how: Any) -> Evaluation:
        """Run it in a folder, which then also says how it was asked for."""
        results = evaluate(self.env, self._arms, out=out, trusted=trusted, **self._options, **how)
        write_text(out / CONFIG, json.dumps(asdict(self), indent=1) + "\n")
        return results

    @property
    def _arms(self) -> Any:
        if isinstance(self.policies, Mapping):
            return dict(self.policies)
        listed = [self.policies] if isinstance(self.policies, str) else list(self.policies)
        if len(listed) == 1 and "=" not in listed[0]:
            return listed[0]
        arms: dict[str, list[str]] = {}
        for one in listed:
            # A path that holds a '=' is a path if it is there.
            name, _, policy = ("", "", one) if Path(one).exists() else one.rpartition("=")
            arms.setdefault(name or one, []).append(policy)
        return arms

    @property
    def _options(self) -> dict[str, Any]:
        seeds = self.seeds
        if isinstance(seeds, int) and not isinstance(seeds, bool):
            seeds = range(self.first_seed, self.first_seed + seeds)
        observe = self.observe
        if isinstance(observe, list) and len(observe) == 1 and ":" in observe[0]:
            observe = observe[0]
        return {
            "feeds": tuple(self.feeds),
            "severities": tuple(map(float, self.severities)),
            "seeds": tuple(seeds) if isinstance(seeds, list | range) else seeds,
            "faults": _faults(self.faults),
            "cells": self.cells,
            "sensors": {**self.sensors, **({"soles": True} if self.soles else {})},
            "calibration": self.calibration,
            "env_options": _values_by_name(self.env_options),
            "scenario": scenario_of(self.scenario),
            "observe": observe,
            "wrap": self.wrap,
            "statistics": self.statistics,
            "settle": self.settle,
            "duration": self.duration,
            "metrics": tuple(self.metrics),
        }


def load_config(path: Path | None, out: Path, repeats: bool) -> dict[str, Any]:
    """Return the keys of a file; of the folder's own if an episode is repeated by it alone."""
    if path is None:
        path = out / CONFIG
        if not (repeats and path.is_file()):
            return {}
    return dict(read_json(path) if path.suffix == ".json" else read_toml(path))


def find_backend(name: str, address: str | None) -> AbstractContextManager[Any]:
    """Return the context in which joblib sends episodes to a backend; ValueError without its package."""
    if name == "loky":
        if address is not None:
            raise ValueError("--address is that of a scheduler: name its --backend, dask or ray.")
        return nullcontext()
    import joblib

    try:
        if name == "dask":
            from distributed import Client

            try:
                Client(address)  # becomes the default client, which joblib asks for
            except OSError as error:
                raise ValueError(
                    f"No scheduler of dask answers at '{address}' ({error}); start one, or correct --address."
                ) from error
        if name == "ray":
            from ray.util.joblib import register_ray

            register_ray()
        chosen: AbstractContextManager[Any] = joblib.parallel_config(name)
        return chosen
    except ImportError as error:
        raise ValueError(f"The backend '{name}' cannot be used ({error}); install its package.") from error


def film_case(results: Evaluation, case: int, path: Path) -> Path:
    """Film one episode of an evaluation into an .mp4; ValueError if its environment cannot be drawn."""
    from surefoot.experiments.walks.video import film_stage, prepare_rendering

    prepare_rendering()
    one = results.plan.episodes[case]
    try:
        stage = results.plan.stage(one, render_mode="rgb_array")
    except TypeError as error:
        raise ValueError(
            f"The environment takes no render_mode='rgb_array', so that it cannot be filmed: {error}."
        ) from error
    try:
        return film_stage(
            path, stage, one.feed, one.seed, f"case {case}: {one.policy}, {one.feed}, {one.severity:g}"
        )
    finally:
        stage.env.close()


def _faults(given: Any) -> Any:
    """Return faults: probabilities of 'dies=0.02', or descriptions with a time."""
    if isinstance(given, Mapping):
        return dict(given)
    pairs = [one.rpartition("=") for one in given if isinstance(one, str)]
    by_chance = [_is_number(value) and not name.startswith("at ") for name, _, value in pairs]
    if pairs and all(by_chance) and len(pairs) == len(given):
        return {name: float(value) for name, _, value in pairs}
    if any(by_chance):
        raise ValueError(
            f"--fault takes probabilities, dies=0.02, or moments, 'at t=12 s ...', not both: {given!r}."
        )
    return tuple(given)


def _values_by_name(given: Any) -> dict[str, Any]:
    """Return options of NAME=VALUE; values are JSON where they can be, else text."""
    if isinstance(given, Mapping):
        return dict(given)
    found = {}
    for one in given:
        name, equals, value = one.partition("=")
        if not (name and equals):
            raise ValueError(f"An option of the environment is NAME=VALUE, got '{one}'.")
        try:
            found[name] = json.loads(value)
        except ValueError:
            found[name] = value
    return found


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
