"""Estimate the additional delay of the foot readings, compared with the description of a log.

A converter averages and settles over some samples, and its reading then waits for the next poll. The delay is
30 to 60 ms at 80 samples per second, and up to 0.3 s at 10. It does not count as a mistake in the log.
Instead, it is a parameter of the fit of :mod:`surefoot.experiments.walking.claims`, and the references are
shifted to the sampling times of the readings.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from surefoot.calibration.results import Finding
from surefoot.experiments.logs.format import Log
from surefoot.experiments.walking.claims import WIDTHS, Claims, condense, fit_parts

DELAY = "feet late or early"
LONGEST = 0.5  # limit of the search in s, either way (an HX711 at 10 samples per second settles in 0.4 s)
STEPS = 0.05, 0.025, 0.0125  # steps in s of the search, the first over the whole range
SURE = 10.0  # minimum gain in log evidence to accept a delay, in nats: one false alarm in 20,000 logs
REPORTED = 0.005  # delays in s below this are too small to correct in the description, and not reported


class Lateness(NamedTuple):
    """Additional delay of the readings, compared with the description."""

    seconds: float  # negative if the readings are earlier than described
    std: float  # in s
    gain: float  # gain in log evidence over zero delay, in nats


PUNCTUAL = Lateness(0.0, np.nan, 0.0)


def measure_lateness(claims: Claims, undo: Callable[[Any], Any] = lambda claims: claims) -> Lateness:
    """Return the delay for which the claims fit best after undoing a mistake.

    The result is zero delay if the evidence improves by less than :data:`SURE`.
    """
    found: dict[float, float] = {}

    def try_at(delay: float) -> float:
        delay = round(delay, 6)
        if delay not in found and abs(delay) <= LONGEST:
            fit = fit_parts(condense(undo(shift(claims, delay))), widths=WIDTHS[-1:])
            found[delay] = fit.evidence if fit.rows else -np.inf
        return found.get(delay, -np.inf)

    best = 0.0
    for step in STEPS:
        reach = LONGEST if step == STEPS[0] else step
        best = max((best + np.arange(-reach, reach + step / 2, step)).tolist(), key=try_at)
    before, here, after = (try_at(best + side * STEPS[-1]) for side in (-1.0, 0.0, 1.0))
    bend = 2.0 * here - before - after
    if not np.isfinite(bend) or bend <= 0.0 or here - try_at(0.0) < SURE:
        return PUNCTUAL
    return Lateness(
        best + STEPS[-1] * 0.5 * (after - before) / bend, STEPS[-1] / float(np.sqrt(bend)), here - try_at(0.0)
    )


def shift(claims: Claims, delay: float) -> Claims:
    """Return claims with the readings moved ``delay`` s earlier, to their sampling times."""
    return replace(claims, raw=_interpolate(claims.raw, delay / claims.dt))


def make_punctual(log: Log, delay: float) -> Log:
    """Return a log with its references at the sampling times of the readings, ``delay`` s earlier."""
    if delay == 0.0:
        return log

    def move(beliefs: Any) -> Any:
        parts = (_interpolate(np.asarray(part, dtype=float), -delay / log.dt) for part in beliefs)
        # Between two rows, a contact flag is set only if it is set in both of them.
        moved = [
            part > 1.0 - 1e-9 if np.asarray(old).dtype == bool else part
            for part, old in zip(parts, beliefs, strict=True)
        ]
        return type(beliefs)(*moved)

    momentum = log.momentum and move(log.momentum)
    return replace(log, reference=move(log.reference), momentum=momentum, turned={})


def _interpolate(values: Any, rows: float) -> Any:
    """Interpolate an array linearly at its row numbers plus ``rows``, with NaN beyond its ends."""
    first, share = int(np.floor(rows)), rows - np.floor(rows)
    at = np.arange(len(values)) + first
    low, high = (np.clip(at + k, 0, len(values) - 1) for k in (0, 1))
    known = ((at >= 0) & (at + (share > 0.0) < len(values))).reshape(-1, *[1] * (values.ndim - 1))
    mixed = values[low] if share == 0.0 else (1.0 - share) * values[low] + share * values[high]
    return np.where(known, mixed, np.nan)


def report_lateness(log: Log, late: Lateness) -> list[Finding]:
    """Return a finding about the delay that names the setting to correct, or none if it is negligible."""
    if abs(late.seconds) < REPORTED:
        return []
    side = "older" if late.seconds > 0.0 else "newer"
    reason = (
        f"The readings of the feet are {abs(late.seconds):.3f} ± {late.std:.3f} s {side} than the "
        "description says; the references were moved accordingly."
    )
    return [Finding(DELAY, reason, _key(log, late.seconds), late.gain, SURE, refuses=False)]


def _key(log: Log, seconds: float) -> str:
    """Return advice on the setting of the description that compensates for the delay."""
    motion = log.motion
    if motion is None:
        lag = log.lag - round(seconds / log.dt)
        if lag >= 0:
            return f'Give "lag_samples": {lag} in the description, which has {log.lag}.'
        return f"Subtract {seconds:.3f} s from the times of the feet's readings, and merge the tables again."
    if motion.readings_age_s + seconds >= 0.0:
        age = motion.readings_age_s + seconds
        return f'Give "readings_age_s": {age:.3f} under "motion", which has {motion.readings_age_s:.3f}.'
    delay = motion.delay_s - seconds
    return f'Give "delay_s": {delay:.3f} under "motion", which has {motion.delay_s:.3f}.'
