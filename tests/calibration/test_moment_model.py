"""The moment filter's model against what it is a model of, by differences and by hand."""

import numpy as np
import pytest
from _ankles import SENSOR, on_ankles
from _moment import move
from _synthetic import DT, LAYOUT, MASS, NOMINAL

from surefoot.calibration import GRAVITY, FeetLayout, FootCalibrator, FootLayout, OnlineSetup, Reference
from surefoot.calibration.moment.blocks import Block
from surefoot.calibration.moment.columns import Columns, Spread, find_talks, first_mean, first_variance
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.health import contact_probability
from surefoot.calibration.moment.model import Model
from surefoot.calibration.moment.modes import (
    FIRST_CHANCE,
    MODES,
    combine,
    mix,
    update,
    wrench_variance,
)
from surefoot.calibration.moment.severity import LIKELY, SEVERITIES, Severity
from surefoot.calibration.moment.state import Belief
from surefoot.calibration.moment.suspects import SURE, Suspects
from surefoot.calibration.moment.tare import Tare

CONFIG = Moment()
WEIGHT = MASS * GRAVITY
ANKLES = FeetLayout(
    tuple(FootLayout.force_torque(name, position_sensor_sole=(0.01, 0.0, 0.05)) for name in ("left", "right"))
)


def setup(layout=LAYOUT):
    start = NOMINAL if layout is LAYOUT else None
    length = {} if layout is LAYOUT else {"foot_length": 0.2}
    channels = layout.channels
    from surefoot.calibration import Parameters

    initial = start or Parameters(np.ones(channels), np.zeros(channels))
    return OnlineSetup(layout=layout, mass=MASS, initial=initial, lag=0, dt=DT, **length)


def block(layout=LAYOUT, seed=0):
    """Eight samples of a robot that moves, with any forces."""
    rng, log, rows = np.random.default_rng(seed), move(seed, 1.0), slice(40, 48)
    motion = log.reference
    return Block(
        force=0.1 + 0.05 * rng.normal(size=(8, layout.channels)),
        read=np.ones((8, layout.channels)),
        end=motion.com[rows],
        com=motion.com[rows],
        velocity=motion.com_velocity[rows],
        spin=motion.angular_momentum[rows] / MASS,
        sole=motion.position_sole[rows] + 0.01 * rng.normal(size=(8, 2, 3)),
        rotation=motion.R_level_sole[rows],
        swing=np.zeros((9, 2)),
        dt=np.full(8, DT),
    )


def momentum_of(block, layout, point, x, columns):
    """Add up sample by sample what acts, about a point, in another way: the momenta at the samples' ends."""
    a, zero = x[columns.scale], x[columns.offset] + x[columns.drift]
    d, m = x[columns.com], float(x[columns.mass][0])
    momentum, total = np.concatenate([x[columns.momentum], np.zeros(6 - columns.components)]), []
    wrench = np.concatenate([x[columns.wrench], np.zeros(6 - columns.components)])
    P = np.array([momentum[3], momentum[4], momentum[0]])
    H = np.array([momentum[1], momentum[2], momentum[5]])
    shear, (to, origin) = columns.components == 6, find_talks(layout)
    for n in range(len(block.dt)):
        f = (1.0 + m) * (a * block.force[n] + zero)
        np.add.at(f, to, x[columns.talk] * block.force[n, origin])
        P = P + block.dt[n] * np.array([wrench[3], wrench[4], wrench[0] - 1.0])
        H = H + block.dt[n] * np.array([wrench[1], wrench[2], wrench[5]])
        arm = block.com[n] - point - np.append(d, 0.0)
        H = H + block.dt[n] * np.cross(arm, (0.0, 0.0, -1.0))
        for foot, (layout_of, where) in enumerate(zip(layout.feet, layout.slices, strict=True)):
            local = layout_of.wrench_map @ f[where]
            force = block.rotation[n, foot] @ local[:3]
            torque = block.rotation[n, foot] @ local[3:]
            if not shear:
                force = np.array([0.0, 0.0, force[2]])
            P = P + block.dt[n] * force
            H = H + block.dt[n] * (torque + np.cross(block.sole[n, foot] - point, force))
        total.append([P[2], H[0], H[1], P[0], P[1], H[2]][: columns.components])
    return np.array(total)


