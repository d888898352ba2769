"""Scores against numbers worked out by hand."""

import numpy as np
import pytest

from surefoot.calibration.layout import FeetLayout, FootLayout
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.walks.score import cop_world, score_forces

CORNERS = np.array([(0.1, 0.05), (0.1, -0.05), (-0.1, 0.05), (-0.1, -0.05)])
LAYOUT = FeetLayout((FootLayout.load_cells("left", CORNERS), FootLayout.load_cells("right", CORNERS)))
POSITION = np.array([[[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]])
FLAT = np.eye(3)[None, None].repeat(2, axis=1)


def score(estimate: list[list[float]], truth: list[list[float]], settle: float = 0.0) -> dict[str, float]:
    n = len(truth)
    return score_forces(
        np.array(estimate),
        np.array(truth),
        layout=LAYOUT,
        position_sole=POSITION.repeat(n, axis=0),
        R_world_sole=FLAT.repeat(n, axis=0),
        time=np.arange(n, dtype=float),
        settle=settle,
    )._asdict()


EVEN = [5.0] * 8
LEFT = [10.0] * 4 + [0.0] * 4
AIR = [0.5] * 8


def test_a_perfect_estimate_scores_nothing() -> None:
    result = score([EVEN, LEFT, AIR], [EVEN, LEFT, AIR])
    assert result == dict.fromkeys(result, 0.0) | {"samples": 3}


def test_weight_moved_from_foot_to_foot() -> None:
    # All weight on the left foot where half is on each: the CoP is off by 0.1 m in y, the sum by nothing.
    result = score([LEFT], [EVEN])
    assert result["cop_y"] == pytest.approx(0.1)
    assert result["cop_x"] == pytest.approx(0.0)
    assert result["cop"] == pytest.approx(0.1)
    assert result["cop_foot"] == pytest.approx(0.0)
    assert result["vgrf"] == pytest.approx(0.0)
    assert result["vgrf_foot"] == pytest.approx(20.0)
    assert result["cell"] == pytest.approx(5.0)


def test_errors_of_both_axes_add_as_squares() -> None:
    # Four newtons more on the left front-left cell at (0.1, 0.15): 44 N at (0.4, 0.6) / 44.
    estimate = [9.0, *EVEN[1:]]
    result = score([estimate, EVEN], [EVEN, EVEN])
    assert result["cop_x"] == pytest.approx(0.4 / 44 / np.sqrt(2))
    assert result["cop_y"] == pytest.approx(0.6 / 44 / np.sqrt(2))
    assert result["cop"] == pytest.approx(np.hypot(0.4, 0.6) / 44 / np.sqrt(2))
    # Of the left foot 24 N at (0.4, 0.2) / 24: one of four values of feet that are not 0.
    assert result["cop_foot"] == pytest.approx(np.hypot(0.4, 0.2) / 24 / np.sqrt(4))
    assert result["vgrf"] == pytest.approx(4 / np.sqrt(2))
    assert result["vgrf_foot"] == pytest.approx(4 / np.sqrt(4))
    assert result["cell"] == pytest.approx(4 / np.sqrt(16))


def test_no_centre_of_pressure_in_the_air() -> None:
    # The last sample truly weighs 4 N: its CoP does not count, its force does.
    result = score([EVEN, LEFT], [EVEN, AIR])
    assert result["cop"] == pytest.approx(0.0)
    assert result["vgrf"] == pytest.approx(36 / np.sqrt(2))


def test_an_estimate_without_a_centre_of_pressure_holds_its_last() -> None:
    result = score([LEFT, AIR], [LEFT, EVEN])
    assert result["held"] == pytest.approx(0.5)
    assert result["cop_y"] == pytest.approx(0.1 / np.sqrt(2))


def test_samples_before_settling_and_without_reading_do_not_count() -> None:
    assert score([EVEN, LEFT, LEFT], [LEFT, LEFT, LEFT], settle=1.0)["cop"] == pytest.approx(0.0)
    result = score([[np.nan, *EVEN[1:]], LEFT], [EVEN, LEFT])
    assert (result["samples"], result["cop"]) == (1, pytest.approx(0.0))
    with pytest.raises(ValueError, match=r"No sample from 9 s on has finite forces.*the walk ends at 1 s"):
        score([EVEN, EVEN], [EVEN, EVEN], settle=9.0)


def test_turned_soles_move_the_centre_of_pressure() -> None:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    R = np.stack([quarter, np.eye(3)])[None]
    cop = cop_world(np.array([[10.0, 0, 0, 0, 0, 0, 0, 0]]), LAYOUT, POSITION, R)
    np.testing.assert_allclose(cop, [[-0.05, 0.2]])


def test_intervals_leave_out_what_is_not_there() -> None:
    interval = mean_interval([1.0, np.nan, 3.0])
    assert (interval.mean, interval.n) == (2.0, 2)
    assert interval.half == pytest.approx(12.7062, abs=1e-4)
    assert np.isnan(mean_interval([4.0]).half)
    assert mean_interval([]).n == 0
