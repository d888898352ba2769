"""Checks of recordings: what no calibration can come from."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from surefoot.calibration.imu.gravity_spread import gravity_spread
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.results import CalibrationRefused

__all__ = ["check_bending", "check_sets", "check_within"]

_GRAVITY = (8.8, 10.8)
"""Between these the length of gravity must lie in m/s^2, with the bias that an accelerometer may have."""

_LENGTH_OFF = 0.01
"""Share by which gravity's length may be off or spread without a warning."""

_TILT = 0.02
"""Gravity's direction must spread by this share of its length in all three directions."""

_SATURATED = 0.002
"""Share of samples at an end of the converter that is taken for saturation."""

_REJECTED, _REJECTED_MOVING = 0.05, 0.1
"""Share of samples that may disagree with all others; the second where the limb moves, as the error of a
differentiated gyroscope has long tails."""

_MOST_BENDS, _SOME_BENDS = 0.7, 0.2
"""Share of the residual from which on bending explains it; the second after the fit, beside hysteresis."""

_WORST = 2.0
"""Rows that leave more than this multiple of the median are named."""

_LEAST_SAMPLES = 4
"""Whole samples that a set must have."""

_CHANCE = 1e-4
"""Probability at which noise alone may seem to bend a limb."""

_FEW = 30
"""Rows below which bending does not show."""

_BENDING, _BENDING_WITH_LOOPS = 0.1, 0.35
"""Share of the tolerated residual that may go with gravity's squares; the second while hysteresis may be part
of it."""


def check_sets(sets: Sequence[InSituSet], options: InSituOptions, leaning: bool) -> tuple[str, ...]:
    """Return warnings, or raise CalibrationRefused for dead or saturated channels and for too little gravity.

    With ``leaning`` a factory matrix stands in for what gravity does not show.
    """
    factors, samples, lengths, warnings = [], 0, [], []
    for data in sets:
        whole = np.asarray(np.isfinite(data.raw).all(axis=1))
        for one in (data.gravity, data.angular_velocity, data.angular_acceleration, data.temperature):
            if one is not None:
                whole &= np.isfinite(one.reshape(len(whole), -1)).all(axis=1)
        if np.sum(whole) < _LEAST_SAMPLES:
            raise CalibrationRefused(
                f"'{data.name}': {np.sum(whole)} of {whole.size} samples are whole, and four are the least.",
                "Check which columns hold no number, and record for longer.",
            )
        _check_channels(data, options)
        gravity = data.gravity[whole]
        sizes = np.linalg.norm(gravity, axis=1)
        lengths.append(float(np.median(sizes)))
        if not data.moves and not _GRAVITY[0] < lengths[-1] < _GRAVITY[1]:
            raise CalibrationRefused(
                f"'{data.name}': gravity is {lengths[-1]:.3g} m/s^2 long, where 9.81 is expected.",
                "Give it in m/s^2 (1 g = 9.80665 m/s^2), and calibrate the accelerometer first.",
            )
        off = max(abs(lengths[-1] / GRAVITY - 1.0), float(np.std(sizes)) / GRAVITY)
        if not data.moves and off > _LENGTH_OFF:
            warnings.append(
                f"'{data.name}': gravity is {lengths[-1]:.2f} m/s^2 long and spreads by {np.std(sizes):.2f}; "
                "calibrate the accelerometer first, or forces and offsets will be off by as much."
            )
        factors.append(np.linalg.qr(gravity - gravity.mean(axis=0), mode="r"))
        samples += len(gravity)
    spread = gravity_spread(np.concatenate(factors), float(np.mean(lengths) * np.sqrt(samples)))
    if spread[2] >= _TILT:
        return tuple(warnings)
    seen = "along one line" if spread[1] < _TILT else "in one plane"
    reason = (
        f"Gravity was seen to turn {seen} only: its direction spreads by {spread[0]:.3f}, "
        f"{spread[1]:.3f} and {spread[2]:.4f} along its three axes, and {_TILT} is needed along each."
    )
    if leaning:
        return (*warnings, f"{reason} What it does not show leans on the factory matrix.")
    raise CalibrationRefused(
        reason, "Tilt the limb about a second axis as well, such as front-back and sideways."
    )


def _check_channels(data: InSituSet, options: InSituOptions) -> None:
    """Raise CalibrationRefused if a channel is dead or saturated."""
    for channel, counts in enumerate(data.raw.T):
        counts = counts[np.isfinite(counts)]
        if len(counts) and np.ptp(counts) == 0.0:
            raise CalibrationRefused(
                f"'{data.name}': channel {channel} reads {counts[0]:g} throughout.",
                "Check its wiring and that the sensor was switched on.",
            )
        if options.code_range is None:
            continue
        low, high = options.code_range
        stuck = float(np.mean((counts <= low) | (counts >= high))) if len(counts) else 0.0
        if stuck > _SATURATED:
            raise CalibrationRefused(
                f"'{data.name}': channel {channel} is saturated in {stuck:.1%} of the samples "
                f"(at or beyond {low:g} or {high:g}).",
                "Take the load off or set the hardware's offset again: a clipped reading shows nothing.",
            )


