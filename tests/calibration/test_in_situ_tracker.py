"""The in-situ tracker: honest deviations, observability, touch, bad samples, one law for all libraries."""

import numpy as np
import pytest
from _in_situ import swept_gravity
from _refusals import refusals
from _tracked import (
    INERTIA,
    MASS,
    MASS_COM,
    NOISE_ROOT,
    OFFSET,
    RESPONSE,
    covariance_of_fit,
    draw_truth,
    make_fit,
)

from surefoot.calibration.estimate import Flag
from surefoot.calibration.in_situ import InSituTracker, InSituTrackerConfig, Limb
from surefoot.calibration.results import CalibrationRefused, FitResult

DOWN = np.array([0.0, 0.0, 9.81])
WEIGHT = np.concatenate([MASS * DOWN, np.cross(MASS_COM, DOWN)])


def weight_of(gravity):
    return np.concatenate([MASS * gravity, np.cross(MASS_COM, gravity)], axis=-1)


def normalised(error, covariance):
    return np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0], axis=-1)


def walked(tracker, runs, steps, dt, seed, fit=None):
    """Track sensors drawn from the fit's covariance, whose offsets drift as the tracker assumes."""
    rng = np.random.default_rng([41, seed])
    config = tracker.config
    truth = draw_truth(fit or make_fit(), rng, runs, config.since_fit_force, config.since_fit_torque)
    walk = RESPONSE * np.repeat([config.drift_force, config.drift_torque], 3) * dt**0.5
    nis = []
    for g in swept_gravity(steps):
        truth = truth._replace(offset=truth.offset + rng.standard_normal((runs, 6)) @ walk.T)
        raw = truth.read(g) + rng.standard_normal((runs, 6)) @ NOISE_ROOT.T
        estimate = tracker.update(raw, np.tile(g, (runs, 1)), dt)
        nis.append(estimate.nis)
    return truth, estimate, np.array(nis)


def test_offsets_are_off_by_as_much_as_is_claimed():
    runs = 150
    # A real fit's errors of matrix and limb cancel at its mean load; here they are small.
    fit = make_fit(covariance_of_fit(scale=0.001, talk=0.0005, limb=0.001))
    truth, estimate, nis = walked(InSituTracker(fit), runs, 80, 1.0, seed=0, fit=fit)
    nees = normalised(estimate.offset - truth.offset, estimate.covariance)
    assert 0.7 < nees.mean() / 6.0 < 1.4
    assert 0.5 < np.nanmean(nis) / 6.0 < 1.1
    errors = [np.linalg.solve(RESPONSE, (o - truth.offset).T)[:3] for o in (OFFSET, estimate.offset)]
    assert np.mean(errors[1] ** 2) < 0.16 * np.mean(errors[0] ** 2)


def test_what_hysteresis_keeps_stays_in_the_covariance():
    doubt = RESPONSE @ np.diag([1.0, 1.0, 1.0, 0.02, 0.02, 0.02]) ** 2 @ RESPONSE.T
    plain, kept = (
        walked(InSituTracker(make_fit(offset_doubt=one)), 1, 20, 1.0, seed=1)[1] for one in (None, doubt)
    )
    np.testing.assert_allclose(kept.covariance, plain.covariance + doubt)
    np.testing.assert_array_equal(kept.offset, plain.offset)


def test_a_perfect_sensor_is_left_as_it_is():
    tracker = InSituTracker(make_fit())
    for g in swept_gravity(60):
        estimate = tracker.update(RESPONSE @ weight_of(g) + OFFSET, g, 0.1)
        assert estimate.learnt
    np.testing.assert_allclose(estimate.offset, OFFSET, rtol=1e-11)
    np.testing.assert_allclose(estimate.wrench, weight_of(g), atol=1e-9)


