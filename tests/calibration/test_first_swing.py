"""What the moment filter makes of feet in the air: first of all their tare, and anew at a first swing."""

import numpy as np
import pytest
from _robots import BAD, rows_between, stream
from _synthetic import DT, LAYOUT, MASS, NOMINAL, walk
from numpy.testing import assert_allclose, assert_array_equal

from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.drift import LearntDrift
from surefoot.calibration.moment.noise import FIRST_NOISE
from surefoot.calibration.moment.stream import MomentStream
from surefoot.calibration.moment.tare import Tare
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.setup import OnlineMethod, OnlineSetup

CONFIG = MomentFilterConfig()
SETUP = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL)
UNKNOWNS = Unknowns(SETUP, CONFIG)
BLOCK = CONFIG.every


@pytest.fixture(scope="module")
def log():
    return walk(1, 0.1, 8.0, 2.0, BAD)


@pytest.fixture
def moment():
    return MomentStream(SETUP, CONFIG)


def blocks(moment, raw, reference):
    """The state after each block."""
    method, state, states = OnlineMethod(moment.init, moment.update, moment.retract), None, []
    for first in range(0, len(raw) - BLOCK + 1, BLOCK):
        at = slice(first, first + BLOCK)
        start = () if state is None else (state,)
        state, _, _ = stream(method, raw[at], rows_between(reference, at.start, at.stop), *start)
        states.append(state)
    return states


def test_rows_of_the_robot_are_written_with_the_offsets_that_its_feet_show(moment, log, monkeypatch):
    written, rows = [], moment.newton_euler.rows
    monkeypatch.setattr(
        moment.newton_euler, "rows", lambda mean, *rest: (written.append(mean.copy()), rows(mean, *rest))[1]
    )
    states = blocks(moment, log.raw, log.reference)
    moved = 0
    for before, after, mean in zip(states[:-1], states[1:], written[1:], strict=True):
        hung = (after.swing_samples > before.swing_samples) @ moment.tare.by_channel > 0.5
        offsets = mean[UNKNOWNS.offset]
        if hung.any():
            moved += bool(np.abs(offsets - before.mean[UNKNOWNS.offset])[hung].max() > 0.0)
            # What these rows tell of them afterwards is little beside the tare.
            assert_allclose(after.mean[UNKNOWNS.offset][hung], offsets[hung], atol=2e-3)
        else:
            assert_array_equal(offsets, before.mean[UNKNOWNS.offset])
    assert moved > 10


def test_a_walk_begins_anew_once_for_each_foot(moment, log):
    trust = [float(state.faults.trust) for state in blocks(moment, log.raw, log.reference)]
    assert (np.diff(trust) < 0.0).sum() == 2


def test_only_who_does_not_know_scales_and_offsets_forgets(moment, log):
    """Of three robots the first has never swung, the second has, the third knows all."""
    state = moment.init(np.stack([log.raw[0]] * 3))
    mean, covariance = state.mean + 0.01, state.covariance.copy()
    covariance[:, 0, -1] = covariance[:, -1, 0] = 1e-4
    covariance[2] *= 1e-4
    ago = np.array([[-1.0, -1.0], [3.0, 5.0], [-1.0, -1.0]])
    state = state._replace(mean=mean, covariance=covariance, noise=0.0 * state.noise + 2.0, swing_ago=ago)
    faults = state.faults._replace(trust=state.faults.trust + 30.0)
    after, trusted = moment._begun_anew(state, faults, np.array([[12.0, 0.0]] * 3))
    for old, new in ((mean, after.mean), (covariance, after.covariance), (state.noise, after.noise)):
        assert_array_equal(new[1:], old[1:])
    assert_array_equal(trusted.trust, [0.0, 30.0, 30.0])
    scales = UNKNOWNS.scale
    assert_array_equal(after.mean[0, scales], UNKNOWNS.start[scales])
    assert_array_equal(after.mean[0, scales.stop :], mean[0, scales.stop :])
    first = np.diag(moment.init(log.raw[0]).covariance)
    assert_array_equal(after.covariance[0][scales], np.diag(first)[scales])
    assert (after.noise[0] == FIRST_NOISE).all()
    # Once in a swing.
    again, _ = moment._begun_anew(
        state._replace(swing_samples=np.full((3, 2), 5.0)), faults, np.array([[12.0, 0.0]] * 3)
    )
    assert_array_equal(again.mean, mean)


def test_drift_since_a_swing_is_shared_by_the_rows_since_then(moment, log):
    drift = LearntDrift(SETUP, CONFIG, UNKNOWNS, Tare(SETUP, CONFIG, UNKNOWNS))
    state = moment.init(log.raw[0])._replace(swing_ago=np.array([4.0, -1.0]), rate=np.array(9.0))
    of_foot = np.array(LAYOUT.foot_of_channel)
    walked = 9.0 * UNKNOWNS.walk[UNKNOWNS.offset] * BLOCK * DT
    on_ground = drift.since_swing(state, np.zeros(2))
    assert_allclose(on_ground[of_foot == 0], 25.0 * walked[of_foot == 0])
    assert_array_equal(on_ground[of_foot == 1], 0.0)
    assert_array_equal(drift.since_swing(state, np.array([12.0, 0.0])), 0.0)
    long = drift.since_swing(state._replace(swing_ago=np.array([1e4, 1e4])), np.zeros(2))
    assert_allclose(long, (4.0 / (BLOCK * DT)) ** 2 * walked)


def test_what_is_handed_out_has_aged_by_the_drift_that_is_learnt(moment, log):
    drift = LearntDrift(SETUP, CONFIG, UNKNOWNS, Tare(SETUP, CONFIG, UNKNOWNS))
    state = moment.init(log.raw[0])._replace(rate=np.array(9.0))
    assert_allclose(drift.aged(state), 9.0 * (UNKNOWNS.age * UNKNOWNS.walk)[UNKNOWNS.map])
    state = blocks(moment, log.raw, log.reference)[-1]
    offsets = slice(UNKNOWNS.scales, None)
    known = np.diag(state.given_covariance)[offsets]
    assert (known > drift.aged(state)[offsets]).all()
    faster = moment._given(state._replace(rate=np.array(100.0)), state.mean)
    more = np.diag(faster.given_covariance)[offsets] - known
    assert_allclose(more, (100.0 / state.rate - 1.0) * drift.aged(state)[offsets], rtol=1e-6)
