"""Old readings are answered, and results that are worse than their start are not."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from _logs import run
from scipy.spatial.transform import Rotation

from surefoot.arrays import take_rows
from surefoot.calibration import CalibrationRefused, Flag
from surefoot.calibration.diagnosis import Experience, Mistake, Tried, diagnose
from surefoot.experiments import write_log
from surefoot.experiments.instrument.channels import settling_motion
from surefoot.experiments.instrument.check import check_log
from surefoot.experiments.logs.format import Log
from surefoot.experiments.walking.agreement import compare_with_start
from surefoot.experiments.walking.hypotheses import hypotheses
from surefoot.experiments.walking.judge import judge_log
from surefoot.experiments.walking.lateness import DELAY, make_punctual
from surefoot.experiments.walks.replay import replay_log, starting_map


def late(log: Log, seconds: float) -> Log:
    """Write readings that were taken a time ago in s."""
    rows = np.arange(len(log))
    raw = np.column_stack([np.interp(rows - seconds / log.dt, rows, column) for column in log.raw.T])
    return dataclasses.replace(log, raw=raw)


@pytest.mark.parametrize("age", [0.037, 0.15])
def test_the_age_of_readings_is_estimated_and_undone(bad_start: Log, age: float) -> None:
    old, initial = late(bad_start, age), starting_map(bad_start)
    judged = judge_log(old, initial)
    (found,) = judged.findings
    assert (found.name, found.refuses) == (DELAY, False)
    own = judge_log(bad_start, initial).lateness.seconds
    assert judged.lateness.seconds - own == pytest.approx(age, abs=0.005)
    learnt = [
        replay_log(one, "moment", initial).scale[-1] for one in (bad_start, make_punctual(old, age), old)
    ]
    errors = [np.abs(one / learnt[0] - 1.0).max() for one in learnt[1:]]
    assert errors[0] < 0.03
    assert errors[0] < errors[1]


@pytest.mark.parametrize("seconds", [0.1, -0.1])
def test_the_key_of_an_age_has_its_sign(bad_start: Log, seconds: float) -> None:
    """Without joints and IMU in the log, old readings need references that are less late."""
    lag = bad_start.lag
    log = dataclasses.replace(bad_start, lag=0, reference=take_rows(bad_start.reference, slice(lag, None)))
    log = dataclasses.replace(log, momentum=None, raw=log.raw[:-lag], time=log.time[:-lag])
    found = judge_log(late(log, seconds), starting_map(log)).findings[0]
    assert found.name == DELAY
    if seconds > 0.0:
        assert " s older than the description says" in found.reason
        assert found.cure.startswith("Subtract 0.")
    else:
        assert " s newer than the description says" in found.reason
        assert found.cure == 'Give "lag_samples": 8 in the description, which has 0.'


def test_a_tilted_imu_is_the_likeliest_cause(bad_start: Log) -> None:
    """It turns all that the robot believes about its own middle, and both soles lean alike."""
    R, told = Rotation.from_euler("xyz", (4.0, 9.0, 0.0), degrees=True).as_matrix(), bad_start.reference
    middle = told.position_sole.mean(axis=1)
    reference = told._replace(
        com=middle + (told.com - middle) @ R.T,
        com_acceleration=told.com_acceleration @ R.T,
        position_sole=middle[:, None] + (told.position_sole - middle[:, None]) @ R.T,
        R_level_sole=R @ told.R_level_sole,
    )
    log = dataclasses.replace(bad_start, reference=reference)
    judged = judge_log(log, starting_map(log))
    assert judged.findings
    assert judged.causes[0].mistake.kind == "IMU tilted"


def made_worse(log: Log, factor: Any) -> Any:
    """Return what a method would that leaves the starting map for a worse one in the first quarter."""
    initial = starting_map(log)
    after = (np.arange(len(log)) > len(log) // 4)[:, None]
    scale = np.where(after, initial.scale * factor, initial.scale)
    estimate = replay_log(log, "none", initial)
    return estimate._replace(scale=scale)


def test_a_result_that_is_worse_than_its_start_is_found(walks: dict[str, Log]) -> None:
    log = walks["bad-start"]
    initial = starting_map(log)
    assert compare_with_start(log, initial, replay_log(log, "moment", initial)) == []
    tilt = np.where(np.arange(log.layout.channels) % 2 == 0, 1.5, 0.5)
    (found,) = compare_with_start(log, initial, made_worse(log, tilt))
    assert found.refuses
    assert "centre of pressure" in found.reason
    assert "(start " in found.reason
    (found,) = compare_with_start(log, initial, made_worse(log, 2.0))
    assert re.search(r"force [\d.]+ % of the weight \(start \d", found.reason)


def test_a_worse_result_is_not_written(
    bad_start: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both commands compare; a method of one's own that spoils the map ends in exit status 3."""
    from surefoot.experiments.instrument import check
    from surefoot.experiments.walking import calibrate

    path = write_log(bad_start, tmp_path / "walk.parquet")
    for module in (calibrate, check):
        monkeypatch.setattr(module, "replay_log", lambda log, *_, **__: made_worse(log, 3.0))
    with pytest.raises((CalibrationRefused, SystemExit)):
        calibrate.calibrate_log(bad_start, "moment", folder=tmp_path, stem="walk", file="walk.parquet")
    assert "agrees with the robot's motion worse" in run("calibrate", "walk", path, code=3).stderr
    assert [one.name for one in tmp_path.iterdir()] == ["walk.parquet"]
    assert "worse than the start" in [one.finding.name for one in check_log(path).wrong]


def test_every_flag_has_words() -> None:
    assert all(one.words for one in Flag)
    assert len({one.words for one in Flag}) == len(Flag)


def test_every_mistake_of_a_walk_has_a_motion_that_settles_it(bad_start: Log) -> None:
    kinds = {one.kind for one in hypotheses(bad_start.layout)} | {DELAY, "contradiction", "broken"}
    assert [kind for kind in kinds if not settling_motion(kind)] == []


class TestDiagnosis:
    """Certainty needs residuals of sound data."""

    experience = Experience(unknown=0.3, mimicked=0.1, size=1.0, spread=0.25)

    def test_a_cause_is_certain_only_if_it_leaves_residuals_of_sound_data(self) -> None:
        one, other = (Mistake(kind, kind, "undo it", lambda data: data) for kind in "ab")
        for size, certain in ((0.9, True), (1.5, False), (3.0, False)):
            found = diagnose([Tried(one, 500.0, size), Tried(other, 0.0, size)], 0.0, 5.0, self.experience)
            assert found.is_certain == certain
            total = found.none + found.unknown + sum(one.probability for one in found.causes)
            assert total == pytest.approx(1.0)
        assert found.likely is None
        assert found.sentence() == "None of the 2 mistakes that were tried explains it."

    def test_sound_data_need_no_cause(self) -> None:
        mistake = Mistake("a", "a", "undo it", lambda data: data)
        found = diagnose([Tried(mistake, -5.0, 1.0)], 0.0, 1.0, self.experience)
        assert found.none > 0.9

    def test_two_mistakes_of_one_effect_share_their_probability(self) -> None:
        tried = [Tried(Mistake(kind, f"cause {kind}", "undo it", lambda d: d), 50.0, 0.9) for kind in "ab"]
        found = diagnose(tried, 0.0, 5.0, self.experience)
        assert not found.is_certain
        assert "cause a (probability 4" in found.sentence()
        assert "next 4" in found.sentence()
