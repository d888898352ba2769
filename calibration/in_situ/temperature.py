"""The sensor's temperature: it acts on the readings and, times the load of each axis, on the gains."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.data import InSituSet, Matrix
from surefoot.calibration.in_situ.model import AXES
from surefoot.calibration.in_situ.solver.problem import Problem
from surefoot.calibration.in_situ.solver.solve import Solution, beside_loads, criterion, follow
from surefoot.calibration.results import Finding

_GAIN_STD = 0.005  # expected size of the gains in 1/K; that of an axis that no load reaches stays at zero


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
        return tuple(replace(data, temperature=None) for data in sets), None, _warn(words)
    if all(data.time is not None for data in sets):
        left = _measure_rest(sets, lambda data: np.asarray(data.time), common=True)
        if left < limits.NOT_GRAVITY:
            words = (
                f"The temperature went with time: one slope leaves {left:.0%} of its spread, so that its "
                "coefficient may be that of a drift (matrix and limb do not lean on which it is). Let the "
                "sensor warm in one set and cool in another."
            )
    centred = [replace(data, temperature=one - mean) for data, one in zip(sets, given, strict=True)]
    return tuple(centred), mean, _warn(words)


def _warn(words: str) -> list[Finding]:
    return [Finding("temperature", words, refuses=False)] if words else []


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


def add_gains(plain: Solution) -> Solution:
    """Return a fit with gains of the axes by temperature, or the plain one where they are not worth it.

    The plain one has the temperature as a signal, without hysteresis.
    """

    def warm(fit: Solution) -> Problem:
        return beside_loads(plain.problem, _warm_loads(plain.problem, fit), _GAIN_STD)

    fitted = follow(warm, plain, 2)
    if criterion(fitted) >= criterion(plain):
        return plain
    return replace(fitted, problem=replace(fitted.problem, gains=AXES))


def _warm_loads(problem: Problem, fit: Solution) -> list[Matrix]:
    """Return the temperature times the load by a fit at the rows of a problem's sets, (m, 6) each."""
    inputs, found = problem.basis.shape[2], []
    for part, T in zip(problem.sets, fit.loads, strict=True):
        signals = part.source.signals
        kelvin = signals[:, inputs, None]  # the first signal behind those of the loads
        found.append(kelvin * (signals[:, :inputs] @ T[:, :inputs].T))
    return found
