"""The masses beyond the sensors against Newton and Euler written out for one rigid foot at a time."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from surefoot.calibration import GRAVITY, FeetLayout, FootLayout
from surefoot.calibration.front_end.motion import MotionColumns
from surefoot.calibration.moment.distal import DistalMasses

DT, N = 1.0 / 80.0, 24
CORNERS = [(0.1, 0.05), (0.1, -0.04), (-0.06, 0.05), (-0.07, -0.05)]
TILTED = Rotation.from_rotvec([0.1, -0.4, 0.3]).as_matrix()
PLATE = {"mass_below": 0.15, "com_below_sole": (0.02, -0.01, 0.008)}
FOOT = {"mass_below": 0.8, "com_below_sole": (0.03, 0.01, 0.025)}
SENSOR = {"position_sensor_sole": (0.01, -0.005, 0.06), "R_sole_sensor": TILTED}

CELLS = FeetLayout(tuple(FootLayout.load_cells(name, CORNERS, **PLATE) for name in ("left", "right")))
ANKLES = FeetLayout(tuple(FootLayout.force_torque(name, **SENSOR, **FOOT) for name in ("left", "right")))
BOTH = FeetLayout(
    tuple(
        FootLayout.combined(
            name,
            FootLayout.load_cells(name, CORNERS, **PLATE),
            FootLayout.force_torque(name, **SENSOR, **FOOT),
        )
        for name in ("left", "right")
    )
)


def motion(seed, tilt=0.3):
    """Soles and a centre of mass on parabolas, in a level frame that itself wanders about."""
    rng = np.random.default_rng([13, seed])
    time = (np.arange(N) - (N - 1) / 2) * DT
    sole_acceleration = rng.normal(size=(2, 3)) * 4.0
    position = (
        rng.normal(size=(2, 3)) * 0.1
        + time[:, None, None] * rng.normal(size=(2, 3))
        + time[:, None, None] ** 2 / 2 * sole_acceleration
    )
    acceleration = rng.normal(size=3)
    com = [0.0, 0.0, 0.3] + time[:, None] * rng.normal(size=3) + time[:, None] ** 2 / 2 * acceleration
    frame = rng.normal(size=(N, 3))
    R = Rotation.from_rotvec(rng.normal(size=(2, 3)) * tilt).as_matrix()
    return {
        "com": com + frame,
        "acceleration": np.broadcast_to(acceleration, (N, 3)).copy(),
        "position": position + frame[:, None],
        "R": np.broadcast_to(R, (N, 2, 3, 3)).copy(),
    }, sole_acceleration


def flat(moved):
    """A motion as flat references, with zeros for what inertia does not depend on."""
    columns = MotionColumns.of(2)
    reference = np.zeros((N, columns.size))
    reference[:, columns.com] = moved["com"]
    reference[:, columns.com_acceleration] = moved["acceleration"]
    reference[:, columns.position_sole] = moved["position"].reshape(N, -1)
    reference[:, columns.R_level_sole] = moved["R"].reshape(N, -1)
    return reference


def lost(part, acceleration, R):
    """Wrench in the sole frame that a part beyond a sensor keeps from it, its weight at level rest apart."""
    up = np.array([0.0, 0.0, 1.0])
    force_level = part["mass_below"] * (acceleration + GRAVITY * up)
    force = R.T @ force_level - part["mass_below"] * GRAVITY * up
    return np.concatenate([force, np.cross(part["com_below_sole"], force)])


def in_sensor_frame(wrench):
    """Take a wrench at the sole to the ankle sensor, by the forces' points of action."""
    force, moment = wrench[:3], wrench[3:]
    at_sensor = moment - np.cross(SENSOR["position_sensor_sole"], force)
    return np.concatenate([TILTED.T @ force, TILTED.T @ at_sensor])


