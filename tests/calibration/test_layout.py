"""Laying out the channels of feet."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surefoot.calibration.layout import FeetLayout, FootLayout, nao_shoe_layout

CORNERS = [(0.1, 0.05), (0.1, -0.05), (-0.06, 0.05), (-0.06, -0.05)]


def test_cells_add_up_as_forces_at_points_do():
    rng = np.random.default_rng(1)
    position = rng.uniform(-0.1, 0.1, (5, 2))
    force = rng.uniform(-5.0, 50.0, 5)
    foot = FootLayout.load_cells("left", position)

    points = np.column_stack([position, np.zeros(5)])
    forces = np.column_stack([np.zeros(5), np.zeros(5), force])
    wrench = np.concatenate([forces.sum(axis=0), np.cross(points, forces).sum(axis=0)])

    np.testing.assert_allclose(foot.wrench_map @ force, wrench, rtol=1e-14, atol=1e-14)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(height=st.floats(-1.0, 1.0))
def test_heights_of_cells_do_not_matter(height):
    flat = FootLayout.load_cells("left", CORNERS)
    raised = FootLayout.load_cells("left", [(x, y, height) for x, y in CORNERS])
    np.testing.assert_array_equal(flat.wrench_map, raised.wrench_map)


def test_feet_follow_each_other_in_one_array():
    left = FootLayout.load_cells("left", CORNERS)
    right = FootLayout("right", np.eye(6), ("fx", "fy", "fz", "tx", "ty", "tz"))
    feet = FeetLayout((left, right))

    assert feet.channels == 10
    assert feet.slices == (slice(0, 4), slice(4, 10))
    assert feet.channel_names[3:5] == ("left/rear-right", "right/fx")
    np.testing.assert_array_equal(feet.foot_of_channel, [0] * 4 + [1] * 6)
    np.testing.assert_array_equal(feet.wrench_map[0, :, 4:], 0.0)
    np.testing.assert_array_equal(feet.wrench_map[1, :, :4], 0.0)
    np.testing.assert_array_equal(feet.wrench_map[1, :, 4:], np.eye(6))


def test_nao_shoes_are_mirror_images():
    left, right = nao_shoe_layout().feet
    mirrored = left.position_cell_sole * (1.0, -1.0, 1.0)
    np.testing.assert_allclose(mirrored[[1, 0, 3, 2]], right.position_cell_sole, atol=1e-15)


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        ([(0.0, 0.0), (1.0, 0.0)], "needs at least three cell positions of shape (cells, 2) or (cells, 3)"),
        (np.zeros((4, 4)), "got shape (4, 4)"),
        ([(0.0, 0.0), (1.0, np.nan), (0.0, 1.0)], "cell positions of foot 'left' hold values"),
        ([(0.0, 0.0), (0.1, 0.1), (0.2, 0.2)], "The cells of foot 'left' lie on one line"),
    ],
)
def test_refuses_cells_that_make_no_foot(positions, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        FootLayout.load_cells("left", positions)


@pytest.mark.parametrize(
    ("wrench_map", "names", "message"),
    [
        (np.zeros((5, 4)), ("a",) * 4, "must have shape (6, channels), got (5, 4)"),
        (np.full((6, 1), np.inf), ("a",), "holds values that are not finite"),
        (np.zeros((6, 2)), ("a",), "has 2 channels but 1 channel names: ('a',)"),
    ],
)
def test_refuses_a_map_that_is_none(wrench_map, names, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        FootLayout("left", wrench_map, names)


def test_a_force_plate_is_one_foot_alone():
    plate = FeetLayout((FootLayout.load_cells("plate", CORNERS),))
    assert plate.slices == (slice(0, 4),)
    assert plate.wrench_map.shape == (1, 6, 4)
    assert plate.channel_names[0] == "plate/front-left"


def test_refuses_missing_feet_and_twins():
    foot = FootLayout.load_cells("left", CORNERS)
    for feet in ((), (foot, foot, foot)):
        with pytest.raises(ValueError, match=re.escape(f"such as a force plate; got {len(feet)}")):
            FeetLayout(feet)
    with pytest.raises(ValueError, match="Both feet are named 'left'"):
        FeetLayout((foot, foot))


@pytest.mark.parametrize("raw", [np.zeros(7), np.zeros((8, 3)), np.float64(1.0), [1.0, 2.0]])
def test_refuses_readings_of_other_channels(raw):
    with pytest.raises(ValueError, match=re.escape("'raw' must hold one reading for each of the 8 channels")):
        nao_shoe_layout().check_raw(raw)
