"""The tilt that the robot's computer makes of its IMU."""

from math import cos, sin

import numpy as np
import pytest

from surefoot.sensors.telemetry.attitude import UPRIGHT, Attitude, update

DT = 0.01


def upright(roll: float, pitch: float) -> tuple[float, float, float]:
    return (-sin(pitch), sin(roll) * cos(pitch), cos(roll) * cos(pitch))


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.3, -0.2), (-0.5, 0.4)])
def test_roll_and_pitch_are_those_of_the_up_vector(roll: float, pitch: float) -> None:
    attitude = Attitude(upright(roll, pitch), (0.0, 0.0, 0.0))
    assert attitude.roll == pytest.approx(roll)
    assert attitude.pitch == pytest.approx(pitch)


def test_turning_follows_the_gyroscope() -> None:
    """In free fall the accelerometer is left aside: a turn about y by 0.5 rad is a pitch of 0.5 rad."""
    attitude = UPRIGHT
    for _ in range(100):
        attitude = update(attitude, (0.0, 0.5, 0.0), (0.0, 0.0, 0.0), DT)
    assert attitude.pitch == pytest.approx(0.5, abs=1e-4)
    assert attitude.roll == pytest.approx(0.0, abs=1e-12)


def test_at_rest_it_finds_its_tilt_and_the_gyroscopes_bias() -> None:
    true = np.array(upright(0.1, -0.05))
    bias, attitude = (0.003, -0.002, 0.0), UPRIGHT
    for _ in range(20_000):
        attitude = update(attitude, bias, tuple(9.81 * true), DT)
    assert attitude.roll == pytest.approx(0.1, abs=2e-4)
    assert attitude.pitch == pytest.approx(-0.05, abs=2e-4)
    # Of the bias only what is level can be seen.
    level = np.array(bias) - true * (true @ np.array(bias))
    np.testing.assert_allclose(np.array(attitude.bias) - true * (true @ attitude.bias), level, atol=1e-4)


def test_impacts_do_not_tilt_it() -> None:
    attitude = update(UPRIGHT, (0.0, 0.0, 0.0), (30.0, 0.0, 30.0), DT)
    assert attitude == UPRIGHT
