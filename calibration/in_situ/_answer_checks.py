"""Answers that are none: unseen axes, turns that are not told, priors that readings contradict; private."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from surefoot.calibration.in_situ._solve import Problem, Solution, transforms
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.calibration.in_situ.options import InSituOptions, KnownLimb
from surefoot.calibration.layout import FORCE_TORQUE_NAMES
from surefoot.calibration.results import CalibrationRefused

__all__ = [
    "check_axes",
    "check_factory",
    "check_rotation",
    "check_scale",
    "doubts_of_limb",
    "with_doubt_of_scale",
]

Matrix = NDArray[np.float64]

_CORRUPT = 0.3
"""A row of the factory matrix is looked at if its share of unexplained wrench is above this ..."""

_CORRUPT_RATIO = 3.0
"""... and above this multiple of the other rows'."""

_ALONE = 0.95
"""Share of a row's misfit that one entry alone must explain to be to blame."""

_MISPRINT = 0.7
"""... and share of the row's largest entry by which it must change: sensors age by less."""

_ONE_TURN = float(np.cos(np.radians(5.0)))
"""Rotations closer than this are one."""

_GAIN = (0.5, 2.0)
"""Between these a factory matrix must lie by the weight that it shows: sensors age by less."""

_FACTORY_STD = 0.1
"""Deviation of a factory matrix's scale, as a share."""

_SIGMAS = 4.0
"""Deviations between what the readings say of the limb and what was said of it that are worth a warning."""


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


def check_axes(fit: InSituFit, problem: Problem, solution: Solution, options: InSituOptions) -> None:
    """Refuse a matrix of which some axis was never seen, however well the limb's mass is known."""
    T = transforms(problem, solution.limb, solution.rotation)[:, :6]
    load = np.zeros(6)
    for part, t in zip(problem.sets, T, strict=True):
        mean = solve_triangular(part.bb, part.bu)[0] @ t.T
        load += np.sum((part.uu @ t.T) ** 2, axis=0) + part.samples * mean**2
    load = np.sqrt(load)
    channels = fit.matrix.shape[1]
    for axis, name in enumerate(FORCE_TORQUE_NAMES):
        row = slice(axis * channels, (axis + 1) * channels)
        spread = fit.response.T @ fit.covariance[row, row] @ fit.response
        doubt = float(np.sqrt(np.sum(np.diag(spread) * load**2))) / max(float(load[axis]), 1e-300)
        if not doubt < options.axis_tolerance:
            raise CalibrationRefused(
                f"The axis {name} is known to {doubt:.0%} of its load only.",
                f"Hang masses where they load {name} differently, check that all {channels} channels are "
                "connected, each once, or give a factory matrix.",
            )


def check_factory(factory: Matrix, problem: Problem, solution: Solution) -> None:
    """Refuse a factory matrix of which the sign, the unit or one entry alone contradicts the readings."""
    T = transforms(problem, solution.limb, solution.rotation)[:, :6]
    measured = np.concatenate([part.response[:, : T.shape[2]] for part in problem.sets], axis=1)
    expected = np.concatenate(list(T), axis=1)
    shown = factory @ measured
    wrong = expected - shown
    size = np.linalg.norm(wrong, axis=1) / np.linalg.norm(expected, axis=1)
    row = int(np.argmax(size))
    if size[row] >= max(_CORRUPT, _CORRUPT_RATIO * float(np.median(np.delete(size, row)))):
        _check_entry(factory, measured, wrong[row], row)
    gain = float(np.sum(shown[:3] * expected[:3]) / np.sum(expected[:3] ** 2))
    if not _GAIN[0] < gain < _GAIN[1]:
        raise CalibrationRefused(
            f"By the factory matrix the readings show {gain:.3g} times the forces that hang there.",
            "Check the sign of gravity (down; an accelerometer reads up), the units of the matrix (N and N m "
            "per count) and of the masses (kg).",
        )


def _check_entry(factory: Matrix, measured: Matrix, wrong: NDArray[np.float64], row: int) -> None:
    """Refuse a row in which one entry alone explains what the row leaves."""
    share = (measured @ wrong) ** 2 / (np.sum(measured**2, axis=1) * np.sum(wrong**2))
    column = int(np.argmax(share))
    step = float(measured[column] @ wrong / np.sum(measured[column] ** 2))
    if share[column] < _ALONE or abs(step) < _MISPRINT * np.max(np.abs(factory[row])):
        return
    raise CalibrationRefused(
        f"Entry [{row}, {column}] of the factory matrix, {factory[row, column]:.4g}, contradicts the "
        f"readings: with {factory[row, column] + step:.4g} in its place row {row} leaves "
        f"{1.0 - share[column]:.1%} of what it leaves now, and the other rows fit as they are.",
        "Compare the matrix with the maker's sheet, its signs and exponents first.",
    )


def doubts_of_limb(known: KnownLimb, fit: InSituFit, alone: tuple[float, float] | None) -> tuple[str, ...]:
    """Say so where the readings alone give the limb another weight.

    Args:
        known: What was said of the limb.
        fit: What came out.
        alone: The limb's mass and its deviation without what was said, in kg; None if readings do not tell.
    """
    mass, deviation = (fit.limb.mass, 0.0) if alone is None else alone
    off = abs(mass - known.mass) / float(np.hypot(deviation, known.mass_std))
    if off < _SIGMAS:
        return ()
    return (
        f"The readings give the limb {mass:.3f} kg, and {known.mass:.3f} kg were said, {off:.0f} deviations "
        "apart: the added masses, their places or the limb's weight are not as stated.",
    )


def with_doubt_of_scale(fit: InSituFit) -> InSituFit:
    """Say of a fit whose scale is the factory's that factories are off: real sensors were by 11 and 19 %."""
    covariance, channels = fit.covariance.copy(), fit.matrix.shape[1]
    scale = _FACTORY_STD * fit.matrix.ravel()
    covariance[: scale.size, : scale.size] += np.outer(scale, scale)
    weight = _FACTORY_STD * np.concatenate([[fit.limb.mass], fit.limb.mass_com])
    covariance[7 * channels :, 7 * channels :] += np.outer(weight, weight)
    return replace(
        fit,
        covariance=covariance,
        warnings=(
            *fit.warnings,
            "The scale of all forces is the factory matrix's; weigh the limb to know it.",
        ),
    )
