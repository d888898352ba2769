"""The filter's rows against a rigid body whose forces are known: they hold exactly at the truth."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from surefoot.calibration import (
    GRAVITY,
    FeetLayout,
    FootLayout,
    OnlineSetup,
    Parameters,
    Reference,
)
from surefoot.calibration._moment_rows import Block
from surefoot.calibration._moment_stream import MomentStream
from surefoot.calibration.moment_filter import MomentFilterConfig

MASS, DT, LENGTH = 5.3, 1.0 / 80.0, 0.17
CORNERS = [(0.1, 0.05), (0.1, -0.04), (-0.06, 0.05), (-0.07, -0.05)]
SENSOR = {
    "position_sensor_sole": (0.01, -0.005, 0.06),
    "R_sole_sensor": Rotation.from_rotvec([0.1, -0.4, 0.3]).as_matrix(),
}


def cells(name, **options):
    return FootLayout.load_cells(name, CORNERS, **options)


def ankle(name, **options):
    return FootLayout.force_torque(name, **SENSOR, **options)


def both(name):
    return FootLayout.combined(name, cells(name), ankle(name))


LAYOUTS = {
    "cells": FeetLayout((cells("left"), cells("right"))),
    "three and five cells": FeetLayout(
        (
            FootLayout.load_cells("left", CORNERS[:3]),
            FootLayout.load_cells("right", [*CORNERS, (0.02, 0.01)]),
        )
    ),
    "one plate": FeetLayout((cells("plate"),)),
    "ankles": FeetLayout((ankle("left"), ankle("right"))),
    "cells left, ankle right": FeetLayout((cells("left"), ankle("right"))),
    "both on each": FeetLayout((both("left"), both("right"))),
}
# Sizes of the reference's errors, each about ten times what is usual, so that second orders show.
SIZES = {"com": 0.02, "mass": 0.05, "acceleration": 0.3, "delay": 0.02}


def block_of(force, motion, swing):
    """A block of samples that may all be learnt from, of a robot that stands."""
    ones = np.ones(len(force))
    return Block(force=force, motion=motion, swing=swing, stand=ones, use=ones)


class Body:
    """A rigid-body state with known forces on the feet, what its sensors read, and its beliefs.

    Args:
        layout: The feet.
        seed: Of everything that is random.
        cross_talk: Share that six-axis sensors talk across.
    """

    def __init__(self, layout, seed, cross_talk=0.0):
        self.rng = rng = np.random.default_rng([17, seed])
        # One group a block: rows are then exact for an average, however the body moves.
        self.config = MomentFilterConfig(cross_talk=cross_talk, every=8, average=8, settle=3)
        setup = OnlineSetup(
            layout=layout,
            mass=MASS,
            initial=Parameters(np.ones(layout.channels), np.zeros(layout.channels)),
            dt=DT,
            foot_length=LENGTH,
        )
        self.stream = MomentStream(setup, self.config)
        self.layout, self.unknowns = layout, self.stream.unknowns
        self.feet, self.n = len(layout.feet), self.config.every + 2 * self.config.settle
        unknowns, K = self.unknowns, layout.channels

        x = unknowns.start.copy()
        x[unknowns.scale] += 0.1 * rng.normal(size=unknowns.gains) * (unknowns.std[unknowns.scale] > 0)
        x[unknowns.offset] = 0.03 * rng.normal(size=K)
        self.x = x
        self.A = np.zeros((K, K))
        self.A[unknowns.out, unknowns.inp] = x[unknowns.scale]

        self.position = rng.normal(size=(self.n, self.feet, 3)) * (0.1, 0.1, 0.03)
        self.R = Rotation.from_rotvec(rng.normal(size=(self.n * self.feet, 3)) * 0.2).as_matrix()
        self.R = self.R.reshape(self.n, self.feet, 3, 3)
        self.com = np.array([0.0, 0.0, 0.3]) + rng.normal(size=(self.n, 3)) * 0.03
        # The force of each channel changes evenly, so that its rate has no higher orders.
        self.at_rest, self.rate = self._forces(), self._forces()

    def _forces(self):
        """Draw the true channels of feet on the ground, shape (K,)."""
        parts = []
        for foot in self.layout.feet:
            wrench = self.rng.normal(size=6) * (5.0, 5.0, 10.0, 0.5, 0.5, 0.3) + (0, 0, 25.0, 0, 0, 0)
            if not all(sensor.six_axis for sensor in foot.sensors) and len(foot.sensors) == 1:
                wrench *= (0, 0, 1, 1, 1, 0)  # cells alone: neither shear nor twist
            for sensor in foot.sensors:
                share = np.linalg.pinv(sensor.wrench_map) @ wrench
                null = null_space(sensor.wrench_map)
                parts.append(share + null @ self.rng.normal(size=null.shape[1]) * 3.0)
        return np.concatenate(parts)

    def channels(self, late=0.0):
        """True channels at all samples, or a while later, shape (n, K)."""
        time = (np.arange(self.n) - self.n / 2) * DT + late
        return self.at_rest + time[:, None] * self.rate

    def block(self, com=(0.0, 0.0), mass=0.0, acceleration=(0.0, 0.0, 0.0), delay=0.0):
        """What the robot reads and believes when its reference is wrong by this much."""
        F = self.channels(delay)
        true_mass = MASS / (1.0 + mass)
        force, moment = np.zeros((self.n, 3)), np.zeros((self.n, 3))
        for foot, (side, where) in enumerate(zip(self.layout.feet, self.layout.slices, strict=True)):
            for k in range(self.n):
                wrench = side.wrench_map @ F[k, where]
                f, t = self.R[k, foot] @ wrench[:3], self.R[k, foot] @ wrench[3:]
                force[k] += f
                moment[k] += t + np.cross(self.position[k, foot] - self.com[k], f)
        believed = Reference(
            com=self.com + np.array([*com, 0.0]),
            com_acceleration=force / true_mass - [0.0, 0.0, GRAVITY] + acceleration,
            # A robot that thinks itself heavier thinks all its parts heavier.
            angular_momentum_rate=moment * (1.0 + mass),
            position_sole=self.position,
            R_level_sole=self.R,
            stance=np.ones((self.n, self.feet), bool),
            swing=np.zeros((self.n, self.feet), bool),
            accelerometer=np.zeros((self.n, 3)),
            gyroscope=np.zeros((self.n, 3)),
        )
        F0 = np.linalg.solve(self.A, (self.channels() - self.offset).T).T
        motion = self.stream._front_end.motions.flatten(believed, F0)
        return block_of(F0, motion, np.zeros((self.n, self.feet)))

    @property
    def offset(self):
        """True offsets of the channels in N or N m."""
        return self.x[self.unknowns.offset] * self.unknowns.unit

    def rows(self, mean, block):
        """The Newton-Euler rows of one block."""
        stated = np.ones((*mean.shape[:-1], self.stream.rows.kinds))
        rows, places = self.stream.rows.total(mean, block, stated)
        offsets = slice(self.unknowns.gains, self.unknowns.gains + self.unknowns.channels)
        np.testing.assert_allclose(places, rows.H[..., offsets] / self.unknowns.unit, atol=1e-15)
        return rows

    def residual(self, told=1.0, **errors):
        """H x - y at the truth, the errors of the reference told ``told`` times."""
        unknowns, x = self.unknowns, self.x.copy()
        x[unknowns.com] = told * np.asarray(errors.get("com", (0.0, 0.0))) / LENGTH
        x[unknowns.mass] = told * errors.get("mass", 0.0)
        x[unknowns.acceleration] = told * np.asarray(errors.get("acceleration", np.zeros(3))) / GRAVITY
        x[unknowns.delay] = told * errors.get("delay", 0.0)
        rows = self.rows(x, self.block(**errors))
        assert (rows.variance > 0.0).all()
        return rows.H @ x - rows.y


def bodies():
    for name, layout in LAYOUTS.items():
        for cross_talk in (0.0, 0.01) if "ankle" in name or "both" in name else (0.0,):
            yield pytest.param(layout, cross_talk, id=f"{name}, cross-talk {cross_talk}")


@pytest.mark.parametrize(("layout", "cross_talk"), list(bodies()))
def test_the_rows_hold_at_the_truth(layout, cross_talk):
    for seed in range(5):
        body = Body(layout, seed, cross_talk)
        six = all(sensor.six_axis for foot in layout.feet for sensor in foot.sensors[-1:])
        assert body.stream.rows.kinds == (6 if six else 3)
        np.testing.assert_allclose(body.residual(), 0.0, atol=1e-12)
        # And at no other gains and offsets: each column matters, as no row is a row of zeros.
        rows = body.rows(body.x, body.block())
        known = slice(0, body.unknowns.gains + body.unknowns.channels)
        assert (np.abs(rows.H[:, known]).max(axis=0) > 1e-4).all()


def draw(rng, name, size):
    count = {"com": 2, "acceleration": 3}.get(name)
    direction = rng.normal(size=count)
    return size * direction / np.linalg.norm(direction) if count else size * np.sign(direction)


@pytest.mark.parametrize("name", SIZES)
@pytest.mark.parametrize(("layout", "cross_talk"), list(bodies()))
def test_each_error_of_the_reference_is_told_to_first_order(layout, cross_talk, name):
    for seed in range(3):
        body = Body(layout, seed, cross_talk)
        error = draw(body.rng, name, SIZES[name])
        left = [np.abs(body.residual(**{name: error * size})).max() for size in (1.0, 0.1, 0.01)]
        untold = [np.abs(body.residual(told=0.0, **{name: error * size})).max() for size in (1.0, 0.01)]
        assert untold[0] > 1e-3, "the error must show where nobody tells of it"
        assert 50.0 < untold[0] / untold[1] < 200.0, "and be of first order"
        for coarse, fine in pairwise(left):
            assert fine < max(coarse / 80.0, 1e-12), "what is left must be of second order"
        wrong_way = np.abs(body.residual(told=-1.0, **{name: error * 0.01})).max()
        assert wrong_way > 1.5 * untold[1]


@pytest.mark.parametrize(("layout", "cross_talk"), list(bodies()))
def test_all_errors_at_once_leave_the_second_order(layout, cross_talk):
    body = Body(layout, 7, cross_talk)
    errors = {name: draw(body.rng, name, size) for name, size in SIZES.items()}
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
    # Neighbours whose rate of change would need the sample are left out as well.
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
    count, reading = body.stream.rows.hanging(block_of(F0, block.motion, hanging))
    np.testing.assert_array_equal(count, [body.config.every] + [0] * (body.feet - 1))
    rows = body.stream.rows.tare(block, count, reading)
    np.testing.assert_allclose(rows.H @ body.x, rows.y, atol=1e-14)
    said = np.abs(rows.H).max(axis=-1) > 0.0
    np.testing.assert_array_equal(said, layout.foot_of_channel == 0)
    load = body.stream.rows.load(reading) @ body.x[: body.unknowns.gains + body.unknowns.channels]
    assert load[0] == pytest.approx(0.0, abs=1e-12)


def test_only_samples_well_within_a_swing_hang():
    body = Body(LAYOUTS["cells"], 0)
    block, settle = body.block(), body.config.settle
    swing = np.zeros((body.n, 2))
    swing[4:12, 0] = 1.0
    count, reading = body.stream.rows.hanging(block_of(block.force, block.motion, swing))
    inside = slice(4 + settle, 12 - settle)
    np.testing.assert_array_equal(count, [2, 0])
    np.testing.assert_allclose(reading[:4], block.force[inside, :4].mean(axis=0))
    np.testing.assert_array_equal(reading[4:], 0.0)


def test_the_load_of_a_foot_is_its_vertical_force_in_body_weights():
    body = Body(LAYOUTS["both on each"], 3)
    block = body.block()
    known = body.unknowns.gains + body.unknowns.channels
    load = body.stream.rows.load(block.force[5]) @ body.x[:known]
    expected = [
        (side.wrench_map @ body.channels()[5, where])[2] / (MASS * GRAVITY)
        for side, where in zip(body.layout.feet, body.layout.slices, strict=True)
    ]
    np.testing.assert_allclose(load, expected, rtol=1e-12)


@pytest.mark.parametrize(
    "make",
    [
        ankle,
        pytest.param(
            cells,
            marks=pytest.mark.xfail(
                strict=True, reason="a plate's shear counts as lacking, though cells never see shear"
            ),
        ),
    ],
)
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
    motion = body.stream._front_end.motions.flatten(believed, F)
    hanging = np.zeros((n, 2))
    hanging[:, 1] = 1.0
    block, x = block_of(F, motion, hanging), body.unknowns.start
    count, reading = body.stream.rows.hanging(block)
    tare = body.stream.rows.tare(block, count, reading)
    np.testing.assert_allclose(tare.H @ x, tare.y, atol=1e-9)
    rows = body.rows(x, block)
    np.testing.assert_allclose(rows.H @ x, rows.y, atol=1e-9)


def test_a_batch_of_blocks_is_its_blocks():
    one, two = Body(LAYOUTS["ankles"], 1), Body(LAYOUTS["ankles"], 2)
    blocks = [one.block(), two.block()]
    stacked = Block(*(np.stack(parts) for parts in zip(*blocks, strict=True)))
    means = np.stack([one.x, two.x])
    together = one.rows(means, stacked)
    for k in (0, 1):
        alone = one.rows(means[k], blocks[k])
        for a, b in zip(together, alone, strict=True):
            np.testing.assert_allclose(a[k], b, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("cross_talk", [0.0, 0.01])
def test_instruments_of_one_foot_tell_the_same_wrench(cross_talk):
    body = Body(LAYOUTS["both on each"], 5, cross_talk)
    rows = body.stream.rows.parity(body.block())
    assert (np.abs(rows.H).max(axis=-1) > 0.0).any()
    np.testing.assert_allclose(rows.H @ body.x, rows.y, atol=1e-12)
    wrong = body.x.copy()
    wrong[body.unknowns.own[0]] += 0.1
    assert np.abs(rows.H @ wrong - rows.y).max() > 1e-4
