"""Sweeps: what they refuse, what they compute, and that nothing computed is lost."""

import errno
import json
import os
import re
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from surefoot.controllers.policy import PolicyNetwork
from surefoot.experiments.cli.app import app
from surefoot.experiments.sweep import SweepError, SweepPlan, plan_from_toml, replay_cell, run_cell, run_sweep
from surefoot.experiments.sweep import store as store_module
from surefoot.experiments.sweep.backends import Died
from surefoot.experiments.sweep.episode import OUTCOME, Cell, failed_row
from surefoot.experiments.sweep.run import rows_of
from surefoot.experiments.sweep.store import JOURNAL, RESULTS, SweepStore, read_results
from surefoot.experiments.walks.closed_loop import run_loop

RUNNER = CliRunner()
SHORT = SweepPlan(
    controllers=("stabiliser",),
    feeds=("true", "none"),
    scenarios=("stand",),
    severities=(1.0, 2.0),
    seeds=(7, 8),
    duration=0.3,
    settle=0.1,
)


def made(cell: Cell) -> dict[str, Any]:
    """A row that costs nothing."""
    return failed_row(cell, "") | {
        "return": 0.1 * cell.number,
        "time": 1.0 + cell.number / 3,
        "fell": cell.severity * (1 + cell.seed) > 9,
        "digest": f"{cell.number:032x}",
    }


