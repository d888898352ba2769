"""A learnt map against the map that it started from."""

from typing import Any

import numpy as np
import pytest
from _moment import Errors, Motion, move
from _synthetic import DT, LAYOUT, MASS, NOMINAL

from surefoot.calibration import Flag, FootCalibrator, MomentumReference, Parameters
from surefoot.calibration.comparison import SURE, Residuals, evidence_for_start
from surefoot.calibration.moment.state import VersusStartState

NONE, NOISE = np.zeros(2), np.full(2, 1e-6)


def calibrator(initial: Parameters = NOMINAL) -> FootCalibrator:
    return FootCalibrator(LAYOUT, mass=MASS, initial=initial, dt=DT, lag=0)


def flagged(one: FootCalibrator, log: Motion) -> Any:
    """At which samples the learnt map is said to be worse than the start."""
    found = []
    for k, raw in enumerate(log.raw):
        estimate = one.update(raw, MomentumReference(*(part[k] for part in log.reference)), DT)
        found.append(bool(estimate.flags[0] & int(Flag.WORSE_THAN_START)))
    return np.array(found)


def test_evidence_grows_with_rows_and_has_no_unit() -> None:
    rng = np.random.default_rng(0)
    learnt, start = (Residuals.of(size * rng.standard_normal((500, 2))) for size in (0.3, 0.2))
    few, many = (evidence_for_start(learnt, start, NONE, NOISE, rows) for rows in (5.0, 20.0))
    assert many == pytest.approx(4.0 * few)
    assert few < SURE < many
    assert evidence_for_start(start, learnt, NONE, NOISE, 20.0) == pytest.approx(-many)
    in_mm = [Residuals(1e3 * one.mean, 1e6 * one.square) for one in (learnt, start)]
    assert evidence_for_start(*in_mm, NONE, 1e6 * NOISE, 20.0) == pytest.approx(many)


def test_no_map_is_to_blame_for_what_the_robot_does_not_know_of_itself() -> None:
    """A centre of mass that is off by 3 mm moves the residuals of both maps by as much."""
    rows = 0.01 * np.random.default_rng(1).standard_normal((400, 2))
    start, learnt = Residuals.of(rows - 0.003), Residuals.of(rows + 0.005)
    assert evidence_for_start(learnt, start, np.full(2, 0.004), NOISE, 100.0) < 1.0
    learnt = Residuals.of(rows + 0.03)
    assert evidence_for_start(learnt, start, np.full(2, 0.004), NOISE, 100.0) > SURE


def test_one_by_one_is_all_at_once() -> None:
    rows = np.random.default_rng(2).standard_normal((50, 2))
    one = Residuals(NONE, NONE)
    for k, row in enumerate(rows):
        one = one.include(row, 1.0 / (k + 1))
    for part, same in zip(one, Residuals.of(rows), strict=True):
        np.testing.assert_allclose(part, same)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("errors", [Errors.stated(), Errors(noise=5e-4)], ids=["bad start", "right start"])
def test_a_robot_that_learns_is_never_said_to_have_become_worse(seed: int, errors: Errors) -> None:
    assert not flagged(calibrator(), move(seed, 14.0, errors)).any()


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_nor_is_one_that_a_crane_lifts(share: float) -> None:
    lifted = np.where(np.arange(round(14.0 / DT)) * DT > 6.0, share, 0.0)
    assert not flagged(calibrator(), move(4, 14.0, Errors.stated(), lifted=lifted)).any()


@pytest.mark.parametrize("seed", [5, 6])
def test_a_map_of_sensors_that_were_replaced_is_worse(seed: int, tmp_path: Any) -> None:
    """The new sensors read as the start says. What was learnt of the old ones is loaded."""
    errors = Errors(scale=0.3, offset=0.08, noise=5e-4)
    before = calibrator()
    assert not flagged(before, move(seed, 14.0, errors)).any()
    before.save(tmp_path / "state.npz")
    after = calibrator()
    after.load(tmp_path / "state.npz")
    found = flagged(after, move(50 + seed, 12.0, Errors(noise=5e-4)))
    assert found[-round(3.0 / DT) :].all()
    after.reset()
    assert not flagged(after, move(56, 6.0, Errors(noise=5e-4))).any()


def test_the_flag_is_the_evidence_of_the_state() -> None:
    state = VersusStartState.begin(3)
    assert not state._replace(evidence=SURE).is_worse
    assert state._replace(evidence=SURE + 0.1).is_worse