@pytest.mark.parametrize("layout", [LAYOUT, ANKLES], ids=["cells", "ankles"])
def test_rows_are_the_derivatives_of_what_acts(layout):
    columns = Columns.of(layout)
    made, samples = Model(setup(layout), CONFIG, columns), block(layout)
    rng = np.random.default_rng(1)
    x = first_mean(columns) + 0.03 * rng.normal(size=columns.size)
    x[columns.com], x[columns.mass], x[columns.delay] = 0.0, 0.0, 0.0
    rows = made.rows(samples, x[columns.map], np.zeros(layout.channels))

    def both(x):
        momenta = momentum_of(samples, layout, rows.point, x, columns)
        return momenta.mean(axis=0), momenta[-1]

    mean, end = both(x)
    np.testing.assert_allclose(rows.mean @ x + rows.mean_rest, mean, atol=1e-12)
    np.testing.assert_allclose(rows.end @ x + rows.end_rest, end, atol=1e-12)
    for i in set(range(columns.size)) - {columns.delay.start}:
        step = np.zeros(columns.size)
        step[i] = 1e-6
        for k, (above, below) in enumerate(zip(both(x + step), both(x - step), strict=True)):
            found = (rows.mean, rows.end)[k][:, i]
            np.testing.assert_allclose(found, (above - below) / 2e-6, atol=1e-8)


def test_a_delay_shifts_what_is_measured():
    columns, samples = Columns.of(LAYOUT), block()
    rows = Model(setup(), CONFIG, columns).rows(
        samples, first_mean(columns)[columns.map], np.zeros(8), np.eye(8)
    )
    momenta = momentum_of(samples, LAYOUT, rows.point, first_mean(columns), columns)
    slope = momenta[-1] / samples.duration
    velocity = samples.velocity.mean(axis=0)
    # The sum of the shares of what is left of the block is half of it, and half a sample.
    left = 0.5 * (samples.duration + DT)
    turned = left * np.array([0.0, -velocity[1], velocity[0]])
    np.testing.assert_allclose(rows.mean[:, columns.delay.start], turned - slope, atol=1e-12)


def test_the_momentum_about_another_point():
    for layout in (LAYOUT, ANKLES):
        columns = Columns.of(layout)
        made = Model(setup(layout), CONFIG, columns)
        rng = np.random.default_rng(2)
        P, H, step = rng.normal(size=(3, 3))
        x = np.zeros(columns.size)
        x[columns.momentum] = [P[2], H[0], H[1], P[0], P[1], H[2]][: columns.components]
        transition, added = made.move(step, P * GRAVITY)
        moved = H - np.cross(step, P)
        expected = [P[2], moved[0], moved[1], P[0], P[1], moved[2]][: columns.components]
        np.testing.assert_allclose((transition @ x + added)[columns.momentum], expected, atol=1e-12)


def test_the_posterior_under_other_priors_is_that_of_a_filter_that_began_with_them():
    """One linear row after another, on a wide prior and on each prior itself; then weighed by hand."""
    columns, rng = Columns.of(LAYOUT), np.random.default_rng(3)
    spread = Spread.of(setup(), CONFIG)
    severity, of, judged = Severity(columns, spread), columns.map, slice(0, columns.offset.stop)
    H = np.zeros((6, columns.size))
    H[:, of] = rng.normal(size=(6, of.stop)) * np.sqrt(first_variance(columns, spread, CONFIG)[of])
    y, R = 0.5 * rng.normal(size=6), 0.01 * np.eye(6)
    drifted = 1e-4
    priors = severity.prior(drifted)
    np.testing.assert_allclose(priors[1, : LAYOUT.channels], SEVERITIES[0] ** 2 * (spread.scale + drifted))

    def posterior(prior):
        mean, covariance = first_mean(columns), np.diag(first_variance(columns, spread, CONFIG))
        covariance[judged, judged] = np.diag(prior)
        covariance[columns.drift, columns.drift] += 2e-4 * np.diag(spread.unit**2)
        S = H @ covariance @ H.T + R
        off = y - H @ mean
        gain = covariance @ H.T @ np.linalg.inv(S)
        likelihood = -0.5 * (off @ np.linalg.solve(S, off) + np.linalg.slogdet(S)[1])
        return mean + gain @ off, covariance - gain @ H @ covariance, likelihood

    wide = np.concatenate([25.0 * spread.scale + drifted, 25.0 * spread.offset])
    mean, covariance, widely = posterior(wide)
    found = severity.weigh(mean[None], covariance[None], drifted)
    means, covariances, chances = [], [], []
    for prior, likely in zip(priors, np.outer(LIKELY, LIKELY).ravel(), strict=True):
        mean, covariance, likelihood = posterior(prior)
        means.append(mean[of])
        covariances.append(covariance[of, of])
        chances.append(likelihood + np.log(likely))
    chance = np.exp(np.array(chances) - max(chances))
    assert found.evidence[0] == pytest.approx(np.log(chance.sum()) + max(chances) - widely, abs=1e-6)
    found = found.publish(np.ones(1))
    mean, covariance = combine(chance / chance.sum(), np.array(means), np.array(covariances))
    np.testing.assert_allclose(found.mean, mean, atol=1e-6)
    scale = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose(
        found.covariance / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=1e-4
    )
    assert ((found.undetermined >= 0.0) & (found.undetermined <= 1.0)).all()


