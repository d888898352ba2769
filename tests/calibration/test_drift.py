"""How fast sensors drift, learnt from one swing to the next."""

from dataclasses import replace

import numpy as np
import pytest
from _robots import BAD, calibrated, fleet, rows_of
from _synthetic import DT, LAYOUT, MASS, NOMINAL, believed_mass, errors
from numpy.testing import assert_allclose

from surefoot.calibration import FootCalibrator
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
CHANNELS, STRIDE = LAYOUT.channels, 8
ROBOTS = 80


BEGUN = moment_filter(SETUP).init(np.full(CHANNELS, np.nan))


def swings(zeros, sound=1.0, samples=12.0, state=BEGUN):
    """Let the left foot swing for one block a stride, with these means, shape (swings, K), in N."""
    sound = np.ones(CHANNELS) * sound
    for reading in zeros:
        # In the air, down again, and for the rest of the stride nothing happens to the foot.
        for blocks, count in ((1.0, samples), (STRIDE - 1.0, 0.0)):
            ago = np.where(state.swing_ago < 0.0, -1.0, state.swing_ago + 1.0)
            state = DRIFT.followed(state._replace(swing_ago=ago), np.array([count, 0.0]), reading, sound)
            ago = np.where(state.swing_ago < 0.0, -1.0, state.swing_ago + blocks - 1.0)
            state = state._replace(swing_ago=ago)
    return state


def rates(zeros, *arguments, **options):
    """The rates that robots find, whose zeros have shape (swings, robots, K)."""
    return np.array([swings(zeros[:, i], *arguments, **options).rate for i in range(zeros.shape[1])])


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
    rate = rates(wandering(times, 40))
    assert 0.8 < np.median(rate) / times**2 < 1.2
    assert np.percentile(rate, 5) > 0.4 * times**2
    assert np.percentile(rate, 95) < 2.5 * times**2


@pytest.mark.parametrize("times", [0.0, 0.3, 1.0])
def test_it_is_as_stated_where_zeros_do_not_drift_faster(times):
    rate = rates(wandering(times, 40))
    assert rate.min() == 1.0
    assert np.median(rate) < 1.15


def test_it_is_forgotten_when_the_drift_ends():
    fast, slow = wandering(5.0, 30), wandering(1.0, 40, 1)
    found = [swings(slow[:, i], state=swings(fast[:, i])).rate for i in range(ROBOTS)]
    assert np.median(found) < 1.6


def test_what_all_channels_of_a_foot_share_is_no_drift():
    rng = np.random.default_rng(3)
    touching = 2.0 * np.abs(rng.normal(size=(20, ROBOTS, 1)))
    assert_allclose(rates(wandering(1.0, 20) + touching), rates(wandering(1.0, 20)))


def test_lost_channels_do_not_count_and_two_are_too_few():
    zeros = wandering(1.0, 20)
    wild = zeros.copy()
    wild[..., 1] += 50.0 * np.random.default_rng(4).normal(size=wild[..., 1].shape)
    sound = np.ones(CHANNELS)
    sound[1] = 0.0
    assert np.median(rates(wild)) > 20.0
    assert_allclose(rates(wild, sound), rates(zeros, sound))
    sound[2] = 0.0
    assert_allclose(rates(wandering(5.0, 20), sound), 1.0)


def test_a_swing_of_a_few_samples_is_passed_over():
    zeros = wandering(5.0, 20)
    assert_allclose(rates(zeros, samples=7.0), 1.0)
    # The next whole one is held against the last whole one, over all the time in between.
    state = swings(zeros[:2, 0])
    later = swings(zeros[2:4, 0], samples=4.0, state=state)
    assert_allclose(later.swing_zero, state.swing_zero)
    assert later.swing_ago[0] == state.swing_ago[0] + 2 * STRIDE


def test_gains_drift_and_other_unknowns_do_not():
    stated, mean = UNKNOWNS.walk * CONFIG.every * DT, BEGUN.mean.copy()
    for scale, rate, faster in ((0.5, 1.0, 1.0), (2.0, 4.0, 4.0 * 16.0), (10.0, 1.0, 81.0)):
        mean[0] = scale
        walk = DRIFT.walk(BEGUN._replace(mean=mean, rate=rate))
        assert walk[0] / stated[0] == pytest.approx(faster)
        assert_allclose(walk[UNKNOWNS.offset] / stated[UNKNOWNS.offset], rate)
        assert (walk[UNKNOWNS.map.stop :] == 0.0).all()


def test_neglected_cells_are_known_as_well_as_stated():
    """Three times the bad start and its drift, which nobody states."""
    neglected = replace(
        BAD,
        gain=3.0 * BAD.gain,
        offset=3.0 * BAD.offset,
        gain_drift=3.0 * BAD.gain_drift,
        offset_drift=3.0 * BAD.offset_drift,
    )
    found, before = [], []
    for log in fleet(range(8), speeds=(0.04,), faults=neglected, duration=24.0):
        calibrator = FootCalibrator(LAYOUT, "moment", mass=believed_mass(neglected), initial=NOMINAL)
        seen = [calibrator.update(log.raw[k], rows_of(log.reference, k), DT) for k in range(len(log.raw))]
        assert 3.0 < calibrator.state.rate < 30.0
        estimate = seen[0]._replace(
            cop=np.array([one.cop for one in seen]), vgrf=np.array([one.vgrf for one in seen])
        )
        found.append(errors(estimate, log, 14.0)[0])
        before.append(errors(calibrated(log.raw, log.reference, neglected, "none"), log, 14.0)[0])
    assert np.median(found) < 0.25 * np.median(before)
