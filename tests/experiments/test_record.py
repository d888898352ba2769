"""Recorded walks: repeatable, and blind to the truth they carry."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from surefoot.calibration.parameters import Parameters
from surefoot.experiments.logs.format import Log, LogError
from surefoot.experiments.walking.calibrate import calibrate_log
from surefoot.experiments.walks.record import CONDITIONS, record_walk
from surefoot.experiments.walks.replay import replay_logs, standing_weights, starting_map


@pytest.mark.slow
def test_the_same_seed_is_the_same_walk() -> None:
    first, again = (record_walk(0.1, 3, 4.6) for _ in range(2))
    for name, log in first.items():
        np.testing.assert_array_equal(again[name].raw, log.raw)
        np.testing.assert_array_equal(again[name].reference.com, log.reference.com)


def test_a_method_cannot_see_the_truth(walks: dict[str, Log]) -> None:
    log = walks["bad-start"]
    blind = dataclasses.replace(log, truth=None)
    seen, unseen = (replay_logs([one], "window")[0].force for one in (log, blind))
    np.testing.assert_array_equal(seen, unseen)


def test_every_condition_starts_where_it_says(walks: dict[str, Log]) -> None:
    assert [c.name for c in CONDITIONS] == list(walks)
    for condition in CONDITIONS:
        log = walks[condition.name]
        assert log.calibrated is not None
        assert log.truth is not None
        assert log.about["start"] == condition.start
        assert np.isfinite(log.reference.com).all()
        # What the cells read by their true map is the truth, but for their age and noise.
        error = log.truth.scale * log.raw + log.truth.offset - log.truth.force
        standing = log.time < 3.0
        assert np.sqrt(np.mean(error[standing] ** 2)) < 0.05


def test_the_window_takes_its_weights_of_a_quiet_stand(
    walks: dict[str, Log], log: Log, tmp_path: Path, undrawn: None
) -> None:
    walk = walks["paper"]
    weights = standing_weights(walk, starting_map(walk), 4.0)
    # Where it has stood for long enough the cells and the reference agree better than in walking.
    assert 1e-3 < weights["delta_force"] < 0.01
    assert 2e-3 < weights["delta_cop"] < 0.05
    made = calibrate_log(walk, "window", folder=tmp_path, stem="walk", file="walk.parquet", stand=4.0)
    found = pd.read_parquet(made.walk).filter(regex="^force_.*_N$").to_numpy()
    same, usual = (replay_logs([walk], "window", **options)[0].force for options in (weights, {}))
    np.testing.assert_allclose(found, same, rtol=1e-6, atol=1e-6)
    assert np.abs(found - usual).max() > 1e-3
    with pytest.raises(
        LogError, match=r"Only 0 of 0 samples .* The log's first 0\.5 s were taken for a quiet stand\."
    ):
        standing_weights(log, starting_map(log), 0.5)


def test_none_is_the_starting_map(log: Log) -> None:
    calibrated = Parameters(1.1 * log.nominal.scale, log.nominal.offset + 0.5)
    log = dataclasses.replace(log, calibrated=calibrated)
    for start, expected in (("nominal", log.nominal), ("calibrated", calibrated)):
        replayed = replay_logs([log], "none", start)[0]
        np.testing.assert_allclose(replayed.force, expected.force(log.raw), atol=1e-9)
        np.testing.assert_allclose(replayed.scale, np.tile(expected.scale, (len(log), 1)), rtol=1e-12)
        np.testing.assert_allclose(replayed.offset, np.tile(expected.offset, (len(log), 1)), rtol=1e-12)


def test_the_map_that_is_handed_out_gives_the_forces(log: Log) -> None:
    log = dataclasses.replace(log, nominal=Parameters(1.05 * log.nominal.scale, 1.05 * log.nominal.offset))
    replayed = replay_logs([log], "window", standing_start=False)[0]
    np.testing.assert_allclose(replayed.scale * log.raw + replayed.offset, replayed.force, atol=1e-8)
    assert np.abs(replayed.scale[-1] / log.nominal.scale - 1).max() > 1e-4, "the window learnt nothing"


def test_each_log_is_of_its_own_robot_and_map(log: Log) -> None:
    nominal = Parameters(1.1 * log.nominal.scale, 1.1 * log.nominal.offset)
    # Half of the counts under twice the map are the same forces.
    halved = dataclasses.replace(
        log, raw=0.5 * log.raw, nominal=Parameters(2.0 * log.nominal.scale, log.nominal.offset)
    )
    logs = [log, halved, dataclasses.replace(log, nominal=nominal), dataclasses.replace(log, mass=5.0)]
    same, again, other, lighter = replay_logs(logs, "window", standing_start=False)
    np.testing.assert_allclose(again.force, same.force, atol=1e-9)
    np.testing.assert_allclose(again.scale, 2.0 * same.scale, rtol=1e-9)
    for changed in (other, lighter):
        assert np.abs(changed.force - same.force).max() > 0.1


def test_a_map_that_is_not_there_is_refused(log: Log) -> None:
    with pytest.raises(LogError, match=r"has no 'calibrated' map; start from 'nominal', or add the map\."):
        starting_map(log, "calibrated")
    with pytest.raises(LogError, match=r"starts from 'nominal' or 'calibrated', not from 'factory'\."):
        replay_logs([log], "none", "factory")
