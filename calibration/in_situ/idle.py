"""Checks that readings follow gravity: idle channels, compensated readings and those of another frame."""

from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from surefoot.calibration.arrays import orthonormal
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.model import AXES, SPREAD_ROUNDING, STATIC, transform_basis
from surefoot.calibration.results import Finding

_CHANCE = 1e-4  # probability at which noise alone may seem to follow gravity
_MANY = 3  # idle channels from which a common cause is likelier than broken gauges
_EXPECTED = 3.0  # multiple of the limit by which gravity must be expected in a channel to call it idle


def check_idle(sets: Sequence[InSituSet], factory: NDArray[np.float64] | None) -> Iterator[Finding]:
    """Find channels, or forces, that do not follow gravity in any set.

    ``factory`` is the maker's matrix, shape (6, k), which converts channels to forces, or ``None``.
    """
    limit = float(chdtri(3 * len(sets), _CHANCE))
    if sum(len(data.raw) for data in sets) / 2 <= limit:
        return
    follows = np.sum([_follow_gravity(data, data.raw) for data in sets], axis=0)
    idle, forces = np.flatnonzero(follows < limit), np.zeros(0)
    if factory is not None:
        forces = np.sum([_follow_gravity(data, data.raw @ factory[:3].T) for data in sets], axis=0)
    if factory is not None and not np.all(forces < limit):
        # A torque about an axis through the centre of mass is always zero, and its channel only has noise.
        expected = np.sum([_expect_gravity(data, factory) for data in sets], axis=0)
        idle = idle[expected[idle] > _EXPECTED * limit]
    if len(idle) >= _MANY or (len(forces) and np.all(forces < limit)):
        what = "None of the channels follows gravity"
        if len(idle) < len(follows):
            what = f"The forces do not follow gravity: channels {', '.join(map(str, idle))} only have noise"
            if len(forces) and np.all(forces < limit):
                what = "The forces do not follow gravity"
        reason = (
            f"{what}. The likeliest cause: the readings are compensated already (a payload is set in the "
            "driver or the robot's controller), they are in axes that do not turn with the sensor (a robot's "
            "base axes), or gravity is not of this recording."
        )
        cure = "Log the sensor's own readings in its own axes, with no payload set, and gravity likewise."
        yield Finding("idle channels", reason, cure, float(np.max(follows)), limit)
        return
    for channel in idle:
        reason = f"Channel {channel} does not follow gravity in any set: it reads noise alone."
        yield Finding(
            "idle channel", reason, "Check its gauge and its cable.", float(follows[channel]), limit
        )


def _expect_gravity(data: InSituSet, factory: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the n R^2 on gravity that a maker's matrix, shape (6, k), predicts for each channel, (k,)."""
    whole = np.isfinite(data.raw).all(axis=1) & np.isfinite(data.gravity).all(axis=1)
    raw, gravity = (one[whole] - one[whole].mean(axis=0) for one in (data.raw, data.gravity))
    loads = (transform_basis(False) @ gravity.T).swapaxes(1, 2).reshape(STATIC, -1)
    hangs = np.linalg.lstsq(loads.T, (raw @ factory.T).ravel(), rcond=None)[0]
    expected = (hangs @ loads).reshape(-1, AXES) @ np.linalg.pinv(factory).T
    square = np.maximum(np.sum(raw**2, axis=0), np.finfo(float).tiny)
    return np.asarray(len(raw) * np.sum(expected**2, axis=0) / square)


def _follow_gravity(data: InSituSet, readings: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the n R^2 of a regression of each channel on gravity, shape (k,); about 3 for pure noise."""
    there = np.isfinite(readings) & np.isfinite(data.gravity).all(axis=1, keepdims=True)
    follows, alike = np.empty(readings.shape[1]), defaultdict[bytes, list[int]](list)
    for channel, rows in enumerate(there.T):
        alike[rows.tobytes()].append(channel)
    # Channels with readings in the same samples share a basis.
    for channels in alike.values():
        rows = there[:, channels[0]]
        gravity, counts = data.gravity[rows], readings[rows][:, channels]
        basis, _ = orthonormal(gravity - gravity.mean(axis=0), SPREAD_ROUNDING)
        counts -= counts.mean(axis=0)
        square = np.maximum(np.sum(counts**2, axis=0), np.finfo(float).tiny)
        follows[channels] = len(counts) * np.sum((basis.T @ counts) ** 2, axis=0) / square
    return follows