@pytest.mark.slow
def test_heat_is_followed_through_the_drift():
    tracker, rng = InSituTracker(make_fit()), np.random.default_rng(3)
    slope = RESPONSE @ np.array([5e-4, -5e-4, 5e-4, 1e-5, 1e-5, -1e-5])
    offset, off = OFFSET.copy(), []
    for g in np.tile(swept_gravity(300), (4, 1)):
        offset = offset + slope
        raw = RESPONSE @ weight_of(g) + offset + NOISE_ROOT @ rng.standard_normal(6)
        estimate = tracker.update(raw, g, 1.0)
        off.append((offset - estimate.offset) / estimate.offset_std)
    # Forces: cross-talk that the fit leaves open weighs as much as the drift of torques.
    left, drifted = (np.linalg.solve(RESPONSE, offset - o)[:3] for o in (estimate.offset, OFFSET))
    assert np.linalg.norm(left) < 0.3 * np.linalg.norm(drifted)
    assert np.sqrt(np.mean(np.square(off))) < 2.0


def test_nothing_is_learnt_while_the_foot_stands():
    tracker = InSituTracker(make_fit(), since_fit_force=0.0, since_fit_torque=0.0)
    # After a mere second of walking, what the fit knew is nearly all there is.
    first = tracker.update(RESPONSE @ WEIGHT + OFFSET, DOWN, 1.0)
    pushed = WEIGHT - np.array([0.0, 0.0, 300.0, 4.0, 3.0, 0.0])
    for _ in range(10):
        stands = tracker.update(RESPONSE @ pushed + OFFSET, DOWN, 6.0, in_air=False)
        assert not stands.learnt
        assert np.isnan(stands.nis)
    np.testing.assert_array_equal(stands.offset, first.offset)
    grown = np.linalg.inv(RESPONSE) @ (stands.covariance - first.covariance)[:6, :6]
    walk = np.diag(grown @ np.linalg.inv(RESPONSE).T)
    config = tracker.config
    expected = np.repeat([config.drift_force, config.drift_torque], 3) ** 2 * 60.0
    np.testing.assert_allclose(walk, expected, rtol=1e-6)
    np.testing.assert_allclose(stands.wrench, pushed, atol=0.05)
    assert stands.flags.tolist() == [0] * 6


@pytest.mark.parametrize("push", [6.0, -40.0, 300.0])
def test_a_touch_that_was_not_given_is_seen_in_the_wrench(push):
    tracker = InSituTracker(make_fit())
    for g in swept_gravity(20):
        before = tracker.update(RESPONSE @ weight_of(g) + OFFSET, g, 0.1)
    touched = RESPONSE @ (weight_of(g) + np.array([0.0, push, 0.0, 0.0, 0.0, 0.0])) + OFFSET
    during = tracker.update(touched, g, 0.1)
    assert during.flags.tolist() == [Flag.REJECTED] * 6
    assert not during.learnt
    np.testing.assert_array_equal(during.offset, before.offset)
    after = tracker.update(RESPONSE @ weight_of(g) + OFFSET, g, 0.1)
    assert after.learnt


def test_an_offset_that_leapt_is_found_once_it_may_have():
    tracker = InSituTracker(make_fit())
    leapt = OFFSET + RESPONSE @ np.array([30.0, -20.0, 25.0, 0.5, 0.3, -0.4])
    tracker.update(RESPONSE @ WEIGHT + OFFSET, DOWN, 0.1)
    assert not tracker.update(RESPONSE @ WEIGHT + leapt, DOWN, 0.1).learnt
    tracker.doubt(30.0, 0.5)
    for g in swept_gravity(50):
        estimate = tracker.update(RESPONSE @ weight_of(g) + leapt, g, 0.1)
    assert estimate.learnt
    error = np.linalg.solve(RESPONSE, estimate.offset - leapt)
    assert np.abs(error[:3]).max() < 0.5
    np.testing.assert_array_less(np.abs(estimate.offset - leapt), 4.0 * estimate.offset_std)


