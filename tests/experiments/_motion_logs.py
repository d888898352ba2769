"""Logs of joints and IMU in place of references."""

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import surefoot  # noqa: F401  (registers the environments)
from surefoot.experiments.logs.format import Log, LogError, read_log, write_log


def refusal_of(path: Path) -> str:
    """Return why a log is refused."""
    with pytest.raises(LogError) as refused:
        read_log(path)
    return str(refused.value)


def write_motion(log: Log, motion: pd.DataFrame, path: Path, description: dict[str, Any]) -> Path:
    """Write a log without its references; joints and IMU into a table of their own."""
    write_log(log, path)
    table = pd.read_csv(path)
    table[[name for name in table.columns if not name.startswith("reference_")]].to_csv(path, index=False)
    motion.to_csv(path.with_suffix(".motion.csv"), index=False)
    side = path.with_suffix(".json")
    told = json.loads(side.read_text())
    del told["lag_samples"]
    side.write_text(
        json.dumps(told | {"motion": {"table": path.with_suffix(".motion.csv").name} | description})
    )
    return path
