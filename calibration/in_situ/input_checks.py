"""Checks of recordings: what no calibration can come from."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from surefoot.calibration.imu.gravity_spread import gravity_spread
from surefoot.calibration.imu.static import savitzky_golay
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.results import CalibrationRefused

__all__ = [
    "BENT_CURE",
    "TOO_FAST",
    "Contradiction",
    "check_bending",
    "check_sets",
    "check_within",
    "felt_by_turning",
    "turning",
]

_GRAVITY = (8.8, 10.8)
"""Between these the length of gravity must lie in m/s^2, with the bias that an accelerometer may have."""

_LENGTH_OFF = 0.01
"""Share by which gravity's length may be off or spread without a warning."""

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

_EXPLAINS = 0.7
"""A bias or a scale is named if it leaves less than this share of what gravity's length is off by."""

_SPEEDING = 0.05
"""Spread of gravity's length, as a share, that only motion makes."""

_SHOWN = 1000
"""Samples of a set from which the accelerometer is judged."""

_PIVOT = 1.0
"""How far in m the point is likely to be about which a limb turns."""

_LENGTH_NOISE = 0.05
"""Noise of gravity's length in m/s^2 beside which that expectation counts."""

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

_REJECTED, _REJECTED_MOVING = 0.05, 0.1
"""Share of samples that may disagree with all others; the second where the limb moves, as the error of a
differentiated gyroscope has long tails."""

_STRAY = 0.002
"""Share of samples that may be left out without a warning."""

_MOST_BENDS, _SOME_BENDS = 0.7, 0.2
"""Share of the residual from which on bending explains it; the second after the fit, beside hysteresis."""

_WORST = 2.0
"""Rows that leave more than this multiple of the median are named."""

_ROUNDS = 4
"""Steps of Gauss and Newton by which gravity's length is fitted."""

_LEAST_SAMPLES = 4
"""Whole samples that a set must have."""

_CHANCE = 1e-4
"""Probability at which noise alone may seem to bend a limb."""

_SMOOTHED, _FEWEST = 0.3, 5
"""Time in s, and rows at least, over which the turning of gravity is taken."""

BENT_CURE = (
    "Hold the joints beyond the sensor fast, or lighten what is added; if it is the sensor, 'nonlinear' fits "
    "a polynomial."
)
"""What helps where readings go with gravity's squares."""

TOO_FAST = "the limb moved too fast to be taken as at rest"
"""What is said of that."""

_FEW = 30
"""Rows below which bending does not show."""

_BENDING, _BENDING_WITH_LOOPS = 0.1, 0.35
"""Share of the tolerated residual that may go with gravity's squares; the second while hysteresis may be part
of it."""


class Contradiction(CalibrationRefused):
    """Raised where sets contradict each other or themselves, for which there may be many causes."""


