"""Logs through the online methods: one by one, together, and from either starting map."""

import dataclasses

import numpy as np
import pytest

from surefoot.calibration.parameters import Parameters
from surefoot.experiments.logs.format import Log, LogError
from surefoot.experiments.walks.replay import replay_logs, starting_map


def test_none_is_the_starting_map(log: Log) -> None:
    calibrated = Parameters(1.1 * log.nominal.scale, log.nominal.offset + 0.5)
    log = dataclasses.replace(log, calibrated=calibrated)
    for start, expected in (("nominal", log.nominal), ("calibrated", calibrated), ("bench", calibrated)):
        replayed = replay_logs([log], "none", start)[0]
        np.testing.assert_allclose(replayed.force, expected.force(log.raw), atol=1e-9)
        np.testing.assert_allclose(replayed.scale, np.tile(expected.scale, (len(log), 1)), rtol=1e-12)
        np.testing.assert_allclose(replayed.offset, np.tile(expected.offset, (len(log), 1)), rtol=1e-12)


def test_the_map_that_is_handed_out_gives_the_forces(log: Log) -> None:
    log = dataclasses.replace(log, nominal=Parameters(1.05 * log.nominal.scale, 1.05 * log.nominal.offset))
    replayed = replay_logs([log], "window", standing_start=False)[0]
    np.testing.assert_allclose(replayed.scale * log.raw + replayed.offset, replayed.force, atol=1e-8)
    assert np.abs(replayed.scale[-1] / log.nominal.scale - 1).max() > 1e-4, "the window learnt nothing"


def test_together_is_one_by_one(log: Log) -> None:
    others = [
        dataclasses.replace(log, nominal=Parameters(factor * log.nominal.scale, factor * log.nominal.offset))
        for factor in (0.95, 1.0, 1.1)
    ]
    others.append(dataclasses.replace(others[0], mass=5.0))
    together = replay_logs(others, "window", standing_start=False)
    for one, replayed in zip(others, together, strict=True):
        alone = replay_logs([one], "window", standing_start=False)[0]
        np.testing.assert_allclose(replayed.force, alone.force, atol=1e-9)
        np.testing.assert_allclose(replayed.scale, alone.scale, rtol=1e-10)


def test_a_map_that_is_not_there_is_refused(log: Log) -> None:
    with pytest.raises(LogError, match=r"has no 'calibrated' map; start from 'nominal', or add the map\."):
        starting_map(log, "calibrated")
    with pytest.raises(LogError, match=r"starts from 'nominal' or 'calibrated', not from 'factory'\."):
        replay_logs([log], "none", "factory")
    with pytest.raises(ValueError, match=r"Method 'kalman' does not exist\. Available: 'moment', 'window'"):
        replay_logs([log], "kalman")
