"""A study of walks from end to end: what it writes, that it can be interrupted, and what it refuses."""

import dataclasses
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from _logs import run as run_command

from surefoot.calibration import METHODS
from surefoot.experiments.logs.format import Log, read_log
from surefoot.experiments.walks import run, scenarios
from surefoot.experiments.walks.options import WalkStudyOptions
from surefoot.experiments.walks.page import write_walks_page
from surefoot.experiments.walks.play import Stream, play
from surefoot.experiments.walks.record import record_walk
from surefoot.experiments.walks.run import WalkStudyResults, run_walk_study
from surefoot.experiments.walks.scenarios import SCENARIOS, TRUE_MAP, Scenario, find_scenarios, log_paths
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.sensors import ForceTorque

RUN = ("speed-0.1", "instant-0.1", "fault-dropped")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> WalkStudyResults:
    options = WalkStudyOptions(
        out=tmp_path_factory.mktemp("walks"),
        seeds=2,
        scenarios=RUN,
        methods=("none", "tare"),
        jobs=1,
        duration=STAND_TIME + 5.5,
        settle=STAND_TIME + 1.0,
    )
    return run_walk_study(options)


@pytest.mark.slow
def test_every_run_is_scored(results: WalkStudyResults) -> None:
    scores = results.scores
    assert len(scores) == len(RUN) * 3 * 2
    assert set(scores["method"]) == {TRUE_MAP, "none", "tare"}
    assert np.isfinite(scores[["cop", "vgrf", "cell"]].to_numpy()).all()
    means = scores.groupby(["scenario", "method"])["cop"].mean()
    for name in ("speed-0.1", "instant-0.1"):
        assert means[name, TRUE_MAP] < means[name, "tare"] < means[name, "none"]
    # Cells that convert when they are asked have no age: the true map leaves their noise alone.
    assert means["instant-0.1", TRUE_MAP] < 1e-4 < means["speed-0.1", TRUE_MAP]
    assert not scores[scores["method"] == "none"]["worse"].any()
    dropped = scores[(scores["scenario"] == "fault-dropped") & (scores["method"] != TRUE_MAP)]
    assert (dropped["found"] < 0.02).all()
    assert (dropped[["isolated", "named"]] == 1.0).all(axis=None)


@pytest.mark.slow
def test_walks_are_shared_and_kept(results: WalkStudyResults, monkeypatch: pytest.MonkeyPatch) -> None:
    logs = results.options.out / "logs"
    # Two seeds of two walks, each read by cells of two kinds.
    assert len(list(logs.iterdir())) == 8
    monkeypatch.setattr(scenarios, "record_walk", _must_not_run)
    monkeypatch.setattr(run, "play", _must_not_run)
    again = run_walk_study(results.options)
    pd.testing.assert_frame_equal(again.scores, results.scores)
    assert again.left_out == results.left_out


def _must_not_run(*_: object, **__: object) -> None:
    raise AssertionError("this was done before and is kept")


