"""The moment filter on ankle sensors; and that batch and saving do not matter."""

import numpy as np
import pytest
from _matched import ANKLES, matched, on_ankles
from _robots import BAD, repeated, rows_between, stream
from _synthetic import LAYOUT, MASS, NOMINAL, walk

from surefoot.calibration import FootCalibrator, OnlineSetup, Reference
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.stream import moment_filter
from surefoot.calibration.state import load_state, save_state


@pytest.fixture(scope="module")
def ankle_fleet():
    return matched(on_ankles(3, 0.1, 4.0), ANKLES, MomentFilterConfig(cross_talk=0.01), 3, 1)


@pytest.fixture(scope="module")
def together(ankle_fleet):
    """The last estimate and the blocks of all of them side by side."""
    return stream(
        moment_filter(ankle_fleet.setup, ankle_fleet.config), ankle_fleet.raw, ankle_fleet.reference
    )[1:]


def test_what_was_learnt_as_a_robot_fell_is_taken_back():
    """Of three robots side by side the second falls: it believes to lean by 3 cm for a second."""
    log = walk(1, 0.1, 8.0, 2.0, BAD)
    raw, reference = np.stack([log.raw] * 3, axis=1), repeated(log.reference, 3, axis=1)
    lean = reference.com.copy()
    lean[320:400, 1, 0] += 0.03
    fell = reference._replace(com=lean)
    method, which = moment_filter(OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL)), np.arange(3) == 1
    state, _, _ = stream(method, raw[:320], rows_between(fell, 0, 320))
    before = state.given[1].copy()
    state, _, _ = stream(method, raw[320:400], rows_between(fell, 320, 400), state)
    assert np.abs(state.given[1] - before).max() > 0.02
    after = method.retract(state, which)
    for old, new in zip(state, after, strict=True):
        if isinstance(old, np.ndarray):
            np.testing.assert_array_equal(new[[0, 2]], old[[0, 2]])
    # Until it leant all three were alike.
    np.testing.assert_array_equal(after.mean[1], state.kept_mean[0, 0])
    # What it learns is handed out once it has learnt for a while.
    held, _, _ = stream(method, raw[400:512], rows_between(reference, 400, 512), after)
    np.testing.assert_array_equal(held.given[1], after.given[1])
    assert (held.mean[1] != after.mean[1]).any()
    proven, _, _ = stream(method, raw[512:608], rows_between(reference, 512, 608), held)
    assert (proven.given[1] != after.given[1]).any()
    # Again and again: what is gone back to is never of a fall.
    twice = method.retract(method.retract(after, which), which)
    np.testing.assert_array_equal(twice.mean[1], after.mean[1])


@pytest.mark.parametrize("method", ["none", "tare", "window", "moment"])
def test_a_calibrator_takes_back_what_it_can(method):
    calibrator = FootCalibrator(LAYOUT, method, mass=MASS, initial=NOMINAL)
    calibrator.retract()
    assert calibrator.state is None
    log = walk(1, 0.1, 4.0, 0.5, BAD)
    for k in range(300):
        calibrator.update(log.raw[k], Reference(*(part[k] for part in log.reference)))
    learnt = calibrator.state
    calibrator.retract(False)
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
    state, estimate, _ = stream(moment_filter(drawn.setup, drawn.config), drawn.raw, drawn.reference)
    rms = lambda values: np.sqrt((values**2).mean(axis=0))  # noqa: E731
    gain = state.mean[:, unknowns.scale]
    after, before = rms(gain - drawn.gain[-1]), rms(unknowns.start[unknowns.scale] - drawn.gain[-1])
    # Shear, and the twist above all, are small; what they excite little is found late.
    assert after[: unknowns.channels].mean() < 0.8 * before[: unknowns.channels].mean()
    assert after.mean() < before.mean()
    offset = unknowns.offsets(state.mean)
    assert (rms(offset - drawn.offset[-1]) < 0.3 * rms(drawn.offset[-1])).all()
    wrong = [rms(force - truth.force[-1]) for force in (estimate.force, drawn.raw[-1])]
    assert (wrong[0] < 0.5 * wrong[1]).all()
    if cross_talk:
        given = unknowns.offsets(state.given)
        full = np.einsum("rij,rj->ri", estimate.matrix, drawn.raw[-1]) + given
        np.testing.assert_allclose(full, estimate.force, atol=1e-9)
    else:
        assert estimate.matrix is None


@pytest.mark.slow
def test_ankle_sensors_in_a_batch_are_themselves_one_by_one(ankle_fleet, together):
    method = moment_filter(ankle_fleet.setup, ankle_fleet.config)
    last, blocks = together
    for i in (0, 2):
        row = Reference(*(part[:, i] for part in ankle_fleet.reference))
        _, alone, single = stream(method, ankle_fleet.raw[:, i], row)
        for field, a, b in zip(last._fields, last, alone, strict=True):
            if a is not None:
                np.testing.assert_allclose(a[i], b, rtol=1e-9, atol=1e-9, err_msg=field)
        np.testing.assert_allclose([nis[i] for nis, _ in blocks], [nis for nis, _ in single], rtol=1e-6)


def test_saved_in_mid_block_it_goes_on_bit_for_bit(ankle_fleet, tmp_path):
    method = moment_filter(ankle_fleet.setup, ankle_fleet.config)
    raw, reference = ankle_fleet.raw, ankle_fleet.reference
    cut = 203
    head = Reference(*(part[:cut] for part in reference))
    tail = Reference(*(part[cut:] for part in reference))
    state, _, _ = stream(method, raw[:cut], head)
    save_state(tmp_path / "state.npz", state)
    restored = load_state(tmp_path / "state.npz", method.init(raw[0]))
    (_, one, _), (_, two, _) = (stream(method, raw[cut:], tail, state=start) for start in (state, restored))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)
