"""Calibration of single channels from known weights.

Known loads on one cell and its readings give F = c S + d (CoP paper, Eqs. 1, 2; Table 2) by linear regression
of the *load on the reading*. The noise is in the readings, so that this regression shrinks c by the noise's
share of the readings' variance: some 1e-9 for a 24-bit converter under kilograms, and it is the noise that
the paper prints.

The correction of a whole foot's centre of pressure follows in
:mod:`surefoot.calibration.weights.cop_correction`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.arrays import Floats
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats

_SAME = 1e-9  # loads or codes whose relative difference is at or below this count as the same


@dataclass(frozen=True, eq=False)
class ChannelFit:
    """Scales and offsets of K channels from known loads."""

    value: Parameters  # the map F = c S + d; in the unit of the loads (N, or kg as in the paper's Table 2)
    covariance: Floats
    """Of each channel's (c, d), shape (K, 2, 2), from the scatter of the residuals; NaN for a channel with
    two samples, which leave none."""
    result: FitResult  # always determined: a channel that is not is refused
    stats: tuple[FitStats, ...]  # one for each channel; the residual is in the unit of the loads


def fit_channels(raw: ArrayLike, load: ArrayLike, channel_names: Sequence[str] | None = None) -> ChannelFit:
    """Fit the scale and offset of each channel to known loads on that channel (CoP paper, Eqs. 1, 2).

    Args:
        raw: Readings, shape (n, K). A NaN or infinite reading leaves that sample out for that channel.
        load: The load on the channel, shape (n,) if all cells bore the same loads, else (n, K), in N or in
            any unit that the result is to have.
        channel_names: The channels' names in messages.

    Returns:
        The maps of all channels.

    Raises:
        ValueError: If the shapes do not belong together.
        CalibrationRefused: If a channel saw fewer than two different loads, or did not react to them.

    >>> fit = fit_channels([[100.0], [300.0], [500.0]], [0.0, 1.0, 2.0])
    >>> print(f"{fit.value.scale[0]:.4f} N per count, {fit.value.offset[0]:.2f} N")
    0.0050 N per count, -0.50 N
    """
    code = np.asarray(raw, dtype=np.float64)
    known = np.asarray(load, dtype=np.float64)
    if code.ndim != 2:
        raise ValueError(f"'raw' must have shape (samples, channels), got {code.shape}.")
    if len(code) == 0:
        raise ValueError(f"'raw' must hold at least one sample, got shape {code.shape}.")
    if known.shape not in (code.shape, code.shape[:1]):
        raise ValueError(
            f"'load' must have shape {code.shape[:1]} or {code.shape} for 'raw' of shape {code.shape}, "
            f"got {known.shape}."
        )
    known = np.broadcast_to(known.reshape(len(code), -1), code.shape)
    names = [f"channel {i}" for i in range(code.shape[1])] if channel_names is None else list(channel_names)
    if len(names) != code.shape[1]:
        raise ValueError(f"'raw' has {code.shape[1]} channels, but {len(names)} channel names were given.")
    read = np.asarray(np.isfinite(code).any(axis=1))
    fits = [_fit_line(code[:, i], known[:, i], name, read) for i, name in enumerate(names)]
    value = np.array([fit[0] for fit in fits]).reshape(-1, 2)
    covariance = np.array([fit[1] for fit in fits]).reshape(-1, 2, 2)
    return ChannelFit(
        value=Parameters(value[:, 0], value[:, 1]),
        covariance=covariance,
        result=FitResult.DETERMINED,
        stats=tuple(fit[2] for fit in fits),
    )


def _fit_line(
    code: Floats, load: Floats, name: str, read: NDArray[np.bool_]
) -> tuple[Floats, Floats, FitStats]:
    """Regress one channel's loads on its codes; returns (c, d), their covariance and the stats.

    In rows in which any channel was ``read``, one without a value was not weighed.
    """
    kept = np.isfinite(code) & np.isfinite(load)
    dropped, bad = int(np.sum(~kept)), int(np.sum(~kept & ~(np.isnan(code) & read)))
    code, load = code[kept], load[kept]
    without = f" ({bad} samples without a finite value left out)" if bad else ""
    if len(load) < 2 or np.ptp(load) <= _SAME * np.max(np.abs(load)):
        seen = f"only the load {load[0]:g} N" if len(load) else "no load"
        raise CalibrationRefused(
            f"The cell '{name}' saw {seen}{without}, and a line needs two.",
            "Add a reading of this cell without load and one under another known weight.",
        )
    if np.ptp(code) <= _SAME * np.max(np.abs(code)):
        raise CalibrationRefused(
            f"The cell '{name}' read {code[0]:g} under all {len(load)} loads{without}.",
            "Check its wiring and that the weights rest on it.",
        )
    # About the mean code and in units of its spread, so that codes near 2^23 cost no digits.
    mean, spread = np.mean(code), np.std(code)
    basis = np.column_stack([(code - mean) / spread, np.ones_like(code)])
    slope_and_level, _, rank, singular = np.linalg.lstsq(basis, load, rcond=None)
    residual = load - basis @ slope_and_level
    back = np.array([[1 / spread, 0.0], [-mean / spread, 1.0]])
    free = len(load) - 2
    variance = np.sum(residual**2) / free if free else np.nan
    stats = FitStats(
        samples=len(load),
        dropped=dropped,
        gated=0,
        residual_rms=float(np.sqrt(np.mean(residual**2))),
        rank=int(rank),
        unknowns=2,
        condition=float(singular[0] / singular[-1]),
    )
    line = np.asarray(back @ slope_and_level, dtype=np.float64)
    return line, variance * back @ np.linalg.inv(basis.T @ basis) @ back.T, stats
