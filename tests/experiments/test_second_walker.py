"""The second walker: what it believes of itself agrees with the truth of its simulation."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from surefoot.calibration import Reference
from surefoot.calibration.centroidal import ground_reference
from surefoot.calibration.cop import cop_of_feet, sole_wrenches
from surefoot.experiments.logs.format import write_log

DURATION, WEIGHT = 18.0, 8.33 * 9.81


@pytest.fixture(scope="module")
def walker(benchmark_script):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
        return benchmark_script("second_walker")


@pytest.fixture(scope="module")
def logs(walker):
    """A walk on servos without stairs, by its cells."""
    return walker.record(0.04, 3, DURATION, ("smooth", "chips"), stairs=False)


def test_it_walks_and_its_cells_carry_its_weight(walker, logs):
    log = logs["smooth"]
    assert not log.about["fell"]
    total = log.truth.force.sum(axis=1)
    standing = (log.time > 2.0) & (log.time < walker.STAND - 1.0)
    np.testing.assert_allclose(total[standing], WEIGHT, rtol=1e-3)
    # Over whole strides the ground carries the weight as well.
    assert total[log.time > walker.STAND + 2.0].mean() == pytest.approx(WEIGHT, rel=0.01)
    x = log.truth.position_sole[-1, :, 0].mean()
    assert x == pytest.approx(0.04 * (DURATION - walker.STAND - 1.0), abs=0.05)


def test_beliefs_are_of_the_samples_that_the_lag_says(logs):
    """A reference that is early or late by a sample fits the truth clearly worse."""
    log = logs["smooth"]
    wrench = sole_wrenches(log.truth.force, log.layout)
    reference = ground_reference(log.reference, log.mass)

    def misfit(lag):
        later = Reference(*(part[lag:] for part in log.reference))
        true = cop_of_feet(wrench[:-lag], later.position_sole, later.R_level_sole)
        off = uniform_filter1d(reference.cop[lag:] - true, 3, axis=0)[log.time[lag:] > 6.0]
        return float(np.std(off[:, 1]))

    assert misfit(log.lag) < 0.006
    assert misfit(log.lag) < 0.7 * min(misfit(log.lag - 1), misfit(log.lag + 1))


def test_a_foot_that_surely_swings_carries_nothing(logs):
    log = logs["smooth"]
    foot = log.truth.force.reshape(-1, 2, 4).sum(axis=2)[: -log.lag]
    swing, stance = log.reference.swing[log.lag :], log.reference.stance[log.lag :]
    assert swing.mean() > 0.1
    assert np.abs(foot[swing]).max() < 2.0
    assert np.median(foot[stance]) > 30.0


def test_the_true_map_undoes_the_errors_of_instant_cells(logs):
    log = logs["smooth"]
    undone = log.truth.scale * log.raw + log.truth.offset
    np.testing.assert_allclose(undone, log.truth.force, atol=0.1)
    assert np.abs(log.nominal.force(log.raw) - log.truth.force).max() > 1.0
    chips = logs["chips"]
    assert np.std(chips.truth.scale * chips.raw + chips.truth.offset - chips.truth.force) > 0.1


def test_a_log_is_scored_as_the_arena_scores(walker, logs, tmp_path):
    path = write_log(logs["smooth"], walker.log_path(tmp_path, "smooth", 0.04, 3, DURATION))
    raw, tared = walker.score(path, "none"), walker.score(path, "tare")
    # Drift, offsets of 1.5 N and scales 12 % off leave millimetres, of which the tare takes a part.
    assert 0.002 < raw["cop"] < 0.05
    assert not raw["worse"]
    assert tared["cell"] < raw["cell"]
