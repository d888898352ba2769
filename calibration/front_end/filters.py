r"""Low-pass filters of forces and of the motion: causal for streams, zero-phase for logs.

The CoP paper smooths forces and accelerations with a zero-phase filter of 10 Hz. Such a filter looks into
the future: it can replay a log but never run on a robot. In a stream the same second-order Butterworth filter
runs forwards only; it delays by about :math:`\sqrt 2 / (2 \pi f_c)` (23 ms at 10 Hz), which does no harm
where **both** sides of a comparison pass it. It is a difference equation

.. math:: y_k = b_0 x_k + b_1 x_{k-1} + b_2 x_{k-2} - a_1 y_{k-1} - a_2 y_{k-2}

in transposed direct form II, written as one matrix that takes (input, two states) to (output, two states).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy

from surefoot.arrays import Floats
from surefoot.calibration.arrays import Array


class LowPass(NamedTuple):
    """A causal filter as a pair of pure functions over C signals side by side, shape (C,)."""

    init: Callable[[Array], Array]
    """``init(signal) -> state``: the state of a filter that has seen this value for ever, shape (2, C)."""
    apply: Callable[[Array, Array], tuple[Array, Array]]  # ``apply(signal, state) -> (filtered, state)``


def low_pass(cutoff: float, dt: float) -> LowPass:
    """Build the causal second-order Butterworth low-pass filter; at the cutoff half of the power passes.

    ValueError if the cutoff in Hz does not lie between zero and half of the sample rate.

    >>> import numpy as np
    >>> init, apply = low_pass(10.0, 1 / 80)
    >>> state = init(np.zeros(1))
    >>> filtered, state = apply(np.ones(1), state)
    >>> filtered.round(4)
    array([0.0976])
    """
    transition, steady = coefficients(cutoff, dt)

    def init(signal: Array) -> Array:
        return steady * signal

    def apply(signal: Array, state: Array) -> tuple[Array, Array]:
        both = transition @ np.vstack([signal, state])
        return both[0], both[1:]

    return LowPass(init, apply)


def zero_phase(values: Floats, cutoff: float, dt: float) -> Floats:
    """Filter a whole log forwards and backwards, so that nothing is delayed.

    Missing values are bridged by straight lines for the filter's sake and are missing again in the result.

    Args:
        values: The log, N samples first in any shape. NaN and infinite values count as missing.
        cutoff: Cutoff of each of the two passes in Hz.
        dt: Time between samples in s.

    Returns:
        The filtered log, of the same shape.

    Raises:
        ValueError: If the cutoff does not lie between zero and half of the sample rate.
    """
    _check(cutoff, dt)
    flat = np.array(values, dtype=np.float64).reshape(len(values), -1)
    known = np.isfinite(flat)
    index = np.arange(len(flat))
    for column in np.flatnonzero(~known.all(axis=0) & known.any(axis=0)):
        seen = known[:, column]
        flat[~seen, column] = np.interp(index[~seen], index[seen], flat[seen, column])
    flat[:, ~known.any(axis=0)] = 0.0
    b, a = _butterworth(cutoff, dt)
    padding = min(len(flat) - 1, round(1.0 / (cutoff * dt)))
    filtered = scipy.signal.sosfiltfilt(np.concatenate([b, a])[None], flat, axis=0, padlen=padding)
    filtered[~known] = np.nan
    result: Floats = filtered.reshape(np.shape(values))
    return result


def coefficients(cutoff: float, dt: float) -> tuple[Floats, Floats]:
    """Write the filter as its matrix, shape (3, 3), and its state per unit of a constant, shape (2, 1)."""
    _check(cutoff, dt)
    b, a = _butterworth(cutoff, dt)
    transition = np.array(
        [[b[0], 1.0, 0.0], [b[1] - a[1] * b[0], -a[1], 1.0], [b[2] - a[2] * b[0], -a[2], 0.0]]
    )
    steady = np.array([[1.0 - b[0]], [b[2] - a[2]]])
    return transition, steady


def _butterworth(cutoff: float, dt: float) -> tuple[Floats, Floats]:
    """Return b and a of the difference equation: the bilinear transform of 1 / (s² + √2 s + 1)."""
    k = np.tan(np.pi * cutoff * dt)
    a = np.array([1.0 + np.sqrt(2.0) * k + k * k, 2.0 * (k * k - 1.0), 1.0 - np.sqrt(2.0) * k + k * k])
    return k * k * np.array([1.0, 2.0, 1.0]) / a[0], a / a[0]


def _check(cutoff: float, dt: float) -> None:
    """Raise ValueError if the sample rate cannot carry a cutoff."""
    if not dt > 0.0:
        raise ValueError(f"'dt' must be a positive time between samples in s, got {dt}.")
    if not 0.0 < cutoff < 0.5 / dt:
        raise ValueError(
            f"'cutoff' must lie between 0 and half of the sample rate, {0.5 / dt:g} Hz, got {cutoff}."
        )