@pytest.mark.slow
def test_a_new_method_leaves_old_scores_alone(
    results: WalkStudyResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played: list[str] = []
    original = run.play
    monkeypatch.setattr(
        run,
        "play",
        lambda streams, method, **more: played.append(method) or original(streams, method, **more),
    )
    folder = shutil.copytree(results.options.out, tmp_path / "walks")
    methods = ("none", "tare", "quasi-static")
    more = dataclasses.replace(results.options, out=folder, scenarios=("speed-0.1",), methods=methods)
    assert set(run_walk_study(more).scores["method"]) == {TRUE_MAP, "none", "tare", "quasi-static"}
    assert played == ["quasi-static"]


def test_another_option_is_another_file(tmp_path: Path) -> None:
    walk = Scenario("w", "w")
    names = {
        log_paths(one, seed, duration, tmp_path)["chips"].name
        for one in (walk, dataclasses.replace(walk, beliefs={"errors": {"mass": 0.02}}))
        for seed in (0, 1)
        for duration in (10.0, 12.0)
    }
    assert len(names) == 8


@pytest.mark.slow
def test_the_page_holds_everything(results: WalkStudyResults, undrawn: None) -> None:
    text = write_walks_page(results).page.read_text(encoding="utf-8")
    assert not re.search(r"(?:src|href)=\"(?!data:|#)", text)
    for name in RUN:
        assert f'<section id="{name}">' in text
    out = results.options.out
    pd.testing.assert_frame_equal(
        pd.read_parquet(out / "tables" / "scores.parquet"), results.scores, check_like=True
    )
    tare = results.scores[(results.scores["scenario"] == "speed-0.1") & (results.scores["method"] == "tare")]
    assert f"{1e3 * tare['cop'].mean():.2f} ± " in text


@pytest.mark.slow
def test_the_command(tmp_path: Path) -> None:
    answer = run_command("compare", "walking", "--scenario", "moon", "--out", tmp_path, code=2)
    assert "There is no scenario 'moon'. Available: speed-0.02" in answer.output
    answer = run_command("compare", "walking", "--method", "magic", "--out", tmp_path, code=2)
    assert "Method 'magic' does not exist." in answer.output


def test_options_refuse_what_cannot_be_done() -> None:
    with pytest.raises(ValueError, match="'seeds' must be at least 1, got 0"):
        WalkStudyOptions(seeds=0)
    with pytest.raises(ValueError, match="'settle' must lie between 4 s of standing"):
        WalkStudyOptions(settle=50.0)
    quick = WalkStudyOptions(seeds=9).quickly()
    assert quick.seeds == 2
    assert WalkStudyOptions().rows == (TRUE_MAP, *METHODS)
    assert WalkStudyOptions(methods=("moment",)).rows == (TRUE_MAP, "moment")


def test_scenarios_are_the_ones_that_were_asked_for() -> None:
    assert not any(scenario.long for scenario in find_scenarios((), quick=True))
    walked = {name for name, scenario in SCENARIOS.items() if scenario.study == "walks"}
    assert {s.name for s in find_scenarios((), quick=False)} == walked
    for scenario in SCENARIOS.values():
        assert scenario.condition in {condition.name for condition in scenario.cells}
        assert scenario.answers
    # Cells are read by one walk: its recording serves all that ask something else of it.
    assert SCENARIOS["fault-dead"].walk == SCENARIOS["instant-0.04"].walk == SCENARIOS["speed-0.04"].walk
    assert SCENARIOS["standing-held"].walk != SCENARIOS["standing"].walk
    assert "(flipped; none" in SCENARIOS["fault-flipped"].answers
    swapped = SCENARIOS["fault-swapped"]
    for seed in range(20):
        (fault,) = swapped.faults_of(seed, 18.0)
        assert fault.other is not None
        assert fault.other // 4 == fault.channel // 4
        assert 18.0 <= fault.start <= 19.6
    assert {swapped.faults_of(seed, 18.0)[0].channel for seed in range(60)} == set(range(8))


@pytest.mark.slow
def test_a_clock_error_moves_the_reference_and_nothing_else() -> None:
    instant = SCENARIOS["instant-0.1"].cells[1:]
    right = record_walk(0.1, 2, STAND_TIME + 2.0, instant)["instant"]
    late = record_walk(0.1, 2, STAND_TIME + 2.0, instant, clock_error=2 * right.dt)["instant"]
    np.testing.assert_array_equal(late.raw, right.raw)
    # Two samples late: what is believed now was right two samples ago, while telemetry is complete.
    walking = right.time > STAND_TIME
    for name in ("com", "accelerometer"):
        now, then = getattr(late.reference, name)[walking][2:], getattr(right.reference, name)[walking][:-2]
        assert (
            np.abs(now - then).max() < 0.05 * np.abs(now - getattr(right.reference, name)[walking][2:]).max()
        )


@pytest.mark.slow
def test_beliefs_and_sensors_are_altered(results: WalkStudyResults) -> None:
    paths = sorted((results.options.out / "logs").glob("*_instant_seed0_*.parquet"))
    plain = read_log(paths[0])
    beliefs = {"errors": {"mass": 0.02}}
    instant = SCENARIOS["instant-0.1"].cells[1:]
    heavy = record_walk(0.1, 0, STAND_TIME + 1.0, instant, beliefs=beliefs)["instant"]
    true_mass = plain.mass / (1.0 + np.sign(plain.mass - 5.305) * 0.005)
    assert abs(heavy.mass / true_mass - 1.0) == pytest.approx(0.02, abs=1e-3)


@pytest.fixture(scope="module")
def ankles() -> dict[str, Log]:
    return record_walk(0.1, 1, STAND_TIME + 2.0, SCENARIOS["ankle-ft"].cells)


@pytest.mark.parametrize("name", ["ankle", "both"])
def test_six_axis_sensors_are_undone_up_to_their_noise(ankles: dict[str, Log], name: str) -> None:
    log = ankles[name]
    assert log.truth is not None
    stream = Stream(log=log, seed=1, judged=log.time >= STAND_TIME, began=STAND_TIME)
    (floor,), (start,) = play([stream], TRUE_MAP), play([stream], "none", foot_length=0.17)
    error, before = (one.force - log.truth.force for one in (floor, start))
    names = np.array([channel.rpartition("/")[2] for channel in log.layout.channel_names])
    config = ForceTorque()
    for axes, noise, gain in ((["fx", "fy", "fz"], config.noise_force, 0.08), (["tx"], 0.0025, 0.08)):
        chosen = np.isin(names, axes)
        # Undoing a gain of 8 % and cross-talk of 1 % scales the noise by little more.
        assert np.sqrt(np.mean(error[:, chosen] ** 2)) == pytest.approx(noise, rel=3 * gain)
        assert np.sqrt(np.mean(before[:, chosen] ** 2)) > 5 * noise


def test_an_ankle_tells_what_the_cells_tell(ankles: dict[str, Log]) -> None:
    both, ankle = ankles["both"], ankles["ankle"]
    assert both.truth is not None
    assert ankle.truth is not None
    cells = [i for i, name in enumerate(both.layout.channel_names) if "front" in name or "rear" in name]
    total = [i for i, name in enumerate(ankle.layout.channel_names) if name.endswith("/fz")]
    by_cells = both.truth.force[:, cells].reshape(-1, 2, 4).sum(axis=-1)
    by_ankle = ankle.truth.force[:, total]
    # What is left is the inertia of the foot between the two, of 0.17 kg.
    assert np.sqrt(np.mean((by_cells - by_ankle) ** 2)) < 0.5
    # Both are read in the order left cells, left ankle, right cells, right ankle.
    names = [name.partition("/")[0] for name in both.layout.channel_names]
    assert names == ["left"] * 10 + ["right"] * 10
    ankles_of_both = [i for i in range(20) if i not in cells]
    np.testing.assert_array_equal(both.truth.force[:, ankles_of_both], ankle.truth.force)


@pytest.mark.slow
def test_what_fails_is_left_out_and_named(
    results: WalkStudyResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, undrawn: None
) -> None:
    original = run.play

    def play_or_fail(streams: Any, method: str, **more: Any) -> Any:
        if method == "tare":
            raise RuntimeError("no tare today")
        return original(streams, method, **more)

    monkeypatch.setattr(run, "play", play_or_fail)
    folder = shutil.copytree(results.options.out, tmp_path / "walks")
    shutil.rmtree(folder / "results")
    found = run_walk_study(dataclasses.replace(results.options, out=folder, scenarios=("speed-0.1",)))
    assert list(found.failures) == ["speed-0.1 tare"]
    assert set(found.scores["method"]) == {TRUE_MAP, "none"}
    assert "RuntimeError: no tare today" in write_walks_page(found).page.read_text(encoding="utf-8")
    monkeypatch.setattr(run, "streams_of", lambda *_: 1 / 0)
    shutil.rmtree(folder / "results")
    with pytest.raises(ValueError, match=r"No case could be scored\. The first, 'speed-0\.1 floor': "):
        run_walk_study(found.options)
