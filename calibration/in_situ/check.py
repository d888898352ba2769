"""Checks of single sets: before the fit, of unusable data; after it, of limbs that are not rigid."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from surefoot.calibration.arrays import orthonormal
from surefoot.calibration.imu.gravity_spread import gravity_spread
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.data import InSituOptions, InSituSet, Task
from surefoot.calibration.in_situ.idle import check_idle
from surefoot.calibration.in_situ.model import DIRECT
from surefoot.calibration.in_situ.solver.compress import CompressedSet
from surefoot.calibration.reference import GRAVITY, look_like_newtons
from surefoot.calibration.results import CalibrationRefused, Finding

_UNITS = {
    1.0: "g (1 g = 9.80665 m/s^2)",
    1e3: "thousandths of g",
    1e2 * GRAVITY: "cm/s^2",
    1e3 * GRAVITY: "mm/s^2",
    GRAVITY**2: "m/s^2 already, and was converted once more",
}
"""Likely units of gravity vectors of these lengths."""


_NEXT = 20  # values next to an end that are counted
TOO_FAST = "the limb moved too fast to be taken as at rest"  # reason in the message


def check_sets(task: Task) -> list[Finding]:
    """Check channels, masses, units and the turning of gravity, and refuse a set without enough samples."""
    sets, options, owner = task.sets, task.options, task.owner
    found, factors, samples, sizes = [*_check_copies(sets), *_check_newtons(sets)], [], 0, []
    for data in sets:
        whole = np.asarray(np.isfinite(data.raw).all(axis=1))
        for one in (data.gravity, data.angular_velocity, data.angular_acceleration, data.temperature):
            if one is not None:
                whole &= np.isfinite(one.reshape(len(whole), -1)).all(axis=1)
        if np.sum(whole) < limits.SAMPLES:
            raise CalibrationRefused(
                f"'{data.name}': {np.sum(whole)} of {whole.size} samples are whole, and four are the least.",
                "Check which columns hold no number, and record for longer.",
            )
        gravity = data.gravity[whole]
        length = np.linalg.norm(gravity, axis=1)
        found += _check_channels(data, options)
        found += _check_added(data)
        found += _check_length(data, float(np.median(length)), float(np.std(length)))
        sizes.append(float(np.median(length)))
        factors.append(np.linalg.qr(gravity - gravity.mean(axis=0), mode="r"))
        samples += len(gravity)
    spread = gravity_spread(np.concatenate(factors), float(np.mean(sizes) * np.sqrt(samples)))
    if spread[1] >= limits.TILT:
        found += check_idle(sets, task.factory)
    if spread[2] >= limits.TILT:
        return found
    seen = "along one line" if spread[1] < limits.TILT else "in one plane"
    reason = (
        f"Gravity was seen to turn {seen} only: its direction spreads by {spread[0]:.3f}, "
        f"{spread[1]:.3f} and {spread[2]:.4f} along its three axes, and {limits.TILT} is needed along each."
    )
    cure = "Tilt the limb about a second axis as well, such as front-back and sideways."
    leaning = bool(owner) and spread[0] >= limits.TILT
    if leaning:
        reason, cure = f"{reason} What it does not show leans on the {owner} matrix.", ""
    return [*found, Finding("gravity's turning", reason, cure, spread[2], limits.TILT, refuses=not leaning)]


def _check_copies(sets: Sequence[InSituSet]) -> Iterator[Finding]:
    """Yield which sets and channels hold the readings of another, and samples that repeat the one before."""
    for one, other in combinations(sets, 2):
        rows = min(len(one.raw), len(other.raw))
        if one is not other and rows and np.array_equal(one.raw[:rows], other.raw[:rows], equal_nan=True):
            reason = f"'{one.name}' and '{other.name}' hold the same readings: one is a copy."
            yield Finding("copied set", reason, "Take the set's own file, or leave it out.")
    alike = [data.raw for data in sets if data.channels == sets[0].channels]
    for a, b in combinations(range(sets[0].channels), 2):
        if all(np.array_equal(raw[:, a], raw[:, b], equal_nan=True) for raw in alike):
            reason = f"Channels {a} and {b} hold the same readings: one is a copy of the other."
            yield Finding("copied channel", reason, "Check the names of the columns and the wiring.")
    for data in sets:
        if (share := measure_repeated(data)) > limits.REPEATED:
            reason = (
                f"'{data.name}': {share:.0%} of the samples repeat the one before in all channels: the "
                "driver is slower than the log, or hangs."
            )
            cure = "Log each sample of the sensor once, at the time at which it was read."
            yield Finding("repeated", reason, cure, share, limits.REPEATED, refuses=False)
    spread = max(_measure_variance(data.raw) for data in sets)
    for data in sets:
        moved, leads = _measure_held(data, spread)
        limit = limits.HELD if leads else limits.STUCK
        if moved > limit:
            reason = (
                f"'{data.name}': gravity repeats the sample before while readings move on, by {moved:.0%} of "
                "their spread: the accelerometer stands still, or is slower than the log."
            )
            cure = "Log the IMU as often as the sensor."
            yield Finding("held gravity", reason, cure, moved, limit)


def measure_repeated(data: InSituSet) -> float:
    """Return the share of samples that repeat the one before in all channels."""
    again = (data.raw[1:] == data.raw[:-1]) & np.isfinite(data.raw[1:])
    return float(np.mean(np.all(again, axis=1))) if len(again) else 0.0


def _measure_variance(raw: NDArray[np.float64]) -> float:
    """Return the variance of whole rows, shape (n, k), summed over channels."""
    whole = raw[np.isfinite(raw).all(axis=1)]
    return float(np.sum(np.var(whole, axis=0))) if len(whole) else 0.0


def _measure_held(data: InSituSet, spread: float) -> tuple[float, bool]:
    """Return how far readings move, beside white noise, while gravity repeats, and whether gravity follows.

    A limb that rests repeats gravity as well, while a zero walks or a filter settles. Where gravity is held,
    readings have come to where it jumps when the hold ends; where it is rounded, half of the way. The move is
    a share of the root of ``spread``, the readings' variance in counts^2.
    """
    whole = np.isfinite(data.raw).all(axis=1) & np.isfinite(data.gravity).all(axis=1)
    raw, gravity = data.raw[whole], data.gravity[whole]
    same = np.all(gravity[1:] == gravity[:-1], axis=1)
    if not same.any():
        return 0.0, False
    run = np.append(0, np.cumsum(~same))
    mean = np.stack([np.bincount(run, one) / np.bincount(run) for one in raw.T], axis=1)
    noise = np.sum(np.diff(raw, axis=0)[same] ** 2) / 2.0
    moved = max(float(np.sum((raw - mean[run]) ** 2) - noise), 0.0) / len(raw)
    # The samples at which a hold ends, and the step of the readings that belongs to gravity's jump there.
    ends = np.flatnonzero(~same & np.append(False, same[:-1]))
    u = np.column_stack([np.ones(len(gravity)), gravity])
    response = np.linalg.lstsq(u, raw, rcond=None)[0]
    step = (u[ends + 1] - u[ends]) @ response
    came = float(np.sum((raw[ends] - u[ends] @ response) * step))
    leads = came > limits.CAME * float(np.sum(step**2)) > 0.0
    return float(np.sqrt(moved / max(spread, np.finfo(float).tiny))), leads


def _check_newtons(sets: Sequence[InSituSet]) -> Iterator[Finding]:
    """Yield a finding if the added masses look like weights in newtons."""
    masses = [data.added_mass for data in sets]
    if look_like_newtons(masses):
        listed = ", ".join(f"{one:g}" for one in masses if one)
        reason = f"The added masses are multiples of {GRAVITY / 10:g} ({listed}), as weights in newtons are."
        yield Finding("newtons", reason, "Give masses in kg.")


def _check_added(data: InSituSet) -> Iterator[Finding]:
    """Yield a finding if nobody hangs such a mass, or at such a place, on a limb."""
    if data.added_mass > limits.HEAVIEST:
        reason = (
            f"'{data.name}': {data.added_mass:g} kg were added, and no limb bears that: the mass is likely "
            "in grams."
        )
        yield Finding("mass", reason, "Give masses in kg.", data.added_mass, limits.HEAVIEST)
    reach = float(np.linalg.norm(data.added_com)) * (data.added_mass > 0.0)
    if reach > limits.FARTHEST:
        reason = (
            f"'{data.name}': the added mass hangs {reach:.3g} m away from the sensor: its place is likely in "
            "mm, cm or inches."
        )
        cure = "Give places in m, in the sensor's frame."
        yield Finding("place", reason, cure, reach, limits.FARTHEST)


def _check_length(data: InSituSet, length: float, spread: float) -> list[Finding]:
    """Return a finding if a set's gravity is of a length that gravity does not have."""
    reason = f"'{data.name}': gravity is {length:.4g} m/s^2 long, where 9.81 is expected."
    looks = [text for value, text in _UNITS.items() if abs(length / value - 1.0) < limits.SAME_UNIT]
    swings = data.moves and spread > limits.SPEEDING * length
    if not looks and (swings or limits.SHORTEST_GRAVITY < length < limits.LONGEST_GRAVITY):
        return []
    cure = "Calibrate the accelerometer first."
    if looks:
        reason += f" Give it in m/s^2; it looks like {looks[0]}."
        cure = "Convert it, and calibrate the accelerometer first."
    elif spread > limits.SPEEDING * length and not data.moves:
        reason += f" It spreads by {spread:.2g}: {TOO_FAST}."
        cure = "Give the gyroscope's readings as well, or move slowly."
    else:
        reason += f" Give it in m/s^2; or the accelerometer's scale is off by {length / GRAVITY - 1.0:+.0%}."
    return [Finding("length of gravity", reason, cure, length)]


