"""What an in-situ calibration refuses, and why; private."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from surefoot.calibration.in_situ._compress import CompressedSet
from surefoot.calibration.in_situ._covariance import weighted_inverse
from surefoot.calibration.in_situ._model import STATIC
from surefoot.calibration.in_situ._rank import data_rank
from surefoot.calibration.in_situ._solve import Problem, Solution, solve, transforms
from surefoot.calibration.in_situ._start import hanging
from surefoot.calibration.in_situ.dataset import InSituSet
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.results import CalibrationRefused

__all__ = [
    "check_bending",
    "check_factory",
    "check_masses",
    "check_rotation",
    "check_scale",
    "check_sets",
    "check_within",
]

Matrix = NDArray[np.float64]

_GRAVITY = (8.8, 10.8)
"""Between these the length of gravity must lie in m/s^2, with the bias that an accelerometer may have."""

_TILT = 0.02
"""Gravity's direction must spread by this share of its length in all three directions."""

_SATURATED = 0.002
"""Share of samples at an end of the converter that is taken for saturation."""

_REJECTED = 0.05
"""Share of samples that may disagree with all others ..."""

_REJECTED_MOVING = 0.1
"""... and where the limb moves, as the error of a differentiated gyroscope has long tails."""

_STRAINED = 3.0
"""Sets that differ by less than this multiple of what noise does agree with each other."""

_CULPRIT = 0.2
"""A set is to blame if the others fit together at less than this share of the cost of all ..."""

_SLIGHT = 0.15
"""Share of the tolerance up to which no set is looked at by itself."""

_WEIGHED = 0.3
"""... and see it off by more than this share of the tolerance."""

_NO_MASS = 0.02
"""A mass in kg so small that its place means nothing."""

_REACH = 0.1
"""Lever in m by which moments of masses that all hang at one place are judged."""

_CORRUPT = 0.3
"""A row of the factory matrix is looked at if its share of unexplained wrench is above this ..."""

_CORRUPT_RATIO = 3.0
"""... and above this multiple of the other rows'."""

_ALONE = 0.95
"""Share of a row's misfit that one entry alone must explain to be to blame."""

_MISPRINT = 0.7
"""... and share of the row's largest entry by which it must change: sensors age by less."""

_CHANCE = 1e-4
"""Probability at which noise alone may seem to bend a limb."""

_ONE_TURN = float(np.cos(np.radians(5.0)))
"""Rotations closer than this are one."""

_BENDING_WITH_LOOPS = 0.5
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
    scatter = np.zeros((3, 3))
    samples, lengths = 0, []
    for data in sets:
        whole = np.isfinite(data.raw).all(axis=1) & np.isfinite(data.gravity).all(axis=1)
        _check_channels(data, options)
        if np.sum(whole) < 4:
            raise CalibrationRefused(
                f"'{data.name}': {np.sum(whole)} of {whole.size} samples are whole, and four are the least.",
                "Check which channels hold no number, and record for longer.",
            )
        gravity = data.gravity[whole]
        lengths.append(float(np.median(np.linalg.norm(gravity, axis=1))))
        if not data.moves and not _GRAVITY[0] < lengths[-1] < _GRAVITY[1]:
            raise CalibrationRefused(
                f"'{data.name}': gravity is {lengths[-1]:.3g} m/s^2 long, where 9.81 is expected.",
                "Give it in m/s^2 (1 g = 9.80665 m/s^2), and calibrate the accelerometer first.",
            )
        centred = gravity - gravity.mean(axis=0)
        scatter += centred.T @ centred
        samples += len(gravity)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(scatter / samples)[::-1], 0.0)) / np.mean(lengths)
    if spread[2] >= _TILT:
        return ()
    seen = "along one line" if spread[1] < _TILT else "in one plane"
    reason = (
        f"Gravity was seen to turn {seen} only: its direction spreads by {spread[0]:.3f}, "
        f"{spread[1]:.3f} and {spread[2]:.4f} along its three axes, and {_TILT} is needed along each."
    )
    if leaning:
        return (f"{reason} What it does not show leans on the factory matrix.",)
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
        misfit, bending = _misfit(data, part), _bending(data, part)
        if bending > _BENDING_WITH_LOOPS * options.misfit_tolerance and bending > 0.5 * misfit:
            raise _bends(data, bending)
        if misfit > options.misfit_tolerance:
            raise _unexplained(data, part, misfit)
    return tuple(warnings)


def check_bending(sets: Sequence[InSituSet], parts: Sequence[CompressedSet], options: InSituOptions) -> None:
    """Refuse limbs that bend a little, once what looks like it for a while, hysteresis, was taken off."""
    for data, part in zip(sets, parts, strict=True):
        bending = _bending(data, part)
        if bending > _BENDING * options.misfit_tolerance and bending > 0.2 * _misfit(data, part):
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
    g = data.gravity[part.index.astype(int)] / 9.81
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


