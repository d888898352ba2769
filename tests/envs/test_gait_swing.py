"""The way of a foot through the air."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surefoot.envs.gait.swing import lift, minimum_jerk


@given(st.floats(-1.0, 2.0), st.floats(0.0, 0.1))
def test_the_foot_is_never_below_the_ground_nor_above_its_height(phase, height):
    assert 0.0 <= lift(phase, height) <= height + 1e-12


@given(st.floats(0.0, 1.0))
def test_the_way_is_symmetric(phase):
    assert minimum_jerk(phase) + minimum_jerk(1.0 - phase) == pytest.approx(1.0, abs=1e-12)
    assert lift(phase, 0.015) == pytest.approx(lift(1.0 - phase, 0.015), abs=1e-12)


def test_it_leaves_and_lands_without_velocity_or_acceleration():
    h = 1e-4
    for way in (minimum_jerk, lambda s: lift(s, 1.0)):
        for end, inward in ((0.0, h), (1.0, -h)):
            gone = way(end + inward) - way(end)
            assert abs(gone / h) < 1e-6
            assert abs(way(end + 2 * inward) - 2 * way(end + inward) + way(end)) / h**2 < 0.1


def test_the_way_only_goes_forward():
    assert (np.diff(minimum_jerk(np.linspace(0, 1, 200))) > 0).all()


def test_half_way_is_the_top():
    assert lift(0.5, 0.015) == pytest.approx(0.015)
    assert minimum_jerk(0.5) == pytest.approx(0.5)


@pytest.mark.parametrize("height", [-0.01, float("nan"), float("inf")])
def test_a_lift_below_ground_is_refused(height):
    with pytest.raises(ValueError, match="'height' of the lift"):
        lift(0.5, height)