def check_sets(sets: Sequence[InSituSet], options: InSituOptions, leaning: bool) -> tuple[str, ...]:
    """Return warnings, or raise CalibrationRefused for dead or saturated channels and for too little gravity.

    With ``leaning`` a factory matrix stands in for what gravity does not show.
    """
    factors, samples, sizes, rows = [], 0, [], []
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
        _check_added(data)
        gravity = data.gravity[whole]
        sizes.append(float(np.median(np.linalg.norm(gravity, axis=1))))
        rows.append(np.flatnonzero(whole)[:: max(len(gravity) // _SHOWN, 1)])
        factors.append(np.linalg.qr(gravity - gravity.mean(axis=0), mode="r"))
        samples += len(gravity)
    warnings = _check_accelerometer(sets, rows)
    spread = gravity_spread(np.concatenate(factors), float(np.mean(sizes) * np.sqrt(samples)))
    if spread[2] >= _TILT:
        return warnings
    seen = "along one line" if spread[1] < _TILT else "in one plane"
    reason = (
        f"Gravity was seen to turn {seen} only: its direction spreads by {spread[0]:.3f}, "
        f"{spread[1]:.3f} and {spread[2]:.4f} along its three axes, and {_TILT} is needed along each."
    )
    if leaning:
        return (*warnings, f"{reason} What it does not show leans on the factory matrix.")
    CalibrationRefused(
        reason, "Tilt the limb about a second axis as well, such as front-back and sideways."
    ).unless_accepted()
    return warnings


def _check_added(data: InSituSet) -> None:
    """Raise CalibrationRefused if nobody hangs such a mass, or at such a place, on a limb."""
    if data.added_mass > _HEAVIEST:
        CalibrationRefused(
            f"'{data.name}': {data.added_mass:g} kg were added, and no limb bears that: the mass is likely "
            "in grams.",
            "Give masses in kg.",
        ).unless_accepted()
    reach = float(np.linalg.norm(data.added_com)) * (data.added_mass > 0.0)
    if reach > _FARTHEST:
        CalibrationRefused(
            f"'{data.name}': the added mass hangs {reach:.3g} m away from the sensor: its place is likely in "
            "mm or cm.",
            "Give places in m, in the sensor's frame.",
        ).unless_accepted()


def _check_accelerometer(sets: Sequence[InSituSet], rows: Sequence[NDArray[np.int_]]) -> tuple[str, ...]:
    """Return a warning if gravity's length is off; raise CalibrationRefused if it cannot be gravity.

    A limb that turns about a fixed point p feels g - (dw x p + w x (w x p)): its own acceleration is taken
    off, whatever p is. What is left of the length is a bias's or a scale's.
    """
    for data, there in zip(sets, rows, strict=True):
        _check_unit(data, float(np.median(np.linalg.norm(data.gravity[there], axis=1))))
    felt = np.concatenate([data.gravity[there] for data, there in zip(sets, rows, strict=True)])
    circling = np.concatenate([felt_by_turning(data, there) for data, there in zip(sets, rows, strict=True)])
    plain, _, _ = _length_fit(felt, circling, bias=False)
    last = np.cumsum([len(there) for there in rows])
    for data, of_set in zip(sets, np.split(plain, last[:-1]), strict=True):
        _check_length(data, of_set + GRAVITY)
    off = _rms(plain)
    if max(abs(float(np.median(plain))), float(np.std(plain))) <= _LENGTH_OFF * GRAVITY:
        return ()
    moves = any(data.moves for data in sets)
    size = plain + GRAVITY
    scale = float(np.mean(size) / GRAVITY)
    by_scale = float(np.std(size)) / scale
    of_bias, _, bias = _length_fit(felt, circling, bias=True)
    shown = ", ".join(f"{value:.2f}" for value in bias)
    cure = "calibrate the accelerometer first, or forces and offsets will be off by as much."
    causes = [
        (by_scale, f"the accelerometer's scale is off by {100.0 * (scale - 1.0):+.1f} %; {cure}"),
        (_rms(of_bias), f"the accelerometer has a bias of about ({shown}) m/s^2; {cure}"),
    ]
    if not moves and all(data.time is not None for data in sets):
        turns = [felt_by_turning(turning(data), there) for data, there in zip(sets, rows, strict=True)]
        causes.append((_rms(_length_fit(felt, np.concatenate(turns), bias=False)[0]), f"{TOO_FAST}."))
    left, words = min(causes)
    what = f"Gravity is {np.median(size):.2f} m/s^2 long and spreads by {np.std(size):.2f}"
    if left < _EXPLAINS * off:
        return (f"{what}: {words}",)
    # A base that moves as well is no fault of the accelerometer's.
    return () if moves else (f"{what}: {TOO_FAST}, or {cure}",)


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def turning(data: InSituSet) -> InSituSet:
    """Return a set that was taken to be at rest with the motion that gravity shows: none about its direction.

    Where gaps or few samples hide it, the set itself is returned.
    """
    if data.time is None or len(data.time) < 2:
        return data
    dt = float(np.median(np.diff(data.time)))
    window = max(_FEWEST, 2 * round(0.5 * _SMOOTHED / dt) + 1)
    if len(data.time) <= 2 * window or not np.isfinite(data.gravity).all():
        return data
    g = data.gravity
    change = savitzky_golay(g, window=window, derivative=1, dt=dt)
    spin = -np.cross(g, change) / np.maximum(np.sum(g**2, axis=1, keepdims=True), np.finfo(float).tiny)
    rate = savitzky_golay(spin, window=window, derivative=1, dt=dt)
    return replace(data, angular_velocity=spin, angular_acceleration=rate)


def _length_fit(
    felt: NDArray[np.float64], circling: NDArray[np.float64], bias: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return by how much gravity is too long, shape (n,), the arm of the turning and the bias, (3,) each."""
    arm, offset = np.zeros(3), np.zeros(3)
    prior = np.eye(6 if bias else 3) * _LENGTH_NOISE / _PIVOT
    for _ in range(_ROUNDS):
        g = felt + circling @ arm - offset
        size = np.linalg.norm(g, axis=1)
        towards = g / np.maximum(size, np.finfo(float).tiny)[:, None]
        columns = np.einsum("ni,nij->nj", towards, circling)
        known = arm
        if bias:
            columns, known = np.concatenate([columns, -towards], axis=1), np.concatenate([arm, offset])
        step = np.linalg.lstsq(
            np.concatenate([columns, prior]), np.concatenate([GRAVITY - size, -prior @ known]), rcond=None
        )[0]
        arm = arm + step[:3]
        offset = offset + step[3:] if bias else offset
    size = np.linalg.norm(felt + circling @ arm - offset, axis=1)
    return np.asarray(size - GRAVITY), arm, offset


def felt_by_turning(data: InSituSet, rows: NDArray[np.int_]) -> NDArray[np.float64]:
    """Return [dw]x + [w]x [w]x, shape (n, 3, 3): the acceleration at an arm from what a limb turns about."""
    if data.angular_velocity is None or data.angular_acceleration is None:
        return np.zeros((len(rows), 3, 3))
    spin, rate = data.angular_velocity[rows], data.angular_acceleration[rows]
    eye = np.eye(3)
    turn = np.stack([np.cross(rate, axis) + np.cross(spin, np.cross(spin, axis)) for axis in eye], axis=2)
    return np.asarray(turn)


def _check_unit(data: InSituSet, length: float) -> None:
    """Raise CalibrationRefused if gravity's length is that of another unit."""
    looks = [text for value, text in _UNITS.items() if abs(length / value - 1.0) < _SAME_UNIT]
    if looks:
        CalibrationRefused(
            f"{_length_reason(data, length)} Give it in m/s^2; it looks like {looks[0]}.",
            "Convert it, and calibrate the accelerometer first.",
        ).unless_accepted()


def _length_reason(data: InSituSet, length: float) -> str:
    return f"'{data.name}': gravity is {length:.4g} m/s^2 long, where 9.81 is expected."


def _check_length(data: InSituSet, sizes: NDArray[np.float64]) -> None:
    """Raise CalibrationRefused if a set's gravity is of a length that gravity does not have."""
    length, spread = float(np.median(sizes)), float(np.std(sizes))
    if _GRAVITY[0] < length < _GRAVITY[1]:
        return
    if spread > _SPEEDING * length and not data.moves:
        CalibrationRefused(
            f"{_length_reason(data, length)} It spreads by {spread:.2g}: {TOO_FAST}.",
            "Give the gyroscope's readings as well, or move slowly.",
        ).unless_accepted()
        return
    CalibrationRefused(
        f"{_length_reason(data, length)} Give it in m/s^2; or the accelerometer's scale is off by "
        f"{length / GRAVITY - 1.0:+.0%}.",
        "Calibrate the accelerometer first.",
    ).unless_accepted()


def _check_channels(data: InSituSet, options: InSituOptions) -> None:
    """Raise CalibrationRefused if a channel is dead or saturated."""
    for channel, of_channel in enumerate(data.raw.T):
        counts = of_channel[np.isfinite(of_channel)]
        if len(counts) and np.ptp(counts) == 0.0:
            CalibrationRefused(
                f"'{data.name}': channel {channel} reads {counts[0]:g} throughout.",
                "Check its wiring and that the sensor was switched on.",
            ).unless_accepted()
        low, high = options.code_range or (-np.inf, np.inf)
        stuck = float(np.mean((counts <= low) | (counts >= high))) if len(counts) else 0.0
        if stuck > _SATURATED:
            CalibrationRefused(
                f"'{data.name}': channel {channel} is saturated in {stuck:.1%} of the samples "
                f"(at or beyond {low:g} or {high:g}).",
                "Take the load off or set the hardware's offset again: a clipped reading shows nothing.",
            ).unless_accepted()
        _check_ends(data, channel, of_channel)


def _check_ends(data: InSituSet, channel: int, counts: NDArray[np.float64]) -> None:
    """Raise CalibrationRefused if a channel stays at its highest or lowest reading while its load goes on."""
    for end, sign in ((np.nanmax(counts), 1.0), (np.nanmin(counts), -1.0)):
        held = counts == end
        if np.sum(held) < _TIES:
            continue
        values, times = np.unique(sign * counts[np.isfinite(counts)], return_counts=True)
        if len(values) <= _NEXT or times[-1] <= _TIES_RATIO * np.mean(times[-1 - _NEXT : -1]):
            continue
        beyond, deviation = _beyond(data, counts, held, sign)
        if beyond > deviation + values[-1] - values[-2]:
            CalibrationRefused(
                f"'{data.name}': channel {channel} is clipped: {times[-1]} samples read exactly {end:g}"
                f"{_when(data, held)}, none reads beyond, and gravity went on turning.",
                "Take the load off, set the hardware's offset again, or lower the gain: a clipped reading "
                "shows nothing.",
            ).unless_accepted()


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


def check_within(
    sets: Sequence[InSituSet], parts: Sequence[CompressedSet], options: InSituOptions
) -> tuple[str, ...]:
    """Return which samples were left out, or raise CalibrationRefused if no rigid limb explains a set."""
    warnings = []
    for data, part in zip(sets, parts, strict=True):
        share = float(np.mean(part.rejected))
        if share > (_REJECTED_MOVING if data.moves else _REJECTED):
            Contradiction(
                f"'{data.name}': {share:.0%} of the samples disagree with all others"
                f"{_when(data, part.rejected)}.",
                "Something touched the limb or it moved too fast: leave that time out, or record the set "
                "again with the foot in the air.",
            ).unless_accepted()
        if share > _STRAY:
            warnings.append(
                f"'{data.name}': {np.sum(part.rejected)} samples that disagree with all others were left out"
                f"{_when(data, part.rejected)}: something may have touched the limb."
            )
        left = _residual_share(data, part)
        if left > options.residual_tolerance:
            bending = _bending(data, part)
            bends = bending > _MOST_BENDS * left
            (_bends(data, bending) if bends else _unexplained(data, part, left)).unless_accepted()
    return tuple(warnings)


def check_bending(
    sets: Sequence[InSituSet], parts: Sequence[CompressedSet], options: InSituOptions, loops: bool
) -> tuple[float, tuple[str, ...]]:
    """Return by how much a limb bends that may, and what to say of it; or raise CalibrationRefused.

    With ``loops`` hysteresis, which looks like it for a while, may still be in the readings.
    """
    limit = (_BENDING_WITH_LOOPS if loops else _BENDING) * options.residual_tolerance
    most, warnings = 0.0, []
    for data, part in zip(sets, parts, strict=True):
        bending = _bending(data, part)
        if bending <= limit or bending <= _SOME_BENDS * _residual_share(data, part):
            continue
        if bending > (options.bending_tolerance or 0.0):
            _bends(data, bending).unless_accepted()
        else:
            most = max(most, bending)
            warnings.append(f"{_bends(data, bending).reason} Matrix and offset count as unsure by as much.")
    return most, tuple(warnings)


def _bends(data: InSituSet, share: float) -> Contradiction:
    return Contradiction(
        f"'{data.name}': {share:.1%} of the readings' spread goes with gravity's squares: the limb bends as "
        "it turns, or the sensor is not linear.",
        BENT_CURE,
    )


def _residual_share(data: InSituSet, part: CompressedSet) -> float:
    """Return the share of the spread that gravity does not explain, less white noise where time shows it."""
    left = float(np.sum(part.residual**2))
    if data.time is not None and part.rows > 1:
        left -= float(np.sum(np.diff(part.residual, axis=0) ** 2)) / 2.0
    return _share_of_spread(left, part)


def _share_of_spread(square: float, part: CompressedSet) -> float:
    return float(np.sqrt(max(square, 0.0) / part.spread)) if part.spread > 0.0 else 0.0


def _bending(data: InSituSet, part: CompressedSet) -> float:
    """Return the share of the spread that goes with gravity's squares, beyond what noise would.

    The squares are weighted like the rows, so that no drift is taken for them.
    """
    if part.rows < _FEW:
        return 0.0
    g = data.gravity[part.index.astype(int)] / GRAVITY
    # The sixth square follows from the length of gravity.
    squares = np.stack([g[:, i] * g[:, j] for i, j in ((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))], axis=1)
    columns = part.colour.weigh(np.column_stack([np.ones(len(g)), g, squares]), part.spacing)
    basis = np.linalg.qr(np.column_stack([part.score[:, np.any(part.score, axis=0)], columns]))[0]
    basis = basis[:, -squares.shape[1] :]
    explained = float(np.sum((basis.T @ part.residual) ** 2))
    left = float(np.sum(part.residual**2)) - explained
    terms, channels = squares.shape[1], part.residual.shape[1]
    by_chance = float(chdtri(terms * channels, _CHANCE)) / channels
    chance = left * by_chance / max(part.rows - basis.shape[1], 1) * part.level(basis)
    return _share_of_spread(explained - chance, part)


def _unexplained(data: InSituSet, part: CompressedSet, share: float) -> Contradiction:
    size = np.linalg.norm(part.residual / (np.std(part.residual, axis=0) + np.finfo(float).tiny), axis=1)
    worst = np.zeros_like(part.used)
    worst[part.index.astype(int)[size > _WORST * np.median(size)]] = True
    return Contradiction(
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