def broken(cell: Cell) -> dict[str, Any]:
    raise AssertionError(f"cell {cell.number} is run again")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"feeds": ()}, "'feeds' is empty, so that there is nothing to sweep; name at least one."),
        ({"seeds": (3, 4, 3)}, "'seeds' holds 3 twice: the same cells would be run again."),
        ({"severities": (1, 1.0)}, "'severities' holds 1.0 twice"),
        ({"scenarios": ("uphill",)}, "There is no scenario 'uphill'. Available: speed-0.02, speed-0.04"),
        ({"feeds": ("kalman",)}, "There is no feed 'kalman'. Available: 'true', 'none'"),
        (
            {"controllers": ("pid",)},
            "There is no controller 'pid'. Available: 'zero', 'stabiliser', 'shipped', 'shipped-rand",
        ),
        ({"controllers": ("gone.npz",)}, "There is no policy file 'gone.npz'"),
        ({"controllers": ("no_module:f",)}, "module 'no_module' cannot be imported"),
        ({"controllers": ("math:no",)}, "module 'math' has no function 'no'"),
        ({"severities": (-1.0,)}, "A severity must be finite and not negative, got -1.0."),
        ({"seeds": (-1,)}, "A seed must not be negative, got -1."),
        ({"settle": 30.0}, "'settle' must be at least 0 s and less than 'duration', got 30 s and 24 s."),
        ({"cells": "scales"}, "There is no LoadCells preset 'scales'"),
    ],
)
def test_a_plan_refuses(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        SweepPlan(**changes)


def test_true_feet_have_no_severity() -> None:
    grid = SHORT.grid
    assert [(c.feed, c.severity, c.seed) for c in grid] == [
        *(("true", 0.0, seed) for seed in (7, 8)),
        *(("none", severity, seed) for severity in (1.0, 2.0) for seed in (7, 8)),
    ]
    assert [c.number for c in grid] == list(range(6))
    assert replace(SHORT, duration=0.4).fingerprint != SHORT.fingerprint == replace(SHORT).fingerprint


def test_a_fault_is_drawn_by_the_seed_and_survives_writing() -> None:
    cells = replace(SHORT, scenarios=("fault-dead", "imu-bias"), feeds=("none",)).grid
    first, second = (cell.sensors["faults"][0] for cell in cells[:2])
    assert first["kind"] == second["kind"] == "dead"
    assert first != second
    assert all(Cell.from_json(cell.to_json()) == cell for cell in cells)


def test_a_file_says_the_same(tmp_path: Path) -> None:
    path = tmp_path / "sweep.toml"
    path.write_text(
        'controllers = ["stabiliser"]\nfeeds = ["true", "none"]\nscenarios = ["mine"]\nseverities = [1, 2]\n'
        "seeds = 2\nfirst_seed = 7\nduration = 1\nsettle = 0.1\n"
        '[scenario.mine]\nbased_on = "pushes"\noptions = { push_impulse = [0.4, 0.6] }\n'
    )
    plan = plan_from_toml(path, duration=0.3)
    assert plan.seeds == SHORT.seeds
    assert plan.duration == 0.3
    assert plan.grid[0].options["push_impulse"] == [0.4, 0.6]
    assert plan.grid[0].options["speed"] == 0.04


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "severity = [1]",
            "there is no key 'severity'. Available: controllers, feeds, scenarios, severities",
        ),
        (
            '[scenario.a]\nspeed = 1\nbased_on = "stand"',
            "there is no key 'speed'. Available: based_on, title",
        ),
        ('scenarios = ["a"]\n[scenario.a]\nbased_on = "b"', "There is no scenario 'b'."),
        ('scenarios = ["a"]\n[scenario.a]\nenvironment = "No-v0"', "'No-v0', which is not registered"),
        ("seeds = [", "is not TOML"),
        ("seeds = []", "'seeds' is empty"),
        ("severities = 3", "axes are lists"),
    ],
)
def test_a_file_is_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "sweep.toml"
    path.write_text(text)
    result = RUNNER.invoke(app, ["sweep", str(path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert result.stderr.startswith("surefoot: ")
    assert message in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_cell_is_the_closed_loop_at_true_feet() -> None:
    plan = replace(SHORT, feeds=("true",), scenarios=("speed-0.04",), seeds=(7,), duration=4.3, settle=4.0)
    row, run = run_cell(plan.grid[0]), run_loop("true", speed=0.04, seed=7, duration=4.3)
    assert not row["error"]
    assert (row["time"], row["fell"]) == (pytest.approx(run.time), run.fell)
    assert row["cop_error"] == 0.0
    assert row["cop_tracking"] > 0.0
    assert 3.0 < row["return"] / row["steps"] < 4.0


def test_sweeping_and_repeating_a_cell(tmp_path: Path) -> None:
    results = run_sweep(SHORT, tmp_path, backend="here")
    rows = results.rows
    assert results.computed == len(rows) == 6
    assert not len(results.failed)
    assert (rows["steps"] == 24).all()
    by_severity = rows.groupby("severity")["cop_error"].mean()
    assert by_severity[0.0] == 0.0 < by_severity[1.0] < by_severity[2.0]
    replayed = replay_cell(tmp_path / RESULTS, 5)
    assert replayed.different == replayed.other_versions == ()
    said = RUNNER.invoke(app, ["replay", str(tmp_path), "--cell", "5"])
    assert said.exit_code == 0
    assert said.stdout.endswith("Identical.\n")

    table = pd.read_parquet(tmp_path / RESULTS)
    table.loc[5, "return"] = np.nextafter(table.loc[5, "return"], np.inf)
    table.to_parquet(tmp_path / "other.parquet")
    said = RUNNER.invoke(app, ["replay", str(tmp_path / "other.parquet"), "--cell", "5"])
    assert said.exit_code == 1
    assert said.stdout.endswith("Different.\n")
    with pytest.raises(SweepError, match=r"There is no cell 9 in .* it has 6, from 0 to 5"):
        replay_cell(tmp_path, 9)

    again = run_sweep(SHORT, tmp_path, backend="here", job=broken)
    assert again.computed == 0
    pd.testing.assert_frame_equal(again.rows, rows, check_exact=True)
    with pytest.raises(SweepError, match=r"holds another sweep .* or give another folder with --out"):
        run_sweep(replace(SHORT, seeds=(7,)), tmp_path, backend="here")
    plan = json.loads((tmp_path / "sweep.json").read_text())
    plan["versions"]["numpy"] = "1.0"
    (tmp_path / "sweep.json").write_text(json.dumps(plan))
    with pytest.raises(SweepError, match=r"was begun with numpy 1\.0, which is not what runs now"):
        run_sweep(SHORT, tmp_path, backend="here")
    assert run_sweep(SHORT, tmp_path, backend="here", any_version=True, job=broken).computed == 0


@pytest.fixture
def toys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sweep_toys.py").write_text(
        "import numpy as np\n"
        "def raises(observation):\n    raise RuntimeError('the gains are gone')\n"
        "def refuses(state_layout):\n    raise ValueError('not this robot')\n"
        "class Counts:\n"
        "    def __init__(self, state_layout): self.calls = None\n"
        "    def reset(self): self.calls = 0\n"
        "    def __call__(self, observation):\n"
        "        self.calls += 1\n"
        "        return np.full(11, 0.01 * self.calls, np.float32)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("toys")
def test_functions_of_the_users(tmp_path: Path) -> None:
    plan = replace(SHORT, controllers=("sweep_toys:Counts", "sweep_toys:raises", "zero"), feeds=("true",))
    results = run_sweep(plan, tmp_path / "out", backend="here")
    assert list(results.failed["cell"]) == [2, 3]
    assert results.failed["error"].str.endswith("RuntimeError: the gains are gone").all()
    assert "sweep_toys.py" in results.failed["error"].iloc[0]
    digests = results.finished.groupby("seed")["digest"].nunique()
    assert (digests == 2).all()
    retried = run_sweep(plan, tmp_path / "out", backend="here", retry_failed=True)
    assert retried.computed == 2
    with pytest.raises(
        ValueError, match="'stand' with controller 'sweep_toys:refuses' cannot be run: not this"
    ):
        run_sweep(replace(plan, controllers=("sweep_toys:refuses",)), tmp_path / "no", backend="here")
    (tmp_path / "sweep_toys.py").write_text("def raises(observation):\n    return None\n")
    fake = run_cell(plan.grid[2])
    assert "is another one than the sweep began with" in fake["error"]


def policy_file(path: Path, state_size: int) -> str:
    parts = {"state": state_size, "cop": 2, "cop_valid": 3}
    policy = PolicyNetwork(
        parts,
        [np.full((2, sum(parts.values())), 0.1)],
        [np.zeros(2)],
        posture_matrix=np.eye(11)[:, [4, 5]],
        posture_speed=0.5,
        posture_memory=2.0,
        hold=4,
        dt=1.0 / 80.0,
    )
    policy.save(path)
    return str(path)


def test_a_policy_file_is_a_controller(tmp_path: Path) -> None:
    path = policy_file(tmp_path / "policy.npz", 63)
    plan = replace(SHORT, controllers=("zero", path), feeds=("true", "none"), severities=(1.0,), seeds=(7,))
    results = run_sweep(plan, tmp_path / "out", backend="here")
    assert not len(results.failed)
    assert results.rows["digest"].nunique() == 4
    assert replay_cell(tmp_path / "out", 3).different == ()
    policy_file(tmp_path / "policy.npz", 60)
    assert {"digest", "error"} < set(replay_cell(tmp_path / "out", 3).different)
    with pytest.raises(ValueError, match=r"cannot be run: The policy was trained on 'state' of 60 numbers"):
        run_sweep(replace(plan), tmp_path / "other", backend="here")
    with zipfile.ZipFile(tmp_path / "sb3.zip", "w") as archive:
        archive.writestr("data", "{}")
    with pytest.raises(ValueError, match=r"is a Stable-Baselines3 zip, which holds pickled objects"):
        run_sweep(replace(plan, controllers=(str(tmp_path / "sb3.zip"),)), tmp_path / "third", backend="here")


def test_half_a_line_is_cut_off(tmp_path: Path) -> None:
    with SweepStore(tmp_path).opened(SHORT.fingerprint, {}) as store:
        for cell in SHORT.grid[:3]:
            store.add(made(cell))
        # What a kill leaves: the table is not there yet.
        kept = (tmp_path / JOURNAL).read_bytes()
    (tmp_path / RESULTS).unlink()
    (tmp_path / JOURNAL).write_bytes(kept[:-40])
    assert list(read_results(tmp_path)["cell"]) == [0, 1]
    results = run_sweep(SHORT, tmp_path, backend="here", job=made)
    assert results.computed == 4
    assert list(pd.read_parquet(tmp_path / RESULTS)["cell"]) == list(range(6))
    assert not (tmp_path / JOURNAL).read_bytes()


def test_a_damaged_journal_is_named_and_kept(tmp_path: Path) -> None:
    with SweepStore(tmp_path).opened(SHORT.fingerprint, {}) as store:
        for cell in SHORT.grid[:3]:
            store.add(made(cell))
        lines = (tmp_path / JOURNAL).read_bytes().splitlines(keepends=True)
    (tmp_path / RESULTS).unlink()
    damaged = lines[0] + lines[1][:30] + b"\n" + lines[2]
    (tmp_path / JOURNAL).write_bytes(damaged)
    with pytest.raises(SweepError, match=r"is damaged .* Delete this line to go on; its cell is run again"):
        run_sweep(SHORT, tmp_path, backend="here", job=made)
    assert (tmp_path / JOURNAL).read_bytes() == damaged
    (tmp_path / JOURNAL).write_bytes(lines[0] + lines[2])
    assert run_sweep(SHORT, tmp_path, backend="here", job=made).computed == 4


def test_a_full_disk_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, lines = store_module._write_all, iter(range(100))

    def full(file: int, data: bytes) -> None:
        if next(lines) == 4:
            os.write(file, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        real(file, data)

    monkeypatch.setattr(store_module, "_write_all", full)
    with pytest.raises(
        SweepError, match=r"No space left on device\. The 4 cells that were finished are kept"
    ):
        run_sweep(SHORT, tmp_path, backend="here", job=made)
    assert (tmp_path / JOURNAL).read_bytes().count(b"\n") == 4
    assert (tmp_path / JOURNAL).read_bytes().endswith(b"\n")
    assert run_sweep(SHORT, tmp_path, backend="here", job=made).computed == 2


def test_a_worker_with_other_software_is_refused(tmp_path: Path) -> None:
    def older(cell: Cell) -> dict[str, Any]:
        return made(cell) | {"mujoco": "2.0"}

    with pytest.raises(SweepError, match=r"A worker runs mujoco 2\.0, which is not what runs here"):
        run_sweep(SHORT, tmp_path, backend="here", job=older)
    assert run_sweep(SHORT, tmp_path, backend="here", job=older, any_version=True).computed == 6


def test_a_folder_is_one_sweeps_and_one_process_at_a_time(tmp_path: Path) -> None:
    with (
        SweepStore(tmp_path).opened("one", {}),
        pytest.raises(SweepError, match="Another sweep is at work"),
        SweepStore(tmp_path).opened("one", {}),
    ):
        pass
    (tmp_path / "sweep.json").unlink()
    (tmp_path / RESULTS).write_bytes(b"")
    with (
        pytest.raises(SweepError, match=r"holds results without a sweep\.json"),
        SweepStore(tmp_path).opened("", {}),
    ):
        pass
    with pytest.raises(SweepError, match="is not a table of Parquet"):
        read_results(tmp_path / RESULTS)
    with pytest.raises(SweepError, match="no such file; 'surefoot sweep' writes one"):
        read_results(tmp_path / "gone.parquet")


class Crew:
    """Workers of whom one dies of a cell, and with it all that is under way with it."""

    def __init__(self, deadly: int) -> None:
        self.deadly, self.runs = deadly, list[int]()

    def stream(self, job: Any, cells: list[Cell], *, alone: bool = False) -> Iterator[dict[str, Any] | Died]:
        del alone
        for first, second in zip(cells[::2], [*cells[1::2], None], strict=False):
            pair = [cell for cell in (first, second) if cell is not None]
            self.runs += [cell.number for cell in pair]
            if self.deadly in [cell.number for cell in pair]:
                yield Died(tuple(cell.number for cell in pair), "it was killed", broken=True)
                return
            yield from map(job, pair)


@pytest.mark.parametrize("deadly", range(6))
def test_a_worker_that_dies_costs_its_cell_alone(deadly: int) -> None:
    crew: Any = Crew(deadly)
    rows = {row["cell"]: row for row in rows_of(crew, made, list(SHORT.grid))}
    assert sorted(rows) == list(range(6))
    assert [n for n, row in rows.items() if row["error"]] == [deadly]
    assert rows[deadly]["error"] == "The worker that ran this cell died: it was killed"
    # Only what died with it was begun twice.
    assert len(crew.runs) <= 6 + 2


def test_backends_are_refused(tmp_path: Path) -> None:
    for options, message in (
        ({"backend": "slurm"}, "There is no backend 'slurm'. Available: 'local', 'dask', 'ray', 'here'."),
        ({"backend": "local", "address": "tcp://a:1"}, "Only dask and ray have an address"),
        ({"backend": "here", "jobs": 0}, "'jobs' must be at least 1, got 0."),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            run_sweep(SHORT, tmp_path, job=made, **options)  # type: ignore[arg-type]


def test_the_outcome_is_in_every_row() -> None:
    assert set(OUTCOME) <= set(made(SHORT.grid[0]))
