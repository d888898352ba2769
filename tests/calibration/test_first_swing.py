"""What the moment filter makes of feet in the air: first of all their tare, and anew at a first swing."""

import numpy as np
import pytest
from _robots import BAD, rows_between, stream
from _synthetic import DT, LAYOUT, MASS, NOMINAL, walk
from numpy.testing import assert_allclose, assert_array_equal

from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.drift import LearntDrift
from surefoot.calibration.moment.noise import FIRST_NOISE
from surefoot.calibration.moment.rows import Block, Rows
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
    states = blocks(moment, log.raw, log.reference)
    anew = np.flatnonzero(np.diff([float(state.faults.trust) for state in states]) < 0.0) + 1
    assert len(anew) == 2
    for at in anew:
        # One block has passed since.
        assert states[at].noise.min() > 0.8 * FIRST_NOISE > states[at - 1].noise.min()


def in_the_air(moment, offsets, samples=BLOCK):
    """A block in which the first foot hangs for some samples, and shows offsets in body weights."""
    config, ones = moment.config, np.ones(moment.config.span)
    swing = np.zeros((config.span, 2))
    swing[: samples + 2 * config.settle, 0] = 1.0
    block = Block(
        force=np.tile(-np.asarray(offsets) * SETUP.weight, (config.span, 1)),
        motion=np.tile(moment._front_end.motions.resting, (config.span, 1)),
        swing=swing,
        use=ones,
        stand=ones,
    )
    return block, *moment.tare.hanging(moment.unknowns.start, block)


def learnt_so_far(moment, log):
    """A robot that has not swung a foot, with offsets of 0.01 and covariances that are no start's."""
    state = moment.init(log.raw[0])
    covariance = 0.5 * state.covariance
    covariance[0, -1] = covariance[-1, 0] = 1e-4
    return state._replace(
        mean=state.mean + 0.01,
        covariance=covariance,
        kept_mean=state.kept_mean + 0.02,
        kept_covariance=0.7 * state.kept_covariance,
    )


def test_only_who_had_wrong_offsets_forgets(moment, log):
    """One has swung before, one knew, one lost the cell, one is in its swing; and one forgets."""
    state, knew = learnt_so_far(moment, log), np.full(8, 0.0115)
    shown, third = knew.copy(), np.eye(8)[2]
    shown[2] = 0.03
    swung = state._replace(swing_ago=np.array([3.0, 5.0]))
    swinging = state._replace(swing_samples=np.full(2, 5.0))
    for keeps, offsets, lost in (
        (swung, shown, np.zeros(8)),
        (state, knew, np.zeros(8)),
        (state, shown, third),
        (swinging, shown, np.zeros(8)),
    ):
        after, anew = moment._product.forgotten(keeps, *in_the_air(moment, offsets), lost)
        assert not anew
        for old, new in zip(keeps, after, strict=True):
            if isinstance(old, np.ndarray):
                assert_array_equal(new, old)
    after, anew = moment._product.forgotten(state, *in_the_air(moment, shown), np.zeros(8))
    assert anew
    gone = np.zeros(UNKNOWNS.size, dtype=bool)
    # One wrong offset of the foot is enough; the other foot has shown nothing.
    gone[:4] = gone[UNKNOWNS.scales : UNKNOWNS.scales + 4] = True
    pair, first = gone[:, None] | gone, moment.init(log.raw[0]).covariance
    # A fault that is found later must not bring back what was forgotten, and a fall only what it shook.
    for name in ("mean", "kept_mean"):
        assert_array_equal(getattr(after, name), np.where(gone, UNKNOWNS.start, getattr(state, name)))
    lower = UNKNOWNS.lower
    assert_array_equal(after.covariance, np.where(pair, first, state.covariance))
    assert_array_equal(after.kept_covariance, np.where(pair[lower], first[lower], state.kept_covariance))


