"""The filter for logs of slowly moving limbs (in-situ paper, II-B and IV).

The paper's model holds at rest. Its authors moved the limb slowly and filtered both raw readings and
accelerometer with a Savitzky-Golay filter of third order over 301 samples, 3 s at 100 Hz. The filter is
zero-phase and uses future samples, so that it can only be applied to logs.
"""

import numpy as np
import scipy
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.checks import check_value


def savitzky_golay(
    signal: ArrayLike, window: int = 301, order: int = 3, *, derivative: int = 0, dt: float = 1.0
) -> Floats:
    """Return a log smoothed by local polynomials (in-situ paper, IV), or its derivative.

    Args:
        signal: Samples at a constant rate, shape (n, ...).
        window: Length of the window in samples, odd.
        order: Order of the polynomials.
        derivative: Order of the derivative, 0 for the signal itself.
        dt: Time between samples in s, used for derivatives only.

    Returns:
        The smoothed signal or its derivative (per s), shape (n, ...). Half a window at either end is from the
        polynomial of the outermost window.

    Raises:
        ValueError: If the log is shorter than the window or holds values that are not finite, or if the
            window, the order and the derivative are inconsistent.

    >>> savitzky_golay(np.arange(1.0, 8.0) ** 3, window=5).round(6)
    array([  1.,   8.,  27.,  64., 125., 216., 343.])
    """
    values = np.asarray(signal, dtype=np.float64)
    if values.ndim == 0:
        raise ValueError("'signal' must have samples on its first axis, got a single number.")
    if window % 2 == 0 or not 0 <= derivative <= order < window or order > 5:
        raise ValueError(
            "'window' must be odd and exceed 'order', at most 5, and 'derivative' must not, "
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
    filtered: Floats = scipy.signal.savgol_filter(values, window, order, derivative, dt, axis=0)
    return filtered
