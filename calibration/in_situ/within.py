"""Checks within sets: samples that disagree with all others, and what gravity explains in no linear way."""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from surefoot.calibration.in_situ.check import when
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.model import DIRECT
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.reference import GRAVITY

__all__ = ["BENT_CURE", "bending", "check_bending", "check_within"]

_REJECTED, _REJECTED_MOVING = 0.05, 0.1
"""Share of samples that may disagree with all others; the second where the limb moves, as the error of a
differentiated gyroscope has long tails."""

_STRAY = 0.002
"""Share of samples that may be left out without a warning."""

_MOST_BENDS, _SOME_BENDS = 0.7, 0.2
"""Share of the residual from which on bending explains it; the second after the fit, beside hysteresis."""

_NOISY = 0.3
"""Share of a set's spread that may be left unexplained where samples have no order in time."""

_WORST = 2.0
"""Rows that leave more than this multiple of the median are named."""

_CHANCE = 1e-4
"""Probability at which noise alone may seem to bend a limb."""

_FEW = 30
"""Rows below which bending does not show."""

_BENDING, _BENDING_WITH_LOOPS = 0.1, 0.35
"""Share of the tolerated residual that may go with gravity's squares; the second while hysteresis may be part
of it."""

BENT_CURE = "Hold the joints beyond the sensor fast, or lighten what is added."
"""What helps where readings go with gravity's squares."""


def check_within(
    sets: Sequence[InSituSet], parts: Sequence[CompressedSet], options: InSituOptions
) -> list[Finding]:
    """Return which samples were left out, and which sets no rigid limb explains."""
    found = []
    for data, part in zip(sets, parts, strict=True):
        share = float(np.mean(part.rejected))
        if share > (_REJECTED_MOVING if data.moves else _REJECTED):
            reason = (
                f"'{data.name}': {share:.0%} of the samples disagree with all others"
                f"{when(data, part.rejected)}."
            )
            cure = (
                "Something touched the limb or it moved too fast: leave that time out, or record the set "
                "again with the foot in the air."
            )
            found.append(Finding("outliers", reason, cure, share, _REJECTED, contradicts=True))
        elif share > _STRAY:
            reason = (
                f"'{data.name}': {np.sum(part.rejected)} samples that disagree with all others were left out"
                f"{when(data, part.rejected)}: something may have touched the limb."
            )
            found.append(Finding("outliers", reason, value=share, limit=_STRAY, refuses=False))
        left = _residual_share(data, part)
        # Without an order in time nothing tells white noise from all else: only what is beyond it refuses.
        if left > (options.residual_tolerance if data.time is not None else _NOISY):
            share = bending(part)
            bends = share > _MOST_BENDS * left
            found.append(_bends(data, share, 0.0) if bends else _unexplained(data, part, left))
    return found


def check_bending(
    sets: Sequence[InSituSet], parts: Sequence[CompressedSet], options: InSituOptions, loops: bool
) -> tuple[float, list[Finding]]:
    """Return by how much a limb bends that may, and what to say of it.

    With ``loops`` hysteresis, which looks like it for a while, may still be in the readings.
    """
    limit = (_BENDING_WITH_LOOPS if loops else _BENDING) * options.residual_tolerance
    most, found = 0.0, []
    for data, part in zip(sets, parts, strict=True):
        share = bending(part)
        if share <= limit or share <= _SOME_BENDS * _residual_share(data, part):
            continue
        most = max(most, share)
        found.append(_bends(data, share, options.bending_tolerance or 0.0))
    return most, found


def _bends(data: InSituSet, share: float, allowed: float) -> Finding:
    reason = (
        f"'{data.name}': {share:.1%} of the readings' spread goes with gravity's squares: the limb bends as "
        "it turns, or the sensor is not linear."
    )
    if share > allowed:
        return Finding("bending", reason, BENT_CURE, share, allowed, contradicts=True)
    reason += " Matrix and offset count as unsure by as much."
    return Finding("bending", reason, value=share, limit=allowed, refuses=False)


def _residual_share(data: InSituSet, part: CompressedSet) -> float:
    """Return the share of the spread that gravity does not explain, less white noise where time shows it."""
    left = float(np.sum(part.residual**2))
    if data.time is not None and part.rows > 1:
        left -= float(np.sum(np.diff(part.residual, axis=0) ** 2)) / 2.0
    return _share_of_spread(left, part)


def _share_of_spread(square: float, part: CompressedSet) -> float:
    return float(np.sqrt(max(square, 0.0) / part.spread)) if part.spread > 0.0 else 0.0


def bending(part: CompressedSet) -> float:
    """Return the share of the spread that goes with gravity's squares, beyond what noise would.

    The squares are weighted like the rows, so that no drift is taken for them.
    """
    if part.rows < _FEW:
        return 0.0
    g = part.source.signals[:, DIRECT] / GRAVITY
    # The sixth square follows from the length of gravity.
    squares = np.stack([g[:, i] * g[:, j] for i, j in ((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))], axis=1)
    columns = part.colour.weigh(np.column_stack([np.ones(len(g)), g, squares]), part.spacing)
    basis = np.linalg.qr(np.column_stack([part.score[:, np.any(part.score, axis=0)], columns]))[0]
    basis = basis[:, -squares.shape[1] :]
    explained = float(np.sum((basis.T @ part.residual) ** 2))
    left = float(np.sum(part.residual**2)) - explained
    # Channels of which one is much noisier, or that share their noise, are worth fewer than they are.
    scatter = part.residual.T @ part.residual
    channels = float(np.trace(scatter) ** 2 / max(float(np.sum(scatter**2)), np.finfo(float).tiny))
    terms = squares.shape[1]
    by_chance = float(chdtri(terms * channels, _CHANCE)) / channels
    chance = left * by_chance / max(part.rows - basis.shape[1], 1) * part.level(basis)
    return _share_of_spread(explained - chance, part)


def _unexplained(data: InSituSet, part: CompressedSet, share: float) -> Finding:
    size = np.linalg.norm(part.residual / (np.std(part.residual, axis=0) + np.finfo(float).tiny), axis=1)
    worst = np.zeros_like(part.used)
    worst[part.index.astype(int)[size > _WORST * np.median(size)]] = True
    reason = (
        f"'{data.name}': {share:.1%} of the readings' spread follows gravity in no linear way"
        f"{when(data, worst)}."
    )
    cure = (
        "Something touched the limb, the motion was too fast or the sensor's hysteresis is large: record the "
        "set again, slowly and with the foot in the air."
    )
    return Finding("residual", reason, cure, share, contradicts=True)
