"""One sample as the in-situ tracker takes it in: its signals, and what is wrong with it; private."""

from typing import Any

from surefoot.calibration._arrays import check_tail
from surefoot.calibration._constants import namespace_of
from surefoot.calibration.estimate import Flag
from surefoot.calibration.in_situ._model import PAIRS

__all__ = ["flags_of", "signals_of"]

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""

_LIGHTEST, _HEAVIEST = 1.0, 100.0
"""Size of g - a in m/s^2 below and above which it is not that of a limb."""

_FASTEST = 1e3
"""Angular velocity in rad/s that no limb reaches; its square, an acceleration in rad/s^2."""


def signals_of(
    raw: Array,
    gravity: Array,
    angular_velocity: Array | None,
    angular_acceleration: Array | None,
    *,
    like: Array,
    inertia: bool,
) -> Array:
    """Check the sample, and build u: gravity, and in motion what its turning adds.

    Args:
        raw: Counts, shape (..., k).
        gravity: g - a in m/s^2, shape (..., 3).
        angular_velocity: In rad/s, shape (..., 3), or None.
        angular_acceleration: In rad/s^2, shape (..., 3), or None.
        like: The counts before, which tell shape and dtype.
        inertia: Whether the limb's inertia is known.

    Returns:
        u, shape (..., 3) without and (..., 12) with turning.

    Raises:
        ValueError: If a shape or dtype does not fit, or motion is given for a limb without inertia.
    """
    xp = namespace_of(raw)
    *batch, channels = like.shape
    given = {"raw": (raw, channels), "gravity": (gravity, 3)}
    if (angular_velocity is None) != (angular_acceleration is None):
        raise ValueError("Give 'angular_velocity' and 'angular_acceleration' together, or neither.")
    if angular_velocity is not None and angular_acceleration is not None:
        given["angular_velocity"] = (angular_velocity, 3)
        given["angular_acceleration"] = (angular_acceleration, 3)
    for name, (value, last) in given.items():
        check_tail(value, (last,), name)
        if tuple(value.shape) != (*batch, last) or value.dtype != like.dtype:
            raise ValueError(
                f"'{name}' must have shape {(*batch, last)} and dtype {like.dtype} like the first "
                f"reading, got {tuple(value.shape)} and {value.dtype}."
            )
    if angular_velocity is None or angular_acceleration is None:
        return gravity
    if not inertia:
        raise ValueError(
            "This calibration does not know the limb's inertia: calibrate with the motion, or leave the "
            "angular velocity out."
        )
    products = xp.stack([angular_velocity[..., i] * angular_velocity[..., j] for i, j in PAIRS], axis=-1)
    return xp.concat([gravity, angular_acceleration, products], axis=-1)


def flags_of(
    raw: Array, signals: Array, dt: float, code_range: tuple[float, float] | None
) -> tuple[Array, Array, Array, bool]:
    """Tell what is wrong with a sample.

    Args:
        raw: Counts, shape (..., k).
        signals: u, shape (..., 3) or (..., 12).
        dt: Time since the last sample in s.
        code_range: Lowest and highest count of the converter, or None.

    Returns:
        Flags of the channels, shape (..., k); which readings are whole, and which signals physical, shape
        (...); whether time has passed.
    """
    xp = namespace_of(raw)
    missing = xp.isnan(raw)
    endless = xp.isinf(raw)
    saturated = xp.zeros_like(missing)
    if code_range is not None:
        saturated = ((raw <= code_range[0]) | (raw >= code_range[1])) & ~endless
    g = xp.sqrt(xp.sum(signals[..., :3] ** 2, axis=-1))
    turning = xp.all(xp.abs(signals[..., 3:]) < _FASTEST**2, axis=-1)
    physical = (g >= _LIGHTEST) & (g <= _HEAVIEST) & turning
    passed = bool(0.0 < dt < float("inf"))
    flags = (
        int(Flag.MISSING) * missing
        + int(Flag.OUT_OF_RANGE) * endless
        + int(Flag.SATURATED) * saturated
        + int(Flag.REFERENCE) * (~physical)[..., None]
    )
    flags = xp.asarray(flags, dtype=xp.int64) + (0 if passed else int(Flag.GAP))
    ready = physical & ~xp.any(missing | endless | saturated, axis=-1)
    return flags, ready, physical, passed