def _check_channels(data: InSituSet, options: InSituOptions) -> Iterator[Finding]:
    """Yield which channels are dead, saturated or clipped."""
    lowest, highest = np.nanmin(data.raw, axis=0), np.nanmax(data.raw, axis=0)
    for channel, counts in enumerate(data.raw.T):
        at = f"'{data.name}': channel {channel}"
        if lowest[channel] == highest[channel]:
            reason = f"{at} reads {lowest[channel]:g} throughout."
            cure = "Check its wiring and that the sensor was switched on."
            yield Finding("dead channel", reason, cure)
        if options.code_range is not None:
            low, high = options.code_range
            stuck = float(np.mean(((counts <= low) | (counts >= high))[np.isfinite(counts)]))
            if stuck > limits.SATURATED:
                reason = (
                    f"{at} is saturated in {stuck:.1%} of the samples (at or beyond {low:g} or {high:g})."
                )
                cure = (
                    "Take the load off or set the hardware's offset again: a clipped reading shows nothing."
                )
                yield Finding("saturation", reason, cure, stuck, limits.SATURATED)
        yield from _check_ends(data, f"channel {channel}", counts, data.gravity)
    for axis, values in zip("xyz", data.gravity.T, strict=True):
        yield from _check_ends(data, f"axis {axis} of the accelerometer", values, data.raw)


