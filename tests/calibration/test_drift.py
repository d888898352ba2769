"""How fast sensors drift, learnt from one swing to the next."""

from dataclasses import replace

import numpy as np
import pytest
from _robots import BAD, calibrated, fleet, robot, rows_of
from _synthetic import DT, LAYOUT, MASS, NOMINAL, believed_mass, errors
from numpy.testing import assert_allclose

from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.drift import LearntDrift
from surefoot.calibration.moment.stream import moment_filter
from surefoot.calibration.moment.tare import Tare
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.setup import OnlineSetup

CONFIG = MomentFilterConfig()
SETUP = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL)
UNKNOWNS = Unknowns(SETUP, CONFIG)
DRIFT = LearntDrift(SETUP, CONFIG, UNKNOWNS, Tare(SETUP, CONFIG, UNKNOWNS))
CHANNELS, FEET, STRIDE = LAYOUT.channels, len(LAYOUT.feet), 8
ROBOTS = 200


def swings(zeros, sound=1.0, samples=12.0, state=None):
    """Let the left foot swing for one block a stride, with these means, shape (swings, robots, K), in N."""
    if state is None:
        state = moment_filter(SETUP).init(np.full((zeros.shape[1], CHANNELS), np.nan))
    sound = np.ones(CHANNELS) * sound
    for reading in zeros:
        for block in range(STRIDE):
            state = state._replace(swing_ago=np.where(state.swing_ago < 0.0, -1.0, state.swing_ago + 1.0))
            count = np.zeros((zeros.shape[1], FEET))
            count[:, 0] = samples * (block == 0)
            state = DRIFT.followed(state, count, reading, sound)
    return state


def wandering(times, strides, seed=0):
    """Zeros that walk ``times`` as far as stated, and tares with the noise that is stated of them."""
    rng = np.random.default_rng([0xD21F7, seed])
    size = strides, ROBOTS, CHANNELS
    step = CONFIG.offset_drift * np.sqrt(STRIDE * CONFIG.every * DT / 60.0)
    noise = CONFIG.swing_noise * np.sqrt(16.0 / 12.0)
    zeros = np.cumsum(times * step * rng.normal(size=size), axis=0) + noise * rng.normal(size=size)
    return zeros * UNKNOWNS.unit


@pytest.mark.parametrize("times", [2.0, 3.0, 5.0])
def test_it_is_found(times):
    rate = swings(wandering(times, 40)).rate
    assert 0.8 < np.median(rate) / times**2 < 1.2
    assert np.percentile(rate, 5) > 0.4 * times**2
    assert np.percentile(rate, 95) < 2.5 * times**2


@pytest.mark.parametrize("times", [0.0, 0.3, 1.0])
def test_it_is_as_stated_where_zeros_do_not_drift_faster(times):
    rate = swings(wandering(times, 40)).rate
    assert rate.min() == 1.0
    assert np.median(rate) < 1.15


def test_it_is_forgotten_when_the_drift_ends():
    state = swings(wandering(5.0, 30))
    assert np.median(swings(wandering(1.0, 40, 1), state=state).rate) < 1.6


def test_what_all_channels_of_a_foot_share_is_no_drift():
    rng = np.random.default_rng(3)
    touching = 2.0 * np.abs(rng.normal(size=(20, ROBOTS, 1)))
    assert_allclose(swings(wandering(1.0, 20) + touching).rate, swings(wandering(1.0, 20)).rate)


def test_lost_channels_do_not_count_and_two_are_too_few():
    zeros = wandering(1.0, 20)
    wild = zeros.copy()
    wild[..., 1] += 50.0 * np.random.default_rng(4).normal(size=wild[..., 1].shape)
    sound = np.ones(CHANNELS)
    sound[1] = 0.0
    assert np.median(swings(wild).rate) > 20.0
    assert_allclose(swings(wild, sound).rate, swings(zeros, sound).rate)
    sound[2] = 0.0
    assert_allclose(swings(wandering(5.0, 20), sound).rate, 1.0)


def test_a_swing_of_a_few_samples_is_passed_over():
    zeros = wandering(5.0, 20)
    assert_allclose(swings(zeros, samples=7.0).rate, 1.0)
    # The next whole one is held against the last whole one, over all the time in between.
    state = swings(zeros[:2])
    later = swings(zeros[2:4], samples=4.0, state=state)
    assert_allclose(later.swing_zero, state.swing_zero)
    assert_allclose(later.swing_ago[:, 0], state.swing_ago[:, 0] + 2 * STRIDE)


def test_gains_drift_and_other_unknowns_do_not():
    state = moment_filter(SETUP).init(np.full((3, CHANNELS), np.nan))
    mean = state.mean.copy()
    mean[:, 0] = 0.5, 2.0, 10.0
    walk = DRIFT.walk(state._replace(mean=mean, rate=np.array([1.0, 4.0, 1.0])))
    stated = UNKNOWNS.walk * CONFIG.every * DT
    assert_allclose(walk[:, 0] / stated[0], [1.0, 4.0 * 16.0, 81.0])
    assert_allclose(
        walk[:, UNKNOWNS.offset] / stated[UNKNOWNS.offset], np.outer([1.0, 4.0, 1.0], np.ones(CHANNELS))
    )
    assert (walk[:, UNKNOWNS.map.stop :] == 0.0).all()


def test_neglected_cells_are_known_as_well_as_stated():
    """Three times the bad start and its drift, which nobody states."""
    neglected = replace(
        BAD,
        gain=3.0 * BAD.gain,
        offset=3.0 * BAD.offset,
        gain_drift=3.0 * BAD.gain_drift,
        offset_drift=3.0 * BAD.offset_drift,
    )
    logs, raw, reference = fleet(range(8), speeds=(0.04,), faults=neglected, duration=24.0)
    setup = OnlineSetup(layout=LAYOUT, mass=believed_mass(neglected), initial=NOMINAL)
    method = moment_filter(setup)
    state = method.init(raw[0])
    for k in range(len(raw)):
        state, _ = method.update(state, raw[k], rows_of(reference, k), DT)
    assert (state.rate > 3.0).all()
    assert (state.rate < 30.0).all()
    estimate = calibrated(raw, reference, neglected)
    start = calibrated(raw, reference, neglected, "none")
    found, before = (
        np.array([errors(robot(each, i), log, 14.0)[0] for i, log in enumerate(logs)])
        for each in (estimate, start)
    )
    assert np.median(found) < 0.25 * np.median(before)
