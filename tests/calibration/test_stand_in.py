"""How cells stand in for each other, against conditional normal distributions worked out one by one."""

import numpy as np
import pytest

from surefoot.calibration import GRAVITY, FeetLayout, FootLayout, OnlineSetup, Parameters
from surefoot.calibration.moment.stand_in import StandIn

MASS = 5.3
CORNERS = [(0.1, 0.05), (0.1, -0.05), (-0.06, 0.05), (-0.06, -0.05)]
CELLS = FeetLayout(tuple(FootLayout.load_cells(name, CORNERS) for name in ("left", "right")))
SENSOR = FootLayout.force_torque("left", position_sensor_sole=(0.01, 0.0, 0.06))
FLOOR = 1e-5  # variance in body weights squared that the table is never taken to be more sure than


def stand_in(layout=CELLS, memory=50.0):
    K = layout.channels
    initial = Parameters(np.ones(K), np.zeros(K))
    return StandIn(OnlineSetup(layout=layout, mass=MASS, initial=initial, foot_length=0.17), memory)


def moments(seed, K=8):
    rng = np.random.default_rng([37, seed])
    root = rng.normal(size=(K, K)) * rng.uniform(0.05, 0.5, K)[:, None]
    return root @ root.T


def conditional(C, i, heard):
    """What a normal distribution of covariance C says of i by those heard: by regression, and its spread."""
    root = np.linalg.cholesky(C)
    others = [j for j in heard if j != i]
    said, *_ = np.linalg.lstsq(root[others].T, root[i], rcond=None)
    coefficients = np.zeros(len(C))
    coefficients[others] = said
    return coefficients, np.linalg.norm(root[i] - said @ root[others])


@pytest.mark.parametrize("lost", [(), (2,), (0, 5), (0, 1, 6)])
@pytest.mark.parametrize("seed", range(3))
def test_what_the_others_say_is_the_conditional_mean(seed, lost):
    C, gone = moments(seed), np.zeros(8)
    gone[list(lost)] = 1.0
    said, spread = stand_in().others(C, gone)
    heard = [i for i in range(8) if i not in lost]
    for i in range(8):
        coefficients, std = conditional(C + FLOOR * np.eye(8), i, heard)
        np.testing.assert_allclose(said[i], coefficients, rtol=1e-7, atol=1e-9)
        assert spread[i] == pytest.approx(std * MASS * GRAVITY, rel=1e-7)


def test_lost_channels_say_nothing_of_any():
    gone = np.array([0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    said, _ = stand_in().others(moments(1), gone)
    np.testing.assert_array_equal(said[:, gone > 0.5], 0.0)
    np.testing.assert_array_equal(np.diag(said), 0.0)
    assert np.abs(said[:, gone < 0.5]).max() > 0.1


def test_to_begin_with_a_foot_stands_on_equal_springs():
    table = stand_in().init()
    gone = np.eye(8)[3]
    said, spread = stand_in().others(table, gone)
    # Equal springs share a load by the plane that fits it best: loads of half the weight, at a quarter of the
    # sole's extent from its middle, and 3 % of the weight that each cell differs.
    x, y = np.transpose(CORNERS)
    plane = np.column_stack([np.ones(4), x - x.mean(), y])
    # A load at the origin is off the middle of the cells.
    shares = plane @ np.linalg.inv(np.column_stack([np.ones(4), y, -x]).T @ plane)
    C = shares @ np.diag([0.5, 0.125 * np.ptp(y), 0.125 * np.ptp(x)]) ** 2 @ shares.T + 0.03**2 * np.eye(4)
    np.testing.assert_allclose(table[:4, :4], C, rtol=1e-9, atol=1e-12)
    # A rigid plate has no warp, F0 - F1 - F2 + F3 = 0; what is not sure draws the coefficients together.
    np.testing.assert_allclose(said[3], [-1.0, 1.0, 1.0, 0, 0, 0, 0, 0], atol=0.2)
    for weights in ((1.0, 0.0, 0.0), (1.0, 4.0, 0.0), (1.0, 0.0, -6.0), (1.0, 3.0, 5.0)):
        force = np.zeros(8)
        force[:4] = 10.0 * plane @ weights
        assert said[3] @ force == pytest.approx(force[3], abs=0.1 * np.abs(force).max())
    # About what equal springs would give each cell is 3 % of the weight, four times in that difference.
    assert spread[3] == pytest.approx(2.0 * 0.03 * MASS * GRAVITY, rel=0.1)


def test_one_foot_says_nothing_of_the_other():
    table = stand_in().init()
    np.testing.assert_array_equal(table[:4, 4:], 0.0)
    force = np.random.default_rng(1).normal(size=(16, 8)) * 10.0
    table = stand_in().learn(table, force)
    np.testing.assert_array_equal(table[:4, 4:], 0.0)
    said, _ = stand_in().others(table, np.eye(8)[1])
    np.testing.assert_array_equal(said[:4, 4:], 0.0)


def test_a_plate_on_springs_of_its_own_is_learnt_and_found_again():
    rng, learner = np.random.default_rng(7), stand_in(memory=20.0)
    x, y = np.transpose(CORNERS)
    plane = np.column_stack([np.ones(4), x, y])
    stiffness = np.array([1.4, 0.8, 0.9, 1.2])
    table = learner.init()

    def foot(samples):
        # Force = stiffness times how far the plate goes down at the cell: two numbers tilt it, one lowers it.
        down = rng.normal(size=(samples, 3)) * (1.0, 4.0, 8.0) + (3.0, 0.0, 0.0)
        return 4.0 * (down @ plane.T) * stiffness

    for _ in range(300):
        force = np.concatenate([foot(16), foot(16)], axis=1)
        table = learner.learn(table, force)
    before = learner.others(learner.init(), np.eye(8)[2])
    said, spread = learner.others(table, np.eye(8)[2])
    force = np.concatenate([foot(200), foot(200)], axis=1)
    wrong, naive = (
        np.sqrt(((force @ row - force[:, 2]) ** 2).mean()) for row in (said[2], before[0][2])
    )  # fmt: skip
    assert wrong < 0.15 * naive
    assert spread[2] < 0.2 * before[1][2]


def test_what_was_learnt_fades():
    learner = stand_in(memory=4.0)
    table = learner.init()
    learnt = learner.learn(table, np.full((16, 8), 10.0))
    seen = (10.0 / (MASS * GRAVITY)) ** 2
    np.testing.assert_allclose(learnt[:4, :4], 0.75 * table[:4, :4] + 0.25 * seen, rtol=1e-12)


def test_axes_of_a_six_axis_sensor_stand_in_for_nobody():
    layout = FeetLayout((SENSOR, FootLayout.load_cells("right", CORNERS)))
    learner = stand_in(layout)
    np.testing.assert_array_equal(learner.cells, [False] * 6 + [True] * 4)
    table = learner.learn(learner.init(), np.ones((16, 10)))
    np.testing.assert_array_equal(table[:6, 6:], 0.0)