def check_masses(problem: Problem, solution: Solution, noise: Matrix, options: InSituOptions) -> None:
    """Refuse added masses that the readings contradict; name the set without which the others agree."""
    freedom = solution.residual.size - solution.jacobian.shape[1]
    if problem.moving or freedom <= 0 or np.sum(solution.residual**2) < _STRAINED * freedom:
        return
    seen = _seen_masses(problem, solution, noise)
    off = _disagreement(problem, seen)
    if np.max(off) <= _SLIGHT * options.mass_tolerance:
        return
    names = [part.name for part in problem.sets]
    cure = "Weigh what was added and measure where it hung, or leave the set out."
    blamed = {}
    for j in range(len(names)):
        others = _without(problem, solution, j)
        if others is not None and others.cost < _CULPRIT * solution.cost:
            by_others = _seen_masses(problem, others, noise)
            blamed[j] = _disagreement(problem, by_others)[j], by_others[j]
    if blamed:
        # Of several sets without which the others agree, the one that would need the smallest change.
        j = min(blamed, key=lambda j: blamed[j][0])
        amount, follows = blamed[j]
        if amount > _WEIGHED * options.mass_tolerance:
            raise CalibrationRefused(
                f"The added mass of '{names[j]}' contradicts the other sets: {_place(problem.added[j])} was "
                f"given, and {_place(follows)} follows from the others.",
                cure,
            )
    if np.max(off) > options.mass_tolerance:
        j = int(np.argmax(off))
        raise CalibrationRefused(
            f"The added masses contradict each other, most of all that of '{names[j]}': "
            f"{_place(problem.added[j])} was given, and {_place(seen[j])} follows from all sets together.",
            cure,
        )


def _seen_masses(problem: Problem, solution: Solution, noise: Matrix) -> Matrix:
    """What was added to each set by the readings: (m, m c) in kg and kg m, shape (J, 4)."""
    matrix = weighted_inverse(solution.response[:, :6], noise)
    beside = (solution.response @ transforms(problem, solution.limb, solution.rotation))[..., 3:]
    total = [
        hanging(matrix, part, solution.rotation, rest)
        for part, rest in zip(problem.sets, beside, strict=True)
    ]
    return np.asarray(np.array(total) - solution.limb[:STATIC])


def _disagreement(problem: Problem, seen: Matrix) -> NDArray[np.float64]:
    """How far each set's mass and first moment are off, as shares of the largest mass and its reach, (J,)."""
    added = problem.added[:, :STATIC]
    off = np.abs(seen - added)
    mass = np.max(added[:, 0])
    moments = added[:, 1:] - np.mean(added[added[:, 0] > 0.0, 1:], axis=0) * (added[:, :1] > 0.0)
    reach = max(float(np.max(np.linalg.norm(moments, axis=1))), _REACH * mass)
    return np.asarray(np.maximum(off[:, 0] / mass, np.max(off[:, 1:], axis=1) / reach))


def _place(parameters: NDArray[np.float64]) -> str:
    mass = parameters[0]
    if abs(mass) < _NO_MASS:
        return f"{mass:.3f} kg"
    x, y, z = parameters[1:STATIC] / mass
    return f"{mass:.3f} kg at ({x:.3f}, {y:.3f}, {z:.3f}) m"


def _without(problem: Problem, solution: Solution, left_out: int) -> Solution | None:
    """Fit the other sets, if they determine all."""
    sets = tuple(part for i, part in enumerate(problem.sets) if i != left_out)
    others = replace(problem, sets=sets, added=np.delete(problem.added, left_out, axis=0))
    if not sets or (problem.prior_response is None and data_rank(others, solution.limb).missing):
        return None
    return solve(others, [solution.outer])


def check_rotation(found: Sequence[Solution]) -> None:
    """Refuse an accelerometer whose turn is not told, as by masses that all hang in one plane."""
    best = found[0].rotation
    for other in found[1:]:
        cosine = (np.trace(best.T @ other.rotation) - 1.0) / 2.0
        if cosine < _ONE_TURN:
            raise CalibrationRefused(
                "Two rotations of the accelerometer, "
                f"{np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))):.0f} degrees apart, fit the readings "
                "equally well: added masses in one plane do not tell a sensor from its mirror image.",
                "Hang a mass off the plane of the others, or give a factory matrix.",
            )


def check_scale(fit: InSituFit, options: InSituOptions) -> None:
    """Refuse a fit that does not know how strong anything is."""
    mass, deviation = fit.limb.mass, fit.limb_mass_std
    if not (mass > 0.0 and deviation <= options.scale_tolerance * mass):
        raise CalibrationRefused(
            f"The limb's mass comes out as {mass:.3g} kg with a standard deviation of {deviation:.2g} kg, so "
            "the scale of all forces is as unsure.",
            "Add larger masses or at places further apart, record for longer, or say what the limb weighs.",
        )


def check_factory(factory: Matrix, problem: Problem, solution: Solution) -> None:
    """Refuse a factory matrix in which one entry alone contradicts the readings."""
    T = transforms(problem, solution.limb, solution.rotation)[:, :6]
    measured = np.concatenate([part.response[:, : T.shape[2]] for part in problem.sets], axis=1)
    expected = np.concatenate(list(T), axis=1)
    wrong = expected - factory @ measured
    size = np.linalg.norm(wrong, axis=1) / np.linalg.norm(expected, axis=1)
    row = int(np.argmax(size))
    if size[row] < _CORRUPT or size[row] < _CORRUPT_RATIO * np.median(np.delete(size, row)):
        return
    share = (measured @ wrong[row]) ** 2 / (np.sum(measured**2, axis=1) * np.sum(wrong[row] ** 2))
    column = int(np.argmax(share))
    step = float(measured[column] @ wrong[row] / np.sum(measured[column] ** 2))
    if share[column] < _ALONE or abs(step) < _MISPRINT * np.max(np.abs(factory[row])):
        return
    raise CalibrationRefused(
        f"Entry [{row}, {column}] of the factory matrix, {factory[row, column]:.4g}, contradicts the "
        f"readings: with {factory[row, column] + step:.4g} in its place row {row} leaves "
        f"{1.0 - share[column]:.1%} of what it leaves now, and the other rows fit as they are.",
        "Compare the matrix with the maker's sheet, its signs and exponents first.",
    )