@pytest.mark.parametrize(
    ("value", "flag"), [(np.nan, Flag.MISSING), (np.inf, Flag.OUT_OF_RANGE), (32767.0, Flag.SATURATED)]
)
def test_a_bad_channel_changes_no_estimate(value, flag):
    tracker = InSituTracker(make_fit(), code_range=(-32768.0, 32767.0))
    raw = RESPONSE @ WEIGHT + OFFSET
    before = tracker.update(raw, DOWN, 0.1)
    bad = raw.copy()
    bad[2] = value
    during = tracker.update(bad, DOWN, 0.1)
    assert during.flags.tolist() == [0, 0, flag, 0, 0, 0]
    assert not during.learnt
    np.testing.assert_array_equal(during.offset, before.offset)
    assert all(np.isfinite(part).all() for name, part in during._asdict().items() if name != "nis")
    if flag is not Flag.SATURATED:
        np.testing.assert_allclose(during.wrench, before.wrench, rtol=1e-12)


@pytest.mark.parametrize("gravity", [[np.nan, 0.0, 9.81], [0.0, 0.0, 0.0], [0.0, np.inf, 9.81]])
def test_gravity_that_is_none_teaches_nothing(gravity):
    tracker = InSituTracker(make_fit())
    before = tracker.update(RESPONSE @ WEIGHT + OFFSET + 1.0, DOWN, 0.1)
    during = tracker.update(RESPONSE @ WEIGHT + OFFSET, gravity, 0.1)
    assert during.flags.tolist() == [Flag.REFERENCE] * 6
    np.testing.assert_array_equal(during.offset, before.offset)
    assert np.isfinite(tracker.state.covariance).all()


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf])
def test_time_that_does_not_pass_is_flagged(dt):
    tracker = InSituTracker(make_fit())
    estimate = tracker.update(RESPONSE @ WEIGHT + OFFSET, DOWN, dt)
    assert estimate.flags.tolist() == [Flag.GAP] * 6
    assert np.isfinite(estimate.offset_std).all()


def test_standing_still_informs_no_more_than_hysteresis_lets_it():
    raw = RESPONSE @ WEIGHT + OFFSET
    stds = []
    for lag in (0.0, 0.04):
        tracker = InSituTracker(make_fit(), lag=lag, drift_force=0.0, drift_torque=0.0)
        for _ in range(200):
            estimate = tracker.update(raw, DOWN, 0.01)
        force = np.linalg.solve(RESPONSE, np.linalg.solve(RESPONSE, estimate.covariance[:6, :6]).T)
        stds.append(np.sqrt(force[0, 0]))
    # Anywhere in 4 % of 48 N, beside half a newton since the fit.
    prior, loop = 0.5**2 + 0.2**2, (0.04 * 48.0) ** 2 / 12.0
    expected = np.sqrt(prior * loop / (prior + loop))
    assert stds[1] > 0.95 * expected
    assert stds[0] < 0.7 * stds[1]


def test_a_moving_limb_shows_its_inertia():
    limb = Limb(MASS, MASS_COM, INERTIA)
    rng = np.random.default_rng(4)
    velocity, turn = rng.standard_normal(3), 5.0 * rng.standard_normal(3)
    f = DOWN + rng.standard_normal(3)
    force = MASS * f - np.cross(turn, MASS_COM) - np.cross(velocity, np.cross(velocity, MASS_COM))
    torque = np.cross(MASS_COM, f) - INERTIA @ turn - np.cross(velocity, INERTIA @ velocity)
    tracker = InSituTracker(make_fit(limb=limb))
    raw = RESPONSE @ np.concatenate([force, torque]) + OFFSET
    estimate = tracker.update(raw, f, 0.1, velocity, turn)
    assert estimate.learnt
    assert estimate.nis < 1e-9
    with pytest.raises(ValueError, match="does not know the limb's inertia"):
        InSituTracker(make_fit()).update(raw, f, 0.1, velocity, turn)
    with pytest.raises(ValueError, match="together, or neither"):
        tracker.update(raw, f, 0.1, velocity)


def test_a_known_load_may_hang_on_the_limb():
    com = np.array([0.05, 0.0, 0.3])
    tracker = InSituTracker(make_fit(), added_mass=0.5, added_com=tuple(com))
    load = WEIGHT + np.concatenate([0.5 * DOWN, np.cross(0.5 * com, DOWN)])
    assert tracker.update(RESPONSE @ load + OFFSET, DOWN, 0.1).nis < 1e-9


