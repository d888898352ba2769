"""The scenarios of benchmarks/walks.py: what they ask, that scores are right, and what tables say of them."""

import numpy as np
import pandas as pd
import pytest

from surefoot.calibration import METHODS
from surefoot.experiments.logs.format import Log
from surefoot.experiments.walks.record import record_walk
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.sensors import ForceTorque


@pytest.fixture(scope="module")
def script(benchmark_script):
    return benchmark_script("walks")


@pytest.fixture(scope="module")
def streams(benchmark_script):
    return benchmark_script("streams")


SHORT = {"duration": STAND_TIME + 6.5, "settle": STAND_TIME + 1.0}


@pytest.mark.slow
def test_scenarios_that_share_a_walk_are_scored_on_one_recording(script, monkeypatch):
    recorded, original = [], script.record_walk
    monkeypatch.setattr(script, "record_walk", lambda *a, **k: recorded.append(a) or original(*a, **k))
    names = ("speed-0.1", "instant-0.1", "fault-dropped")
    walks = script.walks_of([script.SCENARIOS[name] for name in names], 1, **SHORT)
    methods = ("true-map", "none", "tare")
    scores = pd.DataFrame([row for walk in walks for row in script.score(walk, methods)["scores"]])
    assert len(recorded) == len(walks) == 2
    assert len(scores) == len(names) * len(methods)
    cop = scores.set_index(["scenario", "method"])["cop"]
    for name in ("speed-0.1", "instant-0.1"):
        assert cop[name, "true-map"] < cop[name, "tare"] < cop[name, "none"]
    # Cells that convert when they are asked have no age: the true map leaves only their noise.
    assert cop["instant-0.1", "true-map"] < 1e-4 < cop["speed-0.1", "true-map"]
    dropped = scores[(scores["scenario"] == "fault-dropped") & (scores["method"] != "true-map")]
    assert (dropped["found"] < 0.02).all()
    assert (dropped[["isolated", "named"]] == 1.0).all(axis=None)


def test_scenarios_are_the_ones_that_were_asked_for(script):
    scenarios = script.SCENARIOS
    assert not any(one.long for one in script.find_scenarios((), quick=True))
    assert {one.study for one in script.find_scenarios((), quick=False)} == {"walks"}
    with pytest.raises(ValueError, match=r"no scenario 'moon'\. Available: speed-0\.02"):
        script.find_scenarios(("moon",), quick=False)
    for one in scenarios.values():
        assert one.condition in {condition.name for condition in one.cells}
        assert one.question
    assert scenarios["fault-dead"].walk == scenarios["instant-0.04"].walk == scenarios["speed-0.04"].walk
    assert scenarios["standing-held"].walk != scenarios["standing"].walk
    walks = script.walks_of([scenarios["speed-0.04"], scenarios["half-an-hour"]], 5)
    assert [walk.scenarios[0] for walk in walks].count("half-an-hour") == 3