def test_few_samples_prove_less(moment, log):
    state = learnt_so_far(moment, log)
    for samples, proven in ((1, False), (BLOCK, True)):
        block, count, reading = in_the_air(moment, np.full(8, 0.019), samples)
        assert count[0] == samples
        assert moment._product.forgotten(state, block, count, reading, np.zeros(8))[1] == proven


def test_a_first_swing_is_over_however_short_it_was(moment, log):
    state = learnt_so_far(moment, log)._replace(swing_samples=np.array([2.0, 0.0]))
    after = moment._drifting.followed(state, np.zeros(2), np.zeros(8), np.ones(8))
    assert_array_equal(after.swing_ago, [0.0, -1.0])
    assert after.rate == 1.0


def test_a_foot_that_never_swung_is_judged_by_the_starting_map(moment, log):
    """What was learnt before says that it bears half the robot, and is sure of it."""
    block, _, _ = in_the_air(moment, np.zeros(8))
    state = learnt_so_far(moment, log)
    mean = state.mean.copy()
    mean[UNKNOWNS.offset] = 0.125
    state = state._replace(mean=mean, covariance=1e-6 * state.covariance)
    for ago, hangs in ((-1.0, BLOCK), (3.0, 0)):
        swung = state._replace(swing_ago=np.full(2, ago))
        count, _, doubted = moment._hanging(swung, block, swung.faults)
        assert_array_equal(count, [hangs, 0.0])
        assert doubted == (hangs == 0)


def test_rows_share_what_offsets_drifted_by_since_a_swing(moment, log):
    product = moment._product
    state = moment.init(log.raw[0])._replace(swing_ago=np.array([4.0, -1.0]), rate=9.0)
    of_foot = np.array(LAYOUT.foot_of_channel)
    walked = 9.0 * UNKNOWNS.walk[UNKNOWNS.offset] * BLOCK * DT
    on_ground = product.drifted(state, np.zeros(2))
    assert_allclose(on_ground, np.where(of_foot == 0, 25.0, 0.0) * walked)
    assert_array_equal(product.drifted(state, np.array([12.0, 0.0])), 0.0)
    long = product.drifted(state._replace(swing_ago=np.array([1e4, 1e4])), np.zeros(2))
    assert_allclose(long, (4.0 / (BLOCK * DT)) ** 2 * walked)


def test_rows_are_less_sure_by_the_product(moment):
    known, places = np.full(UNKNOWNS.size, 0.25), np.zeros((6, 8))
    known[UNKNOWNS.offset] = 0.04
    places[2, 5] = 3.0 / SETUP.weight
    rows = Rows(np.zeros((6, UNKNOWNS.size)), np.zeros(6), np.full(6, 0.1))
    for allowed, more in (
        (moment._product.unsure(rows, places, known, np.full(6, 7.0)), 0.015 * 7.0 * 9.0 * 0.25 * 0.04),
        (moment._product.since_swing(rows, places, known, np.full(8, 0.5)), 6 * 9.0 * 0.25 * 0.5),
    ):
        assert_allclose(allowed.variance, np.where(np.arange(6) == 2, 0.1 + more, 0.1))
        assert allowed.H is rows.H
        assert allowed.y is rows.y


def test_what_is_handed_out_has_aged_by_the_drift_that_is_learnt(moment, log):
    drift = LearntDrift(SETUP, CONFIG, UNKNOWNS, Tare(SETUP, CONFIG, UNKNOWNS))
    state = moment.init(log.raw[0])._replace(rate=9.0)
    assert_allclose(drift.aged(state), 9.0 * (UNKNOWNS.age * UNKNOWNS.walk)[UNKNOWNS.map])
    state = blocks(moment, log.raw, log.reference)[-1]
    offsets = slice(UNKNOWNS.scales, None)

    def known(rate):
        return np.diag(moment._given(state._replace(rate=rate)).given_covariance)[offsets]

    assert state.due
    as_it_is = known(state.rate)
    assert (as_it_is > drift.aged(state)[offsets]).all()
    more = known(100.0) - as_it_is
    assert_allclose(more, (100.0 / state.rate - 1.0) * drift.aged(state)[offsets], rtol=1e-6)
