"""Checks of recordings at the door: what no calibration can come from."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from surefoot.calibration.imu.gravity_spread import gravity_spread
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.gravity import Sphere
from surefoot.calibration.in_situ.model import DIRECT
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.results import CalibrationRefused

__all__ = [
    "BENT_CURE",
    "TOO_FAST",
    "bending",
    "check_bending",
    "check_gravity",
    "check_sets",
    "check_within",
    "when",
]


_GRAVITY = (8.8, 10.8)
"""Between these the length of gravity must lie in m/s^2, with the bias that an accelerometer may have."""

_UNITS = {
    1.0: "g (1 g = 9.80665 m/s^2)",
    1e3: "thousandths of g",
    1e2 * GRAVITY: "cm/s^2",
    1e3 * GRAVITY: "mm/s^2",
    GRAVITY**2: "m/s^2 already, and was converted once more",
}
"""What gravity of such a length is likely to be in."""

_SAME_UNIT = 0.2
"""Share by which a length may be off that of a unit."""

_SPEEDING = 0.05
"""Spread of gravity's length, as a share, that only motion makes."""

_HEAVIEST, _FARTHEST = 100.0, 5.0
"""Added masses in kg, and places in m, that nobody hangs on a limb."""

_TIES, _TIES_RATIO = 5, 5.0
"""Equal readings at the end of a channel that show that it is clipped, and how many times more than at the
next values."""

_NEXT = 20
"""Values next to the end that are counted."""

_TILT = 0.02
"""Gravity's direction must spread by this share of its length in all three directions."""

_SATURATED = 0.002
"""Share of samples at an end of the converter that is taken for saturation."""

_LEAST_SAMPLES = 4
"""Whole samples that a set must have."""

TOO_FAST = "the limb moved too fast to be taken as at rest"
"""What is said of that."""


def check_sets(sets: Sequence[InSituSet], options: InSituOptions, leaning: bool) -> list[Finding]:
    """Return what is wrong with channels, masses, units and the turning of gravity.

    Args:
        sets: As they were given.
        options: Of the fit.
        leaning: Whether a factory matrix stands in for what gravity does not show.

    Raises:
        CalibrationRefused: If a set has no samples to speak of.
    """
    found, factors, samples, sizes = [], [], 0, []
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
        found += _check_channels(data, options)
        found += _check_added(data)
        gravity = data.gravity[whole]
        length = np.linalg.norm(gravity, axis=1)
        found += _check_length(data, float(np.median(length)), float(np.std(length)))
        sizes.append(float(np.median(length)))
        factors.append(np.linalg.qr(gravity - gravity.mean(axis=0), mode="r"))
        samples += len(gravity)
    spread = gravity_spread(np.concatenate(factors), float(np.mean(sizes) * np.sqrt(samples)))
    if spread[2] >= _TILT:
        return found
    seen = "along one line" if spread[1] < _TILT else "in one plane"
    reason = (
        f"Gravity was seen to turn {seen} only: its direction spreads by {spread[0]:.3f}, "
        f"{spread[1]:.3f} and {spread[2]:.4f} along its three axes, and {_TILT} is needed along each."
    )
    cure = "Tilt the limb about a second axis as well, such as front-back and sideways."
    if leaning:
        reason, cure = f"{reason} What it does not show leans on the factory matrix.", ""
    return [*found, Finding("gravity's turning", reason, cure, spread[2], _TILT, refuses=not leaning)]


def check_gravity(sets: Sequence[InSituSet], sphere: Sphere) -> list[Finding]:
    """Return what the length of gravity says of the accelerometer, and of a limb that was not at rest."""
    found = [Finding("accelerometer", words, refuses=False) for words in sphere.describe()]
    if any(data.moves for data in sets) or sphere.spread <= _SPEEDING * GRAVITY:
        return found
    reason = (
        f"Gravity is {sphere.length:.2f} m/s^2 long and spreads by {sphere.spread:.2f}: {TOO_FAST}, or the "
        "accelerometer is very noisy."
    )
    cure = "Give the gyroscope's readings as well, or move slowly."
    return [*found, Finding("speed", reason, cure, sphere.spread, _SPEEDING * GRAVITY)]


def _check_added(data: InSituSet) -> list[Finding]:
    """Return a finding if nobody hangs such a mass, or at such a place, on a limb."""
    found = []
    if data.added_mass > _HEAVIEST:
        reason = (
            f"'{data.name}': {data.added_mass:g} kg were added, and no limb bears that: the mass is likely "
            "in grams."
        )
        found.append(Finding("mass", reason, "Give masses in kg.", data.added_mass, _HEAVIEST))
    reach = float(np.linalg.norm(data.added_com)) * (data.added_mass > 0.0)
    if reach > _FARTHEST:
        reason = (
            f"'{data.name}': the added mass hangs {reach:.3g} m away from the sensor: its place is likely in "
            "mm or cm."
        )
        found.append(Finding("place", reason, "Give places in m, in the sensor's frame.", reach, _FARTHEST))
    return found