@pytest.mark.parametrize("seed", range(5))
def test_an_ankle_sensor_in_the_air_feels_its_foot(seed):
    moved, sole_acceleration = motion(seed)
    felt = DistalMasses(ANKLES, 9.81, DT, N).felt(flat(moved))
    expected = [in_sensor_frame(-lost(FOOT, sole_acceleration[foot], moved["R"][0, foot])) for foot in (0, 1)]
    np.testing.assert_allclose(felt, np.concatenate(expected), atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_cells_in_the_air_feel_their_plate(seed):
    moved, sole_acceleration = motion(seed)
    felt = DistalMasses(CELLS, 9.81, DT, N).felt(flat(moved)).reshape(2, 4)
    x, y = np.transpose(CORNERS)
    for foot in (0, 1):
        wrench = -lost(PLATE, sole_acceleration[foot], moved["R"][0, foot])
        total, moment = felt[foot].sum(), (y @ felt[foot], -x @ felt[foot])
        np.testing.assert_allclose([total, *moment], wrench[2:5], atol=1e-9)
        # A rigid plate's inertia is linear over the sole; a warp would be no inertia.
        plane = np.column_stack([np.ones(4), x, y])
        fitted = plane @ np.linalg.lstsq(plane, felt[foot], rcond=None)[0]
        np.testing.assert_allclose(felt[foot], fitted, atol=1e-9)


def test_both_on_one_foot_feel_each_their_own():
    moved, _ = motion(3)
    felt = DistalMasses(BOTH, DT, N).felt(flat(moved)).reshape(2, 10)
    np.testing.assert_allclose(
        felt[:, :4], DistalMasses(CELLS, 9.81, DT, N).felt(flat(moved)).reshape(2, 4), atol=1e-12
    )
    np.testing.assert_allclose(
        felt[:, 4:], DistalMasses(ANKLES, 9.81, DT, N).felt(flat(moved)).reshape(2, 6), atol=1e-12
    )


@pytest.mark.parametrize("layout", [CELLS, ANKLES, BOTH])
def test_at_level_rest_there_is_nothing_to_feel(layout):
    moved, _ = motion(0, tilt=0.0)
    rest = {name: np.broadcast_to(values[:1], values.shape) for name, values in moved.items()}
    rest["acceleration"] = np.zeros((N, 3))
    masses = DistalMasses(layout, DT, N)
    assert masses.matter
    np.testing.assert_allclose(masses.felt(flat(rest)), 0.0, atol=1e-9)
    np.testing.assert_allclose(masses.total(flat(rest), np.zeros((N, 3))), 0.0, atol=1e-9)


def test_a_foot_at_rest_on_its_side_no_longer_weighs_on_its_sensor():
    moved, _ = motion(0, tilt=0.0)
    rest = {name: np.broadcast_to(values[:1], values.shape) for name, values in moved.items()}
    rest["acceleration"] = np.zeros((N, 3))
    quarter = Rotation.from_rotvec([np.pi / 2, 0.0, 0.0]).as_matrix()  # the left edge points up
    rest["R"] = np.broadcast_to(quarter, (N, 2, 3, 3))
    weight = FOOT["mass_below"] * GRAVITY
    # The zero holds (0, 0, -m g); on its side the foot pulls along its own right edge instead.
    wrench = np.array([0.0, -weight, weight])
    expected = in_sensor_frame(np.concatenate([wrench, np.cross(FOOT["com_below_sole"], wrench)]))
    felt = DistalMasses(ANKLES, 9.81, DT, N).felt(flat(rest))
    np.testing.assert_allclose(felt[:6], expected, atol=1e-9)


def newton_euler(layout, moved, sole_acceleration, origin):
    """Sum, foot by foot and instrument by instrument, what the channels' wrenches lack of the ground's."""
    total = np.zeros(6)
    for foot, sides in enumerate(layout.feet):
        R = moved["R"][0, foot]
        for sensor in sides.sensors:
            part = {"mass_below": sensor.mass_below, "com_below_sole": sensor.com_below_sole}
            # Only what an instrument sees can be missing from it: no shear and no twist from load cells.
            sees = (sensor.wrench_map != 0.0).any(axis=1)
            share = np.where(sees, sensor.share, 0.0)
            wrench = share * lost(part, sole_acceleration[foot], R)
            force, moment = R @ wrench[:3], R @ wrench[3:]
            arms = moved["position"][:, foot] - origin
            total += np.concatenate([force, np.mean([moment + np.cross(arm, force) for arm in arms], axis=0)])
    return total


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("layout", "tilt"),
    [
        (ANKLES, 0.3),
        (BOTH, 0.0),
        (CELLS, 0.3),
        (CELLS, 0.0),
        (BOTH, 0.3),
    ],
)
def test_the_feet_lack_what_newton_and_euler_ask_for(layout, tilt, seed):
    moved, sole_acceleration = motion(seed, tilt)
    origin = moved["com"] * (1.0, 1.0, 0.0) + 0.05
    total = DistalMasses(layout, DT, N).total(flat(moved), origin)
    np.testing.assert_allclose(total, newton_euler(layout, moved, sole_acceleration, origin), atol=1e-9)


def test_a_weightless_plate_does_not_matter():
    bare = FeetLayout((FootLayout.load_cells("plate", CORNERS),))
    assert not DistalMasses(bare, DT, N).matter
