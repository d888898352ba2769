"""Noise and misfit follow residuals of any size, each kind of row its own."""

import numpy as np
import pytest

from surefoot.calibration.moment.noise import FIRST_MISFIT, FIRST_NOISE, followed_misfit, followed_noise
from surefoot.calibration.moment.rows import Residuals

KINDS, ROWS = 3, 24


def after(blocks, residual, there=1.0):
    """Noise and misfit after blocks of residuals, whose expected variance is the noise, as in the filter."""
    noise, misfit = np.full(KINDS, FIRST_NOISE), FIRST_MISFIT
    for _ in range(blocks):
        e, here = np.broadcast_to(residual, ROWS), np.broadcast_to(there, ROWS)
        seen = Residuals(e, np.tile(noise, ROWS // KINDS), here, 1.0)
        noise, misfit = followed_noise(noise, seen), followed_misfit(misfit, seen)
    return noise, misfit


def test_each_kind_of_row_has_the_noise_of_its_own_residuals():
    noise, _ = after(300, np.tile([1.0, 3.0, 5.0], ROWS // KINDS))
    np.testing.assert_allclose(noise, [1.0, 9.0, 25.0], rtol=0.05)


@pytest.mark.parametrize(("residual", "noise"), [(0.0, 1.0), (1e3, 100.0)])
def test_noise_stays_between_what_is_assumed_and_a_hundred_times_that(residual, noise):
    assert after(300, residual)[0] == pytest.approx(np.full(KINDS, noise))


def test_what_fits_is_believed_after_some_seconds_and_what_does_not_is_not():
    assert after(60, 1.0)[1] < 1.0
    assert after(60, 1e3)[1] > 20.0


def test_rows_that_are_not_there_say_nothing_of_the_noise():
    assert after(5, 1e3, there=0.0)[0] == pytest.approx(np.full(KINDS, FIRST_NOISE))
