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
    """A block in which the first foot of robots hangs for some samples, and shows offsets in body weights."""
    config, ones = moment.config, np.ones((len(offsets), moment.config.span))
    swing = np.zeros((*ones.shape, 2))
    swing[:, : samples + 2 * config.settle, 0] = 1.0
    block = Block(
        force=-np.asarray(offsets)[:, None, :] * SETUP.weight + 0.0 * ones[..., None],
        motion=moment._front_end.motions.resting + 0.0 * ones[..., None],
        swing=swing,
        use=ones,
        stand=ones,
    )
    return block, *moment.tare.hanging(moment.unknowns.start, block)


def learnt_so_far(moment, log, robots):
    """Robots that have not swung a foot, with offsets of 0.01 and covariances that are no start's."""
    state = moment.init(np.stack([log.raw[0]] * robots))
    covariance = 0.5 * state.covariance
    covariance[:, 0, -1] = covariance[:, -1, 0] = 1e-4
    return state._replace(
        mean=state.mean + 0.01,
        covariance=covariance,
        kept_mean=state.kept_mean + 0.02,
        kept_covariance=0.7 * state.kept_covariance,
    )


def test_only_who_had_wrong_offsets_forgets(moment, log):
    """Of four robots the first has never swung, the second has, the third knew; the fourth lost the cell."""
    state = learnt_so_far(moment, log, 4)
    state = state._replace(swing_ago=np.array([[-1.0, -1.0], [3.0, 5.0], [-1.0, -1.0], [-1.0, -1.0]]))
    shown, lost = np.full((4, 8), 0.0115), np.zeros((4, 8))
    shown[[0, 1, 3], 2] = 0.03
    lost[3, 2] = 1.0
    after, anew = moment._product.forgotten(state, *in_the_air(moment, shown), lost)
    assert_array_equal(anew, [True, False, False, False])
    gone = np.zeros(UNKNOWNS.size, dtype=bool)
    # One wrong offset of the foot is enough; the other foot has shown nothing.
    gone[:4] = gone[UNKNOWNS.scales : UNKNOWNS.scales + 4] = True
    pair, first = gone[:, None] | gone, moment.init(log.raw[0]).covariance
    # A fault that is found later must not bring back what was forgotten, and a fall only what it shook.
    for name in ("mean", "kept_mean"):
        old, new = getattr(state, name), getattr(after, name)
        assert_array_equal(new[0], np.where(gone, UNKNOWNS.start, old[0]))
        assert_array_equal(new[1:], old[1:])
    for name in ("covariance", "kept_covariance"):
        old, new = getattr(state, name), getattr(after, name)
        assert_array_equal(new[0], np.where(pair, first, old[0]))
        assert_array_equal(new[1:], old[1:])
    # Once in a swing.
    swinging = state._replace(swing_samples=np.full((4, 2), 5.0))
    assert not moment._product.forgotten(swinging, *in_the_air(moment, shown), lost)[1].any()


def test_few_samples_prove_less(moment, log):
    state, nothing = learnt_so_far(moment, log, 1), np.zeros((1, 8))
    for samples, proven in ((1, False), (BLOCK, True)):
        block, count, reading = in_the_air(moment, np.full((1, 8), 0.019), samples)
        assert count[0, 0] == samples
        assert moment._product.forgotten(state, block, count, reading, nothing)[1].all() == proven


def test_a_first_swing_is_over_however_short_it_was(moment, log):
    state = learnt_so_far(moment, log, 1)._replace(swing_samples=np.array([[2.0, 0.0]]))
    after = moment._drifting.followed(state, np.zeros((1, 2)), np.zeros((1, 8)), np.ones((1, 8)))
    assert_array_equal(after.swing_ago, [[0.0, -1.0]])
    assert after.rate == 1.0


def test_a_foot_that_never_swung_is_judged_by_the_starting_map(moment, log):
    """What was learnt before says that it bears half the robot, and is sure of it."""
    block, _, _ = in_the_air(moment, np.zeros((2, 8)))
    state = learnt_so_far(moment, log, 2)
    mean = state.mean.copy()
    mean[:, UNKNOWNS.offset] = 0.125
    state = state._replace(
        mean=mean, covariance=1e-6 * state.covariance, swing_ago=np.array([[-1.0, -1.0], [3.0, 3.0]])
    )
    count, _, doubted = moment._hanging(state, block, state.faults)
    assert_array_equal(count, [[BLOCK, 0.0], [0.0, 0.0]])
    assert_array_equal(doubted, [False, True])


def test_rows_share_what_offsets_drifted_by_since_a_swing(moment, log):
    product = moment._product
    state = moment.init(log.raw[0])._replace(swing_ago=np.array([4.0, -1.0]), rate=np.array(9.0))
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
    state = moment.init(log.raw[0])._replace(rate=np.array(9.0))
    assert_allclose(drift.aged(state), 9.0 * (UNKNOWNS.age * UNKNOWNS.walk)[UNKNOWNS.map])
    state = blocks(moment, log.raw, log.reference)[-1]
    offsets = slice(UNKNOWNS.scales, None)

    def known(rate):
        given = moment._given(state._replace(rate=np.array(rate)), state.due > 0.5)
        return np.diag(given.given_covariance)[offsets]

    as_it_is = known(float(state.rate))
    assert (as_it_is > drift.aged(state)[offsets]).all()
    more = known(100.0) - as_it_is
    assert_allclose(more, (100.0 / state.rate - 1.0) * drift.aged(state)[offsets], rtol=1e-6)
