"""The attitude filter: what it finds on level and sloping ground, and over lost packets."""

import numpy as np
import pytest

from surefoot.envs import load_nao_spec
from surefoot.robot import Beliefs, NominalModel, TelemetryLayout
from surefoot.robot.beliefs.errors import NO_ERRORS
from surefoot.robot.beliefs.strapdown import Strapdown
from surefoot.sensors.transport.link import Packet

PERIOD, G = 0.01, 9.81
FEET = np.array([(0.0, 0.05, -0.3), (0.0, -0.05, -0.3)])


def pitch(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([(c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)])


class Standing:
    """A robot whose torso turns about its origin, over two feet that the ground holds."""

    def __init__(self, feet: np.ndarray = FEET, rolls: bool = False) -> None:
        self.strapdown, self.feet = Strapdown(PERIOD, G, np.zeros((len(feet), 1, 4)), rolls), feet

    def go_on(
        self, torso=0.0, spin=0.0, slope=0.0, force=0.0, gyroscope=0.0, first=0.0, kick=0.0, seconds=PERIOD
    ):
        """Go on with a pitch of torso and ground in rad, and errors of the accelerometer and the gyroscope.

        The specific force comes from a direction tilted by ``first``; feet slip ahead at ``kick`` m/s.
        """
        R, sole = pitch(torso), pitch(slope)
        sites = np.vstack([np.zeros(3), self.feet @ sole.T]) @ R
        axes = np.tile((R.T @ sole).T, (len(self.feet), 1))
        twist = np.zeros((1 + len(self.feet), 6))
        twist[1:, 3] = kick
        felt = pitch(first) @ R.T @ (0.0, 0.0, G) + (force, 0.0, 0.0)
        for _ in range(round(seconds / PERIOD)):
            self.strapdown.advance(felt, np.array([0.0, spin + gyroscope, 0.0]), sites, axes, twist)

    def tilt(self, torso: float = 0.0) -> float:
        """Return the error of the vertical in rad."""
        return float(np.arccos(np.clip(self.strapdown.R[2] @ pitch(torso)[2], -1.0, 1.0)))


def test_a_robot_at_rest_knows_its_attitude_at_once() -> None:
    robot = Standing()
    robot.go_on()
    assert robot.strapdown.known
    assert robot.tilt() < 1e-3


@pytest.mark.parametrize("gyroscope", [0.0, 0.5])
@pytest.mark.parametrize("tilted", [-0.4, 0.2, 0.38])
def test_a_tilted_first_sample_is_forgotten(tilted: float, gyroscope: float) -> None:
    """Whether the robot moves at the start or an accelerometer at rest contradicts its first sample."""
    robot = Standing()
    robot.go_on(first=tilted, gyroscope=gyroscope, seconds=0.03)
    assert robot.tilt() > 0.15
    robot.go_on()
    assert not robot.strapdown.known, "there are no references to an attitude that uncertain"
    robot.go_on(seconds=2.0)
    assert robot.strapdown.known
    assert robot.tilt() < 0.01
    robot.go_on(seconds=3.0)
    assert robot.tilt() < 0.006


def test_legs_that_slip_do_not_tilt_the_robot() -> None:
    robot = Standing()
    robot.go_on()
    robot.go_on(kick=3.0, seconds=0.1)
    assert robot.tilt() < np.radians(1.0)


def test_the_covariance_narrows_and_stays_positive() -> None:
    robot = Standing()
    for _ in range(500):
        robot.go_on()
        P = robot.strapdown.covariance
        np.testing.assert_allclose(P, P.T, atol=1e-15)
        assert np.linalg.eigvalsh(P).min() > 0.0
    assert np.sqrt(P[1, 1]) < 0.01


def test_the_bias_of_the_gyroscope_is_found() -> None:
    robot = Standing()
    robot.go_on(gyroscope=0.01, seconds=30.0)
    assert robot.strapdown.spin_bias[1] == pytest.approx(0.01, abs=5e-4)
    assert robot.tilt() < 1e-3


@pytest.mark.parametrize("slope", [-0.157, 0.05, 0.157])
def test_soles_on_a_slope_lean_with_it(slope: float) -> None:
    """From the start, and after the ground has tilted under a robot that turns with it."""
    still, moved, rate = Standing(), Standing(), 0.03 * np.sign(slope)
    still.go_on(slope=slope, seconds=10.0)
    moved.go_on(seconds=5.0)
    for k in range(round(abs(slope / rate) / PERIOD)):
        angle = rate * k * PERIOD
        moved.go_on(torso=angle, spin=rate, slope=angle)
    moved.go_on(torso=slope, slope=slope, seconds=1.0)
    for robot, torso in ((still, 0.0), (moved, slope)):
        assert robot.tilt(torso) < 0.012
        normal = robot.strapdown.R @ robot.strapdown.ground
        np.testing.assert_allclose(normal, pitch(slope)[:, 2], atol=0.012)


@pytest.mark.parametrize(("bias", "believed"), [(0.05, 0.8), (0.2, 0.2), (1.0, 0.01)])
def test_soles_show_a_wrong_accelerometer_but_not_a_slope(bias: float, believed: float) -> None:
    """What looks like a bias is less likely one the larger it is."""
    robot = Standing()
    robot.go_on(force=bias, seconds=60.0)
    assert robot.tilt() * G / bias == pytest.approx(1.0 - believed, abs=0.05)


def test_the_lower_sole_shows_the_ground() -> None:
    """A swinging foot may be tilted: it is higher, and left aside."""
    robot = Standing()
    robot.feet = FEET + np.array([(0.0, 0.0, 0.0), (0.0, 0.0, 0.01)])
    axes = np.tile(np.eye(3), (2, 1))
    axes[5] = np.sin(0.3), 0.0, np.cos(0.3)
    sites = np.vstack([np.zeros(3), robot.feet])
    for _ in range(50):
        robot.strapdown.advance(np.array([0.0, 0.0, G]), np.zeros(3), sites, axes, np.zeros((3, 6)))
    np.testing.assert_allclose(robot.strapdown.ground, (0.0, 0.0, 1.0), atol=1e-9)


def test_of_four_feet_the_lower_ones_show_the_ground() -> None:
    robot = Standing(np.array([(x, y, -0.5) for x in (0.2, -0.2) for y in (0.1, -0.1)]))
    axes = np.tile(np.eye(3), (4, 1))
    axes[[8, 11]] = 0.3, 0.0, np.sqrt(1.0 - 0.09)
    sites = np.vstack([np.zeros(3), robot.feet + np.outer((0.0, 0.0, 0.05, 0.04), (0.0, 0.0, 1.0))])
    for _ in range(3):
        robot.strapdown.advance(np.array([0.0, 0.0, G]), np.zeros(3), sites, axes, np.zeros((5, 6)))
    np.testing.assert_allclose(robot.strapdown.ground, (0.0, 0.0, 1.0), atol=1e-12)


def test_round_feet_do_not_show_the_ground() -> None:
    robot = Standing(rolls=True)
    robot.go_on(slope=0.4, force=0.1, seconds=10.0)
    np.testing.assert_array_equal(robot.strapdown.force_bias, 0.0)
    np.testing.assert_allclose(robot.strapdown.ground, robot.strapdown.R[2], atol=1e-3)


def test_a_robot_that_falls_keeps_its_attitude() -> None:
    robot = Standing()
    robot.go_on(seconds=3.0)
    axes, sites = np.tile(np.eye(3), (2, 1)), np.vstack([np.zeros(3), FEET])
    twist = np.full((3, 6), 3.0)  # the legs may do anything
    for _ in range(50):
        robot.strapdown.advance(np.full(3, 0.1), np.zeros(3), sites, axes, twist)
    assert robot.tilt() < 1e-3


@pytest.fixture(scope="module")
def model() -> NominalModel:
    return NominalModel(load_nao_spec(), NO_ERRORS)


def swaying(model: NominalModel, seconds: float, joined: int = 1) -> list[Packet]:
    """Packets of a robot that turns about its ankles, ahead and back."""
    layout = TelemetryLayout(len(model.joint_names))
    ankles = [i for i, name in enumerate(model.joint_names) if name.endswith("AnklePitch")]
    packets = []
    for k in range(round(seconds * joined / PERIOD)):
        time = k * PERIOD / joined
        angle, rate = 0.1 * np.sin(4.0 * time), 0.4 * np.cos(4.0 * time)
        values = np.zeros(layout.size)
        values[layout.joint_position][ankles] = -angle
        values[layout.accelerometer] = pitch(angle).T @ (-0.48 * np.sin(4.0 * time), 0.0, G)
        values[layout.gyroscope] = 0.0, rate, 0.0
        packets.append(Packet(k, time + 0.02, values))
    return packets


def beliefs_of(model: NominalModel, joined: int = 1) -> Beliefs:
    layout = TelemetryLayout(len(model.joint_names))
    return Beliefs(model, layout, PERIOD / joined, 0.02, averaged=False, joined=joined)


@pytest.mark.parametrize("joined", [1, 5])
def test_lost_packets_are_filled_in(model: NominalModel, joined: int) -> None:
    packets = swaying(model, 8.0, joined)
    whole, gaps = beliefs_of(model, joined), beliefs_of(model, joined)
    lost = np.random.default_rng(4).random(len(packets)) < 0.02
    lost[[0, -1]] = False
    whole.update(tuple(packets))
    for packet in packets:
        if not lost[packet.number]:
            gaps.update((packet,))
            assert packet.number < 400 * joined or gaps.run > 1, "references go on"
    assert lost.sum() > 10
    np.testing.assert_allclose(gaps.strapdown.R, whole.strapdown.R, atol=1e-3)
    np.testing.assert_allclose(gaps.strapdown.velocity, whole.strapdown.velocity, atol=0.01)
    nobody = np.zeros(2, bool)
    one, two = (beliefs.reference(7.8, nobody, nobody) for beliefs in (gaps, whole))
    np.testing.assert_allclose(one.com, two.com, atol=5e-4)


def test_a_long_gap_keeps_the_attitude_and_makes_it_less_certain(model: NominalModel) -> None:
    """After 0.9 s without packets, in which the robot happens to come back to where it was."""
    packets, beliefs = swaying(model, 10.0), beliefs_of(model)
    beliefs.update(tuple(packets[:500]))
    before, std = beliefs.strapdown.R.copy(), np.sqrt(beliefs.strapdown.covariance[1, 1])
    beliefs.update(tuple(packets[590:592]))
    assert beliefs.run == 0
    assert np.sqrt(beliefs.strapdown.covariance[1, 1]) > 5.0 * std
    assert np.arccos(np.clip(beliefs.strapdown.R[2] @ before[2], -1.0, 1.0)) < 0.1
    beliefs.update(tuple(packets[592:]))
    assert beliefs.run > 0


def test_late_and_repeated_packets_are_left_out(model: NominalModel) -> None:
    packets, beliefs = swaying(model, 5.0), beliefs_of(model)
    beliefs.update(tuple(packets[:400]))
    R, run = beliefs.strapdown.R, beliefs.run
    beliefs.update((packets[399], packets[396]))
    np.testing.assert_array_equal(beliefs.strapdown.R, R)
    assert beliefs.run == run
    beliefs.update((packets[400],))
    assert beliefs.run == run + 1


def test_numbers_that_begin_again_are_a_gap(model: NominalModel) -> None:
    packets, beliefs = swaying(model, 6.0), beliefs_of(model)
    beliefs.update(tuple(packets[:400]))
    beliefs.update(tuple(packet._replace(number=packet.number - 400) for packet in packets[400:]))
    assert beliefs.run > 50