def _check_length(data: InSituSet, length: float, spread: float) -> list[Finding]:
    """Return a finding if a set's gravity is of a length that gravity does not have."""
    reason = f"'{data.name}': gravity is {length:.4g} m/s^2 long, where 9.81 is expected."
    looks = [text for value, text in _UNITS.items() if abs(length / value - 1.0) < _SAME_UNIT]
    if looks:
        reason += f" Give it in m/s^2; it looks like {looks[0]}."
        return [
            Finding("unit of gravity", reason, "Convert it, and calibrate the accelerometer first.", length)
        ]
    if _GRAVITY[0] < length < _GRAVITY[1]:
        return []
    if spread > _SPEEDING * length and not data.moves:
        reason += f" It spreads by {spread:.2g}: {TOO_FAST}."
        return [Finding("speed", reason, "Give the gyroscope's readings as well, or move slowly.", spread)]
    reason += f" Give it in m/s^2; or the accelerometer's scale is off by {length / GRAVITY - 1.0:+.0%}."
    return [Finding("length of gravity", reason, "Calibrate the accelerometer first.", length)]


def _check_channels(data: InSituSet, options: InSituOptions) -> list[Finding]:
    """Return which channels are dead or saturated."""
    found = []
    for channel, of_channel in enumerate(data.raw.T):
        counts = of_channel[np.isfinite(of_channel)]
        if len(counts) and np.ptp(counts) == 0.0:
            reason = f"'{data.name}': channel {channel} reads {counts[0]:g} throughout."
            cure = "Check its wiring and that the sensor was switched on."
            found.append(Finding("dead channel", reason, cure))
        low, high = options.code_range or (-np.inf, np.inf)
        stuck = float(np.mean((counts <= low) | (counts >= high))) if len(counts) else 0.0
        if stuck > _SATURATED:
            reason = (
                f"'{data.name}': channel {channel} is saturated in {stuck:.1%} of the samples "
                f"(at or beyond {low:g} or {high:g})."
            )
            cure = "Take the load off or set the hardware's offset again: a clipped reading shows nothing."
            found.append(Finding("saturation", reason, cure, stuck, _SATURATED))
        found += _check_ends(data, channel, of_channel)
    return found


def _check_ends(data: InSituSet, channel: int, counts: NDArray[np.float64]) -> list[Finding]:
    """Return a finding if a channel stays at its highest or lowest reading while its load goes on."""
    found = []
    for end, sign in ((np.nanmax(counts), 1.0), (np.nanmin(counts), -1.0)):
        held = counts == end
        if np.sum(held) < _TIES:
            continue
        values, times = np.unique(sign * counts[np.isfinite(counts)], return_counts=True)
        if len(values) <= _NEXT or times[-1] <= _TIES_RATIO * np.mean(times[-1 - _NEXT : -1]):
            continue
        beyond, deviation = _beyond(data, counts, held, sign)
        if beyond > deviation + values[-1] - values[-2]:
            reason = (
                f"'{data.name}': channel {channel} is clipped: {times[-1]} samples read exactly {end:g}"
                f"{when(data, held)}, none reads beyond, and gravity went on turning."
            )
            cure = (
                "Take the load off, set the hardware's offset again, or lower the gain: a clipped reading "
                "shows nothing."
            )
            found.append(Finding("clipping", reason, cure, float(times[-1])))
    return found


def _beyond(
    data: InSituSet, counts: NDArray[np.float64], held: NDArray[np.bool_], sign: float
) -> tuple[float, float]:
    """Return how far held samples should read beyond their end by gravity, and the others' deviation."""
    columns = np.column_stack([np.ones(len(counts)), data.gravity])
    whole = np.isfinite(columns).all(axis=1) & np.isfinite(counts)
    others = whole & ~held
    slope = np.linalg.lstsq(columns[others], counts[others], rcond=None)[0]
    left = counts - columns @ slope
    return -sign * float(np.mean(left[whole & held])), float(np.std(left[others]))


def when(data: InSituSet, marked: NDArray[np.bool_]) -> str:
    """Return where most of the marked samples lie, in words."""
    if not marked.any():
        return ""
    first, last = np.quantile(np.flatnonzero(marked), [0.05, 0.95]).astype(int)
    if data.time is None:
        return f", most of them between samples {first} and {last}"
    return f", most of them between {data.time[first]:.1f} s and {data.time[last]:.1f} s"


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
            found.append(_bends(data, share, 0.0) if bends else _large_residual(data, part, left))
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


def _large_residual(data: InSituSet, part: CompressedSet, share: float) -> Finding:
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
