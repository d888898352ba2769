"""Forces of now, of chips on clocks of their own and of wires that are late."""

import numpy as np
import pytest
from _synthetic import DT, LAYOUT, MASS, NOMINAL, Faults, walk

from surefoot.calibration import FootCalibrator, OnlineSetup, Parameters, Reference
from surefoot.calibration.front_end.ages import SLOPE_SAMPLES, extrapolation_time, with_total_kept

AGE = 0.006
METHODS = ["tare", "window", "moment"]


@pytest.fixture(scope="module")
def log():
    return walk(3, 0.1, 3.0, 1.0, Faults(lag=2))


def chips(log, rng):
    """Read each channel by a chip of its own rate and phase; return readings and their mean age."""
    time = np.arange(len(log.raw)) * DT
    raw = np.empty_like(log.raw)
    period = 1.0 / rng.uniform(78.0, 94.0, log.raw.shape[1])
    for i, (T, phase) in enumerate(zip(period, rng.uniform(size=len(period)), strict=True)):
        raw[:, i] = np.interp(T * (np.floor(time / T - phase) + phase), time, log.raw[:, i])
    return raw, 0.5 * period.mean()


def play(log, raw, method="tare", lag=2, times=None, reference=None, **options):
    calibrator = FootCalibrator(LAYOUT, method, mass=MASS, initial=NOMINAL, dt=DT, lag=lag, **options)
    steps = np.full(len(raw), DT) if times is None else times
    rows = log.reference if reference is None else reference
    return [
        calibrator.update(raw[k], Reference(*(part[k] for part in rows)), float(steps[k]))
        for k in range(len(raw))
    ]


def rms(values):
    return float(np.sqrt(np.nanmean(np.square(values))))


def stack(estimates, name):
    return np.array([getattr(one, name) for one in estimates])


@pytest.mark.parametrize("seed", range(3))
def test_chips_are_brought_to_now(log, seed):
    raw, age = chips(log, np.random.default_rng(seed))
    read, now = play(log, raw), play(log, raw, age=age)
    truth = stack(play(log, log.raw), "cop")
    assert rms(stack(now, "cop") - truth) < 0.75 * rms(stack(read, "cop") - truth)
    np.testing.assert_array_equal(stack(now, "cop_measured"), stack(read, "cop"))
    for name in ("force", "vgrf", "cop_foot"):  # single feet are as they were read
        np.testing.assert_array_equal(stack(now, name), stack(read, name))


@pytest.mark.parametrize("method", ["none", "tare", "moment"])
@pytest.mark.parametrize("lag", [0, 2])
def test_readings_whose_conversions_are_known_meet_at_one_moment(log, method, lag):
    raw, age = chips(log, np.random.default_rng(4))
    time = np.arange(len(raw)) * DT
    rng = np.random.default_rng(4)
    period = 1.0 / rng.uniform(78.0, 94.0, raw.shape[1])
    phase = rng.uniform(size=len(period))
    ages = time[:, None] - period * (np.floor(time[:, None] / period - phase) + phase)
    calibrator = FootCalibrator(LAYOUT, method, mass=MASS, initial=NOMINAL, dt=DT, lag=lag, age=age)
    found = [
        calibrator.update(raw[k], Reference(*(part[k] for part in log.reference)), age=ages[k])
        for k in range(len(raw))
    ]
    late = calibrator.aligned_lag
    assert late == 1
    true = play(log, log.raw, method, lag=lag)
    for name in ("force", "cop_foot"):
        aligned, expected = stack(found, f"{name}_aligned")[60:], stack(true, name)[60 - late : -late]
        read = stack(found, name)[60:] - stack(true, name)[60:]
        assert rms(aligned - expected) < 0.5 * rms(read)


def test_ages_of_another_shape_are_refused(log):
    calibrator = FootCalibrator(LAYOUT, "moment", mass=MASS, initial=NOMINAL, dt=DT)
    reference = Reference(*(part[0] for part in log.reference))
    with pytest.raises(ValueError, match=r"'age' must hold one age in s for each of the 8 channels, got"):
        calibrator.update(log.raw[0], reference, age=np.zeros(4))


@pytest.mark.parametrize("age", [0.0, AGE, 3.0 * DT])
def test_one_lost_sample_is_bridged_in_what_is_aligned(log, age):
    lost = log.raw.copy()
    lost[200] = np.nan
    whole, bridged = (stack(play(log, raw, "none", age=age), "force_aligned") for raw in (log.raw, lost))
    held = stack(play(log, lost, "none"), "force")
    error = rms(bridged[195:210] - whole[195:210])
    assert error < 0.5 * rms(held[200] - log.force[200])


def test_without_a_calibration_readings_are_as_they_were_read(log):
    aged, read = play(log, log.raw, "none", age=AGE), play(log, log.raw, "none")
    np.testing.assert_array_equal(stack(aged, "force"), stack(read, "force"))
    np.testing.assert_array_equal(stack(aged, "cop"), stack(aged, "cop_measured"))


