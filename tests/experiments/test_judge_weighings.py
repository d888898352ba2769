"""Tables of weighings: a mistake is named, a reading that lies off is left out, and sound tables pass."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from surefoot.calibration import GRAVITY, Curves
from surefoot.experiments.cli.app import app
from surefoot.experiments.logs.format import Log, LogError, read_log, write_log
from surefoot.experiments.walks.replay import with_map
from surefoot.experiments.weights.judge import Weighings, judge_weighings

RUNNER = CliRunner()
SHAPES = {
    "one cell": (1, (0.0, 0.5, 1.0, 2.0, 3.0, 5.0), 5),
    "four cells": (4, (0.0, 0.5, 1.0, 2.0, 3.0, 5.0), 5),
    "single readings": (1, (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 4.0), 1),
    "four loads": (2, (0.0, 1.0, 2.0, 4.0), 3),
}


def weigh(shape: str, seed: int) -> Weighings:
    cells, loads, repeats = SHAPES[shape]
    rng, load = np.random.default_rng(seed), np.repeat(loads, repeats)
    slope, level = 1e5 * rng.uniform(0.8, 1.2, cells), 84000 + 3e4 * rng.standard_normal(cells)
    code = level + slope * rng.choice([-1, 1], cells) * load[:, None]
    code = np.rint(code + 30.0 * rng.standard_normal(code.shape))
    names = tuple(f"raw_c{i}_count" for i in range(cells))
    return Weighings(load * GRAVITY, code, names, "load_kg", GRAVITY)


def count(table: Weighings, rows: object, values: object) -> Weighings:
    code = table.code.copy()
    code[rows, 0] = values
    return replace(table, code=code)


def off(table: Weighings, rng: np.random.Generator) -> Weighings:
    row = int(rng.integers(len(table.code)))
    return count(table, row, table.code[row, 0] + 5000)


def exchange(table: Weighings, rng: np.random.Generator) -> Weighings:
    a, b = rng.choice(np.unique(table.load), 2, replace=False)
    load = table.load
    return replace(table, load=np.where(load == a, b, np.where(load == b, a, load)))


def bend(table: Weighings, rng: np.random.Generator) -> Weighings:
    code = 84000 + 4e5 * (1.0 - np.exp(-table.load / 30.0)) + 30.0 * rng.standard_normal(len(table.load))
    return count(table, slice(None), np.rint(code))


MISTAKES: dict[str, tuple[set[str], bool, Callable[[Weighings, np.random.Generator], Weighings]]] = {
    "rail": ({"outliers"}, False, lambda t, g: count(t, int(g.integers(len(t.code))), 8388607)),
    "off": ({"outliers"}, False, off),
    "labels": ({"labels"}, True, exchange),
    "dead": (
        {"dead cell"},
        True,
        lambda t, g: count(t, slice(None), np.rint(g.normal(84000, 30, len(t.code)))),
    ),
    "grams": ({"units"}, True, lambda t, _: replace(t, load=1000.0 * t.load)),
    "curve": ({"curve", "scatter"}, False, bend),
    "newtons": ({"newtons"}, True, lambda t, _: replace(t, load=GRAVITY * t.load)),
}


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_table_of_spoilt_weighings(shape: str, mistake: str) -> None:
    """Each of 28 kinds, of which each is named first."""
    names, refuses, spoil = MISTAKES[mistake]
    for seed in range(2):
        findings, _ = judge_weighings(spoil(weigh(shape, seed), np.random.default_rng(seed)))
        assert findings[0].name in names
        assert findings[0].refuses == refuses


@pytest.mark.parametrize("shape", SHAPES)
def test_sound_tables_pass(shape: str) -> None:
    for seed in range(6):
        findings, out = judge_weighings(weigh(shape, seed))
        assert findings == []
        assert not out.any()


def test_a_label_of_another_load_is_named() -> None:
    table = weigh("four cells", 5)
    table = replace(table, load=np.where(table.load == 2.0 * GRAVITY, 2.5 * GRAVITY, table.load))
    (first,), _ = judge_weighings(table)
    assert "the readings under 2.5 are those of 2 (probability more than 99.9 %" in first.reason


def write(table: Weighings, path: Path) -> Path:
    lines = [f"{table.column},{','.join(table.cells)}"]
    for load, codes in zip(table.load / table.unit, table.code, strict=True):
        lines.append(f"{load:g}," + ",".join(f"{code:.0f}" for code in codes))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_reading_at_the_rail_does_not_turn_the_line(tmp_path: Path) -> None:
    sound = weigh("one cell", 3)
    scales = []
    for table in (sound, count(sound, 7, 8388607)):
        path = write(table, tmp_path / "scales.csv")
        result = RUNNER.invoke(app, ["calibrate", "weights", str(path), "--json"])
        assert result.exit_code == 0, result.output
        said = json.loads((tmp_path / "scales.map.json").read_text())
        scales.append(said["scale_N_per_count"][0])
        assert said["notices"] == json.loads(result.stdout)["notices"]
    assert scales[1] == pytest.approx(scales[0], rel=1e-3)
    assert said["notices"][0].startswith(
        "scales.csv: Column 'raw_c0_count': 1 of 30 readings lie off the line of "
    )
    assert said["notices"][0].endswith("(line 9 of the file, such as 8388607). They are left out.")


def test_exchanged_labels_end_the_command(tmp_path: Path) -> None:
    table = weigh("one cell", 3)
    load = table.load / GRAVITY
    table = replace(table, load=GRAVITY * np.where(load == 1, 2, np.where(load == 2, 1, load)))
    path = write(table, tmp_path / "scales.csv")
    result = RUNNER.invoke(app, ["calibrate", "weights", str(path)])
    assert result.exit_code == 3
    assert (
        "in column 'load_kg' the labels 1 and 2 are exchanged (probability more than 99.9 %" in result.stderr
    )
    assert not (tmp_path / "scales.map.json").exists()
    result = RUNNER.invoke(app, ["calibrate", "weights", str(path), "--accept", "they are right"])
    assert result.exit_code == 0
    assert "Note: scales.csv: accepted (they are right): The weighings contradict each other" in result.stdout


def test_exact_readings_are_as_sure_as_their_rounding(tmp_path: Path) -> None:
    path = tmp_path / "scales.csv"
    path.write_text("load_kg,raw_a_count\n0,100\n1,50100\n2,100100\n3,150100\n")
    result = RUNNER.invoke(app, ["calibrate", "weights", str(path), "--json"])
    (row,) = json.loads(result.stdout)["tables"]["weighings"]["rows"]
    # A rounded count has a standard deviation of 0.29, over four readings that spread by 112,000 in all.
    plus_minus = row["scale (1e-6 N/count), ± one sigma"]["plus_minus"]
    assert plus_minus == pytest.approx(196.133 * np.sqrt(1 / 12) / 111803.4, rel=1e-3)


def test_a_log_starts_from_a_file_of_weights(log: Log, tmp_path: Path, undrawn: None) -> None:
    names = ("left_front_left", "left_front_right", "left_rear_left", "left_rear_right")
    names += tuple(name.replace("left", "right", 1) for name in names)
    load = np.repeat([0.0, 1.0, 2.0, 4.0], 2)
    rows = [f"{kg:g}," + ",".join(f"{8e6 + 1000 * i + 5e5 * kg:.0f}" for i in range(8)) for kg in load]
    path = tmp_path / "scales.csv"
    path.write_text(
        "load_kg," + ",".join(f"raw_{name}_count" for name in names) + "\n" + "\n".join(rows) + "\n"
    )
    assert RUNNER.invoke(app, ["calibrate", "weights", str(path)]).exit_code == 0
    started = with_map(log, tmp_path / "scales.map.json").calibrated
    assert started is not None
    np.testing.assert_allclose(started.scale, GRAVITY / 5e5)
    np.testing.assert_allclose(started.offset, -GRAVITY / 5e5 * (8e6 + 1000 * np.arange(8)))
    walk = write_log(log, tmp_path / "walk.parquet")
    start = ["--start", str(tmp_path / "scales.map.json"), "--method", "none", "--json"]
    result = RUNNER.invoke(app, ["calibrate", "walk", str(walk), *start])
    assert result.exit_code == 0, result.output
    last = json.loads((tmp_path / "walk.none.json").read_text())
    np.testing.assert_allclose(last["scale_N_per_count"], GRAVITY / 5e5)


def test_a_curve_goes_from_the_weights_to_the_walk(log: Log, tmp_path: Path, undrawn: None) -> None:
    """A channel of eight is a resistor; the others keep their lines bit for bit."""
    names = ("left_front_left", "left_front_right", "left_rear_left", "left_rear_right")
    names += tuple(name.replace("left", "right", 1) for name in names)
    load = np.repeat([0.0, 0.5, 1.0, 2.0, 3.0, 4.0], 2)
    code = np.rint(8e6 + 1000.0 * np.arange(8) + 5e5 * load[:, None])
    maps = []
    for bent in (False, True):
        if bent:
            code[:, 2] = np.rint(8e6 + 2e6 * load / (load + 2.0))
        path = write(
            Weighings(load * GRAVITY, code, tuple(f"raw_{name}_count" for name in names), "load_kg", GRAVITY),
            tmp_path / "scales.csv",
        )
        result = RUNNER.invoke(app, ["calibrate", "weights", str(path), "--json"])
        assert result.exit_code == 0, result.output
        maps.append(json.loads((tmp_path / "scales.map.json").read_text()))
    line, curve = maps
    assert "curves" not in line
    kept = [i for i in range(8) if i != 2]
    for key in ("scale_N_per_count", "offset_N", "scale_std_N_per_count"):
        assert [line[key][i] for i in kept] == [curve[key][i] for i in kept]
    assert [one is None for one in curve["curves"]] == [i != 2 for i in range(8)]
    (note,) = curve["notices"]
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
    result = RUNNER.invoke(app, ["calibrate", "walk", str(walk), *start, "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads((tmp_path / "walk.none.json").read_text())["curves"] == curve["curves"]
    result = RUNNER.invoke(app, ["calibrate", "walk", str(walk), *start, "--ros2"])
    assert (result.exit_code, result.stderr) == (
        2,
        "surefoot: walk.parquet: a ROS 2 node takes no curves, and the map to start from has some.\n",
    )


def test_a_description_may_hold_curves(log: Log, tmp_path: Path) -> None:
    path = write_log(log, tmp_path / "walk.csv")
    described = json.loads((tmp_path / "walk.json").read_text())
    knots = [[7e6, 8e6, 9e6], [7e6, 8.2e6, 9e6]]
    described["curves"] = Curves([None] * 7 + [knots]).as_plain()
    (tmp_path / "walk.json").write_text(json.dumps(described))
    read = read_log(path)
    np.testing.assert_array_equal(read.raw, Curves([None] * 7 + [knots]).straighten(log.raw))
    assert read.about["curves"] == described["curves"]
    described["curves"] = [None]
    (tmp_path / "walk.json").write_text(json.dumps(described))
    with pytest.raises(LogError, match="'curves' must be a list of 8, null for a channel without one"):
        read_log(path)


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
