"""Centres of pressure in plain floats, against the definition."""

import numpy as np
import pytest

from surefoot.calibration.cop import cop_of_moments, cop_of_wrench
from surefoot.calibration.front_end.readings import centres

THRESHOLD = 5.0


@pytest.mark.parametrize("feet", [1, 2])
def test_they_are_those_of_the_definition_to_the_bit(feet):
    """Of robots on one foot, on both and on none, some without any torque."""
    rng, seen = np.random.default_rng(11), []
    for k in range(200):
        wrench = rng.normal(0.0, 3.0, (feet, 6))
        wrench[:, 2] = rng.uniform(-10.0, 30.0, feet)
        if k % 7 == 0:
            wrench[:, 3:] = 0.0
        moments = np.column_stack([wrench[:, 2], rng.normal(0.0, 1.0, (feet, 2))])
        known = bool(rng.random() < 0.8)
        cop, exist = centres(wrench, moments, known, THRESHOLD)
        np.testing.assert_array_equal(cop[:-1], cop_of_wrench(wrench, THRESHOLD))
        total = moments.sum(axis=0)
        both = cop_of_moments(total[0], total[1:], THRESHOLD)
        np.testing.assert_array_equal(cop[-1], both if known else np.nan)
        np.testing.assert_array_equal(exist, ~np.isnan(cop[:, 0]))
        seen.append(exist)
    assert np.any(seen, axis=0).all()
    assert not np.all(seen, axis=0).any()
