"""The filter's rows against a rigid body whose forces are known: they hold exactly at the truth."""

from itertools import pairwise

import numpy as np
import pytest
from _body import DT, LAYOUTS, LENGTH, MASS, SIZES, Body, ankle, block_of, cells, flat

from surefoot.calibration import GRAVITY, FeetLayout, OnlineSetup, Parameters, Reference
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.newton_euler import PASSES
from surefoot.calibration.moment.stream import MomentStream

NOMINAL = Parameters(np.ones(8), np.zeros(8))


def bodies():
    for name, layout in LAYOUTS.items():
        for cross_talk in (0.0, 0.01) if "ankle" in name or "both" in name else (0.0,):
            yield pytest.param(layout, cross_talk, id=f"{name}, cross-talk {cross_talk}")


@pytest.mark.parametrize(("layout", "cross_talk"), list(bodies()))
def test_the_rows_hold_at_the_truth(layout, cross_talk):
    for seed in range(5):
        body = Body(layout, seed, cross_talk)
        six = all(sensor.six_axis for foot in layout.feet for sensor in foot.sensors[-1:])
        assert body.stream.newton_euler.kinds == (6 if six else 3)
        np.testing.assert_allclose(body.residual(), 0.0, atol=1e-12)
        # And at no other gains and offsets: each column matters, as no row is a row of zeros.
        rows = body.rows(body.x, body.block())
        known = body.unknowns.map
        assert (np.abs(rows.H[:, known]).max(axis=0) > 1e-4).all()


