"""Recorded walks: repeatable, and blind to the truth they carry."""

import dataclasses

import numpy as np
import pytest

from surefoot.experiments.logs.format import Log
from surefoot.experiments.walks.record import CONDITIONS, record_walk
from surefoot.experiments.walks.replay import replay_logs


@pytest.fixture(scope="module")
def walk() -> dict[str, Log]:
    return record_walk(0.1, 3, 4.6)


@pytest.mark.slow
def test_the_same_seed_is_the_same_walk(walk: dict[str, Log]) -> None:
    again = record_walk(0.1, 3, 4.6)
    for name, log in walk.items():
        np.testing.assert_array_equal(again[name].raw, log.raw)
        np.testing.assert_array_equal(again[name].reference.com, log.reference.com)


def test_a_method_cannot_see_the_truth(walk: dict[str, Log]) -> None:
    log = walk["bad-start"]
    blind = dataclasses.replace(log, truth=None)
    seen, unseen = (replay_logs([one], "window")[0].force for one in (log, blind))
    np.testing.assert_array_equal(seen, unseen)


def test_every_condition_starts_where_it_says(walk: dict[str, Log]) -> None:
    assert [c.name for c in CONDITIONS] == list(walk)
    for condition in CONDITIONS:
        log = walk[condition.name]
        assert log.calibrated is not None
        assert log.truth is not None
        assert log.about["start"] == condition.start
        assert np.isfinite(log.reference.com).all()
        # What the cells read by their true map is the truth, but for their age and noise.
        error = log.truth.scale * log.raw + log.truth.offset - log.truth.force
        standing = log.time < 3.0
        assert np.sqrt(np.mean(error[standing] ** 2)) < 0.05
