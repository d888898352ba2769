"""A session: three ways to read the same feet, which change while the robot stands."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from surefoot.calibration.estimate import Flag
from surefoot.calibration.results import CalibrationRefused
from surefoot.experiments.logs.format import read_log, write_log
from surefoot.experiments.view.session import Session
from surefoot.experiments.view.shown import Shown
from surefoot.experiments.walking.calibrate import calibrate_log
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers import FootSensors, SelfCalibration

STAND = "surefoot/NaoStand-v0"


def run(session: Session, steps: int) -> Shown:
    for _ in range(steps):
        session.step()
    return session.state_to_draw()


def test_without_changes_it_is_self_calibration() -> None:
    session = Session(STAND, seed=4, start={"drift": 0.0}, controller="zero")
    cells = replace(HX711_LOAD_CELLS, scale_drift=0.0, offset_drift=0.0)
    env = SelfCalibration(FootSensors(gym.make(STAND), cells), "moment")
    env.reset(seed=4)
    shown = run(session, 80)
    for _ in range(80):
        env.step(np.zeros(11, dtype=np.float32))
    np.testing.assert_array_equal(shown.readings["calibrated"].force, env.estimate.force)
    np.testing.assert_array_equal(shown.flags, env.estimate.flags)


def test_severity_scales_the_errors_of_the_hardware() -> None:
    truth, usual, worse = (
        run(Session(STAND, seed=4, start={"severity": s, "drift": 0.0}, controller="zero"), 40)
        for s in (0.0, 1.0, 3.0)
    )
    raw = truth.readings["raw"]
    # Without errors, noise and the age of a reading remain.
    np.testing.assert_allclose(raw.force, truth.readings["true"].force, atol=0.5)
    assert truth.cop_error("raw") < 0.002
    ratio = (worse.readings["raw"].force - raw.force) / (usual.readings["raw"].force - raw.force)
    np.testing.assert_allclose(ratio, 3.0, rtol=0.02)


def test_a_changed_scale_and_offset_move_the_raw_cop() -> None:
    plain, changed = (Session(STAND, seed=2, controller="zero") for _ in range(2))
    run(plain, 20)
    run(changed, 20)
    changed.change("scale", (0, 0.5))
    changed.change("offset", (3, -2.0))
    before, after = (run(session, 3).readings["raw"] for session in (plain, changed))
    assert after.force[0] > 1.2 * before.force[0]
    assert after.force[3] == pytest.approx(before.force[3] - 2.0, abs=0.01)
    np.testing.assert_allclose(np.delete(after.force, [0, 3]), np.delete(before.force, [0, 3]))
    assert np.linalg.norm(after.cop_world - before.cop_world) > 0.005


def test_temperature_changes_the_readings_and_back() -> None:
    usual, warm = (Session(STAND, seed=2, start={"severity": 2.0}, controller="zero") for _ in range(2))
    warm.change("temperature", 40.0)
    before, after = (run(session, 10).readings["raw"].force for session in (usual, warm))
    assert np.abs(after - before).max() > 0.1
    warm.change("temperature", 0.0)
    before, after = (run(session, 5).readings["raw"].force for session in (usual, warm))
    np.testing.assert_array_equal(before, after)


def test_faults_are_flagged_until_they_are_repaired() -> None:
    session = Session("surefoot/NaoBalance-v0", seed=1)
    assert not run(session, 160).flags.any()
    session.change("fault", "left/2 dies")
    session.change("fault", "right/rear-left sticks")
    flags = run(session, 160).flags
    assert flags[1] & Flag.DEAD
    assert flags[6] & Flag.STUCK
    assert not np.delete(flags, [1, 6]).any()
    assert session.errors.faults == ("left/2 dies", "right/rear-left sticks")
    session.change("repair")
    assert not session.errors.faults


def test_what_is_done_to_the_robot() -> None:
    session = Session(STAND, seed=5)
    run(session, 40)
    gravity, mass = session.source.model.opt.gravity, session.source.model.body_subtreemass[0]
    session.change("slope", 3.0)
    assert gravity[0] == pytest.approx(-9.81 * np.sin(np.radians(3.0)))
    assert np.linalg.norm(gravity) == pytest.approx(9.81)
    session.change("slope", 0.0)
    session.change("payload", 0.4)
    load = run(session, 80).readings["true"].vgrf.sum()
    assert load == pytest.approx((mass + 0.4) * 9.81, rel=0.02)
    session.change("reset")
    assert session.source.model.body_subtreemass[0] == pytest.approx(mass + 0.4)
    session.change("payload", 0.0)
    assert session.source.model.body_subtreemass[0] == pytest.approx(mass)
    velocity = session.source.truth.com_velocity[-1].copy()
    session.change("push", (0.3, 0.0))
    run(session, 8)
    assert (session.source.truth.com_velocity[-1] - velocity)[0] > 0.02
    assert not session.source.data.xfrc_applied.any()


def test_a_reset_keeps_feet_and_calibration_and_a_seed_does_not() -> None:
    session = Session(STAND, seed=5, start={"drift": 0.0}, controller="zero")
    session.change("fault", "left/1 flips")
    run(session, 320)
    session.change("reset")
    assert (session.time, session.steps, session.errors.faults) == (0.0, 320, ("left/1 flips",))
    kept = session.state_to_draw()
    session.power_up(6)
    assert (session.time, session.steps, session.errors.faults) == (0.0, 0, ())
    readings = [one.readings for one in (kept, session.state_to_draw())]
    learnt = [np.abs(one["calibrated"].force - one["raw"].force).max() for one in readings]
    assert learnt[0] > 1.0
    assert learnt[1] == pytest.approx(0.0, abs=1e-9)


def test_a_recording_is_read_back_and_calibrated(tmp_path: Path, undrawn: None) -> None:
    session = Session("surefoot/NaoBalance-v0", seed=7, start={"feed": "raw", "severity": 2.0})
    run(session, 40)
    session.record()
    run(session, 40)
    session.change("fault", "right/1 swaps with left/2")
    session.change("method", "tare")
    run(session, 40)
    log = read_log(write_log(session.stop_recording(), tmp_path / "stand.parquet"))
    assert (len(log), log.time[-1]) == (80, session.time)
    assert log.truth is not None
    assert log.about["view"]["changes"][-2:] == [
        [80, "fault", "right/1 swaps with left/2"],
        [80, "method", "tare"],
    ]
    with pytest.raises(CalibrationRefused, match="contradict each other"):
        calibrate_log(log, "moment", folder=tmp_path, stem="stand", file="stand.parquet")


def test_a_recording_ends_with_its_episode() -> None:
    session = Session(STAND, seed=7)
    session.record()
    with pytest.raises(ValueError, match=r"^Nothing was recorded yet: record, and let the robot continue"):
        session.stop_recording()
    session.record()
    session.change("push", (4.0, 0.0))
    while not session.over:
        session.step()
    assert session.fell
    assert session.record_is_full
    assert session.stop_recording().about["fell"]


@pytest.fixture(scope="module")
def stand() -> Session:
    return Session(STAND, seed=0)


@pytest.mark.parametrize(
    ("what", "value", "message"),
    [
        ("severity", 11.0, "'severity' must be from 0 to 10, got 11."),
        ("scale", (8, 0.1), "There is no channel 8; they are 0 to 7."),
        ("scale", (0, float("nan")), "'scale' must be from -0.9 to 2, got nan."),
        ("fault", "left/2 melts", ""),
        ("push", (1e3, 0.0), "A push must be at most "),
        ("slope", 11.0, "A slope must be at most 10 degrees, got 11."),
        ("payload", -1.0, "A payload must have from 0 to "),
        ("speed", 0.05, "Only 'surefoot/NaoWalk-v0' can be planned at another speed."),
        ("feed", "weights", "There is no feed 'weights'. Available: true, raw, calibrated."),
        ("method", "os:system", "Method 'os:system' does not exist."),
        ("colour", 1, "There is no change 'colour'. Available: severity, drift"),
    ],
)
def test_a_refused_change_changes_nothing(stand: Session, what: str, value: Any, message: str) -> None:
    before = dict(stand.settings), list(stand.changes), stand.errors.scale.tolist(), stand.errors.faults
    with pytest.raises(ValueError, match=r".") as refused:
        stand.change(what, value)
    assert str(refused.value).startswith(message)
    assert before == (stand.settings, stand.changes, stand.errors.scale.tolist(), stand.errors.faults)


@pytest.mark.slow
def test_another_speed_is_walked_from_the_next_reset_on() -> None:
    session = Session(start={"speed": 0.0})
    pattern = session.source.pattern
    session.change("speed", 0.03)
    assert session.source.pattern is pattern
    session.change("reset")
    assert session.source.pattern is not pattern
    assert session.standing
    with pytest.raises(ValueError, match=r"."):
        session.change("speed", 3.0)
    assert session.settings["speed"] == 0.03


@pytest.mark.filterwarnings("ignore:The observation of .* holds 'cfrc_ext'")
def test_any_robot_on_two_feet() -> None:
    session = Session("Humanoid-v5", seed=1, soles=True)
    assert session.feeds == ("raw", "calibrated")
    assert np.isfinite(run(session, 5).readings["raw"].force).all()
    with pytest.raises(ValueError, match=r"with --soles\.$"):
        Session("Humanoid-v5")
