"""Recordings of the analytic leg: wrenches against MuJoCo, motions within the ranges, and bad options."""

from operator import call
from typing import Any

import mujoco
import numpy as np
import pytest
from _refusals import refusals

from surefoot.calibration.in_situ import InSituSet
from surefoot.calibration.in_situ.fit import Limb
from surefoot.envs.leg_rig.motion import HIP_RANGE, sweep, swing
from surefoot.envs.leg_rig.recording import ADDED_MASSES, RigRecording, record_rig
from surefoot.experiments.force_torque import validation

SHORT: dict[str, Any] = {"duration": 100.0, "rate": 10.0}


def body(mass: float, com: Any, inertia: Any, inside: str = "", at: str = "0 0 0") -> str:
    numbers = [" ".join(f"{value:.17g}" for value in np.ravel(part)) for part in (com, inertia)]
    return (
        f'<body pos="{at}"><inertial mass="{mass}" pos="{numbers[0]}" fullinertia="{numbers[1]}"/>'
        f"{inside}</body>"
    )


def central(mass: float, mass_com: Any, inertia: Any) -> tuple[Any, Any]:
    """Return centre of mass, and the inertia about it as MuJoCo lists it."""
    com = mass_com / mass
    about = inertia - mass * (com @ com * np.eye(3) - np.outer(com, com))
    return com, about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def mujoco_wrenches(told: RigRecording) -> Any:
    """Wrenches of MuJoCo's force and torque sensors under the whole limb, (n, 6), z pointing down."""
    mass, mass_com, inertia = told.limb_leg
    limb = body(mass, *central(mass, mass_com, inertia), '<site name="ft"/>', at="0 0 0.0743")
    cube = [told.added_inertia] * 3 + [0.0] * 3
    added = body(told.added_mass, told.added_com_leg, cube)
    limb = limb.removesuffix("</body>") + added + "</body>"
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 9.81"/><worldbody><body><inertial mass="1" pos="0 0 0" '
        f'diaginertia="1 1 1"/><joint axis="0 1 0"/><joint axis="-1 0 0"/>{limb}</body></worldbody>'
        '<sensor><force site="ft"/><torque site="ft"/></sensor></mujoco>'
    )
    data = mujoco.MjData(model)
    motion = swing(told.time[-1] + told.time[1], 1.0 / told.time[1], seed=drawn_seed())
    rows = []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(*motion[1:], strict=True):
        mujoco.mj_inverse(model, data)
        rows.append(-data.sensordata)
    return np.array(rows)


def drawn_seed() -> int:
    return int(np.random.default_rng([0, 0]).integers(2**31))


@pytest.mark.parametrize("configuration", [3, 5])
def test_wrenches_are_those_of_mujoco(configuration: int) -> None:
    told = record_rig([configuration], duration=6.0, rate=20.0, fast_motion=True)[0]
    np.testing.assert_allclose(told.wrench_leg, mujoco_wrenches(told), atol=1e-9)


@pytest.mark.parametrize("sensor", ["foot", "leg"])
def test_at_rest_wrenches_are_the_weight_of_limb_and_added_mass(sensor: str) -> None:
    for told in record_rig(at_rest=True, **SHORT):
        gravity, limb = -told.specific_force, getattr(told, f"limb_{sensor}")
        mass_com = limb.mass_com + told.added_mass * getattr(told, f"added_com_{sensor}")
        weight = np.hstack([(limb.mass + told.added_mass) * gravity, np.cross(mass_com, gravity)])
        np.testing.assert_allclose(np.linalg.norm(gravity, axis=1), 9.81, rtol=1e-12)
        np.testing.assert_allclose(getattr(told, f"gravity_{sensor}"), gravity, atol=1e-12)
        np.testing.assert_allclose(getattr(told, f"wrench_{sensor}"), weight, atol=1e-10)


@pytest.mark.parametrize("sensor", ["foot", "leg"])
@pytest.mark.parametrize("fast", [False, True])
def test_the_validation_of_fits_expects_the_same_wrenches(fast: bool, sensor: str) -> None:
    told = record_rig([5], duration=6.0, rate=20.0, speed_deg=90.0, fast_motion=fast)[0]
    data = InSituSet(
        raw=np.zeros((len(told.time), 6)),
        gravity=getattr(told, f"gravity_{sensor}"),
        added_mass=told.added_mass,
        added_com=getattr(told, f"added_com_{sensor}"),
        angular_velocity=told.angular_velocity,
        angular_acceleration=told.angular_acceleration,
    )
    limb = Limb(*getattr(told, f"limb_{sensor}"))
    still = getattr(told, f"wrench_{sensor}") - validation.motion_wrench(data, limb)
    found = validation.added_mass(still, data.gravity, limb)
    assert found.mass == pytest.approx(told.added_mass, abs=1e-3)
    np.testing.assert_allclose(found.position, data.added_com, atol=2e-3)


