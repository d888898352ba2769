"""The filter of a log whose limb moves slowly (in-situ paper, II-B and IV).

The paper's model holds at rest. Its authors moved the limb slowly and filtered raw readings and accelerometer
alike with a Savitzky-Golay filter of third order over 301 samples, 3 s at 100 Hz. The filter is zero-phase:
it looks into the future and serves logs only.
"""

from math import factorial

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.calibration.checks import check_value


def savitzky_golay(
    signal: ArrayLike, window: int = 301, order: int = 3, *, derivative: int = 0, dt: float = 1.0
) -> Floats:
    """Return a log smoothed by local polynomials (in-situ paper, IV), or its derivative.

    Args:
        signal: Samples at a constant rate, shape (n, ...).
        window: Length of the polynomials' pieces in samples, odd.
        order: Of the polynomials.
        derivative: Which derivative to take, 0 for the signal itself.
        dt: Time between samples in s; matters to derivatives only.

    Returns:
        The smoothed signal or its derivative (per s), shape (n, ...). Half a window at either end comes from
        the polynomial of the outermost window.

    Raises:
        ValueError: If the log is shorter than the window, holds values that are not finite, or the window,
            the order and the derivative do not belong together.

    >>> savitzky_golay(np.arange(1.0, 8.0) ** 3, window=5).round(6)
    array([  1.,   8.,  27.,  64., 125., 216., 343.])
    """
    values = np.asarray(signal, dtype=np.float64)
    if values.ndim == 0:
        raise ValueError("'signal' must have samples on its first axis, got a single number.")
    if window % 2 == 0 or not 0 <= derivative <= order < window:
        raise ValueError(
            "'window' must be odd and exceed 'order', and 'derivative' must not, "
            f"got window={window}, order={order}, derivative={derivative}."
        )
    check_value("dt", dt, positive=True)
    if len(values) < window:
        raise ValueError(
            f"The log holds {len(values)} samples, but the filter's window is {window} samples long: record "
            "for longer or take a shorter window."
        )
    bad = int(np.sum(~np.isfinite(values.reshape(len(values), -1)).all(axis=1)))
    if bad:
        raise ValueError(
            f"{bad} of {len(values)} samples are not finite, and the filter would spread them over a window: "
            "cut the log at its gaps or fill them first."
        )
    # SciPy has it as well, but to import scipy.signal takes longer than all else that a calibration does.
    half = window // 2
    reach = max(half, 1)
    place = np.arange(-half, half + 1) / reach
    fitted = np.linalg.pinv(np.vander(place, order + 1, increasing=True))  # coefficients, (order + 1, window)
    power = np.arange(derivative, order + 1)
    falling = np.array([factorial(p) / factorial(p - derivative) for p in power]) / (reach * dt) ** derivative
    # Of a window's samples, for the value or the derivative at each of its places, (window, window).
    weights = (falling * place[:, None] ** (power - derivative)) @ fitted[derivative:]
    inner = len(values) - 2 * half
    filtered = np.zeros_like(values)
    for i, weight in enumerate(weights[half]):
        filtered[half : half + inner] += weight * values[i : i + inner]
    filtered[:half] = np.tensordot(weights[:half], values[:window], axes=1)
    filtered[half + inner :] = np.tensordot(weights[half + 1 :], values[-window:], axes=1)
    return filtered