def stream(batch, steps=12):
    rng = np.random.default_rng(5)
    raw = (RESPONSE @ weight_of(swept_gravity(steps))[..., None])[..., 0][
        (slice(None), *(None,) * len(batch))
    ] + OFFSET
    raw = raw + rng.standard_normal((steps, *batch, 6)) @ (5.0 * NOISE_ROOT).T
    raw[4, ..., 1] = np.nan
    gravity = np.broadcast_to(swept_gravity(steps)[(slice(None), *(None,) * len(batch))], (steps, *batch, 3))
    air = rng.random((steps, *batch)) > 0.2
    tracker = InSituTracker(make_fit(), lag=0.01)
    state, answers = None, []
    for r, g, a in zip(raw, gravity, air, strict=True):
        state = tracker.init(r) if state is None else state
        state, estimate = tracker.step(state, r, g, 0.1, in_air=a)
        answers.append(estimate)
    return answers


def test_a_batch_is_a_loop():
    together = stream((2, 3))
    assert together[-1].covariance.shape == (2, 3, 6, 6)
    assert stream(())[-1].wrench.shape == (6,)
    tracker = InSituTracker(make_fit())
    raw = RESPONSE @ WEIGHT + OFFSET + np.arange(12.0).reshape(2, 6)
    _, both = tracker.step(tracker.init(raw), raw, np.stack([DOWN, DOWN]), 0.1)
    for i in range(2):
        _, one = tracker.step(tracker.init(raw[i]), raw[i], DOWN, 0.1)
        np.testing.assert_allclose(both.offset[i], one.offset, rtol=1e-12)
        np.testing.assert_allclose(both.covariance[i], one.covariance, rtol=1e-9, atol=1e-12)


def test_arguments_are_left_alone_and_the_state_is_a_value():
    tracker = InSituTracker(make_fit())
    raw, gravity = RESPONSE @ WEIGHT + OFFSET + 3.0, DOWN.copy()
    kept = raw.copy()
    state = tracker.init(raw)
    _, first = tracker.step(state, raw, gravity, 0.1)
    _, again = tracker.step(state, raw, gravity, 0.1)
    np.testing.assert_array_equal(raw, kept)
    np.testing.assert_array_equal(first.offset, again.offset)


def test_a_state_can_be_set():
    tracker = InSituTracker(make_fit())
    with pytest.raises(RuntimeError, match="before the first"):
        tracker.doubt(1.0, 0.1)
    raw = RESPONSE @ WEIGHT + OFFSET + 3.0
    tracker.update(raw, DOWN, 0.1)
    kept = tracker.state
    wanted = tracker.update(raw + 2.0, DOWN, 0.1)
    tracker.reset()
    assert tracker.state is None
    tracker.state = kept
    np.testing.assert_array_equal(tracker.update(raw + 2.0, DOWN, 0.1).offset, wanted.offset)


test_options_without_meaning_are_refused = refusals(
    lambda options: InSituTrackerConfig(**options),
    ({"drift_force": -1.0}, "'drift_force' must be finite and not negative"),
    ({"lag": -0.1}, "'lag' must be finite and not negative"),
    ({"code_range": (1.0, -1.0)}, "lowest, highest"),
)


def test_what_has_no_meaning_is_refused():
    refused = make_fit(result=FitResult.REFUSED, refusals=(CalibrationRefused("Too few.", "More."),))
    with pytest.raises(ValueError, match=r"this fit was refused. Too few. More."):
        InSituTracker(refused)
    tracker = InSituTracker(make_fit(covariance_of_fit(limb=0.01)))
    with pytest.raises(ValueError, match=r"'raw' must have shape \(..., 6\)"):
        tracker.update(np.zeros(5), DOWN, 0.1)
    with pytest.raises(ValueError, match="'gravity' must have shape"):
        tracker.update(np.zeros(6), DOWN[:2], 0.1)
    tracker.update(OFFSET, DOWN, 0.1)
    with pytest.raises(ValueError, match="like the first reading"):
        tracker.update(np.tile(OFFSET, (2, 1)), DOWN, 0.1)
