"""The standing start from a recording: gates, extension until enough samples came, and refusal.

The weight that is known is the robot's own; the mathematics is that of :mod:`surefoot.calibration.standing`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.calibration.checks import check_value
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import Reference
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats
from surefoot.calibration.standing import QuietStanding

__all__ = ["StandingFit", "standing_start"]


@dataclass(frozen=True, eq=False)
class StandingFit:
    """Starting values from a recording of quiet standing."""

    value: Parameters  # the map (c, d) of the readings
    correction: Parameters  # the same as (a, b) of F = a F0 + b
    covariance: Floats
    """Of (a_1, ..., a_K, b_1, ..., b_K), shape (2 K, 2 K), given that the errors of the robot's mass and
    centre of mass are as small as assumed."""
    result: FitResult  # whether all directions were determined; quiet standing alone never does that
    stats: FitStats  # of the fit; the residual is in multiples of the noise that was assumed
    duration: float  # how much of the recording was needed, in s


def _check_lengths(code: Floats, reference: Reference) -> None:
    """Raise ValueError if readings and references are not of as many samples."""
    if code.ndim != 2:
        raise ValueError(f"'raw' must have shape (samples, channels), got {code.shape}.")
    lengths = {name: len(field) for name, field in reference._asdict().items() if len(field) != len(code)}
    if lengths:
        raise ValueError(f"'raw' holds {len(code)} samples, but fields of the reference hold {lengths}.")


def _too_few(standing: QuietStanding, state: Any, code: Floats) -> CalibrationRefused:
    """Return the refusal of a recording with too few usable samples."""
    warm = state.samples + state.dropped + state.gated
    return CalibrationRefused(
        f"Only {state.samples} of the {standing.minimum_samples} samples that are needed were usable: of "
        f"{warm} after {standing.warm_up:g} s of warming up, {state.dropped} held values that are "
        f"not finite{_silent_channels(code, standing.layout)} and {state.gated} lacked contact or moved.",
        "Stand still for longer, or check the IMU, its thresholds and the cells.",
    )


def standing_start(standing: QuietStanding, raw: ArrayLike, reference: Reference, dt: float) -> StandingFit:
    """Fit a recording, using no more of it than is needed.

    Args:
        standing: The robot, its starting map, and the thresholds.
        raw: Readings, shape (n, K).
        reference: The robot's beliefs, each field with n samples on its first axis.
        dt: Time between samples in s.

    Returns:
        The starting values.

    Raises:
        ValueError: If a shape is not as above.
        CalibrationRefused: If too few samples were finite, in contact and still.
    """
    check_value("dt", dt, positive=True)
    code = np.asarray(raw, dtype=np.float64)
    _check_lengths(code, reference)
    log = Reference(*(np.asarray(field) for field in reference))
    state, end = standing.init(np.zeros(standing.layout.channels)), 0
    while end < len(code) and not standing.ready(state):
        state = standing.update(state, code[end], Reference(*(field[end] for field in log)), dt)
        end += 1
    if state.samples < standing.minimum_samples:
        raise _too_few(standing, state, code)
    estimate, unknowns = standing.solve(state), 2 * standing.layout.channels
    return StandingFit(
        value=estimate.parameters,
        correction=estimate.correction,
        covariance=estimate.covariance,
        result=FitResult.DETERMINED if estimate.rank == unknowns else FitResult.PARTLY_DETERMINED,
        stats=FitStats(
            samples=state.samples,
            dropped=state.dropped,
            gated=state.gated,
            residual_rms=estimate.residual_rms,
            rank=estimate.rank,
            unknowns=unknowns,
            condition=estimate.condition,
        ),
        duration=end * dt,
    )


def _silent_channels(raw: Floats, layout: FeetLayout) -> str:
    silent = [
        name
        for name, readings in zip(layout.channel_names, raw.T, strict=True)
        if not np.isfinite(readings).any()
    ]
    return f" (no reading at all from {', '.join(silent)})" if silent else ""