def _check_ends(
    data: InSituSet, what: str, values: NDArray[np.float64], beside: NDArray[np.float64]
) -> list[Finding]:
    """Return a finding if values stay at their highest or lowest while others, (n, q), go on."""
    for sign in (1.0, -1.0):
        held = sign * values == np.nanmax(sign * values)
        if np.count_nonzero(held) < limits.TIES:
            continue
        columns = np.column_stack([np.ones(len(values)), beside])
        whole = np.isfinite(columns).all(axis=1) & np.isfinite(values)
        others = whole & ~held
        ends, times = np.unique(sign * values[np.isfinite(values)], return_counts=True)
        few = len(ends) <= _NEXT or np.sum(others) <= 2 * columns.shape[1]
        if few or times[-1] <= limits.TIES_RATIO * np.mean(times[-1 - _NEXT : -1]):
            continue
        # How far held samples should read beyond their end, against the deviation of the others.
        left = values - columns @ np.linalg.lstsq(columns[others], values[others], rcond=None)[0]
        beyond = -sign * float(np.mean(left[whole & held]))
        # Where all stays, rounding is off by one and the same amount in all samples.
        apart = len(np.unique(beside[whole & held], axis=0))
        deviations = max(1.0, limits.ROUNDED / np.sqrt(apart))
        if beyond > deviations * np.std(left[others]) + ends[-1] - ends[-2]:
            reason = (
                f"'{data.name}': {what} is clipped: {times[-1]} samples read exactly {sign * ends[-1]:g}"
                f"{_span(data, held)}, none reads beyond, and the limb went on turning."
            )
            cure = (
                "Take the load off, set the hardware's offset again, or take a wider range: what is clipped "
                "shows nothing."
            )
            return [Finding("clipping", reason, cure, float(times[-1]), limits.TIES)]
    return []


