"""The samples of a log at rest, and the filter before them (in-situ paper, II-B and IV).

The paper's model holds at rest. Its authors moved the limb slowly and filtered raw readings and accelerometer
alike with a Savitzky-Golay filter of third order over 301 samples, 3 s at 100 Hz. The filter is zero-phase:
it looks into the future and serves logs only.
"""

from math import factorial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.checks import check_value

__all__ = ["savitzky_golay", "static_samples"]


def savitzky_golay(
    signal: ArrayLike, window: int = 301, order: int = 3, *, derivative: int = 0, dt: float = 1.0
) -> NDArray[np.float64]:
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


def static_samples(
    gravity: ArrayLike,
    angular_velocity: ArrayLike | None = None,
    *,
    dt: float | None = None,
    tolerance: float = 0.02,
    maximum_rate: float = 0.1,
    window: int = 31,
) -> NDArray[np.bool_]:
    """Return at which samples the limb was nearly at rest (in-situ paper, II-B, the main assumption).

    A sample counts as static if the size of the accelerometer's vector is close to its median, **and** if the
    limb turned slowly: by the gyroscope, or without one by the rate at which the filtered direction of
    gravity turns. That rate does not see a rotation about the vertical, which leaves the wrench as it is but
    for its inertia.

    Args:
        gravity: From the accelerometer, in m/s^2, shape (n, 3).
        angular_velocity: From a gyroscope, in rad/s, shape (n, 3), or None.
        dt: Time between samples in s. Without it and without a gyroscope only the size is looked at.
        tolerance: Largest deviation of the size from its median, over the median. 2 % lets the noise of cheap
            accelerometers pass; a knock or a touch stops it.
        maximum_rate: In rad/s. At 0.1 rad/s (6 degrees a second) half a metre from the axis the centripetal
            acceleration is 0.005 m/s^2, 0.05 % of gravity.
        window: Of the filter that the rate is taken with, in samples; only used without a gyroscope.

    Returns:
        Whether each sample is static, shape (n,); False where a value is not finite.

    Raises:
        ValueError: If shapes do not belong together, a threshold is not positive, or the rate is to be taken
            of a log that is too short or not finite.

    >>> static_samples([[0.0, 0.0, -9.81], [0.0, 0.0, -9.8], [0.0, 3.0, -9.81], [np.nan, 0.0, -9.81]])
    array([ True,  True, False, False])
    """
    check_value("tolerance", tolerance, positive=True)
    check_value("maximum_rate", maximum_rate, positive=True)
    g = np.asarray(gravity, dtype=np.float64)
    if g.ndim != 2 or g.shape[1] != 3:
        raise ValueError(f"'gravity' must have shape (n, 3), got {g.shape}.")
    size = np.linalg.norm(g, axis=1)
    finite = np.isfinite(size)
    if not finite.any():
        return np.asarray(finite)
    median = np.median(size[finite])
    static = finite & (np.abs(size - median) <= tolerance * median)
    if angular_velocity is not None:
        turning = np.asarray(angular_velocity, dtype=np.float64)
        if turning.shape != g.shape:
            raise ValueError(f"'angular_velocity' must have shape {g.shape}, got {turning.shape}.")
        return np.asarray(static & (np.linalg.norm(turning, axis=1) <= maximum_rate))
    if dt is None:
        return np.asarray(static)
    smooth = savitzky_golay(g, window)
    change = savitzky_golay(g, window, derivative=1, dt=dt)
    length = np.linalg.norm(smooth, axis=1)
    # |g x g'| / |g|^2, without a division where the filtered vector is zero.
    turned = np.linalg.norm(np.cross(smooth, change), axis=1)
    return np.asarray(static & (length > 0.0) & (turned <= maximum_rate * length**2))
