"""The filter of the in-situ paper."""

import numpy as np
import pytest
from _refusals import refusals

from surefoot.calibration.imu import savitzky_golay

DT = 0.01


def test_cubics_pass_unchanged_and_noise_does_not():
    time = np.arange(1000) * DT
    cubic = np.stack([time**3 - 5.0 * time**2, 2.0 - time], axis=-1)
    np.testing.assert_allclose(savitzky_golay(cubic), cubic, atol=1e-8)
    slope = savitzky_golay(cubic, derivative=1, dt=DT)
    np.testing.assert_allclose(slope[:, 0], 3.0 * time**2 - 10.0 * time, atol=1e-7)
    noise = np.random.default_rng(0).standard_normal(20_000)
    # The centre weight of a cubic over m points, 3 (3 m^2 - 7) / (4 m (m^2 - 4)), is the share that is left.
    left = 3.0 * (3 * 301**2 - 7) / (4 * 301 * (301**2 - 4))
    assert np.var(savitzky_golay(noise)[150:-150]) == pytest.approx(left, rel=0.2)


test_what_cannot_be_filtered_is_refused = refusals(
    lambda signal, options: savitzky_golay(signal, **options),
    (np.zeros(300), {}, "The log holds 300 samples, but the filter's window is 301 samples long"),
    (np.array(1.0), {}, "'signal' must have samples on its first axis, got a single number."),
    (np.zeros(9), {"window": 4}, "'window' must be odd and exceed 'order'"),
    (np.zeros(9), {"window": 9, "order": 6}, "exceed 'order', at most 5"),
    (np.zeros(9), {"window": 3}, "got window=3, order=3, derivative=0."),
    (np.zeros(9), {"window": 5, "derivative": 4}, "got window=5, order=3, derivative=4."),
    (np.zeros(9), {"window": 5, "dt": 0.0}, "'dt' must be finite and positive, got 0.0."),
    (np.array([0.0, np.nan] * 4), {"window": 5}, "4 of 8 samples are not finite"),
    plain=True,
)