def _span(data: InSituSet, marked: NDArray[np.bool_]) -> str:
    """Return where most of the marked samples lie, in words."""
    if not marked.any():
        return ""
    first, last = np.quantile(np.flatnonzero(marked), [0.05, 0.95]).astype(int)
    if data.time is None:
        return f", most of them between samples {first} and {last}"
    return f", most of them between {data.time[first]:.1f} s and {data.time[last]:.1f} s"


_WORST = 2.0  # rows that leave more than this multiple of the median are named

_LEAP = 10.0
"""Multiple of gravity's median step from which on it leaps: sweeps turn evenly, within a factor of two."""

_SINGLY = "They stand alone: single readings leap, by a loose cable, electric noise or lost bits."

_TOUCHED = "something may have touched the limb"

_CHANCE = 1e-4  # probability at which noise alone may seem to bend a limb
_FEW = 30  # rows below which bending does not show

_STEADY = 0.05
"""Share of gravity's spread by which rows may differ from their neighbours in a sweep. Postures at random
differ by 1.5."""

BENT_CURE = "Hold the joints beyond the sensor fast, or lighten what is added."
"""Cure where readings go with gravity's squares."""


def check_within(
    sets: Sequence[InSituSet], parts: Sequence[CompressedSet], hidden: float
) -> tuple[float, list[Finding]]:
    """Return how much a limb bends, which samples were left out, and which sets no rigid limb explains.

    A share of hysteresis that may be hidden in the readings looks like a limb that bends for a while.
    """
    most, found = 0.0, []
    least = limits.BENDING_BESIDE if hidden else limits.BENDING
    if hidden > limits.HIDDEN:
        reason = (
            f"{measure_residual(parts):.1%} of the readings' spread is noise or hysteresis, and only samples "
            f"with times, enough of them, tell which: the answer is as sure as {hidden:.1%} of hysteresis "
            "lets it be."
        )
        found.append(Finding("hidden hysteresis", reason, value=hidden, limit=limits.HIDDEN, refuses=False))
    for data, part in zip(sets, parts, strict=True):
        found += _check_outliers(data, part)
        left, bends = _residual_share(data, part), measure_bending(part)
        # Without an order in time nothing tells white noise from all else: only what is beyond it refuses.
        beyond = left > (limits.RESIDUAL if data.time is not None else limits.NOISY)
        if bends > least and bends > limits.BENDS_PARTLY * left:
            most = max(most, bends)
            beyond &= bends <= limits.BENDS_MOSTLY * left
            if not beyond:
                reason = (
                    f"'{data.name}': {bends:.1%} of the readings' spread goes with gravity's squares: the "
                    "limb bends as it turns, or the sensor is not linear."
                )
                found.append(Finding("bending", reason, BENT_CURE, bends, limits.BENDING, contradicts=True))
        if beyond:
            found.append(_find_residual(data, part, left))
    return most, found


def _check_outliers(data: InSituSet, part: CompressedSet) -> list[Finding]:
    rejected, limit = part.source.rejected, limits.REJECTED_MOVING if data.moves else limits.REJECTED
    if data.time is None:
        limit = limits.REJECTED_POSES
    rejected = rejected & ~_settles(data, rejected)
    share = float(np.mean(rejected))
    if share <= limits.STRAY:
        return []
    beside = np.concatenate([[False], rejected, [False]])
    singly = 2 * np.sum(rejected & ~beside[:-2] & ~beside[2:]) > np.sum(rejected) and data.time is not None
    if share <= limit:
        reason = (
            f"'{data.name}': {np.sum(rejected)} samples that disagree with all others were left out"
            f"{_span(data, rejected)}: {'they stand alone' if singly else _TOUCHED}."
        )
        return [Finding("outliers", reason, value=share, limit=limits.STRAY, refuses=False)]
    reason = f"'{data.name}': {share:.0%} of the samples disagree with all others{_span(data, rejected)}."
    cure = (
        "Something touched the limb or it moved too fast: leave that time out, or record the set again with "
        "the foot in the air."
    )
    if singly:
        reason, cure = (
            f"{reason} {_SINGLY}",
            "Check the cable and its shield, and leave readings out that leap.",
        )
    return [Finding("outliers", reason, cure, share, limit, contradicts=not singly)]


