"""Footsteps: alternate, even, clear of each other, and within reach."""

from itertools import pairwise

import numpy as np
import pytest
from _refusals import refusals
from hypothesis import given, settings
from hypothesis import strategies as st

from surefoot.envs.gait.footsteps import (
    MAX_STEP_LENGTH,
    MAX_STEP_TURN,
    GaitTiming,
    plan_footsteps,
    stance_of_stand,
)

SHOE_HALF = np.array([0.085, 0.049])
SHOE_MIDDLE = np.array([0.02397, 0.00676])
STEP_TIME = 0.8


def shoe_corners(step):
    middle = SHOE_MIDDLE * (1, 1 if step.foot == 0 else -1)
    corners = middle + SHOE_HALF * np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)])
    c, s = np.cos(step.yaw), np.sin(step.yaw)
    return np.array(step.position) + corners @ np.array([[c, s], [-s, c]])


def gap(first, second):
    """How far two convex shoes are apart along the best separating axis; negative if they overlap."""
    best = -np.inf
    for shoe in (first, second):
        edges = np.roll(shoe, -1, axis=0) - shoe
        for x, y in edges:
            normal = np.array([y, -x]) / np.hypot(x, y)
            one, other = first @ normal, second @ normal
            best = max(best, other.min() - one.max(), one.min() - other.max())
    return best


speeds = st.floats(-MAX_STEP_LENGTH / STEP_TIME, MAX_STEP_LENGTH / STEP_TIME)
turns = st.floats(-MAX_STEP_TURN / STEP_TIME, MAX_STEP_TURN / STEP_TIME)


@settings(max_examples=60, deadline=None)
@given(speed=speeds, turn_rate=turns, steps=st.integers(2, 12))
def test_shoes_never_touch(speed, turn_rate, steps):
    feet = list(stance_of_stand())
    for step in plan_footsteps(speed, turn_rate, steps, STEP_TIME):
        feet[step.foot] = step
        assert gap(shoe_corners(feet[0]), shoe_corners(feet[1])) > 0.005


@settings(max_examples=60, deadline=None)
@given(speed=speeds, turn_rate=turns, steps=st.integers(2, 12))
def test_feet_alternate_and_end_side_by_side(speed, turn_rate, steps):
    footsteps = plan_footsteps(speed, turn_rate, steps, STEP_TIME)
    assert len(footsteps) == steps
    assert all(a.foot != b.foot for a, b in pairwise(footsteps))
    last, other = footsteps[-1], footsteps[-2]
    assert last.yaw == pytest.approx(other.yaw, abs=1e-12)
    left, right = (last, other) if last.foot == 0 else (other, last)
    across = np.subtract(left.position, right.position)
    assert across @ (np.cos(last.yaw), np.sin(last.yaw)) == pytest.approx(0.0, abs=0.025)


@settings(max_examples=30, deadline=None)
@given(speed=speeds, turn_rate=turns)
def test_the_mirror_image_of_a_walk_is_the_walk_of_the_mirrored_turn(speed, turn_rate):
    if turn_rate == 0.0:
        return
    walk = plan_footsteps(speed, turn_rate, 7, STEP_TIME)
    mirrored = plan_footsteps(speed, -turn_rate, 7, STEP_TIME)
    for a, b in zip(walk, mirrored, strict=True):
        assert a.foot == 1 - b.foot
        assert a.position == pytest.approx((b.position[0], -b.position[1]), abs=1e-12)
        assert a.yaw == pytest.approx(-b.yaw, abs=1e-12)


@pytest.mark.parametrize("speed", [0.02, 0.04, 0.1, -0.04])
def test_a_straight_walk_goes_as_far_as_its_speed_says(speed):
    steps = 20
    footsteps = plan_footsteps(speed, 0.0, steps, STEP_TIME)
    # The first and the last of the moves are half as long.
    assert footsteps[-1].position[0] == pytest.approx(speed * STEP_TIME * (steps - 2))
    assert {step.yaw for step in footsteps} == {0.0}


def test_an_arc_turns_as_far_as_its_rate_says():
    steps, turn_rate = 12, 0.15
    footsteps = plan_footsteps(0.04, turn_rate, steps, STEP_TIME)
    assert footsteps[-1].yaw == pytest.approx(turn_rate * STEP_TIME * (steps - 2))


test_impossible_walks_are_refused = refusals(
    lambda change: plan_footsteps(
        **{"speed": 0.04, "turn_rate": 0.0, "steps": 6, "step_time": STEP_TIME} | change
    ),
    ({"speed": 0.2}, r"'speed' 0\.2 m/s makes steps of 0\.160 m.*walk at most 0\.1125 m/s"),
    ({"speed": float("nan")}, "'speed' must be finite"),
    ({"turn_rate": 1.0}, r"'turn_rate' 1\.0 rad/s.*turn at most 0\.200 rad/s"),
    ({"turn_rate": float("inf")}, "'turn_rate' must be finite"),
    ({"steps": 1}, "at least two steps"),
)


test_impossible_timings_are_refused = refusals(
    lambda change: GaitTiming(**change),
    ({"step_time": 0.1}, "'step_time'"),
    ({"double_support": 0.95}, "'double_support'"),
    ({"stand_time": 0.0}, "'stand_time'"),
)


def test_steps_that_fit_leave_room_for_standing():
    timing = GaitTiming()
    for duration in np.arange(3.0, 20.0, 0.37):
        steps = timing.steps_within(duration)
        used = 2 * timing.stand_ticks + timing.double_ticks + steps * timing.step_ticks
        assert used <= round(duration * 80) < used + timing.step_ticks
