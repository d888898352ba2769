"""Everything worked out for many robots at once is what the scalar classes work out for each."""

import numpy as np
import pytest

from surefoot.calibration import Reference
from surefoot.envs.instrumentation.drawing import draw_nao
from surefoot.sensors.transport.link import Packet
from surefoot.wrappers.attitude import UPRIGHT, update
from surefoot.wrappers.belief_errors import BeliefErrors
from surefoot.wrappers.beliefs import Beliefs
from surefoot.wrappers.contacts import Kinematics, Plan, Upright
from surefoot.wrappers.nominal import NominalModel
from surefoot.wrappers.telemetry import TelemetryLayout
from surefoot.wrappers.vector.beliefs import BatchBeliefs
from surefoot.wrappers.vector.contacts import BatchKinematics, BatchPlan, BatchUpright
from surefoot.wrappers.vector.nominal import BatchNominal
from surefoot.wrappers.vector.telemetry import BatchAttitude

ROBOTS, PERIOD, DELAY = 3, 0.0125, 2
ERRORS = BeliefErrors(mass=0.01, com=0.005)
NOBODY = np.zeros(ROBOTS, dtype=bool)


def _motions(steps: int, layout: TelemetryLayout, seed: int = 0) -> np.ndarray:
    """Smooth motions of all joints with some noise, shape (steps, N, C)."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(steps)[:, None, None]
    swing = rng.normal(size=(1, ROBOTS, layout.size)), rng.uniform(2.0, 6.0, (1, ROBOTS, layout.size))
    packets = 0.1 * swing[0] * np.sin(swing[1] * time) + 1e-3 * rng.normal(size=(steps, ROBOTS, layout.size))
    packets[..., layout.accelerometer] += (0.0, 0.0, 9.81)
    return packets


def _nominal() -> BatchNominal:
    model = BatchNominal(draw_nao(), ROBOTS, ERRORS)
    model.draw(range(ROBOTS), np.random.default_rng(5))
    return model


def _scalar_models() -> list[NominalModel]:
    drawing, rng = draw_nao(), np.random.default_rng(5)
    models = []
    for _ in range(ROBOTS):
        sites = (drawing.imu, drawing.soles[0], drawing.soles[1])
        model = NominalModel(drawing.spec(), ERRORS, sites=sites, torso=drawing.torso)
        model.draw(rng)
        models.append(model)
    return models


def test_robots_side_by_side_move_as_they_do_alone():
    batch, models, rng = _nominal(), _scalar_models(), np.random.default_rng(1)
    joints = len(models[0].joint_names)
    position, velocity = rng.normal(size=(2, ROBOTS, joints))
    spin = rng.normal(size=(ROBOTS, 3))
    postures = batch.evaluate(position, velocity, spin)
    for i, model in enumerate(models):
        alone = model.evaluate(position[i], velocity[i], spin[i])
        for together, own in zip(postures, alone, strict=True):
            np.testing.assert_allclose(together[i], own, atol=1e-12)
        assert batch.mass[i] == pytest.approx(model.mass, abs=1e-12)
    np.testing.assert_allclose(np.abs(batch.mass / batch.drawn_mass - 1.0), 0.01, rtol=1e-9)


@pytest.mark.parametrize("averaged", [True, False])
def test_references_and_soles_are_those_of_the_scalar_class(averaged):
    models = _scalar_models()
    layout = TelemetryLayout(len(models[0].joint_names))
    packets = _motions(40, layout)
    lag, age = 5, 0.0058
    behind = lag * PERIOD + age
    batch = BatchBeliefs(_nominal(), layout, PERIOD, DELAY, averaged, behind)
    alone = [Beliefs(model, layout, PERIOD, DELAY * PERIOD, averaged) for model in models]
    stance, swing = np.ones((ROBOTS, 2), dtype=bool), np.zeros((ROBOTS, 2), dtype=bool)
    compared = 0
    # The scalar class knows nothing before its second packet; the batch takes the robot for still.
    batch._before = packets[0]
    for number, packet in enumerate(packets):
        now = (number + DELAY) * PERIOD
        for i, beliefs in enumerate(alone):
            beliefs.update((Packet(number, now, packet[i]),))
        if number:
            batch.update(packet)
        if number < 12:
            continue
        reference = batch.reference(stance, swing, NOBODY)
        place, heading = batch.soles()
        for i, beliefs in enumerate(alone):
            own = beliefs.reference(now - behind, stance[i], swing[i])
            for name, together, single in zip(Reference._fields, reference, own, strict=True):
                np.testing.assert_allclose(together[i], single, atol=1e-9, err_msg=name)
            for foot, sole in enumerate(beliefs.soles(now)):
                together = [*place[i, foot], *heading[i, foot]]
                np.testing.assert_allclose(together, tuple(sole), atol=1e-9)
            compared += 1
    assert compared == 28 * ROBOTS


def test_a_robot_whose_episode_starts_is_at_rest_and_others_do_not_notice():
    layout = TelemetryLayout(24)
    packets = _motions(30, layout)
    kept, put = (BatchBeliefs(_nominal(), layout, PERIOD, DELAY, True, 0.08) for _ in range(2))
    none = np.zeros((ROBOTS, 2), dtype=bool)
    for packet in packets[:20]:
        kept.update(packet)
        put.update(packet)
    mask = np.array([False, True, False])
    other = packets[25]
    put.begin_episode(other, mask)
    reference, before = put.reference(none, none, NOBODY), kept.reference(none, none, NOBODY)
    for together, single in zip(reference, before, strict=True):
        np.testing.assert_array_equal(together[~mask], single[~mask])
    np.testing.assert_array_equal(reference.com_acceleration[1], 0.0)
    np.testing.assert_array_equal(reference.angular_momentum_rate[1], 0.0)
    assert np.isfinite(reference.com[1]).all()
    assert (reference.com[1] != before.com[1]).all()
    kept.update(packets[20])
    put.update(np.where(mask[:, None], other, packets[20]))
    moved, expected = put.reference(none, none, mask), kept.reference(none, none, NOBODY)
    np.testing.assert_array_equal(moved.com[~mask], expected.com[~mask])
    assert np.isnan(moved.com[1]).all()


@pytest.mark.parametrize("bad", [np.nan, -np.inf, 1.1e6])
def test_a_packet_that_cannot_be_is_lost_as_it_is_for_the_scalar_class(bad):
    layout, behind, hit = TelemetryLayout(24), 0.08, 20
    sound = _motions(40, layout)
    packets = sound.copy()
    packets[hit, 1, layout.accelerometer.start] = bad
    whole, batch = (BatchBeliefs(_nominal(), layout, PERIOD, DELAY, True, behind) for _ in range(2))
    alone = Beliefs(_scalar_models()[1], layout, PERIOD, DELAY * PERIOD, True)
    none, unknown = np.zeros((ROBOTS, 2), dtype=bool), []
    for number, packet in enumerate(packets):
        whole.update(sound[number])
        batch.update(packet)
        alone.update((Packet(number, (number + DELAY) * PERIOD, packet[1]),))
        expected, found = (beliefs.reference(none, none, NOBODY) for beliefs in (whole, batch))
        for name, together, single in zip(Reference._fields, found, expected, strict=True):
            np.testing.assert_array_equal(together[[0, 2]], single[[0, 2]], err_msg=name)
        if np.isnan(found.com[1]).any():
            unknown.append(number)
            continue
        # Once it is known again, only the turning that nobody measured is missing.
        np.testing.assert_allclose(found.com[1], expected.com[1], atol=1e-3)
        np.testing.assert_allclose(found.com_acceleration[1], expected.com_acceleration[1], atol=0.2)
    # A reference of 6.4 packets ago, 2 of them under way, lies between 3 and 4 rows ago.
    assert unknown == list(range(hit, hit + 7))
    # The scalar class misses two turns, and not one.
    own = alone.reference((number + DELAY) * PERIOD - behind, none[1], none[1])
    np.testing.assert_allclose(found.com[1], own.com, atol=3e-3)
    np.testing.assert_allclose(batch.force_bias[1], alone.force_bias, atol=0.1)


def test_a_lag_shorter_than_the_link_is_refused():
    layout = TelemetryLayout(24)
    with pytest.raises(ValueError, match=r"at least 0\.05 s: choose a longer 'lag'"):
        BatchBeliefs(_nominal(), layout, PERIOD, DELAY, True, 0.03)


def test_tilt_is_that_of_the_scalar_filter():
    rng, batch = np.random.default_rng(2), BatchAttitude(ROBOTS)
    alone = [UPRIGHT] * ROBOTS
    for _ in range(50):
        gyroscope = rng.normal(size=(ROBOTS, 3))
        accelerometer = rng.normal(size=(ROBOTS, 3)) * 6.0 + (0.0, 0.0, 9.81)
        batch.update(gyroscope, accelerometer, PERIOD)
        alone = [
            update(own, tuple(w), tuple(f), PERIOD)
            for own, w, f in zip(alone, gyroscope.tolist(), accelerometer.tolist(), strict=True)
        ]
    np.testing.assert_allclose(batch.tilt, [[own.roll, own.pitch] for own in alone], atol=1e-12)
    np.testing.assert_allclose(batch.bias, [own.bias for own in alone], atol=1e-12)


@pytest.mark.parametrize("lag", [2, 4, 7])
def test_plans_and_contacts_are_those_of_the_scalar_classes(lag):
    rng = np.random.default_rng(3)
    plan, alone = BatchPlan(ROBOTS, lag), [Plan(lag) for _ in range(ROBOTS)]
    sure = 0
    for _ in range(300):
        planned = rng.random((ROBOTS, 4)) < 0.95
        stance, swing = plan.at(planned)
        for i, own in enumerate(alone):
            expected = own.at(planned[i, :2], planned[i, 2:])
            np.testing.assert_array_equal((stance[i], swing[i]), expected)
            sure += int(expected[0].sum())
    assert sure > 100
    plan.begin_episode(np.array([True, False, False]))
    assert not plan.at(planned)[0][0].any()


def test_contacts_by_kinematics_are_those_of_the_scalar_class():
    rng = np.random.default_rng(4)
    batch, alone = BatchKinematics(ROBOTS), [Kinematics() for _ in range(ROBOTS)]
    seen = np.zeros(2, dtype=int)
    for step in range(400):
        height = np.where(rng.random((ROBOTS, 2)) < 0.05, 0.02, 0.0005)
        height[:, 1] = 0.02 * (step // 20 % 2)
        reference = Reference(
            *np.zeros((3, ROBOTS, 3)),
            position_sole=np.stack([0.0 * height, 0.0 * height, height], axis=-1),
            R_level_sole=np.tile(np.eye(3), (ROBOTS, 2, 1, 1)),
            stance=np.zeros((ROBOTS, 2), dtype=bool),
            swing=np.zeros((ROBOTS, 2), dtype=bool),
            accelerometer=np.full((ROBOTS, 3), 9.81 if rng.random() < 0.97 else 1.0),
            gyroscope=np.zeros((ROBOTS, 3)),
        )
        found = batch.at(reference)
        for i, own in enumerate(alone):
            expected = own.at(Reference(*(part[i] for part in reference)))
            np.testing.assert_array_equal((found[0][i], found[1][i]), expected)
            seen += [expected[0].sum(), expected[1].sum()]
    assert (seen > 50).all()


def test_who_is_upright_is_found_as_by_the_scalar_class():
    rng = np.random.default_rng(6)
    batch, alone = BatchUpright(ROBOTS, PERIOD), [Upright(PERIOD) for _ in range(ROBOTS)]
    told = []
    for step in range(600):
        # One leans away for a while, one sits down, and all stumble and have an odd accelerometer.
        leans, sits, odd = 100 < step < 180, 250 < step < 300, 400 < step < 420
        com = np.zeros((ROBOTS, 3))
        com[:, 2] = np.where(np.array([False, sits, False]), 0.15, 0.26) + 0.01 * rng.normal(size=ROBOTS)
        acceleration = 2.0 * rng.normal(size=(ROBOTS, 3)) + [[6.0 * leans, 0.0, 0.0]] + [[0.0], [1.0], [-6.0]]
        soles = np.zeros((ROBOTS, 2, 3))
        soles[..., 2] = 0.01 * rng.random((ROBOTS, 2))
        if rng.random() < 0.1:
            lost = rng.random(ROBOTS) < 0.5
            com[lost], acceleration[lost], soles[lost] = np.nan, np.nan, np.nan
        reference = Reference(
            com=com,
            com_acceleration=acceleration,
            angular_momentum_rate=np.zeros((ROBOTS, 3)),
            position_sole=soles,
            R_level_sole=np.tile(np.eye(3), (ROBOTS, 2, 1, 1)),
            stance=np.zeros((ROBOTS, 2), dtype=bool),
            swing=np.zeros((ROBOTS, 2), dtype=bool),
            accelerometer=np.zeros((ROBOTS, 3)),
            gyroscope=np.zeros((ROBOTS, 3)),
        )
        bias = rng.normal(size=(ROBOTS, 3)) * (2.0 if odd else 0.2)
        found = batch.at(reference, bias)
        expected = [
            own.at(Reference(*(part[i] for part in reference)), bias[i]) for i, own in enumerate(alone)
        ]
        np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal(batch.fell, [own.fell for own in alone])
        told.append(found)
    share = np.mean(told, axis=0)
    assert 0.7 < share[0] < 0.9, share
    assert 0.6 < share[1] < 0.82, share
    assert share[2] < 0.3, share
    low = np.array([[0.0, 0.0, 0.1]] * ROBOTS)
    squat = Reference(*(np.zeros_like(part) for part in reference))._replace(com=low)
    settled = BatchUpright(ROBOTS, PERIOD)
    settled.at(squat._replace(com=3.0 * low), 0.0 * low)
    settled.begin_episode(np.array([False, True, False]))
    np.testing.assert_array_equal(settled.at(squat, 0.0 * low), [False, True, False])
