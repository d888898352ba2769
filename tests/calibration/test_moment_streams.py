"""The moment filter on ankle sensors, robots that fall, and states that are saved."""

import numpy as np
import pytest
from _matched import ANKLES, matched, on_ankles
from _robots import BAD, rows_between, rows_of, stream
from _synthetic import DT, LAYOUT, MASS, NOMINAL, walk

from surefoot.calibration import FootCalibrator, OnlineSetup, Reference
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.stream import moment_filter
from surefoot.calibration.state import load_state, save_state


def test_what_was_learnt_as_a_robot_fell_is_taken_back():
    """It believes to lean by 3 cm for a second."""
    log = walk(1, 0.1, 8.0, 2.0, BAD)
    raw, reference, lean = log.raw, log.reference, log.reference.com.copy()
    lean[320:400, 0] += 0.03
    fell = reference._replace(com=lean)
    method = moment_filter(OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL))
    before, _, _ = stream(method, raw[:320], rows_between(fell, 0, 320))
    state, _, _ = stream(method, raw[320:400], rows_between(fell, 320, 400), before)
    assert np.abs(state.given - before.given).max() > 0.02
    after = method.retract(state)
    # What it knew before it leant.
    upright, _, _ = stream(method, raw[320:400], rows_between(reference, 320, 400), before)
    np.testing.assert_array_equal(after.mean, upright.kept_mean[0])
    # What it learns is handed out once it has learnt for a while.
    held, _, _ = stream(method, raw[400:512], rows_between(reference, 400, 512), after)
    np.testing.assert_array_equal(held.given, after.given)
    assert (held.mean != after.mean).any()
    proven, _, _ = stream(method, raw[512:608], rows_between(reference, 512, 608), held)
    assert (proven.given != after.given).any()
    # Again and again: what is gone back to is never of a fall.
    twice = method.retract(method.retract(after))
    np.testing.assert_array_equal(twice.mean, after.mean)


@pytest.mark.parametrize("method", ["none", "tare", "window", "moment"])
def test_a_calibrator_takes_back_what_it_can(method):
    calibrator = FootCalibrator(LAYOUT, method, mass=MASS, initial=NOMINAL)
    calibrator.retract()
    assert calibrator.state is None
    log = walk(1, 0.1, 4.0, 0.5, BAD)
    for k in range(300):
        calibrator.update(log.raw[k], Reference(*(part[k] for part in log.reference)))
    learnt = calibrator.state
    before = calibrator.update(log.raw[300], Reference(*(part[300] for part in log.reference)))
    calibrator.state = learnt
    calibrator.retract()
    after = calibrator.update(log.raw[300], Reference(*(part[300] for part in log.reference)))
    assert (after.scale != before.scale).any() == (method == "moment")


@pytest.mark.slow
@pytest.mark.parametrize("cross_talk", [0.0, 0.01])
def test_ankle_sensors_are_calibrated_from_walking(cross_talk):
    truth = on_ankles(3, 0.1, 20.0)
    drawn = matched(truth, ANKLES, MomentFilterConfig(cross_talk=cross_talk), 20, 1)
    unknowns = drawn.unknowns
    options = {"cross_talk": cross_talk, "foot_length": drawn.setup.foot_length}
    known, estimates = [], []
    for run in drawn.runs():
        calibrator = FootCalibrator(ANKLES, "moment", mass=MASS, dt=DT, lag=0, **options)
        for k in range(len(run.raw)):
            estimate = calibrator.update(run.raw[k], rows_of(run.reference, k), DT)
        known.append(calibrator.state)
        estimates.append(estimate)
    mean = np.array([state.mean for state in known])
    rms = lambda values: np.sqrt((values**2).mean(axis=0))  # noqa: E731
    gain = mean[:, unknowns.scale]
    after, before = rms(gain - drawn.gain[-1]), rms(unknowns.start[unknowns.scale] - drawn.gain[-1])
    # Shear, and the twist above all, are small; what they excite little is found late.
    assert after[: unknowns.channels].mean() < 0.8 * before[: unknowns.channels].mean()
    assert after.mean() < before.mean()
    offset = np.array([unknowns.offsets(one) for one in mean])
    assert (rms(offset - drawn.offset[-1]) < 0.3 * rms(drawn.offset[-1])).all()
    force = np.array([estimate.force for estimate in estimates])
    wrong = [rms(found - truth.force[-1]) for found in (force, drawn.raw[-1])]
    assert (wrong[0] < 0.5 * wrong[1]).all()
    for estimate, state, raw in zip(estimates, known, drawn.raw[-1], strict=True):
        if cross_talk:
            full = estimate.matrix @ raw + unknowns.offsets(state.given)
            np.testing.assert_allclose(full, estimate.force, atol=1e-9)
        else:
            assert estimate.matrix is None


def test_saved_in_mid_block_it_goes_on_bit_for_bit(tmp_path):
    drawn = matched(on_ankles(3, 0.1, 4.0), ANKLES, MomentFilterConfig(cross_talk=0.01), 1, 1)
    method, (raw, reference, *_) = moment_filter(drawn.setup, drawn.config), drawn.run(0)
    cut = 203
    tail = rows_between(reference, cut, len(raw))
    state, _, _ = stream(method, raw[:cut], rows_between(reference, 0, cut))
    save_state(tmp_path / "state.npz", state)
    restored = load_state(tmp_path / "state.npz", method.init(raw[0]))
    (_, one, _), (_, two, _) = (stream(method, raw[cut:], tail, state=start) for start in (state, restored))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)