@pytest.mark.parametrize("blur", [0.0, 0.3, 1.2])
@pytest.mark.parametrize("settle", [1, 2, 4, 5])
def test_forces_are_averaged_as_the_reference_averages_its_rates(blur, settle):
    rng = np.random.default_rng(3)
    setup = OnlineSetup(layout=LAYOUTS["cells"], mass=MASS, initial=NOMINAL, dt=DT)
    stream = MomentStream(setup, MomentFilterConfig(settle=settle))
    newton, span = stream.newton_euler, stream.config.span
    blur = min(blur, 0.5 * min(settle, PASSES))
    force, _ = newton._blurred(np.eye(span), blur)
    # Each row is a window around its sample: its weights, their middle and their variance.
    place = np.arange(span) - (settle + np.arange(len(force)))[:, None]
    np.testing.assert_allclose(force.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose((force * place).sum(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose((force * place**2).sum(axis=1), blur, atol=1e-12)
    assert (force >= -1e-12).all()
    # What it changes with the variance, against finite differences.
    forces = rng.normal(size=(span, 8))
    above, below = (newton._blurred(forces, blur + d)[0] for d in (1e-5, -1e-5))
    np.testing.assert_allclose(newton._blurred(forces, blur)[1], (above - below) / 2e-5, atol=1e-7)


@pytest.mark.parametrize(("layout", "cross_talk"), list(bodies()))
def test_a_reference_that_averages_is_told_by_the_variance_of_its_window(layout, cross_talk):
    body = Body(layout, 4, cross_talk)
    blur, x, block = body.unknowns.blur, body.x, body.block()
    bent = 0.01 * body.rng.normal(size=(body.n, layout.channels)).cumsum(axis=0)
    block = block._replace(force=block.force + bent)

    def shown(variance):
        x[blur] = variance
        rows = body.rows(x, block)
        return rows.H @ x - rows.y, rows.H[:, blur]

    (above, _), (below, _), (_, column) = shown(0.5 + 1e-5), shown(0.5 - 1e-5), shown(0.5)
    assert np.abs(column).max() > 1e-6
    # The point that moments are taken about moves as well, by a second order.
    np.testing.assert_allclose(column, (above - below) / 2e-5, atol=0.05 * np.abs(column).max())


def draw(rng, name, size):
    count = {"com": 2, "acceleration": 3, "sole": 2}.get(name)
    direction = rng.normal(size=count)
    if name == "acceleration":
        direction[2] = 0.0  # the vertical bias is told of forces alone, see below
    return size * direction / np.linalg.norm(direction) if count else size * np.sign(direction)


@pytest.mark.parametrize("name", SIZES)
@pytest.mark.parametrize(("layout", "cross_talk"), list(bodies()))
def test_each_error_of_the_reference_is_told_to_first_order(layout, cross_talk, name):
    if name == "sole" and len(layout.feet) == 1:
        return  # one sole cannot be off against another
    shown = 0.0
    for seed in range(3):
        body = Body(layout, seed, cross_talk)
        error = draw(body.rng, name, SIZES[name])
        left = [np.abs(body.residual(**{name: error * size})).max() for size in (1.0, 0.1, 0.01)]
        untold = [np.abs(body.residual(told=0.0, **{name: error * size})).max() for size in (1.0, 0.01)]
        shown = max(shown, untold[0])
        assert untold[0] > 3e-5
        assert 50.0 < untold[0] / untold[1] < 200.0, "and be of first order"
        for coarse, fine in pairwise(left):
            assert fine < max(coarse / 80.0, 1e-12), "what is left must be of second order"
        wrong_way = np.abs(body.residual(told=-1.0, **{name: error * 0.01})).max()
        assert wrong_way > 1.5 * untold[1]
    assert shown > 1e-4, "the error must show where nobody tells of it"


@pytest.mark.parametrize(("layout", "cross_talk"), list(bodies()))
def test_all_errors_at_once_leave_the_second_order(layout, cross_talk):
    body = Body(layout, 7, cross_talk)
    errors = {name: draw(body.rng, name, size) for name, size in SIZES.items()}
    if len(layout.feet) == 1:
        del errors["sole"]
    left = [
        np.abs(body.residual(**{name: error * size for name, error in errors.items()})).max()
        for size in (1.0, 0.1, 0.01)
    ]
    assert left[1] < left[0] / 50.0
    assert left[2] < left[1] / 80.0


@pytest.mark.parametrize("axis", [0, 1])
def test_each_axis_of_the_centre_of_mass_has_its_own_column(axis):
    body = Body(LAYOUTS["cells"], 0)
    error = np.zeros(2)
    error[axis] = 0.01
    assert np.abs(body.residual(com=error)).max() < 1e-12
    assert np.abs(body.residual(com=error, told=0.0)).max() > 0.01


@pytest.mark.parametrize(("layout", "cross_talk"), list(bodies()))
def test_no_column_holds_the_believed_centre_of_mass(layout, cross_talk):
    # Its noise is on the right side, and a column that had it too would find what explains it.
    body = Body(layout, 4, cross_talk)
    there, moved = (body.rows(body.x, body.block(com=com)) for com in ((0.0, 0.0), (0.01, -0.02)))
    about_level = slice(0, -1) if body.stream.newton_euler.kinds == 6 else slice(None)  # without Mz
    np.testing.assert_allclose(moved.H[about_level], there.H[about_level], atol=1e-12)
    assert np.abs(moved.y - there.y).max() > 0.01


def test_a_vertical_bias_is_told_of_the_forces():
    body = Body(LAYOUTS["cells"], 0)
    forces = [body.residual(told=told, acceleration=np.array([0.0, 0.0, 0.1]))[0] for told in (1.0, 0.0)]
    assert abs(forces[0]) < 1e-12
    assert abs(forces[1]) == pytest.approx(0.1 / GRAVITY)


def test_every_error_of_the_reference_starts_as_unsure_as_stated():
    unknowns = Body(LAYOUTS["cells"], 0).unknowns
    np.testing.assert_allclose(unknowns.std[unknowns.com], 0.002 / LENGTH)


def test_rows_of_samples_without_use_are_left_out():
    body = Body(LAYOUTS["ankles"], 1)
    block = body.block()
    spoilt = block.force.copy()
    middle = body.n // 2
    spoilt[middle] = 1e6
    use = block.use.copy()
    use[middle] = 0.0
    rows = body.rows(body.x, block._replace(force=spoilt, use=use))
    # Neighbours within `settle` of the sample are left out as well.
    np.testing.assert_allclose(rows.H @ body.x, rows.y, atol=1e-12)
    nothing = body.rows(body.x, block._replace(force=spoilt, use=0.0 * use))
    assert not nothing.H.any()
    assert not nothing.y.any()
    assert (nothing.variance > 0.0).all()


@pytest.mark.parametrize(("layout", "cross_talk"), list(bodies()))
def test_a_foot_in_the_air_reads_its_zero(layout, cross_talk):
    body = Body(layout, 2, cross_talk)
    block = body.block()
    F0 = np.broadcast_to(np.linalg.solve(body.A, -body.offset), block.force.shape)
    hanging = np.zeros((body.n, body.feet))
    hanging[:, 0] = 1.0
    count, reading = body.stream.tare.hanging(body.x, block_of(F0, block.motion, hanging))
    np.testing.assert_array_equal(count, [body.config.every] + [0] * (body.feet - 1))
    rows = body.stream.tare.rows(body.x, block, count, reading)
    np.testing.assert_allclose(rows.H @ body.x, rows.y, atol=1e-14)
    said = np.abs(rows.H).max(axis=-1) > 0.0
    np.testing.assert_array_equal(said, layout.foot_of_channel == 0)
    load, _ = body.stream.tare.load(body.x, reading)
    assert load[0] == pytest.approx(0.0, abs=1e-12)


def test_only_samples_well_within_a_swing_hang():
    body = Body(LAYOUTS["cells"], 0)
    block, settle = body.block(), body.config.settle
    swing = np.zeros((body.n, 2))
    swing[4:12, 0] = 1.0
    still = block.force[0] + 0.1 * body.rng.normal(size=block.force.shape)
    count, reading = body.stream.tare.hanging(body.x, block_of(still, block.motion, swing))
    inside = slice(4 + settle, 12 - settle)
    np.testing.assert_array_equal(count, [2, 0])
    np.testing.assert_allclose(reading[:4], still[inside, :4].mean(axis=0))
    np.testing.assert_array_equal(reading[4:], 0.0)


@pytest.mark.parametrize(("layout", "cross_talk"), list(bodies()))
@pytest.mark.parametrize("early", [0, 1, 5])
def test_a_foot_that_comes_down_early_hangs_no_longer(layout, cross_talk, early):
    """Whatever its offsets are: those of the robot are far from what it believes."""
    body = Body(layout, 2, cross_talk)
    block = body.block()
    F0 = np.tile(np.linalg.solve(body.A, -body.offset), (body.n, 1))
    down = np.zeros((body.n, 1))
    down[body.n - early :] = 1.5 * body.config.swing_load * MASS * GRAVITY
    up = layout.wrench_map[0, 2]
    loaded = F0 + down * np.linalg.solve(body.A, up / (up @ up))
    hanging = np.zeros((body.n, body.feet))
    hanging[:, 0] = 1.0
    count, reading = body.stream.tare.hanging(body.unknowns.start, block_of(loaded, block.motion, hanging))
    assert count[0] == body.config.every - early
    own = layout.foot_of_channel == 0
    np.testing.assert_allclose(reading[own], F0[0, own], atol=1e-12)


def test_the_load_of_a_foot_is_its_vertical_force_in_body_weights():
    body = Body(LAYOUTS["both on each"], 3)
    block = body.block()
    load, _ = body.stream.tare.load(body.x, block.force[5])
    expected = [
        (side.wrench_map @ body.channels()[5, where])[2] / (MASS * GRAVITY)
        for side, where in zip(body.layout.feet, body.layout.slices, strict=True)
    ]
    np.testing.assert_allclose(load, expected, rtol=1e-12)


@pytest.mark.parametrize("make", [ankle, cells])
def test_masses_beyond_the_sensors_make_the_rows_whole(make):
    below = {"mass_below": 0.6, "com_below_sole": (0.02, -0.01, 0.02)}
    layout = FeetLayout((make("left", **below), make("right", **below)))
    body = Body(layout, 4)
    rng, n = body.rng, body.n
    time = (np.arange(n) - (n - 1) / 2)[:, None] * DT
    # Seen from the centre of mass: the left foot stands level, the right one is swung.
    acceleration, bend = rng.normal(size=3), rng.normal(size=3) * 4.0
    soles = np.tile([[0.0, 0.05, -0.3], [0.0, -0.05, -0.25]], (n, 1, 1))
    soles[:, 1] += time * rng.normal(size=3) + time**2 / 2 * bend
    sees = slice(0, 6) if make is ankle else slice(2, 5)
    F = np.zeros((n, layout.channels))
    momentum = rng.normal(size=(n, 3)) * 0.1
    for k in range(n):
        # In the air the sensor feels the foot alone; the other one carries what the motion asks for.
        lost = []
        for speeding in (acceleration, acceleration + bend):
            force = below["mass_below"] * speeding
            lost.append(np.concatenate([force, np.cross(below["com_below_sole"], force)]))
        ground = MASS * (acceleration + np.array([0.0, 0.0, GRAVITY]))
        on_left = np.concatenate([ground, momentum[k] - np.cross(soles[k, 0], ground)])
        for foot, wrench in enumerate((on_left - lost[0], -lost[1])):
            side, where = layout.feet[foot], layout.slices[foot]
            F[k, where] = np.linalg.pinv(side.wrench_map[sees]) @ wrench[sees]
    believed = Reference(
        com=np.zeros((n, 3)),
        com_acceleration=np.broadcast_to(acceleration, (n, 3)),
        angular_momentum_rate=momentum,
        position_sole=soles,
        R_level_sole=np.broadcast_to(np.eye(3), (n, 2, 3, 3)),
        stance=np.ones((n, 2), bool),
        swing=np.zeros((n, 2), bool),
        accelerometer=np.zeros((n, 3)),
        gyroscope=np.zeros((n, 3)),
    )
    motion = flat(body.stream, believed)
    hanging = np.zeros((n, 2))
    hanging[:, 1] = 1.0
    block, x = block_of(F, motion, hanging), body.unknowns.start.copy()
    x[body.unknowns.blur] = 0.0  # this reference follows at once
    count, reading = body.stream.tare.hanging(x, block)
    tare = body.stream.tare.rows(x, block, count, reading)
    np.testing.assert_allclose(tare.H @ x, tare.y, atol=1e-9)
    rows = body.rows(x, block)
    np.testing.assert_allclose(rows.H @ x, rows.y, atol=1e-9)


@pytest.mark.parametrize("cross_talk", [0.0, 0.01])
def test_instruments_of_one_foot_tell_the_same_wrench(cross_talk):
    body = Body(LAYOUTS["both on each"], 5, cross_talk)
    rows = body.stream.parity.rows(body.x, body.block())
    assert (np.abs(rows.H).max(axis=-1) > 0.0).any()
    np.testing.assert_allclose(rows.H @ body.x, rows.y, atol=1e-12)
    wrong = body.x.copy()
    wrong[0] += 0.1
    assert np.abs(rows.H @ wrong - rows.y).max() > 1e-4
