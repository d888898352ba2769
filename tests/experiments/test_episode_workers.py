"""Sweeps on several processes, one of which crashes."""

import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from surefoot.experiments.episodes import EpisodePlan, run_plan
from surefoot.experiments.episodes.run import EPISODES

TOYS = """
import os, time
import numpy as np

def slow(observation):
    time.sleep(0.01)
    return np.zeros(11, np.float32)

def dies(observation):
    os._exit(9)
"""


def command(folder: Path, controllers: str, *, seeds: int) -> subprocess.Popen[bytes]:
    (folder / "sweep_toys.py").write_text(TOYS)
    plan = folder / "sweep.toml"
    plan.write_text(
        f'controllers = {controllers}\nfeeds = ["true"]\nscenarios = ["stand"]\nseverities = [1]\n'
        f"seeds = {seeds}\nduration = 0.6\nsettle = 0.1\n"
    )
    arguments = ["sweep", str(plan), "--out", str(folder / "out"), "--jobs", "2"]
    # A file and no pipe: workers of a killed process would keep a pipe open for a while.
    with (folder / "said.txt").open("wb") as said:
        return subprocess.Popen(
            [sys.executable, "-m", "surefoot", *arguments],
            env=os.environ
            | {"PYTHONPATH": f"{folder}:{os.environ.get('PYTHONPATH', '')}", "OMP_NUM_THREADS": "1"},
            stdout=said,
            stderr=subprocess.STDOUT,
        )


def ended(process: subprocess.Popen[bytes], folder: Path) -> str:
    code = process.wait()
    said = (folder / "said.txt").read_text()
    assert code == 0, said
    return said


def plan_of(*controllers: str, seeds: int) -> EpisodePlan:
    return EpisodePlan(
        controllers, ("true",), ("stand",), (1.0,), tuple(range(seeds)), duration=0.6, settle=0.1
    )


@pytest.mark.slow
def test_a_worker_that_dies_costs_its_episode_alone(tmp_path: Path) -> None:
    controllers = '["zero", "sweep_toys:dies", "stabiliser"]'
    ended(command(tmp_path, controllers, seeds=2), tmp_path)
    rows = pd.read_parquet(tmp_path / "out" / EPISODES)
    assert sorted(rows["case"]) == list(range(6))
    failed = rows[rows["error"] != ""]
    assert list(failed["controller"]) == ["sweep_toys:dies"] * 2
    assert failed["error"].str.startswith("The worker that ran this case died: ").all()


@pytest.mark.slow
def test_results_are_the_same_to_the_last_digit(tmp_path: Path) -> None:
    ended(command(tmp_path, '["zero", "stabiliser"]', seeds=3), tmp_path)
    rows = pd.read_parquet(tmp_path / "out" / EPISODES).sort_values("case", ignore_index=True)
    here = run_plan(plan_of("zero", "stabiliser", seeds=3)).rows
    assert not (rows["error"] != "").any()
    pd.testing.assert_frame_equal(
        rows.drop(columns="wall_time"), here.drop(columns="wall_time"), check_exact=True
    )