@pytest.mark.parametrize("samples", [1, 2, 4])
def test_a_late_wire_is_made_up_for(log, samples):
    late = np.concatenate([log.raw[:1].repeat(samples, axis=0), log.raw[:-samples]])
    truth = stack(play(log, log.raw), "cop")
    off = [rms(stack(play(log, late, age=age), "cop") - truth) for age in (0.0, samples * DT)]
    assert off[1] < 0.75 * off[0]


@pytest.mark.parametrize("method", METHODS)
def test_without_an_age_nothing_changes(log, method):
    plain, told = play(log, log.raw, method), play(log, log.raw, method, age=np.zeros(8))
    for name in ("force", "cop", "scale", "offset"):
        np.testing.assert_array_equal(stack(told, name), stack(plain, name))
    np.testing.assert_array_equal(stack(plain, "cop_measured"), stack(plain, "cop"))


@pytest.mark.parametrize("lag", [0, 2, 5])
def test_what_is_learnt_does_not_depend_on_the_age(log, lag):
    plain, told = (play(log, log.raw, "moment", lag=lag, age=age) for age in (0.0, AGE))
    for name in ("scale", "offset"):
        np.testing.assert_allclose(stack(told, name), stack(plain, name), rtol=1e-9)
    assert rms(stack(told, "cop") - stack(plain, "cop")) > 1e-5


@pytest.mark.parametrize("method", METHODS)
def test_what_did_not_come_is_not_carried_on(log, method):
    raw = log.raw.copy()
    raw[200, 2] = np.nan
    plain, told = (play(log, raw, method, lag=0, age=age) for age in (0.0, AGE))
    plain, told = stack(plain, "cop"), stack(told, "cop")
    assert np.isfinite(told).all()
    same = np.abs(told - plain).max(axis=1) < 1e-9
    assert same[:SLOPE_SAMPLES].all()
    # Until as many samples are good again as a slope is taken over.
    np.testing.assert_array_equal(same[199:205], [False, True, True, True, False, False])


@pytest.mark.parametrize("spoilt", [np.nan, np.inf, -1.0, 0.0, 1.0])
def test_a_clock_that_jumps_starts_slopes_afresh(log, spoilt):
    times = np.full(len(log.raw), DT)
    times[200] = spoilt
    plain, told = (stack(play(log, log.raw, lag=0, times=times, age=age), "cop") for age in (0.0, AGE))
    same = np.abs(told - plain).max(axis=1) < 1e-9
    np.testing.assert_array_equal(same[199:205], [False, True, True, True, False, False])


def test_a_bad_reference_is_nothing_to_go_by(log):
    broken = Reference(*(part.copy() for part in log.reference))
    broken.com[200] = np.nan
    plain, told = (stack(play(log, log.raw, reference=broken, age=age), "cop") for age in (0.0, AGE))
    np.testing.assert_array_equal(told[200:203], plain[200:203])


def test_samples_that_come_late_have_a_slope_that_is_as_much_smaller(log):
    twice = play(log, log.raw, times=np.full(len(log.raw), 2.0 * DT), age=2.0 * AGE)
    once = play(log, log.raw, age=AGE)
    np.testing.assert_allclose(stack(twice, "cop"), stack(once, "cop"), rtol=1e-9, atol=1e-9)


def test_changes_leave_the_vertical_force_and_do_not_grow_without_bound():
    rng = np.random.default_rng(0)
    up = np.array([1.0, 1.0, 1.0, 1.0, 0.9, 0.9, 0.0, 0.0])
    for change in rng.normal(size=(100, 8)):
        kept = with_total_kept(change, up)
        np.testing.assert_allclose(kept @ up, 0.0, atol=1e-12)
        np.testing.assert_array_equal(kept[6:], change[6:])
    np.testing.assert_array_equal(with_total_kept(np.zeros(8), up), 0.0)
    # One channel alone cannot change.
    alone = np.zeros(8)
    alone[2] = 3.0
    np.testing.assert_allclose(with_total_kept(alone, up), 0.0, atol=1e-12)


def test_the_longest_age_is_four_samples():
    setup = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL, age=np.array([0.0, 0.01, 1.0, *5 * [0.0]]))
    np.testing.assert_allclose(extrapolation_time(setup)[:3], [0.0, 0.01, 4.0 * DT])


@pytest.mark.parametrize("age", [-1e-3, np.nan, np.inf, np.zeros(7), np.zeros((8, 1))])
def test_an_age_without_meaning_is_refused(age):
    with pytest.raises(ValueError, match="'age' must be finite and not negative"):
        OnlineSetup(layout=LAYOUT, mass=MASS, initial=Parameters(np.ones(8), np.zeros(8)), age=age)
