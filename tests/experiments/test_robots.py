"""Robots that others made: they do the same on any feet, and a study needs no package."""

import numpy as np
import pandas as pd
import pytest

from surefoot.envs.exercise.held import HeldRobot
from surefoot.experiments.walks import robots as study
from surefoot.experiments.walks.robots import METHODS, Motion, claims_of, compare_robots, run_robot

FALLS = Motion("Walker2d-v5", "falling", 0.3)


def test_the_robot_does_the_same_whatever_its_feet_are_calibrated_by() -> None:
    rows = run_robot(FALLS, "load cells", seed=3, duration=1.6)["scores"]
    assert [row["method"] for row in rows] == list(METHODS)
    assert rows[0]["falls"] > 0
    assert {row["falls"] for row in rows} == {rows[0]["falls"]}
    assert len({row["vgrf"] for row in rows}) > 1


@pytest.mark.parametrize(
    "name",
    [
        "nao",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("g1", "h1", "t1", "op3", "apollo", "berkeley")
        ),
    ],
)
def test_servos_hold_a_robot_in_its_pose_unless_its_targets_are_thrown_about(name: str) -> None:
    try:
        env = HeldRobot(name)
    except ModuleNotFoundError as missing:
        pytest.skip(str(missing))
    still, rng = np.zeros(env.action_space.shape or ()), np.random.default_rng(0)
    env.reset(seed=0)
    assert not any(env.step(still)[2] for _ in range(400))
    env.reset()
    assert any(env.step(rng.uniform(-0.4, 0.4, still.shape))[2] for _ in range(400))


def test_a_claim_counts_the_cases_in_which_the_difference_leaves_its_interval() -> None:
    errors = {
        "none": (1.0, 2.0, 3.0),
        "tare": (1.0, 2.0, 3.0),
        "window": (1.2, 2.2, 3.25),
        "moment": (0.5, 3.9, 2.9),
    }
    about = {"name": "standing", "sensors": "cells", "vgrf": 1.0}
    rows = [
        {"robot": robot, "seed": seed, "method": method, "cop": of[seed], **about}
        for robot in ("a", "b")
        for method, of in errors.items()
        for seed in range(3)
    ]
    tare, window, moment, *_ = claims = claims_of(pd.DataFrame(rows))
    assert (tare.met, window.met, moment.met) == (True, False, True)
    assert (window.measured, moment.measured) == ("2 of 2 (2 in the mean)", "0 of 2 (2 in the mean)")
    assert all(claim.met for claim in claims[3:])


def test_without_the_package_the_others_are_compared_and_the_page_says_so(tmp_path, monkeypatch) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError("The package is not installed.")

    monkeypatch.setattr(study, "load_robot_spec", missing)
    motions = (FALLS, Motion("g1", "standing"))
    report = compare_robots(tmp_path, seeds=2, jobs=1, duration=1.2, motions=motions)
    cells, ankles, claims = report.tables
    assert [row[0] for row in (*cells.rows, *ankles.rows)] == ["Walker2d-v5"] * 2
    assert len(claims.rows) == 2 * len(METHODS[1:])
    assert "Robots of the package are left out: The package is not installed." in report.page.read_text()
    assert (tmp_path / "tables" / "load_cells.csv").is_file()
