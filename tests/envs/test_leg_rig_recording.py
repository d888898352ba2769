"""Recordings of the in-situ rig: exact statics and dynamics, the ranges they cover, and what must not fit."""

from operator import call

import numpy as np
import pytest
from _refusals import refusals

from surefoot.calibration.in_situ import InSituSet
from surefoot.calibration.in_situ.fit import Limb
from surefoot.envs.leg_rig.env import LegRigEnv
from surefoot.envs.leg_rig.recording import RigRecording, record_rig, sweep, swing
from surefoot.envs.leg_rig.spec import ADDED_MASSES, HIP_RANGE
from surefoot.experiments.force_torque import validation

SHORT = {"duration": 100.0, "rate": 10.0}


def expected_wrench(recording: RigRecording, sensor: str, *, gravity=None) -> np.ndarray:
    """Newton and Euler for limb and added mass as one rigid body, shape (n, 6)."""
    limb = getattr(recording, f"limb_{sensor}")
    com = getattr(recording, f"added_com_{sensor}")
    load = recording.added_mass
    mass, mass_com = limb.mass + load, limb.mass_com + load * com
    inertia = limb.inertia + load * (com @ com * np.eye(3) - np.outer(com, com))
    inertia = inertia + recording.added_inertia * np.eye(3)
    omega, alpha = recording.angular_velocity, recording.angular_acceleration
    proper = getattr(recording, f"gravity_{sensor}")
    force = mass * proper - np.cross(alpha, mass_com) - np.cross(omega, np.cross(omega, mass_com))
    torque = np.cross(mass_com, proper) - alpha @ inertia - np.cross(omega, omega @ inertia)
    return np.hstack([force, torque])


def gravity_wrench(recording: RigRecording, sensor: str) -> np.ndarray:
    gravity = -recording.specific_force
    limb, com = getattr(recording, f"limb_{sensor}"), getattr(recording, f"added_com_{sensor}")
    mass_com = limb.mass_com + recording.added_mass * com
    return np.hstack([(limb.mass + recording.added_mass) * gravity, np.cross(mass_com, gravity)])


@pytest.mark.parametrize("sensor", ["foot", "leg"])
def test_at_rest_wrenches_are_the_gravity_of_limb_and_added_mass(sensor):
    for recording in record_rig(at_rest=True, **SHORT):
        gravity = -recording.specific_force
        np.testing.assert_allclose(np.linalg.norm(gravity, axis=1), 9.81, rtol=1e-12)
        np.testing.assert_allclose(getattr(recording, f"gravity_{sensor}"), gravity, atol=1e-12)
        np.testing.assert_allclose(
            getattr(recording, f"wrench_{sensor}"), gravity_wrench(recording, sensor), atol=1e-10
        )


@pytest.mark.parametrize("sensor", ["foot", "leg"])
@pytest.mark.parametrize("fast_motion", [False, True])
def test_moving_wrenches_obey_newton_and_euler(sensor, fast_motion):
    for recording in record_rig([1, 3, 5], fast_motion=fast_motion, **SHORT):
        wrench = getattr(recording, f"wrench_{sensor}")
        np.testing.assert_allclose(wrench, expected_wrench(recording, sensor), atol=1e-9)
        strongest = np.abs(recording.angular_acceleration).max()
        assert (strongest > 5.0) == fast_motion


def test_recordings_are_of_the_published_configurations():
    recordings = record_rig(**SHORT)
    assert [r.configuration for r in recordings] == list(range(1, 9))
    assert [r.name for r in recordings] == [f"set {i}" for i in range(1, 9)]
    for r in recordings:
        load = ADDED_MASSES[r.configuration]
        assert r.added_mass == load.mass
        np.testing.assert_array_equal(r.added_com_foot, load.com_foot)
        np.testing.assert_allclose(r.added_com_leg, load.com_leg, atol=1e-12)
        assert (r.limb_foot.mass, r.limb_leg.mass) == pytest.approx((0.59, 4.72), abs=1e-9)
        # In both frames the IMU is at the same place of the beam.
        np.testing.assert_allclose(
            r.position_imu_leg - r.position_imu_foot, (-0.0035, 0.0, 0.3636), atol=1e-12
        )