def test_without_data_all_is_undetermined():
    columns, spread = Columns.of(LAYOUT), Spread.of(setup(), CONFIG)
    covariance = np.diag(first_variance(columns, spread, CONFIG))
    found = Severity(columns, spread).weigh(first_mean(columns)[None], covariance[None], 0.0)
    assert found.evidence[0] == pytest.approx(0.0, abs=1e-9)
    found = found.publish(np.ones(1))
    np.testing.assert_allclose(found.undetermined, 1.0)
    np.testing.assert_allclose(found.mean, first_mean(columns)[columns.map])


def test_modes_keep_their_chance_and_what_they_know():
    columns, spread = Columns.of(LAYOUT), Spread.of(setup(), CONFIG)
    mean, variance = first_mean(columns), first_variance(columns, spread, CONFIG)
    rows = Model(setup(), CONFIG, columns).rows(block(), mean[columns.map], np.zeros(8))
    covariances = []
    for mode in MODES:
        variance[columns.wrench] = wrench_variance(mode, rows)
        covariances.append(np.diag(variance))
    belief = Belief(np.stack([mean] * 3), np.stack(covariances), FIRST_CHANCE)
    mixed = mix(belief, rows, columns, 0.1)
    assert mixed.chance.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(mixed.mean, belief.mean)
    for before, after in zip(belief.covariance, mixed.covariance, strict=True):
        assert (np.linalg.eigvalsh(after) >= -1e-15).all()
        np.testing.assert_allclose(after[columns.map, columns.map], before[columns.map, columns.map])
    # A robot that lays a hand on something begins with the prior of that hand's force.
    at = columns.wrench.start
    assert mixed.covariance[2, at, at] > 20.0 * mixed.covariance[0, at, at]


def test_a_row_is_taken_in_and_what_is_considered_stays():
    """The mean of two normal distributions; a considered unknown keeps its mean and its variance."""
    mean, covariance, H = np.zeros(2), np.array([[1.0, 0.3], [0.3, 1.0]]), np.array([[1.0, 0.0]])
    found, after = update(mean, covariance, H, np.array([4.2]), np.eye(1), slice(1, 2))
    np.testing.assert_allclose(found, (2.1, 0.0))
    np.testing.assert_allclose(after, [[0.5, 0.15], [0.15, 1.0]])


def test_a_foot_in_the_air_shows_its_zeros_and_nothing_of_its_scales():
    """However far they have drifted since the first tare, which ties offsets to scales."""
    columns, spread = Columns.of(LAYOUT), Spread.of(setup(), CONFIG)
    tare, mean = Tare(setup(), CONFIG, columns, spread), first_mean(columns)
    covariance = np.diag(first_variance(columns, spread, CONFIG))
    belief = Belief(np.tile(mean, (3, 1)), np.tile(covariance, (3, 1, 1)), FIRST_CHANCE)
    state, published = tare.init()._replace(rate=1.0), mean[columns.map]
    hanging, rng = block()._replace(swing=np.ones((9, 2))), np.random.default_rng(0)
    at = np.arange(columns.drift.start, columns.drift.stop)
    for k, time in enumerate((1.0, 2.0, 300.0)):
        zero = rng.normal(0.0, 0.02, size=8)
        seen = hanging._replace(force=np.tile(zero, (8, 1)))
        belief, published, state, _ = tare.take(seen, time, belief, published, state, np.zeros(8))
        for j in range(3):
            force = zero * belief.mean[j, columns.scale] + belief.mean[j, columns.offset] + belief.mean[j, at]
            np.testing.assert_allclose(force, 0.0, atol=1e-3)
        if k == 0:
            first = belief
        np.testing.assert_allclose(
            belief.mean[:, columns.scale], first.mean[:, columns.scale], rtol=1e-3 * k + 1e-12
        )
        std, before = (
            np.sqrt(np.diagonal(one.covariance, axis1=1, axis2=2))[:, columns.scale]
            for one in (belief, first)
        )
        np.testing.assert_allclose(std, before, rtol=1e-3)
        covariance = belief.covariance.copy()
        covariance[:, at, at] += spread.walk[1] * 100.0
        belief = belief._replace(covariance=covariance)


