import numpy as np
import pytest
from _refusals import refusals
from _synthetic import DT, LAYOUT, MASS, NOMINAL, Faults, walk

from surefoot.calibration import Flag, OnlineSetup, Reference, online_method, replay
from surefoot.calibration.baselines import SwingTare


def tared(log, **options):
    return replay(LAYOUT, "tare", log.raw, log.reference, DT, mass=MASS, initial=NOMINAL, lag=0, **options)


def in_the_air():
    """Give the method, its first state, and the reference of a robot that hangs."""
    method = online_method("tare", OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL, lag=0))
    log = walk(0, duration=0.0)
    reference = Reference(*(part[0] for part in log.reference))._replace(swing=np.ones(2, bool))
    return method.update, method.init(log.raw[0]), reference, log.raw[0]


def test_constant_offsets_are_found_exactly():
    log = walk(3, faults=Faults(offset=1.5), duration=6.0)
    np.testing.assert_allclose(tared(log).force[-1], log.force[-1], atol=1e-9)


def test_offsets_behind_wrong_gains_are_found_as_well():
    log = walk(3, faults=Faults(offset=1.5, gain=0.1), duration=6.0)
    estimate = tared(log)
    in_air = np.repeat(log.reference.swing[-240:], 4, axis=1)
    assert in_air.any()
    np.testing.assert_allclose(estimate.force[-240:][in_air], 0.0, atol=1e-9)
    np.testing.assert_array_equal(estimate.scale, np.broadcast_to(NOMINAL.scale, estimate.scale.shape))


@pytest.mark.slow
def test_with_noise_the_zero_is_the_mean_over_a_swing():
    faults = Faults(offset=1.0, noise=0.1)
    found, swing = [], 0
    for seed in range(20):
        log = walk(seed, faults=faults, duration=4.0)
        swing = max(swing, int(log.reference.swing[:, 0].sum()))
        found.append(tared(log).offset[-1] - NOMINAL.offset - log.correction.offset[-1])
    spread = np.std(np.concatenate(found))
    assert 0.1 / np.sqrt(swing) < spread < 0.1 / np.sqrt(SwingTare().minimum_samples)


def test_a_foot_that_is_never_in_the_air_keeps_its_zero():
    log = walk(0, faults=Faults(offset=1.5), duration=1.0)
    reference = log.reference._replace(swing=np.zeros_like(log.reference.swing))
    estimate = tared(log._replace(reference=reference))
    np.testing.assert_allclose(estimate.offset, np.broadcast_to(NOMINAL.offset, estimate.offset.shape))


def test_a_foot_that_carries_weight_is_not_believed_to_swing():
    log = walk(0, faults=Faults(offset=0.3), duration=0.0)
    everywhere = np.ones_like(log.reference.swing)
    estimate = tared(log._replace(reference=log.reference._replace(swing=everywhere)))
    np.testing.assert_allclose(estimate.offset, np.broadcast_to(NOMINAL.offset, estimate.offset.shape))
    assert (estimate.flags[-1] & Flag.REJECTED).all()


def test_one_loaded_cell_speaks_for_its_foot_and_not_for_the_other():
    update, state, reference, _ = in_the_air()
    force = np.array([0.2, 0.3, 30.0, 0.1, 0.2, 0.3, 0.4, 0.1])
    for _ in range(30):
        state, estimate = update(state, (force - NOMINAL.offset) / NOMINAL.scale, reference, DT)
    np.testing.assert_allclose(estimate.force[:4], force[:4])
    np.testing.assert_allclose(estimate.force[4:], 0.0, atol=1e-9)
    assert [bool(flag & Flag.REJECTED) for flag in estimate.flags] == [True] * 4 + [False] * 4


def test_readings_that_do_not_agree_are_no_zero():
    update, state, reference, _ = in_the_air()
    rng = np.random.default_rng(0)
    for _ in range(30):
        force = rng.normal(size=8) * 3.0
        state, estimate = update(state, (force - NOMINAL.offset) / NOMINAL.scale, reference, DT)
    np.testing.assert_allclose(estimate.offset, NOMINAL.offset)


def test_channels_that_are_not_read_wait():
    log = walk(3, faults=Faults(offset=1.5), duration=6.0)
    raw = log.raw.copy()
    raw[:, 5] = np.nan
    estimate = tared(log._replace(raw=raw))
    assert estimate.offset[-1, 5] == NOMINAL.offset[5]
    known = np.arange(8) != 5
    np.testing.assert_allclose(estimate.force[-1, known], log.force[-1, known], atol=1e-9)


test_options_without_meaning_are_refused = refusals(
    lambda options: SwingTare(**options),
    ({"settle": -0.1}, "'settle' must be finite and not negative, got -0.1"),
    ({"spread": 0.0}, "'spread' must be finite and positive, got 0.0"),
    ({"minimum_samples": 0}, "'minimum_samples' must be a whole number from 1 on, got 0"),
    ({"offset_range": float("nan")}, "'offset_range' must be finite and positive, got nan"),
)


def test_a_gap_begins_the_count_anew():
    update, state, reference, raw = in_the_air()
    for dt in [DT] * 8 + [10.0]:
        state, _ = update(state, raw, reference, dt)
    assert (state.airborne == 1).all()
    assert (state.count == 0).all()
