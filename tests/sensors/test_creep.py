"""Creep: the analytic answer to steps, however finely time was stepped."""

import numpy as np
import pytest
import torch

from surefoot.sensors.stages.creep import creep

SHARES, CONSTANTS = (0.02, -0.005, 0.01), (0.5, 8.0, 120.0)


def expected_step(time):
    return 1.0 + sum(s * (1.0 - np.exp(-time / tau)) for s, tau in zip(SHARES, CONSTANTS, strict=True))


@pytest.mark.parametrize("dt", [0.01, 0.7, 60.0])
def test_a_step_creeps_as_the_exponentials_say(dt):
    rng = np.random.default_rng(0)
    element = creep(SHARES, CONSTANTS)
    state = element.init((2,), rng)
    for number in range(1, 51):
        read, state = element.apply(np.array([40.0, -3.0]), state, rng, dt)
        np.testing.assert_allclose(read, np.array([40.0, -3.0]) * expected_step(number * dt), rtol=1e-12)


def test_the_answer_does_not_depend_on_the_step():
    """A load of stairs, each read once or in many uneven parts."""
    rng = np.random.default_rng(1)
    element = creep(SHARES, CONSTANTS)
    whole = parts = element.init((4,), rng)
    for load in rng.normal(0.0, 20.0, (30, 4)):
        duration = rng.uniform(0.01, 20.0)
        at_once, whole = element.apply(load, whole, rng, duration)
        for share in rng.dirichlet(np.ones(9)):
            bit_by_bit, parts = element.apply(load, parts, rng, duration * share)
        np.testing.assert_allclose(bit_by_bit, at_once, rtol=1e-11, atol=1e-11)


def test_unloading_creeps_back_to_nothing():
    rng = np.random.default_rng(2)
    element = creep(SHARES, CONSTANTS)
    _, state = element.apply(np.array([100.0]), element.init((1,), rng), rng, 50.0)
    left, state = element.apply(np.array([0.0]), state, rng, 3.0)
    loaded = expected_step(53.0) - expected_step(3.0)
    np.testing.assert_allclose(left, 100.0 * loaded, atol=1e-12)
    left, _ = element.apply(np.array([0.0]), state, rng, 1e5)
    np.testing.assert_allclose(left, 0.0, atol=1e-12)


def test_no_time_changes_nothing_and_loads_add_up():
    rng = np.random.default_rng(3)
    element = creep(SHARES, CONSTANTS)
    fresh = element.init((3,), rng)
    at_once, _ = element.apply(np.ones(3), fresh, rng, 0.0)
    np.testing.assert_array_equal(at_once, 1.0)
    one, other = rng.normal(size=(2, 20, 3))
    read = {}
    for name, loads in (("one", one), ("other", other), ("both", one + other)):
        state = fresh
        for load in loads:
            read[name], state = element.apply(load, state, rng, 0.3)
    np.testing.assert_allclose(read["both"], read["one"] + read["other"], rtol=1e-12)


def test_torch_reads_the_same():
    rng, generator = np.random.default_rng(4), torch.Generator()
    element = creep(SHARES, CONSTANTS)
    state, other = element.init((2, 3), rng), element.init((2, 3), generator, torch.float64)
    for load in rng.normal(0.0, 10.0, (20, 2, 3)):
        read, state = element.apply(load, state, rng, 0.4)
        same, other = element.apply(torch.from_numpy(load), other, generator, 0.4)
        np.testing.assert_allclose(same, read, rtol=1e-13)


@pytest.mark.parametrize(
    ("shares", "constants", "message"),
    [
        ((0.1,), (), "as many 'shares' as 'time_constants', got 1 and 0"),
        ((float("nan"),), (1.0,), r"'shares' must be finite, got \(nan,\)"),
        ((0.1,), (0.0,), r"'time_constants' must be finite and positive, got \(0.0,\)"),
    ],
)
def test_impossible_elements_are_refused(shares, constants, message):
    with pytest.raises(ValueError, match=message):
        creep(shares, constants)