def test_contact_is_likelier_the_more_a_foot_bears():
    learnt = np.diag(np.r_[np.full(8, 1e-4), np.full(8, 0.04)])
    rows = np.repeat(np.eye(2), 4, axis=1)

    def of(load):
        return contact_probability(
            np.array([load, WEIGHT - load]), rows, learnt, np.full(8, 2.0), 0.05, WEIGHT
        )

    found = np.array([of(load)[0] for load in (-40.0, -1.0, 0.0, 0.5, 1.0, 2.0, 4.0, 20.0, 3.0 * WEIGHT)])
    assert (np.diff(found[1:]) >= 0.0).all()
    assert found[0] < 0.01
    assert found[2] < 0.02
    assert found[-3] > 0.99
    assert of(0.0)[1] > 0.999


def test_a_hand_that_takes_hold_accuses_no_channel():
    """Its force grows for half a second, and a dead channel's would change by as much in a block."""
    columns, spread, even = Columns.of(LAYOUT), Spread.of(setup(), CONFIG), np.linspace(0.08, 0.17, 8)
    mean, variance = first_mean(columns), 1e-4 * first_variance(columns, spread, CONFIG)
    still = block()._replace(force=np.tile(even, (8, 1)))
    rows = Model(setup(), CONFIG, columns).rows(still, mean[columns.map], np.zeros(8))
    known, before = mean[: columns.momentum.start], np.diag(variance[: columns.momentum.start])
    suspects, span = (
        Suspects(LAYOUT, np.ones(8, dtype=bool), columns),
        rows.mean[:, columns.wrench].max(axis=0),
    )
    others, none = np.full((8, 8), 1.0 / 7.0) * (1.0 - np.eye(8)), np.zeros(8)
    beliefs = known, before, others, np.full(8, 0.05), none, none
    state, most = suspects.init(50), 0.0
    for k in range(6):
        unexplained = suspects.weigh(state, rows, *beliefs, 0.1)[0].error * span
        seen = rows._replace(measured=rows.measured - unexplained + np.array([0.004 * k, 0.0, 0.0]))
        state, found = suspects.weigh(state, seen, *beliefs, 0.1)
        most = max(most, state.score.max())
        assert found is None
    # Without a hand that changes, a channel was as good as guilty: 0.8.
    assert 0.3 * SURE < most < 0.7 * SURE


def test_the_inertia_of_a_foot_in_swing_is_not_taken_for_a_zero():
    truth, mass, com = on_ankles(2, 0.2, 12.0), 0.4, np.array([0.02, 0.0, 0.03])
    # One foot swings about the other, which stands still.
    apart, swing = truth.reference.position_sole, truth.reference.swing
    apart = apart[:, 0] - apart[:, 1]
    relative = np.zeros_like(apart)
    relative[1:-1] = (apart[2:] - 2.0 * apart[1:-1] + apart[:-2]) / DT**2
    acceleration = np.stack([relative * swing[:, :1], -relative * swing[:, 1:]], axis=1)
    force = truth.force.copy()
    offset = []
    for told in (0.0, mass):
        layout = FeetLayout(
            tuple(
                FootLayout.force_torque(name, **SENSOR, mass_below=told, com_below_sole=com)
                for name in ("left", "right")
            )
        )
        for foot, side in enumerate(layout.feet):
            load = -mass * acceleration[:, foot]
            wrench = np.hstack([load, np.cross(com, load)])
            part = slice(6 * foot, 6 * foot + 6)
            force[:, part] = truth.force[:, part] + wrench @ np.linalg.inv(side.wrench_map).T
        calibrator = FootCalibrator(layout, "moment", mass=MASS, dt=DT, lag=0, foot_length=0.16)
        for k in range(len(force)):
            estimate = calibrator.update(force[k], Reference(*(part[k] for part in truth.reference)))
        offset.append(np.abs(estimate.offset[[0, 1, 2, 6, 7, 8]]).max())
    assert offset[1] < 0.3 * offset[0], offset