def test_recordings_have_the_published_masses() -> None:
    recordings = record_rig(**SHORT)
    assert [r.name for r in recordings] == [f"set {i}" for i in range(1, 9)]
    for told in recordings:
        load = ADDED_MASSES[told.configuration]
        assert told.added_mass == load.mass
        np.testing.assert_array_equal(told.added_com_foot, load.com_foot)
        assert (told.limb_foot.mass, told.limb_leg.mass) == pytest.approx((0.59, 4.72), abs=1e-9)


def test_angular_velocity_turns_gravity() -> None:
    """In a turning frame dg/dt = -w x g, and acceleration is the derivative of velocity."""
    moving, still = (
        record_rig([1], duration=20.0, rate=200.0, fast_motion=True, at_rest=rest)[0]
        for rest in (False, True)
    )
    velocity, gravity, step = moving.angular_velocity, -still.specific_force, 2.0 / 200.0
    np.testing.assert_allclose(
        (gravity[2:] - gravity[:-2]) / step, -np.cross(velocity, gravity)[1:-1], atol=0.05
    )
    change = (velocity[2:] - velocity[:-2]) / step
    np.testing.assert_allclose(change, moving.angular_acceleration[1:-1], atol=0.05)


def test_a_sweep_covers_both_ranges_slowly_from_both_sides() -> None:
    motion = sweep(300.0, 10.0, 6.0, phase=1.0)
    np.testing.assert_allclose(np.ptp(motion.angle, axis=0), HIP_RANGE, rtol=0.01)
    assert np.degrees(np.abs(motion.rate)).max() <= 6.0
    cells = np.floor(np.degrees(motion.angle + HIP_RANGE / 2.0) / (23.4, 30.1)).astype(int)
    for joint in (0, 1):
        for way in (motion.rate[:, joint] > 0.0, motion.rate[:, joint] < 0.0):
            assert len(np.unique(cells[way], axis=0)) == 9


@pytest.mark.parametrize("make", [lambda: sweep(100.0, 100.0, phase=0.5), lambda: swing(30.0, 400.0, seed=3)])
def test_rates_are_the_derivatives_of_the_angles(make: Any) -> None:
    motion = make()
    step = 2.0 * motion.time[1]
    scale = np.abs(motion.acceleration).max() * step / 2.0
    for value, derivative in ((motion.angle, motion.rate), (motion.rate, motion.acceleration)):
        np.testing.assert_allclose((value[2:] - value[:-2]) / step, derivative[1:-1], atol=0.1 * scale)
    assert (np.abs(motion.angle) <= HIP_RANGE / 2.0 + 1e-9).all()


def test_sets_differ_and_seeds_repeat() -> None:
    first, again = record_rig([1, 1], seed=4, **SHORT), record_rig([1, 1], seed=4, **SHORT)
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.wrench_leg, two.wrench_leg)
    assert not np.allclose(first[0].hip, first[1].hip)
    assert not np.allclose(first[0].hip, record_rig([1], seed=5, **SHORT)[0].hip)


def test_a_compliant_knee_bends_in_proportion_to_its_load() -> None:
    straight = record_rig([3], at_rest=True, **SHORT)[0].specific_force
    bends = [
        np.linalg.norm(
            record_rig([3], at_rest=True, knee_slack=slack, **SHORT)[0].specific_force - straight, axis=1
        )
        for slack in (1e-4, 2e-4, 0.02)
    ]
    np.testing.assert_allclose(bends[1], 2.0 * bends[0], atol=2e-5)
    assert 3.0 < np.degrees(bends[2].max() / 9.81) < 15.0


test_bad_options_are_refused = refusals(
    call,
    (lambda: record_rig([1], duration=30.0), r"at least 85 s, got 'duration' = 30; .*'speed_deg' to 17\.0"),
    (lambda: record_rig([0], **SHORT), "no configuration 0"),
    (lambda: record_rig([1], duration=100.0, rate=0.0), "'rate' must be finite and positive"),
    (lambda: record_rig([1], knee_slack=np.nan, **SHORT), "'knee_slack' must be finite"),
    (lambda: record_rig([1], range_deg=(80.0, 90.0), **SHORT), "'range_deg' must be two ranges within"),
    (lambda: swing(10.0, swing_deg=40.0), "'swing_deg' must be at most half of each range"),
)
