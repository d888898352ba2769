"""A session: three ways to read the same feet, changed while the robot stands."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from surefoot.calibration import Parameters
from surefoot.calibration.estimate import Flag
from surefoot.calibration.results import CalibrationRefused
from surefoot.experiments.logs.format import read_log, write_log
from surefoot.experiments.view.session import Session
from surefoot.experiments.walking.calibrate import calibrate_log
from surefoot.sensors.presets import BAR_CELLS_ON_HX711, HX711_LOAD_CELLS
from surefoot.wrappers import FootSensors, SelfCalibration

STAND = "surefoot/NaoStand-v0"


def run(session: Session, steps: int) -> Session:
    for _ in range(steps):
        session.step()
    return session


def test_without_changes_it_is_self_calibration() -> None:
    session = Session(STAND, seed=4, start={"drift": 0.0}, controller="zero")
    cells = replace(HX711_LOAD_CELLS, scale_drift=0.0, offset_drift=0.0)
    env = SelfCalibration(FootSensors(gym.make(STAND), cells), "moment")
    observation, _ = env.reset(seed=4)
    for _ in range(80):
        session.step()
        observation, *_ = env.step(np.zeros(11, dtype=np.float32))
    shown = session.state_to_draw()
    np.testing.assert_array_equal(shown.readings["calibrated"].force, env.estimate.force)
    np.testing.assert_array_equal(shown.flags, env.estimate.flags)
    np.testing.assert_array_equal(session._fed["cop"], observation["cop"])


def test_severity_scales_the_errors_of_the_hardware() -> None:
    truth, usual, worse = (
        run(
            Session(STAND, seed=4, start={"severity": s, "drift": 0.0}, controller="zero"), 40
        ).state_to_draw()
        for s in (0.0, 1.0, 3.0)
    )
    raw = truth.readings["raw"]
    # What is left without errors is noise, and the age of a reading.
    np.testing.assert_allclose(raw.force, truth.readings["true"].force, atol=0.5)
    assert truth.cop_error("raw") < 0.002
    ratio = (worse.readings["raw"].force - raw.force) / (usual.readings["raw"].force - raw.force)
    np.testing.assert_allclose(ratio, 3.0, rtol=0.02)


@pytest.mark.parametrize("start", [{}, {"severity": 2.5, "drift": 4.0, "temperature": 30.0}])
def test_the_true_map_undoes_all_errors(start: dict[str, float]) -> None:
    session = Session(STAND, seed=3, start=start)
    session.change("scale", (1, 0.3))
    session.change("offset", (6, -4.0))
    run(session, 160)  # by then the load moves slowly enough for readings that are a little old
    scale, offset = session.errors.parameters
    np.testing.assert_allclose(
        scale * session._raw + offset, session.state_to_draw().readings["true"].force, atol=0.5
    )


def test_a_changed_scale_and_offset_move_the_raw_cop() -> None:
    plain, changed = (Session(STAND, seed=2, controller="zero") for _ in range(2))
    run(plain, 20)
    run(changed, 20)
    changed.change("scale", (0, 0.5))
    changed.change("offset", (3, -2.0))
    before, after = (
        run(plain, 3).state_to_draw().readings["raw"],
        run(changed, 3).state_to_draw().readings["raw"],
    )
    assert after.force[0] > 1.2 * before.force[0]
    assert after.force[3] == pytest.approx(before.force[3] - 2.0, abs=0.01)
    np.testing.assert_allclose(np.delete(after.force, [0, 3]), np.delete(before.force, [0, 3]))
    assert np.linalg.norm(after.cop_world - before.cop_world) > 0.005


def test_warm_cells_err_by_what_a_kelvin_adds_to_each() -> None:
    usual, warm = (Session(STAND, seed=2, start={"severity": 2.0}, controller="zero") for _ in range(2))
    tempco = warm.errors._tempco
    spread = BAR_CELLS_ON_HX711.scale_tempco, BAR_CELLS_ON_HX711.offset_tempco
    np.testing.assert_allclose(tempco.std(axis=1), spread, rtol=0.6)
    warm.change("temperature", 40.0)
    before, after = (run(session, 10).state_to_draw().readings["raw"].force for session in (usual, warm))
    load = warm.state_to_draw().readings["true"].force
    np.testing.assert_allclose(after - before, 2.0 * 40.0 * (tempco[0] * load + tempco[1]), atol=2e-3)
    # Nothing of it is left where the temperature is that of the power-up.
    warm.change("temperature", 0.0)
    np.testing.assert_array_equal(*(run(session, 5)._raw for session in (usual, warm)))


def test_drift_is_as_fast_as_it_is_set() -> None:
    rng, spread = np.random.default_rng(0), []
    session = Session(STAND, seed=1)
    hardware = Parameters(*session._sensors.true_parameters())
    for factor in (1.0, 5.0):
        session.errors.drift = factor
        ends = []
        for _ in range(40):
            session.errors._walk[:] = 0.0
            session.errors._rng = rng
            for _ in range(80):
                session.errors.read(np.full(8, 8.4e6), hardware)
            ends.append(session.errors._walk[1].copy())
        spread.append(np.std(ends))
    # The preset's density of the offset, and one second.
    assert spread[0] == pytest.approx(HX711_LOAD_CELLS.offset_drift, rel=0.1)
    assert spread[1] == pytest.approx(5.0 * HX711_LOAD_CELLS.offset_drift, rel=0.1)


@pytest.mark.parametrize(
    ("words", "flag"), [("left/2 dies", Flag.DEAD), ("right/rear-left sticks", Flag.STUCK)]
)
def test_a_broken_cell_is_flagged(words: str, flag: Flag) -> None:
    session = run(Session("surefoot/NaoBalance-v0", seed=1), 160)
    assert not session.state_to_draw().flags.any()
    session.change("fault", words)
    run(session, 160)
    channel = 1 if words.startswith("left") else 6
    assert session.state_to_draw().flags[channel] & flag
    assert not np.delete(session.state_to_draw().flags, channel).any()
    assert session.errors.faults == (words,)
    session.change("repair")
    assert session.errors.faults == ()


def test_a_cell_that_sticks_holds_its_last_reading() -> None:
    session = run(Session(STAND, seed=1), 20)
    session.change("fault", "left/2 sticks")
    held = run(session, 1)._raw[1]
    session.change("scale", (1, 0.5))
    assert run(session, 10)._raw[1] == held


def test_feeds_and_calibrators_are_switched_while_it_stands() -> None:
    session = run(Session(STAND, seed=4, start={"severity": 3.0}), 80)
    seen = {}
    for feed in session.feeds:
        session.change("feed", feed)
        seen[feed] = session._fed["cop"].copy()
    truth = session._tap.seen["cop"]
    np.testing.assert_array_equal(seen["true"], truth)
    assert np.linalg.norm(seen["raw"] - truth) > 0.005
    session.change("method", "none")
    np.testing.assert_array_equal(session._fed["cop"], seen["raw"])
    session.change("method", "moment")
    np.testing.assert_array_equal(session._fed["cop"], seen["calibrated"])
    assert set(session._fed) == set(session._tap.seen) | {"foot_force", "cop"}


def test_what_is_done_to_the_robot() -> None:
    session = run(Session(STAND, seed=5), 40)
    gravity, mass = session.source.model.opt.gravity, session.source.model.body_subtreemass[0]
    session.change("slope", 3.0)
    assert gravity[0] == pytest.approx(-9.81 * np.sin(np.radians(3.0)))
    assert np.linalg.norm(gravity) == pytest.approx(9.81)
    session.change("slope", 0.0)
    session.change("payload", 0.4)
    run(session, 80)
    load = session.state_to_draw().readings["true"].vgrf.sum()
    assert load == pytest.approx((mass + 0.4) * 9.81, rel=0.02)
    session.change("reset")
    assert session.source.model.body_subtreemass[0] == pytest.approx(mass + 0.4)
    session.change("payload", 0.0)
    assert session.source.model.body_subtreemass[0] == pytest.approx(mass)
    velocity = session.source.truth.com_velocity[-1].copy()
    session.change("push", (0.3, 0.0))
    run(session, 8)
    pushed = session.source.truth.com_velocity[-1] - velocity
    assert pushed[0] > 0.02
    assert not session.source.data.xfrc_applied.any()


def test_a_reset_keeps_feet_and_what_was_learnt_and_a_seed_does_not() -> None:
    session = run(Session(STAND, seed=5), 160)
    session.change("fault", "left/1 flips")
    learnt, hardware = session._lines["moment"].estimate.scale.copy(), session._sensors.true_parameters()
    session.change("reset")
    assert session.time == 0.0
    assert session.steps == 160
    np.testing.assert_array_equal(session._sensors.true_parameters(), hardware)
    np.testing.assert_array_equal(session._lines["moment"].estimate.scale, learnt)
    assert session.errors.faults == ("left/1 flips",)
    session.power_up(6)
    assert session.steps == 0
    assert session.errors.faults == ()
    assert not np.array_equal(session._sensors.true_parameters(), hardware)
    np.testing.assert_array_equal(
        session._lines["moment"].estimate.scale, session._sensors.instruments.nominal.scale
    )


def test_a_recording_is_read_back_and_calibrated(tmp_path: Path, undrawn: None) -> None:
    session = run(Session("surefoot/NaoBalance-v0", seed=7, start={"feed": "raw", "severity": 2.0}), 40)
    session.record()
    run(session, 40)
    session.change("fault", "right/1 swaps with left/2")
    session.change("payload", 0.2)
    session.change("method", "tare")
    run(session, 40)
    raw, time = session._raw, session.time
    log = read_log(write_log(session.stop_recording(), tmp_path / "stand.parquet"))
    assert not session.recording
    assert len(log) == 80
    assert log.time[-1] == time
    assert log.truth is not None
    np.testing.assert_array_equal(log.raw[-1], raw)
    with pytest.raises(CalibrationRefused, match="contradict each other"):
        calibrate_log(log, "moment", folder=tmp_path, stem="stand", file="stand.parquet")
    result = calibrate_log(
        log, "moment", folder=tmp_path, stem="stand", file="stand.parquet", accept="cells were exchanged"
    )
    assert result.walk.is_file()


def test_a_recording_ends_with_its_episode() -> None:
    session = Session(STAND, seed=7)
    session.record()
    with pytest.raises(ValueError, match=r"^Nothing was recorded yet: record, and let the robot go on"):
        session.stop_recording()
    session.record()
    session.change("push", (4.0, 0.0))
    while not session.over:
        session.step()
    assert session.fell
    assert session.record_is_full
    assert session.stop_recording().about["fell"]
    with pytest.raises(RuntimeError, match=r"^The episode has ended; change\('reset'\)"):
        session.step()


@pytest.mark.parametrize(
    ("what", "value", "message"),
    [
        ("severity", 11, "'severity' lies from 0 to 10, got 11."),
        ("scale", (8, 0.1), "There is no channel 8; they are 0 to 7."),
        ("scale", (0, float("nan")), "'scale' lies from -0.9 to 2, got nan."),
        ("fault", "left/5 dies", "There is no cell 'left/5'"),
        ("fault", "left/1 sings", ""),
        ("temperature", 80, "'temperature' lies from -40 to 60, got 80."),
        ("feed", "guess", "There is no feed 'guess'. Available: true, raw, calibrated."),
        ("method", "kalman", "Method 'kalman' does not exist."),
        ("slope", 20, "A slope is at most 10 degrees, got 20."),
        ("payload", -1, "A payload has from 0 to 5.3"),
        ("push", (1e4, 0.0), "A push is at most"),
        ("speed", 0.1, "Only 'surefoot/NaoWalk-v0' is planned afresh at another speed."),
        ("colour", 1, "There is no change 'colour'. Available: severity, drift"),
    ],
)
def test_what_is_refused_changes_nothing(stand: Session, what: str, value: Any, message: str) -> None:
    before = dict(stand.settings), list(stand.changes), stand.errors.scale.copy(), stand.errors.faults
    with pytest.raises(ValueError, match=r".") as refused:
        stand.change(what, value)
    assert str(refused.value).startswith(message)
    assert (stand.settings, stand.changes, stand.errors.faults) == (before[0], before[1], before[3])
    np.testing.assert_array_equal(stand.errors.scale, before[2])


@pytest.fixture(scope="module")
def stand() -> Session:
    return Session(STAND, seed=0)


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
    run(session, 5)
    assert np.isfinite(session.state_to_draw().readings["raw"].force).all()
    with pytest.raises(ValueError, match=r"with --soles\.$"):
        Session("Humanoid-v5")
