"""Real plates with errors put in; the recordings are found through SUREFOOT_DATA."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from surefoot.experiments.arena.options import TRUE_MAP
from surefoot.experiments.arena.replay import play
from surefoot.experiments.arena.score import score_run

pytestmark = pytest.mark.slow

FOLDER = Path(os.environ.get("SUREFOOT_DATA", "nowhere"))
recorded = pytest.mark.skipif(
    not (FOLDER / "foot").is_dir(),
    reason="the environment variable SUREFOOT_DATA names no folder with real recordings",
)


@pytest.fixture(scope="module")
def real_recordings(benchmark_script):
    return benchmark_script("real_recordings")


def table(study, load):
    rows = study.study_recording(load(FOLDER))
    return {(row["method"], row["injected"]): row for row in rows}


@pytest.fixture(scope="module")
def board(real_recordings):
    return table(real_recordings, real_recordings.wii_board)


@pytest.fixture(scope="module")
def pole(real_recordings):
    return table(real_recordings, real_recordings.rocked_pole)


@pytest.fixture(scope="module")
def empty(real_recordings):
    return table(real_recordings, real_recordings.drifting_zeros)


@recorded
def test_a_tare_takes_injected_offsets_out_and_leaves_gains(board):
    offsets, untouched = (
        board["tare", "offsets 3 % of the weight"],
        board["none", "offsets 3 % of the weight"],
    )
    assert offsets["cell_n"] < 0.01 * untouched["cell_n"]
    assert offsets["cop_ml_mm"] < 0.1
    gains, raw = board["tare", "gains 10 %"], board["none", "gains 10 %"]
    assert gains["vgrf_n"] == pytest.approx(raw["vgrf_n"], rel=0.01)


@pytest.mark.parametrize("method", ["standing start", "window"])
@pytest.mark.parametrize("injected", ["gains 10 %", "offsets 3 % of the weight", "both"])
@recorded
def test_weight_and_cop_bring_force_and_cop_right(board, method, injected):
    learnt, raw = board[method, injected], board["none", injected]
    assert learnt["vgrf_n"] < 0.2 * raw["vgrf_n"]
    assert np.hypot(learnt["cop_ml_mm"], learnt["cop_ap_mm"]) < 0.2 * np.hypot(
        raw["cop_ml_mm"], raw["cop_ap_mm"]
    )


@recorded
def test_the_weight_alone_excites_the_force_and_little_else(board):
    for injected in ("gains 10 %", "offsets 3 % of the weight", "both"):
        alone, raw = board["window, weight alone", injected], board["none", injected]
        both = board["window", injected]
        assert alone["vgrf_n"] < 0.2 * raw["vgrf_n"]
        assert alone["cop_ap_mm"] > 2.0 * both["cop_ap_mm"]
        assert alone["cop_ml_mm"] > 2.0 * both["cop_ml_mm"]


@recorded
def test_single_cells_are_not_what_force_and_cop_tell(board):
    both = board["window", "offsets 3 % of the weight"]
    assert both["cell_n"] > 5.0 * both["vgrf_n"]  # the warp of offsets shows only while nobody stands there
    assert board["tare", "offsets 3 % of the weight"]["cell_n"] < 0.1 * both["cell_n"]


@recorded
def test_good_cells_are_not_spoilt(board):
    nothing = board["window", "nothing"]
    assert nothing["cop_ml_mm"] < 1.0
    assert nothing["cop_ap_mm"] < 1.0
    assert board["tare", "nothing"]["cell_n"] < 0.1


@recorded
def test_a_rocked_pole_gets_its_force_back(pole):
    for injected in ("gains 10 %", "offsets 3 % of the weight", "both"):
        learnt, raw = pole["window", injected], pole["none", injected]
        assert learnt["vgrf_n"] < 0.2 * raw["vgrf_n"]
        assert learnt["cell_n"] < raw["cell_n"]
    offsets = pole["window", "offsets 3 % of the weight"], pole["none", "offsets 3 % of the weight"]
    assert offsets[0]["cop_ml_mm"] < offsets[1]["cop_ml_mm"]
    assert ("standing start", "both") not in pole  # nobody stood still


@recorded
def test_a_plate_that_is_never_empty_is_not_tared(pole):
    assert pole["tare", "both"]["cell_n"] == pytest.approx(pole["none", "both"]["cell_n"])


@recorded
def test_zeros_that_neither_force_nor_cop_shows_are_seen_in_the_air(empty):
    raw, tared = empty["none", "nothing"], empty["tare", "nothing"]
    assert raw["cell_n"] > 2.0
    assert raw["vgrf_n"] < 0.5
    assert tared["cell_n"] < 0.1 * raw["cell_n"]


@recorded
def test_every_row_says_in_words_what_it_shows(board, pole, empty):
    for rows in (board, pole, empty):
        for row in rows.values():
            assert row["sentence"].endswith(".")
            assert np.isfinite([row["vgrf_n"], row["cell_n"]]).all()


@recorded
@pytest.mark.parametrize("name", ["board", "pole", "empty-plate", "icub"])
def test_what_the_arena_puts_onto_a_recording_can_be_undone(real_recordings, name):
    first, second = real_recordings.recording_streams(FOLDER, name, range(2))
    assert (first.log.raw != second.log.raw).any()
    (floor,) = play([first], TRUE_MAP)
    row = score_run(first, floor)
    assert row["scale"] < 1e-12
    assert row["offset"] < 1e-9
    if name != "empty-plate":
        assert row["cell"] < 1e-9
        assert score_run(first, play([first], "none", foot_length=0.1)[0])["cell"] > 1.0


def test_recordings_are_laid_out(real_recordings):
    rows = pd.DataFrame(
        {
            "recording": "plate",
            "method": method,
            "injected": injected,
            "cop_ml_mm": 10.0 if method == "none" else cop,
            "cop_ap_mm": 10.0,
            "vgrf_n": 1.0,
            "cell_n": 1.0,
            "sentence": "Nothing changes.",
        }
        for method, cop in (("none", 10.0), ("window", 2.0), ("tare", 20.0))
        for injected in ("nothing", "both")
    )
    assert [len(real_recordings.plate_table(rows, kind).rows) for kind in ("nothing", "both")] == [3, 3]
    window, tare = real_recordings.plate_findings(rows)
    assert "window: of 4 errors" in window
    assert "2 are more than 10 % smaller than the readings' own, and 0 more than 10 % larger" in window
    assert "0 are more than 10 % smaller than the readings' own, and 2 more than 10 % larger" in tare
