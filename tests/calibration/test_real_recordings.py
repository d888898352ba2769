"""Real plates with errors put in; the recordings are found through SUREFOOT_DATA."""

import numpy as np
import pytest

from surefoot.experiments import real_recordings

FOLDER = real_recordings.recordings_folder()
pytestmark = pytest.mark.skipif(
    FOLDER is None, reason="the environment variable SUREFOOT_DATA names no folder with real recordings"
)


def table(load):
    rows = real_recordings.study_recording(load(FOLDER))
    return {(row["method"], row["injected"]): row for row in rows}


@pytest.fixture(scope="module")
def board():
    return table(real_recordings.wii_board)


@pytest.fixture(scope="module")
def pole():
    return table(real_recordings.rocked_pole)


@pytest.fixture(scope="module")
def empty():
    return table(real_recordings.drifting_zeros)


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
def test_weight_and_cop_bring_force_and_cop_right(board, method, injected):
    learnt, raw = board[method, injected], board["none", injected]
    assert learnt["vgrf_n"] < 0.2 * raw["vgrf_n"]
    assert np.hypot(learnt["cop_ml_mm"], learnt["cop_ap_mm"]) < 0.2 * np.hypot(
        raw["cop_ml_mm"], raw["cop_ap_mm"]
    )


def test_the_weight_alone_excites_the_force_and_little_else(board):
    for injected in ("gains 10 %", "offsets 3 % of the weight", "both"):
        alone, raw = board["window, weight alone", injected], board["none", injected]
        both = board["window", injected]
        assert alone["vgrf_n"] < 0.2 * raw["vgrf_n"]
        assert alone["cop_ap_mm"] > 2.0 * both["cop_ap_mm"]
        assert alone["cop_ml_mm"] > 2.0 * both["cop_ml_mm"]


def test_single_cells_are_not_what_force_and_cop_tell(board):
    both = board["window", "offsets 3 % of the weight"]
    assert both["cell_n"] > 5.0 * both["vgrf_n"]  # the warp of offsets shows only while nobody stands there
    assert board["tare", "offsets 3 % of the weight"]["cell_n"] < 0.1 * both["cell_n"]


def test_good_cells_are_not_spoilt(board):
    nothing = board["window", "nothing"]
    assert nothing["cop_ml_mm"] < 1.0
    assert nothing["cop_ap_mm"] < 1.0
    assert board["tare", "nothing"]["cell_n"] < 0.1


def test_a_rocked_pole_gets_its_force_back(pole):
    for injected in ("gains 10 %", "offsets 3 % of the weight", "both"):
        learnt, raw = pole["window", injected], pole["none", injected]
        assert learnt["vgrf_n"] < 0.2 * raw["vgrf_n"]
        assert learnt["cell_n"] < raw["cell_n"]
    offsets = pole["window", "offsets 3 % of the weight"], pole["none", "offsets 3 % of the weight"]
    assert offsets[0]["cop_ml_mm"] < offsets[1]["cop_ml_mm"]
    assert ("standing start", "both") not in pole  # nobody stood still


def test_a_plate_that_is_never_empty_is_not_tared(pole):
    assert pole["tare", "both"]["cell_n"] == pytest.approx(pole["none", "both"]["cell_n"])


def test_zeros_that_neither_force_nor_cop_shows_are_seen_in_the_air(empty):
    raw, tared = empty["none", "nothing"], empty["tare", "nothing"]
    assert raw["cell_n"] > 2.0
    assert raw["vgrf_n"] < 0.5
    assert tared["cell_n"] < 0.1 * raw["cell_n"]


def test_every_row_says_in_words_what_it_shows(board, pole, empty):
    for rows in (board, pole, empty):
        for row in rows.values():
            assert row["sentence"].endswith(".")
            assert np.isfinite([row["vgrf_n"], row["cell_n"]]).all()
