"""Laying out the channels of feet."""

import re
from operator import call

import numpy as np
import pytest
from _refusals import refusals
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from surefoot.calibration.cop import cop_of_feet, sole_wrenches
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


test_refuses_cells_that_make_no_foot = refusals(
    lambda positions: FootLayout.load_cells("left", positions),
    (
        [(0.0, 0.0), (1.0, 0.0)],
        "needs one cell position or at least three, of shape (k, 2) or (k, 3)",
    ),
    (np.zeros((4, 4)), "got shape (4, 4)"),
    ([(0.0, 0.0), (1.0, np.nan), (0.0, 1.0)], "cell positions of foot 'left' hold values"),
    ([(0.0, 0.0), (0.1, 0.1), (0.2, 0.2)], "The cells of foot 'left' are on one line"),
    plain=True,
)


test_refuses_a_map_that_is_none = refusals(
    lambda wrench_map, names: FootLayout("left", wrench_map, names),
    (np.zeros((5, 4)), ("a",) * 4, "must have shape (6, channels), got (5, 4)"),
    (np.full((6, 1), np.inf), ("a",), "holds values that are not finite"),
    (np.zeros((6, 2)), ("a",), "has 2 channels but 1 channel names: ('a',)"),
    plain=True,
)


def test_a_force_plate_is_one_foot_alone():
    plate = FeetLayout((FootLayout.load_cells("plate", CORNERS),))
    assert plate.slices == (slice(0, 4),)
    assert plate.wrench_map.shape == (1, 6, 4)
    assert plate.channel_names[0] == "plate/front-left"


def test_refuses_missing_feet_and_twins():
    foot = FootLayout.load_cells("left", CORNERS)
    with pytest.raises(
        ValueError, match=r"^A layout needs at least one foot, such as a force plate; got none\.$"
    ):
        FeetLayout(())
    with pytest.raises(ValueError, match="Several feet are named"):
        FeetLayout((foot, foot))


@pytest.mark.parametrize("raw", [np.zeros(7), np.zeros((8, 3)), np.float64(1.0), [1.0, 2.0]])
def test_refuses_readings_of_other_channels(raw):
    with pytest.raises(ValueError, match=re.escape("'raw' must hold one reading for each of the 8 channels")):
        nao_shoe_layout().check_raw(raw)


TILTED = Rotation.from_rotvec([0.2, -0.5, 0.4]).as_matrix()
PLACE = np.array([0.02, -0.01, 0.06])


def test_an_ankle_sensor_tells_the_wrench_at_the_sole():
    rng = np.random.default_rng(2)
    foot = FootLayout.force_torque("left", position_sensor_sole=PLACE, R_sole_sensor=TILTED)
    point, force, twist = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)
    # One force at one point and one free moment, seen from the sole and from the sensor.
    at_sole = np.concatenate([force, np.cross(point, force) + twist])
    at_sensor = np.concatenate([TILTED.T @ force, TILTED.T @ (np.cross(point - PLACE, force) + twist)])
    np.testing.assert_allclose(foot.wrench_map @ at_sensor, at_sole, rtol=1e-13)
    assert foot.channel_names == ("fx", "fy", "fz", "tx", "ty", "tz")
    assert foot.position_cell_sole is None
    (sensor,) = foot.sensors
    assert sensor.six_axis
    assert sensor.channels == slice(0, 6)
    parallel = FootLayout.force_torque("left", position_sensor_sole=(0.0, 0.0, 0.0))
    np.testing.assert_array_equal(parallel.wrench_map, np.eye(6))


