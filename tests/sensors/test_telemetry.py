"""Packets: when they are measured, what they hold, when they come."""

import numpy as np
import pytest

from surefoot.sensors import Encoders, Imu, Link, preset
from surefoot.sensors.telemetry.computer import PACKETS_BEFORE_START, Telemetry

DT, SUBSTEPS = 1 / 80, 10
EXACT = preset("perfect", Encoders)
AVERAGING = preset("perfect", Imu)
INSTANT = Imu(**{**vars(AVERAGING), "averaged": False})


def clockwork(link: Link, imu: Imu, steps: int = 40) -> list:
    """Send time itself as every joint's angle and as specific force; return (number, arrival, values)."""
    telemetry = Telemetry(2, imu, EXACT, link, DT, SUBSTEPS)
    rng = np.random.default_rng(0)
    packets, state = telemetry.init(np.zeros(2), np.zeros(6), rng)
    found = list(packets)
    for step in range(steps):
        times = step * DT + np.arange(1, SUBSTEPS + 1) * DT / SUBSTEPS
        packets, state = telemetry.advance(
            np.repeat(times[:, None], 2, axis=1),
            np.repeat(times[:, None], 6, axis=1),
            (step + 1) * DT,
            state,
            rng,
        )
        found += packets
        assert all(packet.arrival <= (step + 1) * DT + 1e-9 for packet in packets)
    return [packet for packet in found if packet.number >= PACKETS_BEFORE_START]


def test_packets_are_measured_every_10_ms_and_come_20_ms_later() -> None:
    packets = clockwork(Link(jitter=0.0), preset("perfect", Imu))
    numbers = np.array([packet.number for packet in packets]) - PACKETS_BEFORE_START
    np.testing.assert_array_equal(numbers, np.arange(len(packets)))
    measured = np.array([packet.values[0] for packet in packets])
    np.testing.assert_allclose(measured, 0.01 * (numbers + 1), atol=1e-9)
    np.testing.assert_allclose([packet.arrival for packet in packets], measured + 0.020, atol=1e-9)


def test_an_averaging_imu_is_of_the_middle() -> None:
    telemetry = Telemetry(2, AVERAGING, EXACT, Link(), DT, SUBSTEPS)
    for imu, age in ((AVERAGING, 3.5 * DT / SUBSTEPS), (INSTANT, 0.0)):
        packets = clockwork(Link(jitter=0.0), imu)
        force = np.array([packet.values[telemetry.layout.accelerometer][0] for packet in packets])
        measured = np.array([packet.values[0] for packet in packets])
        np.testing.assert_allclose(measured - force, age, atol=1e-9)


def test_velocities_are_differences_of_angles() -> None:
    packets = clockwork(Link(jitter=0.0), AVERAGING)
    layout = Telemetry(2, AVERAGING, EXACT, Link(), DT, SUBSTEPS).layout
    velocity = np.array([packet.values[layout.joint_velocity] for packet in packets])
    np.testing.assert_allclose(velocity[2:], 1.0, atol=1e-9)


def test_a_link_without_a_rate_brings_the_end_of_every_step() -> None:
    packets = clockwork(preset("perfect", Link), preset("perfect", Imu))
    assert len(packets) == 40
    np.testing.assert_allclose([packet.values[0] for packet in packets], DT * np.arange(1, 41), atol=1e-9)
    np.testing.assert_allclose([packet.arrival for packet in packets], DT * np.arange(1, 41), atol=1e-9)


def test_at_power_up_some_packets_have_come() -> None:
    telemetry = Telemetry(2, Imu(), Encoders(), Link(), DT, SUBSTEPS)
    rest = np.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])
    for seed in range(50):
        packets, state = telemetry.init(np.array([0.1, -0.2]), rest, np.random.default_rng(seed))
        assert 6 <= len(packets) < PACKETS_BEFORE_START
        assert packets[-1].arrival <= 0.0
        assert len(packets) + len(state.under_way) == PACKETS_BEFORE_START
        assert packets[-1].values[:2] == pytest.approx([0.1, -0.2], abs=6e-3)


def test_no_more_than_one_packet_a_substep() -> None:
    for packet in clockwork(Link(rate=800.0, jitter=0.0), AVERAGING):
        assert np.isfinite(packet.values).all()
    text = "Link.rate must be at most 800 per second, one packet a substep of the simulation, got 900.0"
    with pytest.raises(ValueError, match=text):
        Telemetry(2, AVERAGING, EXACT, Link(rate=900.0), DT, SUBSTEPS)