def _settles(data: InSituSet, rejected: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which samples a filter had not settled in: runs that begin as gravity leaps to a posture."""
    step = np.append(0.0, np.linalg.norm(np.diff(data.gravity, axis=0), axis=1))
    leaps = step > max(limits.TILT * GRAVITY, _LEAP * float(np.nanmedian(step)))
    begins = np.flatnonzero(rejected & ~np.append(False, rejected[:-1]) | rejected & leaps)
    run = np.searchsorted(begins, np.arange(len(rejected)), side="right") - 1
    return rejected & leaps[begins[run]] if len(begins) else rejected


def measure_residual(parts: Sequence[CompressedSet]) -> float:
    """Return the largest share of a set's spread that gravity does not explain, noise and all."""
    return max(_share_of_spread(float(np.sum(part.residual**2)), part) for part in parts)


def _residual_share(data: InSituSet, part: CompressedSet) -> float:
    """Return the share of the spread that gravity does not explain, less white noise where time shows it."""
    left = float(np.sum(part.residual**2))
    if data.time is not None and part.rows > 1:
        left -= float(np.sum(np.diff(part.residual, axis=0) ** 2)) / 2.0
    return _share_of_spread(left, part)


def _share_of_spread(square: float, part: CompressedSet) -> float:
    return float(np.sqrt(max(square, 0.0) / part.spread)) if part.spread > 0.0 else 0.0


def bending_signals(u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return gravity's squares beside what is linear in the signals, shape (m, 5), of signals, shape (m, s).

    The sixth square follows from gravity's length. A row's own noise is in its residual as well, and on a
    curved patch of the sphere its squares go with that as if the limb bent. So they are those of the rows
    before and after, whose noise is their own (an instrument); postures stand for themselves.
    """
    beside = np.concatenate([u[1:2], (u[:-2] + u[2:]) / 2.0, u[-2:-1]])
    if np.max(np.var((beside - u)[:, DIRECT], axis=0)) < _STEADY * np.max(np.var(u[:, DIRECT], axis=0)):
        u = beside
    g = u[:, DIRECT] / GRAVITY
    squares = np.stack([g[:, i] * g[:, j] for i, j in ((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))], axis=1)
    basis, _ = orthonormal(np.column_stack([np.ones(len(u)), u]))
    return np.asarray(squares - basis @ (basis.T @ squares))


def measure_bending(part: CompressedSet) -> float:
    """Return the share of the spread that goes with gravity's squares, beyond that of noise.

    The squares are weighted like the rows, so that no drift is taken for them.
    """
    if part.rows < _FEW:
        return 0.0
    basis = np.linalg.qr(part.centre(bending_signals(part.source.signals)))[0]
    explained = float(np.sum((basis.T @ part.residual) ** 2))
    left = float(np.sum(part.residual**2)) - explained
    # Channels of which one is much noisier, or that share their noise, are worth fewer than they are.
    scatter = part.residual.T @ part.residual
    channels = float(np.trace(scatter) ** 2 / max(float(np.sum(scatter**2)), np.finfo(float).tiny))
    by_chance = float(chdtri(basis.shape[1] * channels, _CHANCE)) / channels
    chance = left * by_chance / max(part.rows - basis.shape[1], 1) * part.level(basis)
    return _share_of_spread(explained - chance, part)


def _find_residual(data: InSituSet, part: CompressedSet, share: float) -> Finding:
    size = np.linalg.norm(part.residual / (np.std(part.residual, axis=0) + np.finfo(float).tiny), axis=1)
    worst = np.zeros_like(part.source.used)
    worst[part.source.places.astype(int)[size > _WORST * np.median(size)]] = True
    reason = (
        f"'{data.name}': {share:.1%} of the readings' spread follows gravity in no linear way"
        f"{_span(data, worst)}."
    )
    cure = (
        "Something touched the limb, the motion was too fast or the sensor's hysteresis is large: record the "
        "set again, slowly and with the foot in the air."
    )
    return Finding("residual", reason, cure, share, limits.RESIDUAL, contradicts=True)
