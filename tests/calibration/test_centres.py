"""Centres of pressure of one robot and of many: two ways to the same numbers."""

import numpy as np
import pytest

from surefoot.calibration.cop import cop_of_moments, cop_of_wrench
from surefoot.calibration.front_end.centres import centres

THRESHOLD = 5.0


def loads(robots=200, feet=2):
    """Wrenches and moments of robots on one foot, on both and on none, some without any torque."""
    rng = np.random.default_rng(11)
    wrench = rng.normal(0.0, 3.0, (robots, feet, 6))
    wrench[..., 2] = rng.uniform(-10.0, 30.0, (robots, feet))
    wrench[::7, :, 3:] = 0.0
    moments = np.concatenate([wrench[..., 2:3], rng.normal(0.0, 1.0, (robots, feet, 2))], axis=-1)
    known = rng.random(robots) < 0.8
    return wrench, moments, known


@pytest.mark.parametrize("feet", [1, 2])
def test_one_robot_gets_the_numbers_that_it_gets_among_many_to_the_bit(feet):
    wrench, moments, known = loads(feet=feet)
    many, exist = centres(wrench, moments, known, THRESHOLD)
    assert exist.any(axis=0).all()
    assert not exist.all(axis=0).any()
    for k in range(len(known)):
        one, there = centres(wrench[k], moments[k], known[k], THRESHOLD)
        assert one.tobytes() == many[k].tobytes()
        np.testing.assert_array_equal(there, exist[k])


def test_they_are_those_of_the_definition():
    wrench, moments, known = loads()
    cop, exist = centres(wrench, moments, known, THRESHOLD)
    np.testing.assert_array_equal(cop[:, :2], cop_of_wrench(wrench, THRESHOLD))
    total = moments.sum(axis=1)
    both = cop_of_moments(total[:, 0], total[:, 1:], THRESHOLD)
    np.testing.assert_array_equal(cop[known, 2], both[known])
    assert np.isnan(cop[~known, 2]).all()
    np.testing.assert_array_equal(exist, ~np.isnan(cop[..., 0]))
