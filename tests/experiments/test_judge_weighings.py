"""Tables of weighings: a mistake is named, a reading that lies off is left out, and sound tables pass."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from _logs import fails, redescribe, refusal_of, run, run_for_json
from _streams import stream

from surefoot.calibration import GRAVITY, Curves
from surefoot.experiments.logs.columns import raw_names_of
from surefoot.experiments.logs.format import Log, LogError, read_log, write_log
from surefoot.experiments.walks.replay import with_map
from surefoot.experiments.weights.judge import Weighings, find_memory, judge_weighings
from surefoot.experiments.weights.page import falls
from surefoot.sensors.stages.hysteresis import hysteresis
from surefoot.sensors.stages.mechanics import SMALLEST_LOOP

SHAPES = ("one cell", "four cells", "single readings", "four loads")
MISTAKES = ("rail", "off", "labels", "dead", "grams", "curve", "newtons")
LOOP = np.repeat((0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 3.0, 2.0, 1.0, 0.5, 0.0), 3)  # weights in kg, up and down


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_table_of_spoilt_weighings(spoilt: ModuleType, shape: str, mistake: str) -> None:
    """Each of 28 kinds, of which each is named first."""
    names, refuses, spoil = spoilt.WEIGHING_SPOILERS[mistake]
    for seed in range(2):
        findings = judge_weighings(spoil(spoilt.weigh(shape, seed), np.random.default_rng(seed))).findings
        assert findings[0].name in names
        assert findings[0].refuses == refuses


@pytest.mark.parametrize("shape", SHAPES)
def test_sound_tables_pass(spoilt: ModuleType, shape: str) -> None:
    for seed in range(6):
        judged = judge_weighings(spoilt.weigh(shape, seed))
        assert [one for one in judged.findings if one.name != "shared weight"] == []
        assert np.isfinite(judged.kept).all()


@pytest.mark.parametrize("seed", [27, 171])
def test_a_dead_cell_says_nothing_of_units(seed: int) -> None:
    """By chance the counts of these change with the load by five of what a robust line leaves."""
    load, rng = GRAVITY * np.repeat([0.0, 1.0, 2.0, 4.0], 3), np.random.default_rng(seed)
    code = np.rint(84000 + 30.0 * rng.standard_normal((len(load), 1)))
    findings = judge_weighings(Weighings(load, code, ("raw_a_count",), "load_kg", GRAVITY)).findings
    assert [one.name for one in findings] == ["dead cell"]


def test_a_dead_cell_that_drifts_between_weights_is_dead() -> None:
    """Repeats right after each other do not show it, and are no measure of what a slope is worth."""
    found = []
    for seed in range(20):
        rng, load = np.random.default_rng(seed), GRAVITY * np.repeat([0.0, 1.0, 2.0, 3.0, 4.0, 5.0], 3)
        code = 84000 + np.repeat(30.0 * rng.standard_normal(6), 3) + 3.0 * rng.standard_normal(18)
        table = Weighings(load, np.rint(code[:, None]), ("raw_a_count",), "load_kg", GRAVITY)
        found.append(judge_weighings(table).findings[0])
    assert all(one.refuses for one in found)
    # Of others one weight less would make a line.
    assert sum(one.name == "dead cell" for one in found) > 15


@pytest.mark.parametrize("cells", [2, 3])
def test_cells_without_a_weight_are_to_be_left_empty(cells: int) -> None:
    load, rng = np.tile(np.repeat([0.0, 1.0, 2.0, 4.0], 3), cells), np.random.default_rng(0)
    code = 84000 + 30.0 * rng.standard_normal((len(load), cells))
    code += 1e5 * np.kron(np.eye(cells), np.ones((12, 1))) * load[:, None]
    names = tuple(f"raw_{i}_count" for i in range(cells))
    table = Weighings(GRAVITY * load, np.rint(code), names, "load_kg", GRAVITY)
    first = judge_weighings(table).findings[0]
    assert first.cure.startswith("Leave its readings empty where the weight rested on another cell;")
    own = np.where(np.kron(np.eye(cells), np.ones((12, 1))) > 0.0, table.code, np.nan)
    assert judge_weighings(replace(table, code=own)).findings == []


def test_a_label_of_another_load_is_named(spoilt: ModuleType) -> None:
    table = spoilt.weigh("four cells", 5)
    table = replace(table, load=np.where(table.load == 2.0 * GRAVITY, 2.5 * GRAVITY, table.load))
    (first,) = judge_weighings(table).findings
    assert "the readings under 2.5 are those of 2 (probability 9" in first.reason


def write(table: Weighings, path: Path) -> Path:
    lines = [f"{table.column},{','.join(table.cells)}"]
    for load, codes in zip(table.load / table.unit, table.code, strict=True):
        lines.append(f"{load:g}," + ",".join(f"{code:.0f}" for code in codes))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_reading_at_the_rail_does_not_turn_the_line(spoilt: ModuleType, tmp_path: Path) -> None:
    sound = spoilt.weigh("one cell", 3)
    scales = []
    for table in (sound, spoilt.count(sound, 7, 8388607)):
        path = write(table, tmp_path / "scales.csv")
        told = run_for_json("calibrate", "weights", path)
        said = json.loads((tmp_path / "scales.map.json").read_text())
        scales.append(said["scale_N_per_count"][0])
        assert said["notices"] == told["notices"]
    assert scales[1] == pytest.approx(scales[0], rel=1e-3)
    assert said["notices"][0].startswith(
        "scales.csv: Column 'raw_c0_count': 1 of 30 readings lie off the line of "
    )
    assert said["notices"][0].endswith("(line 9 of the file, such as 8388607). They are left out.")


def test_a_page_does_not_replace_its_map(spoilt: ModuleType, tmp_path: Path) -> None:
    path = write(spoilt.weigh("one cell", 3), tmp_path / "scales.csv")
    result = run("calibrate", "weights", path, "--out", tmp_path / "map.html", code=2)
    assert "end the name in .json" in result.stderr
    assert not (tmp_path / "map.html").exists()


def test_exchanged_labels_end_the_command(spoilt: ModuleType, tmp_path: Path) -> None:
    table = spoilt.weigh("one cell", 3)
    load = table.load / GRAVITY
    table = replace(table, load=GRAVITY * np.where(load == 1, 2, np.where(load == 2, 1, load)))
    path = write(table, tmp_path / "scales.csv")
    result = run("calibrate", "weights", path, code=3)
    assert "in column 'load_kg' the labels 1 and 2 are exchanged (probability 9" in result.stderr
    assert not (tmp_path / "scales.map.json").exists()
    result = run("calibrate", "weights", path, "--accept", "they are right")
    assert "Note: scales.csv: accepted (they are right): The weighings contradict each other" in result.stdout


def loop(share: float, seed: int, drift: float = 0.0) -> Weighings:
    """Weigh a cell with hysteresis, whose loops have a size of their own, up and down."""
    rng, load = np.random.default_rng(seed), GRAVITY * LOOP
    element = hysteresis(share, load.max() * 2.0 ** rng.uniform(0.0, 1.0), smallest=SMALLEST_LOOP)
    felt = stream(element, load[:, None], dt=0.0)[:, 0]
    code = 84000 + 1e4 * (felt + drift * np.linspace(0.0, 1.0, len(load)))
    code = np.rint(code + 30.0 * rng.standard_normal(len(load)))[:, None]
    return Weighings(load, code, ("raw_a_count",), "load_kg", GRAVITY)


@pytest.mark.parametrize("share", [0.0, 1e-3, 1e-2, 5e-2])
def test_hysteresis_of_weights_up_and_down_is_found(share: float) -> None:
    off, names = [], []
    for seed in range(30):
        table = loop(share, seed)
        names.append([one.name for one in judge_weighings(table).findings])
        memory = find_memory(table.load, table.code[:, 0], None)
        assert memory is not None
        off.append((memory.hysteresis - share) / memory.hysteresis_std)
    assert names == [["hysteresis"] if share else []] * 30
    assert np.mean(np.abs(off) < 1.645) > 0.75


def test_a_drift_is_no_hysteresis() -> None:
    table = loop(0.0, 1, drift=1.0)
    (found,) = judge_weighings(table).findings
    assert found.name == "drift"
    assert "'raw_a_count' drifts while it is weighed, by +1 N from its first row to its last." in found.reason


def test_a_drift_under_rising_loads_is_refused() -> None:
    """Their order is that of time, so that the scale would take the drift for load."""
    load = GRAVITY * np.repeat([0.0, 0.5, 1.0, 2.0, 4.0], 4)
    rng, names = np.random.default_rng(3), ("raw_a_count",)
    noise, drift = 20.0 * rng.standard_normal(len(load)), np.linspace(0.0, 1.0, len(load))
    for newtons, refused in ((0.0, []), (0.3, [False]), (-2.5, [True])):
        code = 84000 + 1e4 * (load + newtons * drift) + noise
        found = judge_weighings(Weighings(load, np.rint(code)[:, None], names, "load_kg", GRAVITY)).findings
        assert [one.refuses for one in found if one.name == "drift"] == refused
    memory = find_memory(load, np.rint(code), None)
    assert memory is not None
    assert not memory.loops
    assert memory.drift == pytest.approx(-2.5, rel=0.1)  # in newtons of a line that it turned


def test_a_tare_in_the_middle_is_named() -> None:
    load = GRAVITY * np.repeat([0.0, 0.5, 1.0, 2.0, 3.0, 0.0, 2.0], 3)
    rng, names = np.random.default_rng(4), ("raw_a_count", "raw_b_count")
    code = 84000 + np.array([1.1e4, 0.9e4]) * load[:, None] + 20.0 * rng.standard_normal((len(load), 2))
    code[9:, 1] -= 30000.0
    (first,) = judge_weighings(Weighings(load, np.rint(code), names, "load_kg", GRAVITY)).findings
    assert (first.name, first.refuses) == ("zero jump", True)
    assert "the zero of column 'raw_b_count' jumps by -3" in first.reason
    assert "before line 11 " in first.reason


def test_cells_that_share_a_weight_are_noted() -> None:
    """A weight on a plate of four cells, which each column would take for its own."""
    load = GRAVITY * np.repeat([0.0, 1.0, 2.0, 4.0], 3)
    code = np.rint(84000 + 1e4 * np.array([0.2, 0.3, 0.25, 0.25]) * load[:, None])
    code += np.random.default_rng(5).integers(-20, 20, code.shape)
    cells = tuple(f"raw_{name}_count" for name in "abcd")
    (found,) = judge_weighings(Weighings(load, code, cells, "load_kg", GRAVITY)).findings
    assert (found.name, found.refuses) == ("shared weight", False)
    assert "In 9 rows 4 cells follow the load" in found.reason


def test_hysteresis_is_said_with_its_size(tmp_path: Path) -> None:
    path = write(loop(0.01, 2), tmp_path / "scales.csv")
    told = run_for_json("calibrate", "weights", path)
    (row,) = told["tables"]["weighings"]["rows"]
    assert row["hysteresis (% of full scale)"]["value"] == pytest.approx(1.0, abs=0.03)
    (note,) = told["notices"]
    assert re.search(
        r"on the way up: a hysteresis of 1\.\d+ ± 0\.0\d+ % of full scale, 0\.(5|49) N at half", note
    )
    assert note.endswith("No line or curve undoes it: forces are off by up to half of it, up or down.")
    said = json.loads((tmp_path / "scales.map.json").read_text())
    assert said["hysteresis"][0] == pytest.approx(0.01, abs=3e-4)
    page = (tmp_path / "scales.map.html").read_text()
    assert told["files"]["report"] == str(tmp_path / "scales.map.html")
    assert "data:image/svg+xml" in page
    assert "a hysteresis of 1" in page


def test_hysteresis_of_a_curve_is_no_drift() -> None:
    """Four loads are too few for a curve."""
    table = loop(0.05, 3)
    rows = np.isin(table.load / GRAVITY, (0.0, 1.0, 2.0, 5.0))
    felt = (table.code[rows] - 84000.0) / 1e4
    code = np.rint(1023.0 * felt / (felt + 20.0))
    found = judge_weighings(replace(table, load=table.load[rows], code=code)).findings
    assert "hysteresis" in [one.name for one in found]
    assert "drift" not in [one.name for one in found]


def test_loads_are_told_up_from_down() -> None:
    load = np.array([0.0, 0.0, 1.0, 1.0, 2.0, 1.0, 1.0, 0.0, 1.0])
    np.testing.assert_array_equal(falls(load), [0, 0, 0, 0, 0, 1, 1, 1, 0])


def test_exact_readings_are_as_sure_as_their_rounding(tmp_path: Path) -> None:
    path = tmp_path / "scales.csv"
    path.write_text("load_kg,raw_a_count\n0,100\n1,50100\n2,100100\n3,150100\n")
    (row,) = run_for_json("calibrate", "weights", path)["tables"]["weighings"]["rows"]
    # A rounded count has a standard deviation of 0.29, over four readings that spread by 112,000 in all.
    plus_minus = row["scale (1e-6 N/count), ± one sigma"]["plus_minus"]
    assert plus_minus == pytest.approx(196.133 * np.sqrt(1 / 12) / 111803.4, rel=1e-3)


def test_a_log_starts_from_a_file_of_weights(log: Log, tmp_path: Path, undrawn: None) -> None:
    load = np.repeat([0.0, 1.0, 2.0, 4.0], 2)
    code = 8e6 + 1000 * np.arange(8) + 5e5 * load[:, None]
    names = tuple(raw_names_of(log.layout))
    path = write(Weighings(load * GRAVITY, code, names, "load_kg", GRAVITY), tmp_path / "scales.csv")
    run("calibrate", "weights", path)
    started = with_map(log, tmp_path / "scales.map.json").calibrated
    assert started is not None
    np.testing.assert_allclose(started.scale, GRAVITY / 5e5)
    np.testing.assert_allclose(started.offset, -GRAVITY / 5e5 * (8e6 + 1000 * np.arange(8)))
    walk = write_log(log, tmp_path / "walk.parquet")
    start = ["--start", str(tmp_path / "scales.map.json"), "--method", "none", "--json"]
    run("calibrate", "walk", walk, *start)
    last = json.loads((tmp_path / "walk.none.json").read_text())
    np.testing.assert_allclose(last["scale_N_per_count"], GRAVITY / 5e5)


def test_a_curve_goes_from_the_weights_to_the_walk(log: Log, tmp_path: Path, undrawn: None) -> None:
    """A channel of eight is a resistor; the others keep their lines bit for bit."""
    load = np.repeat([0.0, 0.5, 1.0, 2.0, 3.0, 4.0], 2)
    code = np.rint(8e6 + 1000.0 * np.arange(8) + 5e5 * load[:, None])
    maps = []
    for bent in (False, True):
        if bent:
            code[:, 2] = np.rint(8e6 + 2e6 * load / (load + 2.0))
        path = write(
            Weighings(load * GRAVITY, code, tuple(raw_names_of(log.layout)), "load_kg", GRAVITY),
            tmp_path / "scales.csv",
        )
        run("calibrate", "weights", path)
        maps.append(json.loads((tmp_path / "scales.map.json").read_text()))
    line, curve = maps
    assert "curves" not in line
    kept = [i for i in range(8) if i != 2]
    for key in ("scale_N_per_count", "offset_N", "scale_std_N_per_count"):
        assert [line[key][i] for i in kept] == [curve[key][i] for i in kept]
    assert [one is None for one in curve["curves"]] == [i != 2 for i in range(8)]
    note, _ = curve["notices"]  # and all cells were weighed at once
    assert "Column 'raw_left_rear_left_count' is no line: under " in note
    assert "A monotone cubic takes its place; weights that were left out are found to " in note

    curves = Curves.from_plain(curve["curves"], 8)
    started = with_map(log, tmp_path / "scales.map.json")
    np.testing.assert_array_equal(started.raw, curves.straighten(log.raw))
    assert started.calibrated is not None
    read = started.calibrated.force(curves.straighten(code))
    np.testing.assert_allclose(read, np.repeat(load[:, None] * GRAVITY, 8, axis=1), atol=0.02)
    walk = write_log(log, tmp_path / "walk.parquet")
    start = ["--start", str(tmp_path / "scales.map.json"), "--method", "none"]
    run("calibrate", "walk", walk, *start)
    assert json.loads((tmp_path / "walk.none.json").read_text())["curves"] == curve["curves"]
    fails(
        ["calibrate", "walk", walk, *start, "--ros2"],
        "walk.parquet: a ROS 2 node takes no curves, and the map to start from has some.",
    )


def test_a_description_may_hold_curves(log: Log, path: Path) -> None:
    curves = Curves([None] * 7 + [[[7e6, 8e6, 9e6], [7e6, 8.2e6, 9e6]]])
    redescribe(path, curves=curves.as_plain())
    read = read_log(path)
    np.testing.assert_array_equal(read.raw, curves.straighten(log.raw))
    assert read.about["curves"] == curves.as_plain()
    redescribe(path, curves=[None])
    assert "'curves' must be a list of 8, null for a channel without one" in refusal_of(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1]", "is no map (TypeError "),
        ('{"channels": ["a"], "scale_N_per_count": [1.0]}', "is no map (KeyError 'offset_N')"),
        (
            '{"channels": ["a"], "scale_N_per_count": [1.0], "offset_N": [0.0]}',
            "holds no map for the channel 'left_front_left'; it has ['a'].",
        ),
    ],
)
def test_a_file_that_is_no_map_is_refused(log: Log, tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "map.json"
    path.write_text(text)
    with pytest.raises(LogError) as refused:
        with_map(log, path)
    assert message in str(refused.value)
