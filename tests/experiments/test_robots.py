"""Robots made by others: they do the same on any feet, and servos hold them."""

import numpy as np
import pandas as pd
import pytest

from surefoot.envs.exercise.held import HeldRobot


@pytest.fixture(scope="module")
def script(benchmark_script):
    return benchmark_script("robots")


def test_the_robot_does_the_same_whatever_its_feet_are_calibrated_by(script) -> None:
    falls = script.Motion("Walker2d-v5", "falling", 0.3)
    rows = script.score(falls, "load cells", seed=3, duration=1.6)["scores"]
    assert [row["method"] for row in rows] == list(script.METHODS)
    assert rows[0]["falls"] > 0
    assert {row["falls"] for row in rows} == {rows[0]["falls"]}
    assert len({row["vgrf"] for row in rows}) > 1
    (row,) = script.robot_table(pd.DataFrame(rows), "load cells").rows
    assert row[0] == "Walker2d-v5"


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


def test_harm_counts_the_cases_in_which_the_difference_leaves_its_interval(script) -> None:
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
    tare, window, moment, *of_force = script.harm_table(pd.DataFrame(rows)).rows
    assert (tare[3], window[3], moment[3]) == ("yes", "no", "yes")
    assert (window[2], moment[2]) == ("2 of 2 (2 in the mean)", "0 of 2 (2 in the mean)")
    assert all(row[3] == "yes" for row in of_force)


def test_without_the_package_the_robots_of_gymnasium_are_run(script, monkeypatch, capsys) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError("The package is not installed.")

    monkeypatch.setattr(script, "load_robot_spec", missing)
    assert {motion.packaged for motion in script.runnable(script.MOTIONS)} == {False}
    assert "left out: The package is not installed." in capsys.readouterr().out