def check_within(
    sets: Sequence[InSituSet], parts: Sequence[CompressedSet], options: InSituOptions
) -> tuple[str, ...]:
    """Return which samples were left out, or raise CalibrationRefused if no rigid limb explains a set."""
    warnings = []
    for data, part in zip(sets, parts, strict=True):
        share = float(np.mean(part.rejected))
        if share > (_REJECTED_MOVING if data.moves else _REJECTED):
            raise CalibrationRefused(
                f"'{data.name}': {share:.0%} of the samples disagree with all others"
                f"{_when(data, part.rejected)}.",
                "Something touched the limb or it moved too fast: leave that time out, or record the set "
                "again with the foot in the air.",
            )
        if part.rejected.any():
            warnings.append(
                f"'{data.name}': {np.sum(part.rejected)} samples that disagree with all others were left out"
                f"{_when(data, part.rejected)}."
            )
        left = _residual_share(data, part)
        if left > options.residual_tolerance:
            bending = _bending(data, part)
            raise _bends(data, bending) if bending > _MOST_BENDS * left else _unexplained(data, part, left)
    return tuple(warnings)


def check_bending(
    sets: Sequence[InSituSet], parts: Sequence[CompressedSet], options: InSituOptions, loops: bool
) -> None:
    """Raise CalibrationRefused if a limb bends a little.

    With ``loops`` hysteresis, which looks like it for a while, may still be in the readings.
    """
    limit = (_BENDING_WITH_LOOPS if loops else _BENDING) * options.residual_tolerance
    for data, part in zip(sets, parts, strict=True):
        bending = _bending(data, part)
        if bending > limit and bending > _SOME_BENDS * _residual_share(data, part):
            raise _bends(data, bending)


def _bends(data: InSituSet, share: float) -> CalibrationRefused:
    return CalibrationRefused(
        f"'{data.name}': {share:.1%} of the readings' spread goes with gravity's squares: the limb bends as "
        "it turns, or the sensor is not linear.",
        "Hold the joints beyond the sensor fast, or lighten what is added.",
    )


def _residual_share(data: InSituSet, part: CompressedSet) -> float:
    """Return the share of the spread that gravity does not explain, less white noise where time shows it."""
    left = float(np.sum(part.residual**2))
    if data.time is not None and part.rows > 1:
        left -= float(np.sum(np.diff(part.residual, axis=0) ** 2)) / 2.0
    return _share_of_spread(left, part)


def _share_of_spread(square: float, part: CompressedSet) -> float:
    spread = np.sum(part.ur**2) + np.sum(part.rr**2)
    return float(np.sqrt(max(square, 0.0) / spread)) if spread > 0.0 else 0.0


def _bending(data: InSituSet, part: CompressedSet) -> float:
    """Return the share of the spread that goes with gravity's squares, beyond what noise would."""
    if part.rows < _FEW:
        return 0.0
    g = data.gravity[part.index.astype(int)] / GRAVITY
    # The sixth square follows from the length of gravity.
    squares = np.stack([g[:, i] * g[:, j] for i, j in ((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))], axis=1)
    basis = np.linalg.qr(np.column_stack([np.ones(len(g)), g, squares]))[0]
    explained = float(np.sum((basis.T @ part.residual) ** 2))
    left = float(np.sum(part.residual**2)) - explained
    terms, channels = squares.shape[1], part.residual.shape[1]
    by_chance = float(chi2.isf(_CHANCE, terms * channels)) / channels
    chance = left * by_chance / max(part.rows - basis.shape[1], 1)
    return _share_of_spread(explained - chance, part)


def _unexplained(data: InSituSet, part: CompressedSet, share: float) -> CalibrationRefused:
    size = np.linalg.norm(part.residual / (np.std(part.residual, axis=0) + np.finfo(float).tiny), axis=1)
    worst = np.zeros_like(part.used)
    worst[part.index.astype(int)[size > _WORST * np.median(size)]] = True
    return CalibrationRefused(
        f"'{data.name}': {share:.1%} of the readings' spread follows gravity in no linear way"
        f"{_when(data, worst)}.",
        "Something touched the limb, the motion was too fast or the sensor's hysteresis is large: record the "
        "set again, slowly and with the foot in the air.",
    )


def _when(data: InSituSet, marked: NDArray[np.bool_]) -> str:
    """Return where most of the marked samples lie, in words."""
    if not marked.any():
        return ""
    first, last = np.quantile(np.flatnonzero(marked), [0.05, 0.95]).astype(int)
    if data.time is None:
        return f", most of them between samples {first} and {last}"
    return f", most of them between {data.time[first]:.1f} s and {data.time[last]:.1f} s"
