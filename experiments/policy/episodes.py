"""Episodes of an evaluation on the disk: read whole, or refused with what is wrong."""

from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.calibration._setup import OLD_NAMES
from surefoot.experiments.policy.env import FEEDS
from surefoot.experiments.policy.evaluate import COP_INPUTS
from surefoot.experiments.policy.scores import controllers_of, in_order
from surefoot.experiments.policy.tasks import TASKS
from surefoot.experiments.study.tables import Column, Frame

__all__ = ["EPISODES", "UNNAMED", "read_episodes"]

EPISODES = "episodes.parquet"

UNNAMED = "policy"
"""What a controller is called that nobody named."""

_NAMES = ("controller", "feed", "cop_input", "task")
_NUMBERS = ("severity", "seed", "total", "fell", "time", "cop_error", "tracking")
_MAY_LACK = ("cop_error", "tracking")
"""Errors of a centre of pressure that was never felt are none."""


def read_episodes(path: Path, controller: str = "") -> Frame:
    """Read the episodes of an evaluation.

    Args:
        path: An ``episodes.parquet``, or its folder.
        controller: Who acted, in place of what the file says; files of older versions say nothing.

    Raises:
        ValueError: If there are none, or the file is damaged or holds something else, naming the column.
    """
    path = path / EPISODES if path.is_dir() else path
    if not path.is_file():
        raise ValueError(f"There is no file of episodes '{path}'; 'surefoot evaluate --out' writes one.")
    try:
        frame: Frame = pd.read_parquet(path)
    except Exception as error:  # Whatever a damaged file raises.
        raise ValueError(f"'{path}' is no table of Parquet, or is damaged: {error}.") from error
    if "controller" not in frame:
        frame = frame.assign(controller=UNNAMED)
    if "task" not in frame:
        frame = frame.assign(task=next(iter(TASKS)))
    if missing := [name for name in (*_NAMES, *_NUMBERS) if name not in frame]:
        raise ValueError(f"'{path}' is no table of episodes: it lacks the column '{missing[0]}'.")
    names = {name: _names(path, frame[name]) for name in _NAMES}
    names["controller"] = names["controller"].replace("", UNNAMED)
    names["feed"] = names["feed"].replace(OLD_NAMES)
    frame = frame.assign(**names, **{name: _numbers(path, frame[name]) for name in _NUMBERS})
    for name, known in (("feed", list(FEEDS)), ("cop_input", list(COP_INPUTS)), ("task", list(TASKS))):
        if unknown := sorted(set(frame[name]) - set(known)):
            raise ValueError(f"'{path}' holds the {name} '{unknown[0]}'. Known: {', '.join(known)}.")
    held = controllers_of(frame)
    if controller and len(held) > 1:
        raise ValueError(
            f"'{path}' holds episodes of {', '.join(held)}, which cannot all be called '{controller}'; give "
            "the file without a name."
        )
    return in_order(frame.assign(controller=controller) if controller else frame)


def _names(path: Path, column: Column) -> Column:
    if wrong := [value for value in column if not isinstance(value, str)]:
        raise ValueError(
            f"'{path}' is no table of episodes: its column '{column.name}' holds {wrong[0]!r} and not a name."
        )
    return pd.Series(column.tolist(), index=column.index, name=column.name)


def _numbers(path: Path, column: Column) -> Column:
    """Check one column of numbers, and hand it out as the type that a fresh one has."""
    name = str(column.name)
    if not pd.api.types.is_numeric_dtype(column):
        raise ValueError(f"'{path}' is no table of episodes: its column '{name}' holds no numbers.")
    values = column.to_numpy(dtype=np.float64, na_value=np.nan)
    rules = {"seed": "a whole number from 0", "fell": "true or false", "total": "a finite number"}
    fine = np.isfinite(values)
    if name in _MAY_LACK:
        fine |= np.isnan(values)
    if name != "total":
        fine &= ~(values < 0.0)
    if name == "seed":
        fine &= values == np.floor(values)
    if name == "fell":
        fine &= np.isin(values, (0.0, 1.0))
    if not fine.all():
        rule = rules.get(name, "a finite number and not negative")
        raise ValueError(f"'{path}' holds {values[~fine][0]:g} in its column '{name}', which must be {rule}.")
    kinds = {"seed": np.int64, "fell": np.bool_}
    return pd.Series(values.astype(kinds.get(name, np.float64)), index=column.index, name=name)