def test_both_instruments_of_a_foot_share_its_wrench():
    rng = np.random.default_rng(3)
    cells = FootLayout.load_cells("left", CORNERS, mass_below=0.1)
    ankle = FootLayout.force_torque(
        "left", position_sensor_sole=PLACE, R_sole_sensor=TILTED, mass_below=0.6, com_below_sole=PLACE / 2
    )
    both = FootLayout.combined("left", cells, ankle)
    assert both.channels == 10
    assert both.channel_names == cells.channel_names + ankle.channel_names
    wrench = rng.normal(size=6)
    told = np.concatenate(
        [np.linalg.pinv(cells.wrench_map) @ wrench, np.linalg.solve(ankle.wrench_map, wrench)]
    )
    # Where both tell the truth, so does their mean, on the axes of one alone as well.
    np.testing.assert_allclose(both.wrench_map @ told, wrench, rtol=1e-12)
    np.testing.assert_allclose(
        both.wrench_map[:, :4], [[0], [0], [0.5], [0.5], [0.5], [0]] * cells.wrench_map
    )
    first, second = both.sensors
    assert (first.channels, second.channels) == (slice(0, 4), slice(4, 10))
    assert (first.six_axis, second.six_axis) == (False, True)
    np.testing.assert_array_equal(second.share, [1.0, 1.0, 0.5, 0.5, 0.5, 1.0])
    assert (first.mass_below, second.mass_below) == (0.1, 0.6)
    np.testing.assert_array_equal(second.com_below_sole, PLACE / 2)
    np.testing.assert_array_equal(second.wrench_map, ankle.wrench_map)


def test_what_hangs_below_is_kept_and_nothing_by_default():
    bare, heavy = (
        FootLayout.load_cells("left", CORNERS, **options)
        for options in ({}, {"mass_below": 0.2, "com_below_sole": (0.01, 0.02, 0.03)})
    )
    assert bare.sensors[0].mass_below == 0.0
    assert heavy.sensors[0].mass_below == 0.2
    np.testing.assert_array_equal(heavy.sensors[0].com_below_sole, [0.01, 0.02, 0.03])
    plain = FootLayout("left", np.eye(6)[:, :3], ("a", "b", "c"))
    assert plain.sensors[0].channels == slice(0, 3)


test_refuses_instruments_that_make_no_foot = refusals(
    call,
    (
        lambda: FootLayout.load_cells("left", CORNERS, mass_below=-0.1),
        "'mass_below' of foot 'left' must be finite and not negative, got -0.1 kg.",
    ),
    (
        lambda: FootLayout.force_torque("left", position_sensor_sole=PLACE, mass_below=np.nan),
        "'mass_below' of foot 'left' must be finite and not negative, got nan kg.",
    ),
    (
        lambda: FootLayout.load_cells("left", CORNERS, com_below_sole=(0.0, 0.0)),
        "'com_below_sole' of foot 'left' must hold three finite numbers in m, got (0.0, 0.0).",
    ),
    (
        lambda: FootLayout.force_torque("left", position_sensor_sole=(0.0, np.inf, 0.0)),
        "'position_sensor_sole' of foot 'left' must hold three finite numbers in m, got (0.0, inf, 0.0).",
    ),
    (
        lambda: FootLayout.force_torque("left", position_sensor_sole=PLACE, R_sole_sensor=-np.eye(3)),
        "'R_sole_sensor' of foot 'left' must be a rotation of shape (3, 3), got",
    ),
    (
        lambda: FootLayout.force_torque("left", position_sensor_sole=PLACE, R_sole_sensor=np.eye(2)),
        "'R_sole_sensor' of foot 'left' must be a rotation of shape (3, 3), got",
    ),
    (
        lambda: FootLayout.combined("left", FootLayout.load_cells("left", CORNERS)),
        "Foot 'left' combines instruments and needs at least two, got 1.",
    ),
    (
        lambda: FootLayout.combined("left", *[FootLayout.load_cells("left", CORNERS)] * 2),
        "Foot 'left' combines channels of the same name: ('front-left',",
    ),
    plain=True,
)


def test_a_foot_on_one_cell_has_its_force_where_the_cell_is() -> None:
    """Two feet on one cell each have a common centre of pressure between the cells, and none of their own."""
    feet = tuple(FootLayout.load_cells(name, [(0.03, y)]) for name, y in (("left", 0.01), ("right", -0.02)))
    layout = FeetLayout(feet)
    assert layout.channel_names == ("left/fz", "right/fz")
    force = np.array([30.0, 10.0])
    soles, level = np.array([(0.0, 0.1, 0.0), (0.2, -0.1, 0.0)]), np.tile(np.eye(3), (2, 1, 1))
    cop = cop_of_feet(sole_wrenches(force, layout), soles, level)
    np.testing.assert_allclose(cop, [(30 * 0.03 + 10 * 0.23) / 40, (30 * 0.11 - 10 * 0.12) / 40])
    assert not any(foot.flat for foot in feet)
