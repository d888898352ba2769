"""Noise and drift over all times at once: the Allan deviation that the configurations promise.

White noise of the density N gives N / sqrt(tau), a random walk of the density K gives K sqrt(tau / 3)
(IEEE 952, Annex C).
"""

from dataclasses import replace

import numpy as np
import pytest
from _streams import stream

from surefoot.sensors import Imu, imu, load_cells
from surefoot.sensors.presets import HX711_LOAD_CELLS


def integral(rates: np.ndarray, dt: float) -> np.ndarray:
    return np.concatenate([np.zeros_like(rates[:1]), np.cumsum(rates, axis=0)]) * dt


def overlapping_allan(phase: np.ndarray, dt: float, tau: float) -> np.ndarray:
    """Overlapping Allan deviation of rates with this integral, pooled over the second axis.

    Every eighth of the averages is enough, for they overlap.
    """
    m = round(tau / dt)
    rows = slice(None, None, max(m // 8, 1))
    second = phase[2 * m :][rows] - 2.0 * phase[m:-m][rows] + phase[: -2 * m][rows]
    return np.sqrt(np.mean(second**2, axis=(0, 1)) / (2.0 * tau**2))


def promised(density, walk, tau):
    return np.sqrt(density**2 / tau + walk**2 * tau / 3.0)


def test_load_cells_have_the_noise_and_the_walk_of_their_configuration():
    dt, walk = 1 / 80, 2e-4
    config = replace(HX711_LOAD_CELLS, channels=320, rate=None, scale_drift=0.0, offset_drift=walk)
    config = replace(config, initial_scale_std=0.0)
    rows = stream(load_cells(config), np.zeros((12_000, 1, 320)), dt=dt)
    force = config.nominal_scale * rows + config.nominal_offset
    phase = integral(force.reshape(12_000, -1, 1), dt)
    density = config.noise_counts / config.counts_per_newton * dt**0.5
    for tau in (0.0125, 0.05, 0.2, 1.0, 5.0, 20.0):
        measured = overlapping_allan(phase, dt, tau)
        np.testing.assert_allclose(measured, promised(density, walk, tau), rtol=0.06)
    # The ends alone tell the two numbers.
    short, long = (overlapping_allan(phase, dt, tau)[0] for tau in (0.025, 20.0))
    assert short * 0.025**0.5 == pytest.approx(density, rel=0.1)
    assert long * (3.0 / 20.0) ** 0.5 == pytest.approx(walk, rel=0.1)


def test_an_imu_has_the_noise_and_the_walk_of_its_configuration():
    dt, config = 0.2, Imu(accelerometer_resolution=0.0, gyroscope_resolution=0.0)
    rows = stream(imu(config), np.zeros((60_000, 6)), seed=1, dt=dt)
    for axes, kind in ((slice(0, 3), "accelerometer"), (slice(3, 6), "gyroscope")):
        density, walk = getattr(config, f"{kind}_noise"), getattr(config, f"{kind}_walk")
        phase = integral(rows[:, axes, None], dt)
        for tau in (0.2, 1.0, 5.0, 20.0, 60.0):
            measured = overlapping_allan(phase, dt, tau)
            np.testing.assert_allclose(measured, promised(density, walk, tau), rtol=0.1)
        np.testing.assert_allclose(overlapping_allan(phase, dt, 0.4) * 0.4**0.5, density, rtol=0.1)
        np.testing.assert_allclose(overlapping_allan(phase, dt, 100.0) * (3.0 / 100.0) ** 0.5, walk, rtol=0.1)
