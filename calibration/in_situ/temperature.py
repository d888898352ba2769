"""Effect of a sensor's temperature on its offsets and on the gains of its axes.

The temperature is a signal that acts on the readings directly, and, times the load of each axis, six more
where they are worth it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.compress import UNUSED, CompressedSet
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.model import AXES
from surefoot.calibration.in_situ.problem import Problem, whitening_of
from surefoot.calibration.in_situ.solve import (
    Solution,
    beside_channels,
    beside_loads,
    criterion,
    follow,
    solve,
)

Matrix = NDArray[np.float64]

_ROUNDS = 2
"""Fits of the gains, as the loads come from the fit itself."""

_GAIN_STD = 0.005
"""Expected size of the gains in 1/K; that of an axis that no load reaches stays at zero."""


def centre_temperatures(
    sets: tuple[InSituSet, ...],
) -> tuple[tuple[InSituSet, ...], float | None, list[Finding]]:
    """Return sets with temperatures less their mean, the mean in their unit, and findings.

    Temperatures that show no effect are left out; the mean is None then.
    """
    given = [data.temperature for data in sets if data.temperature is not None]
    if not given:
        return sets, None, []
    words, mean = "", float(np.nanmean(np.concatenate(given)))
    if len(given) < len(sets):
        missing = ", ".join(f"'{data.name}'" for data in sets if data.temperature is None)
        words = f"{missing} has no temperature, so that of the others was left out."
    elif (within := float(np.sqrt(np.mean([np.nanvar(one) for one in given])))) < limits.WARMING:
        words = (
            f"The temperature varies by {within:.2g} K within sets, too little to show its effect "
            f"({limits.WARMING} K): it was left out."
        )
    elif (left := _measure_rest(sets, lambda data: data.gravity)) < limits.NOT_GRAVITY:
        words = (
            f"The temperature went with gravity: what gravity explains leaves {left:.0%} of its spread. It "
            "was left out; let the sensor warm or cool while the limb turns several times."
        )
    if words:
        left_out = Finding("temperature", words, refuses=False)
        return tuple(replace(data, temperature=None) for data in sets), None, [left_out]
    centred = [replace(data, temperature=one - mean) for data, one in zip(sets, given, strict=True)]
    return tuple(centred), mean, _check_time(sets)


def _check_time(sets: Sequence[InSituSet]) -> list[Finding]:
    """Return a warning if the temperature rose, or fell, with time in all sets alike."""
    if any(data.time is None for data in sets):
        return []
    left = _measure_rest(sets, lambda data: np.asarray(data.time)[:, None], common=True)
    if left >= limits.NOT_GRAVITY:
        return []
    words = (
        f"The temperature went with time: one slope leaves {left:.0%} of its spread, so that its coefficient "
        "may be that of a drift (matrix and limb do not lean on which it is). Let the sensor warm in one set "
        "and cool in another."
    )
    return [Finding("temperature", words, refuses=False)]


def _measure_rest(
    sets: Sequence[InSituSet], columns: Callable[[InSituSet], Matrix], common: bool = False
) -> float:
    """Return the share of the temperature's spread within sets that is not linear in columns.

    ``common`` is for one slope in all sets rather than one in each.
    """
    parts = []
    for data in sets:
        assert data.temperature is not None
        together = np.column_stack([data.temperature, columns(data)])
        together = together[np.isfinite(together).all(axis=1)]
        parts.append(together - together.mean(axis=0))
    left = 0.0
    for part in [np.concatenate(parts)] if common else parts:
        warmth, of = part[:, 0], part[:, 1:]
        left += float(np.sum((warmth - of @ np.linalg.lstsq(of, warmth, rcond=None)[0]) ** 2))
    return float(np.sqrt(left / sum(float(np.sum(part[:, 0] ** 2)) for part in parts)))


def find_drift(parts: Sequence[CompressedSet]) -> Finding | None:
    """Return that an offset drifted as the temperature changed, and the cure; None if nothing shows it.

    A drift that went with the temperature of a set hides in that set's own coefficient: no residual shows it,
    but the coefficients of sets disagree. The temperature is the last signal of the sets.
    """
    root = whitening_of(parts)
    own = np.array([part.response[:, -1] for part in parts])
    gram = np.array([part.gram[-1, -1] for part in parts])
    square = np.array([part.uu[-1, -1] ** 2 for part in parts])
    worth = np.where(gram > UNUSED, square / np.maximum(gram, UNUSED), 0.0)
    freedom = (np.count_nonzero(worth) - 1) * len(root)
    if freedom <= 0:
        return None
    off = (own - worth @ own / np.sum(worth)) @ root.T
    if worth @ np.sum(off**2, axis=1) < limits.COEFFICIENTS**2 * freedom:
        return None
    channel = int(np.argmax(np.ptp(own, axis=0)))
    low, high = np.min(own[:, channel]), np.max(own[:, channel])
    return Finding(
        "drift by temperature",
        "The offset drifted as the temperature changed: single sets show coefficients of channel "
        f"{channel} from {low:.3g} to {high:.3g} counts/K.",
        "Let the sensor warm and cool within each set, or leave the temperature out: a drift is followed "
        "without it.",
        refuses=False,
    )


def add_gains(plain: Solution) -> Solution:
    """Return a fit with gains of the axes by temperature, or the plain one where they are not worth it.

    The plain one has the temperature as a signal, without hysteresis.
    """

    def warm(fit: Solution) -> Problem:
        return beside_loads(plain.problem, _warm_loads(plain.problem, fit), _GAIN_STD)

    fitted = follow(warm, plain, _ROUNDS)
    if criterion(fitted) >= criterion(plain):
        return plain
    return replace(fitted, problem=replace(fitted.problem, gains=AXES))


def check_gauges(fit: Solution) -> list[Finding]:
    """Return a warning where gains go with the temperature otherwise than axis by axis."""
    freer = beside_channels(fit.problem, [load @ fit.A.T for load in _warm_loads(fit.problem, fit)])
    if criterion(solve(freer, [fit.outer])) >= criterion(fit):
        return []
    words = (
        "The gains of single channels follow the temperature, each its own way, where the fit has one an "
        "axis: its matrix is less sure than it says. Let the sensor warm up before it is calibrated."
    )
    return [Finding("temperature", words, refuses=False)]


def _warm_loads(problem: Problem, fit: Solution) -> list[Matrix]:
    """Return the temperature times the load by a fit at the rows of a problem's sets, (m, 6) each."""
    inputs, found = problem.basis.shape[2], []
    for part, T in zip(problem.sets, fit.loads, strict=True):
        signals = part.source.signals
        kelvin = signals[:, inputs, None]  # the first signal behind those of the loads
        found.append(kelvin * (signals[:, :inputs] @ T[:, :inputs].T))
    return found