def test_a_fault_is_drawn_within_a_stride_and_swaps_stay_on_a_foot(script):
    swapped = script.SCENARIOS["fault-swapped"]
    faults = [swapped.faults_of(seed, 18.0)[0] for seed in range(60)]
    assert all(fault.other // 4 == fault.channel // 4 and fault.other != fault.channel for fault in faults)
    assert all(18.0 <= fault.start <= 19.6 for fault in faults)
    assert {fault.channel for fault in faults} == set(range(8))


@pytest.mark.slow
def test_a_clock_error_moves_the_reference_and_nothing_else(script):
    instant = script.SCENARIOS["instant-0.1"].cells[1:]
    right = record_walk(0.1, 2, STAND_TIME + 2.0, instant)["instant"]
    late = record_walk(0.1, 2, STAND_TIME + 2.0, instant, clock_error=2 * right.dt)["instant"]
    np.testing.assert_array_equal(late.raw, right.raw)
    # Two samples late: the beliefs of now were right two samples ago, while telemetry is complete.
    walking = right.time > STAND_TIME
    for name in ("com", "accelerometer"):
        true = getattr(right.reference, name)[walking]
        now = getattr(late.reference, name)[walking][2:]
        assert np.abs(now - true[:-2]).max() < 0.05 * np.abs(now - true[2:]).max()


@pytest.fixture(scope="module")
def ankles(script) -> dict[str, Log]:
    return record_walk(0.1, 1, STAND_TIME + 2.0, script.SCENARIOS["ankle-ft"].cells)


@pytest.mark.parametrize("name", ["ankle", "both"])
def test_six_axis_sensors_are_undone_up_to_their_noise(streams, ankles: dict[str, Log], name: str):
    log = ankles[name]
    assert log.truth is not None
    stream = streams.Stream(log=log, seed=1, judged=log.time >= STAND_TIME, began=STAND_TIME)
    played = streams.play(stream, "true-map"), streams.play(stream, "none", foot_length=0.17)
    error, before = (one.force - log.truth.force for one in played)
    names = np.array([channel.rpartition("/")[2] for channel in log.layout.channel_names])
    for axes, noise, gain in ((["fx", "fy", "fz"], ForceTorque().noise_force, 0.08), (["tx"], 0.0025, 0.08)):
        chosen = np.isin(names, axes)
        # Undoing a gain of 8 % and cross-talk of 1 % scales the noise by little more.
        assert np.sqrt(np.mean(error[:, chosen] ** 2)) == pytest.approx(noise, rel=3 * gain)
        assert np.sqrt(np.mean(before[:, chosen] ** 2)) > 5 * noise


def test_an_ankle_measures_the_same_as_the_cells(ankles: dict[str, Log]):
    both, ankle = ankles["both"], ankles["ankle"]
    assert both.truth is not None
    assert ankle.truth is not None
    cells = [i for i, name in enumerate(both.layout.channel_names) if "front" in name or "rear" in name]
    total = [i for i, name in enumerate(ankle.layout.channel_names) if name.endswith("/fz")]
    by_cells = both.truth.force[:, cells].reshape(-1, 2, 4).sum(axis=-1)
    # The rest is the inertia of the foot between the two, of 0.17 kg.
    assert np.sqrt(np.mean((by_cells - ankle.truth.force[:, total]) ** 2)) < 0.5
    # Channels are in the order left cells, left ankle, right cells, right ankle.
    names = [name.partition("/")[0] for name in both.layout.channel_names]
    assert names == ["left"] * 10 + ["right"] * 10
    ankles_of_both = [i for i in range(20) if i not in cells]
    np.testing.assert_array_equal(both.truth.force[:, ankles_of_both], ankle.truth.force)


def rows(scenario: str, cop: dict[str, list[float]], **changes: object) -> pd.DataFrame:
    """One row per run, in which only the CoP errors (mm) differ between methods."""
    found = [
        {"scenario": scenario, "method": method, "seed": seed, "cop": 1e-3 * value}
        for method, values in cop.items()
        for seed, value in enumerate(values)
    ]
    common = {"fell": False, "cop_foot": 2e-3, "vgrf": 0.3, "cell": 0.35, "scale": 0.01, "offset": 0.1}
    common |= {"worse_cop": False, "worse_cop_foot": False, "nees_end": np.nan, "parameters": 16.0}
    common |= {"alarms": 0.0, "hours": 0.5}
    return pd.DataFrame(found).assign(**(common | changes))


def test_differences_from_the_filter_are_paired_and_missing_numbers_are_dashes(script):
    plain = script.SCENARIOS["speed-0.04"]
    cop = {"moment": [4, 5, 6], "tare": [7, 8, 9.3], "none": [4, 9, 7.5], "true-map": [1, 1, 1]}
    table = script.scenario_table(rows(plain.name, cop), plain)
    found = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    behind = {name: row["CoP, more than moment, paired (mm)"] for name, row in found.items()}
    assert behind["swing tare"] == "3.10 ± 0.43"
    assert behind["swing tare"].good
    assert behind["moment"] == ""
    assert not hasattr(behind["raw (none)"], "good")
    assert behind["true map"] == found["true map"]["ends worse"] == found["moment"]["NEES"] == "–"


def test_alarm_rates_have_an_exact_interval(script):
    scores = rows("speed-0.04", {"tare": [1, 1], "true-map": [1, 1]}, alarms=1.0)
    # Two events: Garwood's interval of a Poisson mean is 0.242 to 7.22.
    assert script.alarm_table(scores).rows == (("swing tare", "1.00", "2", "2.00", "0.242 to 7.22"),)


def test_falls_are_counted(script):
    soft = script.SCENARIOS["soft-ground"]
    scores = rows(soft.name, {"none": [10, 10], "window": [6, 6]}, fell=[True, False] * 2)
    assert script.scenario_table(scores, soft).note.endswith("Walks that end in a fall: 1.")


def test_the_baseline_scores_nothing_by_construction(benchmark_script):
    paper = benchmark_script("cop_paper")
    level = {"none": 0.0, "window": 5.0}
    found = pd.DataFrame(
        {
            "condition": "paper", "speed": 0.04, "seed": seed, "method": method, "against": against,
            "cop": 1e-3 * (value + 0.1 * seed * (value > 0)), "vgrf": value / 10,
            "cop_foot": 1e-3, "cell": 0.5,
        }
        for method, value in level.items()
        for seed in range(5)
        for against in ("truth", "baseline")
    )  # fmt: skip
    window, raw = sorted(
        paper.walking_table(found, 0.04).rows, key=lambda row: row[1] != "window (CoP paper)"
    )
    assert raw[2] == "0 *"
    assert window[2:4] == ("5.20 ± 0.20", "10.8")


@pytest.mark.slow
def test_the_reference_and_the_true_map_are_closest_to_the_truth(script, benchmark_script):
    paper = benchmark_script("cop_paper")
    (walk,) = script.walks_of([script.SCENARIOS["bad-start-0.1"]], 1, **SHORT)
    found = pd.DataFrame(paper.score(walk)["yardsticks"])
    assert set(found["method"]) == {"baseline", "reference", "true-map", *METHODS}
    truth = found[found["against"] == "truth"].set_index("method")
    assert truth["cell"].idxmin() == "true-map"
    assert truth["cop"]["reference"] < truth["cop"]["none"]