def test_recordings_and_the_environment_agree():
    env = LegRigEnv(configuration=5)
    observation, info = env.reset(seed=0)
    recording = record_rig([5], at_rest=True, **SHORT)[0]
    for sensor in ("foot", "leg"):
        truth = info["surefoot"]["truth"]
        limb = getattr(recording, f"limb_{sensor}")
        np.testing.assert_allclose(truth[f"mass_com_{sensor}"], limb.mass_com, atol=1e-12)
        np.testing.assert_allclose(truth[f"inertia_{sensor}"], limb.inertia, atol=1e-12)
        # Wrench against gravity is the same linear map in both.
        gravity, wrench = -recording.specific_force, getattr(recording, f"wrench_{sensor}")
        map_ = np.linalg.lstsq(gravity, wrench, rcond=None)[0]
        np.testing.assert_allclose(-observation[4:7] @ map_, truth[f"wrench_{sensor}"], atol=1e-4)


def test_the_imu_is_the_motion_of_its_place():
    """Integrated angular velocity and differentiated gravity agree: dg/dt = -w x g in a turning frame."""
    recording = record_rig([1], duration=20.0, rate=200.0, fast_motion=True)[0]
    dt = 1.0 / 200.0
    change = (recording.angular_velocity[2:] - recording.angular_velocity[:-2]) / (2.0 * dt)
    np.testing.assert_allclose(change, recording.angular_acceleration[1:-1], atol=0.05)
    still = record_rig([1], duration=20.0, rate=200.0, fast_motion=True, at_rest=True)[0]
    gravity = -still.specific_force
    change = (gravity[2:] - gravity[:-2]) / (2.0 * dt)
    expected = -np.cross(recording.angular_velocity, gravity)[1:-1]
    np.testing.assert_allclose(change, expected, atol=0.05)
    assert np.abs(expected).max() > 5.0


def test_a_sweep_covers_both_ranges_slowly():
    motion = sweep(300.0, 10.0, 6.0, phase=1.0)
    np.testing.assert_allclose(np.ptp(motion.angle, axis=0), HIP_RANGE, rtol=0.01)
    assert np.degrees(np.abs(motion.rate)).max() <= 6.0
    # Every ninth of the field is passed both ways by both joints.
    forward = motion.rate[:, 0] > 0.0
    cells = np.floor(np.degrees(motion.angle + HIP_RANGE / 2.0) / (23.4, 30.1)).astype(int)
    for way in (forward, ~forward, motion.rate[:, 1] > 0.0, motion.rate[:, 1] < 0.0):
        assert len(np.unique(cells[way], axis=0)) == 9


def test_a_sweep_without_phase_goes_back_the_way_it_came():
    motion = sweep(200.0, 10.0)
    np.testing.assert_allclose(motion.angle[1:], motion.angle[:0:-1], atol=1e-9)
    np.testing.assert_allclose(motion.rate[1:], -motion.rate[:0:-1], atol=1e-9)


@pytest.mark.parametrize("make", [lambda: sweep(100.0, 100.0, phase=0.5), lambda: swing(30.0, 400.0, seed=3)])
def test_rates_are_the_derivatives_of_the_angles(make):
    motion = make()
    dt = motion.time[1]
    scale = np.abs(motion.acceleration).max() * dt
    for value, derivative in ((motion.angle, motion.rate), (motion.rate, motion.acceleration)):
        difference = (value[2:] - value[:-2]) / (2.0 * dt)
        np.testing.assert_allclose(difference, derivative[1:-1], atol=0.1 * scale)
    assert (np.abs(motion.angle) <= HIP_RANGE / 2.0 + 1e-9).all()


def test_the_motion_of_a_slow_sweep_is_hardly_felt():
    moving, resting = record_rig([5])[0], record_rig([5], at_rest=True)[0]
    for sensor in ("foot", "leg"):
        difference = getattr(moving, f"wrench_{sensor}") - getattr(resting, f"wrench_{sensor}")
        weight = np.linalg.norm(getattr(resting, f"wrench_{sensor}")[:, :3], axis=1)
        assert 1e-5 < (np.linalg.norm(difference[:, :3], axis=1) / weight).max() < 2e-3


def test_sets_differ_and_seeds_repeat():
    first, again = record_rig([1, 1], seed=4, **SHORT), record_rig([1, 1], seed=4, **SHORT)
    other = record_rig([1], seed=5, **SHORT)
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.wrench_leg, two.wrench_leg)
    assert not np.allclose(first[0].hip, first[1].hip)
    assert not np.allclose(first[0].hip, other[0].hip)


