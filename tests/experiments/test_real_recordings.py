"""Real plates with errors put in; the recordings are found through SUREFOOT_DATA."""

import json

import numpy as np
import pandas as pd
import pytest
from _recordings import DATA, needs

from surefoot.experiments.logs.format import read_log

pytestmark = [pytest.mark.slow, needs("foot")]


@pytest.fixture(scope="module")
def score(benchmark_script):
    """Means of a method on a recording, over two draws of errors."""
    script = benchmark_script("real_recordings")
    return lambda name, method: script.score(DATA, name, method, range(2)).mean(numeric_only=True)


@pytest.mark.parametrize("method", ["window", "quasi-static", "moment"])
def test_weight_and_cop_bring_force_and_cop_right(score, method):
    learnt, raw = score("board", method), score("board", "none")
    assert learnt["vgrf"] < 0.2 * raw["vgrf"]
    assert learnt["cop"] < 0.2 * raw["cop"]


def test_a_tare_takes_offsets_out_and_leaves_scales(score):
    tared, raw = score("board", "tare"), score("board", "none")
    assert tared["offset"] < 0.1 * raw["offset"]
    assert tared["scale"] == pytest.approx(raw["scale"])


def test_a_rocked_pole_gets_its_force_back(score):
    learnt, raw = score("pole", "window"), score("pole", "none")
    assert learnt["vgrf"] < 0.2 * raw["vgrf"]
    # A plate that is never empty is not tared.
    assert score("pole", "tare")["cell"] == pytest.approx(raw["cell"])


@pytest.mark.parametrize("name", ["board", "pole"])
def test_errors_that_are_put_in_can_be_undone(score, name):
    floor = score(name, "true-map")
    assert floor["scale"] < 1e-12
    assert floor["offset"] < 1e-9
    assert floor["cell"] < 1e-9
    assert score(name, "none")["cell"] > 1.0


def test_a_board_whose_clock_repeats_a_few_times_is_a_log(tmp_path):
    """18 minutes of a balance board: 23 of 63,559 rows have the time of the row before."""
    with np.load(f"{DATA}/foot/wii_board_18min.npz") as file:
        time, kilograms, place = file["t_s"], file["cells_kg"], file["cell_xy_cm"] / 100.0
    cells = ["a", "b", "c", "d"]
    table = pd.DataFrame(np.rint(1e3 * kilograms), columns=[f"raw_board_{cell}_count" for cell in cells])
    table.insert(0, "time_s", time)
    table.to_csv(tmp_path / "board.csv", index=False)
    foot = {"name": "board", "channel_names": cells, "position_cell_sole_m": place.tolist()}
    told = {"format": "surefoot-log", "format_version": 1, "lag_samples": 0, "mass_kg": 46.0}
    told |= {"layout": [foot], "nominal": {"scale_N_per_count": [9.81e-3] * 4}}
    (tmp_path / "board.json").write_text(json.dumps(told))
    log = read_log(tmp_path / "board.csv", np.inf, feet_alone=True)
    assert (np.diff(time) == 0.0).sum() == 23
    assert len(log) == len(time)
    assert (np.diff(log.time) > 0.0).all()
    assert np.abs(log.time - time).max() < 0.02
