"""Recordings that no calibration can come from; private."""

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

_SIZE = 0.01
"""Share by which gravity's length may be off or spread without a word."""

_TILT = 0.02
"""Gravity's direction must spread by this share of its length in all three directions."""

_SATURATED = 0.002
"""Share of samples at an end of the converter that is taken for saturation."""

_REJECTED = 0.05
"""Share of samples that may disagree with all others ..."""

_REJECTED_MOVING = 0.1
"""... and where the limb moves, as the error of a differentiated gyroscope has long tails."""

_CHANCE = 1e-4
"""Probability at which noise alone may seem to bend a limb."""

_FEW = 30
"""Rows below which nothing can be said of a limb that bends."""

_BENDING_WITH_LOOPS = 0.35
"""Share of the tolerated misfit that may go with gravity's squares while hysteresis may be part of it ..."""

_BENDING = 0.1
"""... and once it is not."""


def check_sets(sets: Sequence[InSituSet], options: InSituOptions, leaning: bool) -> tuple[str, ...]:
    """Refuse readings that say nothing and gravity that shows too little.

    Args:
        sets: The sets.
        options: Range of the converter.
        leaning: Whether a factory matrix stands in for what gravity does not show.

    Returns:
        Warnings.
    """
    factors, samples, lengths, warnings = [], 0, [], []
    for data in sets:
        whole = np.asarray(np.isfinite(data.raw).all(axis=1))
        for one in (data.gravity, data.angular_velocity, data.angular_acceleration, data.temperature):
            if one is not None:
                whole &= np.isfinite(one.reshape(len(whole), -1)).all(axis=1)
        if np.sum(whole) < 4:
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
        if not data.moves and off > _SIZE:
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
                "Take the load off or set the hardware's zero anew: a clipped reading says nothing.",
            )


def check_within(
    sets: Sequence[InSituSet], parts: Sequence[CompressedSet], options: InSituOptions
) -> tuple[str, ...]:
    """Refuse sets whose readings no rigid limb explains; say what was left out of the others."""
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
        misfit = _misfit(data, part)
        if misfit > options.misfit_tolerance:
            bending = _bending(data, part)
            raise _bends(data, bending) if bending > 0.7 * misfit else _unexplained(data, part, misfit)
    return tuple(warnings)


def check_bending(
    sets: Sequence[InSituSet], parts: Sequence[CompressedSet], options: InSituOptions, loops: bool
) -> None:
    """Refuse limbs that bend a little.

    Args:
        sets: The sets.
        parts: Compressed.
        options: What is tolerated.
        loops: Whether hysteresis, which looks like it for a while, may still be in the readings.
    """
    limit = (_BENDING_WITH_LOOPS if loops else _BENDING) * options.misfit_tolerance
    for data, part in zip(sets, parts, strict=True):
        bending = _bending(data, part)
        if bending > limit and bending > 0.2 * _misfit(data, part):
            raise _bends(data, bending)


def _bends(data: InSituSet, share: float) -> CalibrationRefused:
    return CalibrationRefused(
        f"'{data.name}': {share:.1%} of the readings' spread goes with gravity's squares: the limb bends as "
        "it turns, or the sensor is not linear.",
        "Hold the joints beyond the sensor fast, or lighten what is added.",
    )


def _misfit(data: InSituSet, part: CompressedSet) -> float:
    """Share of the spread that gravity does not explain, without white noise where time tells it apart."""
    spread = np.sum(part.ur**2) + np.sum(part.rr**2)
    left = float(np.sum(part.residual**2))
    if data.time is not None and part.rows > 1:
        left -= float(np.sum(np.diff(part.residual, axis=0) ** 2)) / 2.0
    return float(np.sqrt(max(left, 0.0) / spread)) if spread > 0.0 else 0.0


def _bending(data: InSituSet, part: CompressedSet) -> float:
    """Share of the spread that goes with the squares of gravity's components, beyond what noise would."""
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
    spread = np.sum(part.ur**2) + np.sum(part.rr**2)
    return float(np.sqrt(max(explained - chance, 0.0) / spread)) if spread > 0.0 else 0.0


def _unexplained(data: InSituSet, part: CompressedSet, misfit: float) -> CalibrationRefused:
    size = np.linalg.norm(part.residual / (np.std(part.residual, axis=0) + np.finfo(float).tiny), axis=1)
    worst = np.zeros_like(part.used)
    worst[part.index.astype(int)[size > 2.0 * np.median(size)]] = True
    return CalibrationRefused(
        f"'{data.name}': {misfit:.1%} of the readings' spread follows gravity in no linear way"
        f"{_when(data, worst)}.",
        "Something touched the limb, the motion was too fast or the sensor's hysteresis is large: record the "
        "set again, slowly and with the foot in the air.",
    )


def _when(data: InSituSet, marked: NDArray[np.bool_]) -> str:
    """Where most of the marked samples lie."""
    if not marked.any():
        return ""
    first, last = np.quantile(np.flatnonzero(marked), [0.05, 0.95]).astype(int)
    if data.time is None:
        return f", most of them between samples {first} and {last}"
    return f", most of them between {data.time[first]:.1f} s and {data.time[last]:.1f} s"