def test_a_knee_that_bends_shows_in_the_leg_alone():
    straight = record_rig([5], at_rest=True, **SHORT)[0]
    bent = record_rig([5], at_rest=True, knee_slack=0.02, **SHORT)[0]
    np.testing.assert_allclose(bent.wrench_foot, expected_wrench(bent, "foot"), atol=1e-9)
    missed = np.abs(bent.wrench_leg - expected_wrench(bent, "leg")).max()
    assert missed > 1.0
    # The knee's angle is the one between the foot's gravity now and with a straight knee.
    cosine = np.einsum("ni,ni->n", bent.specific_force, straight.specific_force) / 9.81**2
    assert 3.0 < np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < 15.0


def test_a_bent_knee_carries_what_hangs_below_it():
    """The torque of the spring is that of the weight below about the knee: a slack of half bends by half."""
    bends = []
    for slack in (1e-4, 2e-4):
        straight = record_rig([3], at_rest=True, **SHORT)[0]
        bent = record_rig([3], at_rest=True, knee_slack=slack, **SHORT)[0]
        bends.append(np.linalg.norm(bent.specific_force - straight.specific_force, axis=1) / 9.81)
    np.testing.assert_allclose(bends[1], 2.0 * bends[0], atol=2e-6)
    assert bends[0].max() > 1e-4


def test_a_foot_on_the_floor_shows_in_both_sensors_at_the_rear_end_alone():
    free, touching = record_rig([1], **SHORT)[0], record_rig([1], floor=True, **SHORT)[0]
    for sensor in ("foot", "leg"):
        push = np.abs(getattr(free, f"wrench_{sensor}") - getattr(touching, f"wrench_{sensor}")).max(axis=1)
        touched = push > 0.05
        assert 0.05 < touched.mean() < 0.3
        assert push.max() > 3.0
        assert np.degrees(free.hip[touched, 0]).max() < -14.0


test_bad_options_are_refused = refusals(
    call,
    (lambda: record_rig([1], duration=30.0), r"at least 85 s, got 'duration' = 30; .*'speed_deg' to 17\.0"),
    (lambda: record_rig([0], **SHORT), "no configuration 0"),
    (lambda: record_rig([1], duration=100.0, rate=0.0), "'rate' must be finite and positive"),
    (lambda: record_rig([1], knee_slack=np.nan, **SHORT), "'knee_slack' must be finite"),
    (lambda: record_rig([1], range_deg=(80.0, 90.0), **SHORT), "'range_deg' must be two ranges within"),
    (lambda: record_rig([1], range_deg=(0.0, 0.0), **SHORT), "not both 0"),
    (lambda: swing(10.0, swing_deg=40.0), "'swing_deg' must be at most half of each range"),
)


def test_planar_motion_holds_the_other_joint():
    recording = record_rig([1], range_deg=(70.0, 0.0), **SHORT)[0]
    np.testing.assert_array_equal(recording.hip[:, 1], 0.0)
    np.testing.assert_allclose(recording.specific_force[:, 1], 0.0, atol=1e-12)
    assert np.ptp(recording.hip[:, 0]) == pytest.approx(HIP_RANGE[0], rel=0.01)


@pytest.mark.parametrize("fast", [False, True])
def test_validation_expects_the_wrench_of_the_rig(fast: bool) -> None:
    """Against MuJoCo: a leg that swings, with a mass on it."""
    told = record_rig([5], duration=6.0, rate=20.0, speed_deg=90.0, fast_motion=fast)[0]
    data = InSituSet(
        raw=np.zeros((len(told.time), 6)),
        gravity=told.gravity_leg,
        added_mass=told.added_mass,
        added_com=told.added_com_leg,
        angular_velocity=told.angular_velocity,
        angular_acceleration=told.angular_acceleration,
    )
    limb = Limb(*told.limb_leg)
    np.testing.assert_allclose(validation.predict_wrench(data, limb), told.wrench_leg, atol=1e-9)
    still = told.wrench_leg - validation.motion_wrench(data, limb)
    found = validation.added_mass(still, told.gravity_leg, limb)
    assert found.mass == pytest.approx(told.added_mass, abs=1e-4)
    np.testing.assert_allclose(found.position, told.added_com_leg, atol=1e-3)
    lengths = validation.force_ellipsoid(still[:, :3], told.gravity_leg).semi_axes
    np.testing.assert_allclose(lengths / lengths.mean(), 1.0, atol=1e-4)
