"""Commands that run in this process, and logs that are changed on the disk."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from typer.testing import CliRunner

import surefoot  # noqa: F401  (registers the environments)
from surefoot.experiments.cli.app import app
from surefoot.experiments.logs.format import Log, read_log, write_log
from surefoot.experiments.logs.table import LogError


def run(*words: Any, code: int = 0) -> Any:
    """Run a command, which must end with a code."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == code, result.output
    return result


def run_for_json(*words: Any, code: int = 0) -> dict[str, Any]:
    """Parse what a command prints: all of it is JSON, and nothing is on standard error."""
    result = run(*words, "--json", code=code)
    assert result.stderr == ""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    found: dict[str, Any] = json.loads(result.stdout, parse_constant=refuse)
    return found


def fails(arguments: list[Any], message: str) -> None:
    """Run a command that ends in one line."""
    assert run(*arguments, code=2).stderr == f"surefoot: {message}\n"


def refusal_of(path: Path) -> str:
    with pytest.raises(LogError) as refused:
        read_log(path)
    return str(refused.value)


def redescribe(path: Path, **changes: Any) -> None:
    """Change keys of the description beside a log; those that are ``None`` go."""
    side = path.with_suffix(".json")
    told = json.loads(side.read_text()) | changes
    side.write_text(json.dumps({key: value for key, value in told.items() if value is not None}))


def write_motion(log: Log, motion: pd.DataFrame, path: Path, description: dict[str, Any]) -> Path:
    """Write a log without its references; joints and IMU into a table of their own."""
    write_log(log, path)
    table = pd.read_csv(path)
    table[[name for name in table.columns if not name.startswith("reference_")]].to_csv(path, index=False)
    motion.to_csv(path.with_suffix(".motion.csv"), index=False)
    beside = {"table": path.with_suffix(".motion.csv").name}
    redescribe(path, lag_samples=None, motion=beside | description)
    return path


Change = Callable[[pd.DataFrame], pd.DataFrame]


def with_cell(row: int | slice, column: str, value: object) -> Change:
    def change(frame: pd.DataFrame) -> pd.DataFrame:
        frame = frame.astype({column: object})
        frame.loc[row, column] = value
        return frame

    return change


def scale_columns(columns: Iterable[str], factor: float) -> Change:
    return lambda frame: frame.assign(**{name: factor * frame[name] for name in columns})
