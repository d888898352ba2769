"""Every stage against its own specification."""

from operator import call

import numpy as np
import pytest
from _refusals import refusals
from _streams import stream

from surefoot.sensors import chain, drift, offset, quantize, saturate, scale, scale_drift, white_noise
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE

MANY = 20_000


def walk(stage, seconds: float, dt: float, value: float, seed: int = 0) -> np.ndarray:
    """Let many devices wander and return their last readings of a constant."""
    return stream(stage, np.full((round(seconds / dt), MANY), value), seed, dt)[-1]


@pytest.mark.parametrize("dt", [1 / 80, 1 / 20, 1.0])
def test_the_spread_of_a_drift_depends_on_time_and_not_on_the_step(dt: float) -> None:
    spread = walk(drift(density=1.0 * PER_SQRT_MINUTE), 4.0, dt, 0.0).std()
    assert spread == pytest.approx((4.0 / 60.0) ** 0.5, rel=0.03)


@pytest.mark.parametrize("dt", [1 / 80, 1.0])
def test_the_spread_of_a_scale_depends_on_time_and_not_on_the_step(dt: float) -> None:
    readings = walk(scale_drift(density=0.02 * PER_SQRT_MINUTE), 4.0, dt, 50.0)
    assert readings.std() == pytest.approx(50.0 * 0.02 * (4.0 / 60.0) ** 0.5, rel=0.03)
    assert readings.mean() == pytest.approx(50.0, abs=0.02)


def test_initial_errors_have_their_spread_and_stay() -> None:
    rng = np.random.default_rng(1)
    stage = chain(scale_drift(0.12), drift(1.5))
    state = stage.init((MANY,), rng)
    at_rest, later = stage.apply(np.zeros(MANY), state, rng, 0.1)
    loaded, _ = stage.apply(np.full(MANY, 10.0), later, rng, 0.1)
    assert at_rest.std() == pytest.approx(1.5, rel=0.03)
    assert ((loaded - at_rest) / 10.0).std() == pytest.approx(0.12, rel=0.03)


def test_a_fresh_init_does_not_add_to_an_old_state() -> None:
    """Drawing anew is not a random walk over episodes: the spread stays the initial one."""
    rng = np.random.default_rng(2)
    stage = drift(1.0)
    last = [stage.init((MANY,), rng).error.std() for _ in range(20)][-1]
    assert last == pytest.approx(1.0, rel=0.03)


def test_white_noise_has_its_spread_and_no_memory() -> None:
    rng = np.random.default_rng(3)
    stage = white_noise(0.4)
    first, state = stage.apply(np.zeros(MANY), stage.init((MANY,), rng), rng, 0.1)
    second, _ = stage.apply(np.zeros(MANY), state, rng, 0.1)
    assert first.std() == pytest.approx(0.4, rel=0.03)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.03


def test_saturation_clips_and_rounding_rounds() -> None:
    rng = np.random.default_rng(5)
    stage = chain(saturate(-2.0, 1.0), quantize(0.25))
    reading = np.array([-9.0, -1.9, -0.1, 0.1, 0.3, 9.0])
    result, _ = stage.apply(reading, stage.init((6,), rng), rng, 0.1)
    np.testing.assert_array_equal(result, [-2.0, -2.0, 0.0, 0.0, 0.25, 1.0])


def test_stages_act_in_their_order() -> None:
    rng = np.random.default_rng(6)
    one, other = chain(scale(2.0), offset(1.0)), chain(offset(1.0), scale(2.0))
    results = [stage.apply(np.ones(1), stage.init((1,), rng), rng, 0.1)[0] for stage in (one, other)]
    assert np.concatenate(results).tolist() == [3.0, 4.0]


test_impossible_stages_are_refused = refusals(
    call,
    (lambda: drift(-1.0), "'initial_std' must be finite and not negative, got -1.0"),
    (lambda: saturate(1.0, 1.0), r"'low' must be below 'high', got \[1.0, 1.0\]"),
)
