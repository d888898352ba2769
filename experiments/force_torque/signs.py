"""Units and signs of an in-situ log, compared with gravity and the factory matrix."""

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY
from surefoot.experiments.force_torque.checks import contiguous
from surefoot.experiments.force_torque.table import Samples
from surefoot.experiments.logs.table import LogError

__all__ = ["check_acceleration", "check_against_factory", "check_spin"]

_LOOKS = {
    1.0: "g: say units.acceleration = 'g'",
    1000.0: "thousandths of g: say units.acceleration = 'mg'",
    GRAVITY**2: "m/s^2 already: say units.acceleration = 'm/s^2'",
    1e-3 * GRAVITY**2: "m/s^2 already: say units.acceleration = 'm/s^2'",
    1e3 * GRAVITY: "mm/s^2: convert the columns to m/s^2",
    1e2 * GRAVITY: "cm/s^2: convert the columns to m/s^2",
}
"""What an acceleration at rest of that length in m/s^2 is likely to be."""

TURNED = 0.5
"""Time in s over which both sides of dg/dt = -w x g are summed."""

CLEAR = 0.5
"""Correlation from which two signals have a common sign."""

LARGEST = 1e9
"""Magnitude at which absurd values are clipped, so that their squares stay finite."""


def check_acceleration(samples: Samples) -> None:
    """Raise LogError if accelerations cannot be in the unit that was given."""
    size = np.linalg.norm(np.clip(samples.acceleration, -LARGEST, LARGEST), axis=1)
    felt = float(np.median(size))
    if 0.8 * GRAVITY < felt < 1.2 * GRAVITY:
        return
    looks = [text for value, text in _LOOKS.items() if 0.8 < felt / value < 1.2]
    hint = (
        f"it looks like {looks[0]}" if looks else "give m/s^2 with gravity in it, or say units.acceleration"
    )
    raise LogError(
        f"{samples.file}: {_named(samples.acceleration_names)} have a median length of {felt:.4g} m/s^2 in "
        f"set '{samples.name}', and a limb that hangs still feels {GRAVITY:.4g}; {hint}."
    )


def check_spin(samples: Samples) -> None:
    """Raise LogError if a gyroscope is in other units or of other signs: gravity must turn as it says.

    Seen from the limb gravity turns by dg/dt = -w x g. The slope of its change on the integral of the right
    side is one where units and signs agree.
    """
    spin, time = samples.angular_velocity, samples.time
    if spin is None or time is None:
        return
    expected, seen = [], []
    stride = max(1, round(TURNED / float(np.median(np.diff(time)))))
    for part in contiguous(time):
        if part.stop - part.start <= stride:
            continue
        a, t = samples.acceleration[part], time[part]
        rate = -np.cross(spin[part], a)
        total = np.zeros_like(a)
        total[1:] = np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t)[:, None], axis=0)
        expected.append(total[stride:] - total[:-stride])
        seen.append(a[stride:] - a[:-stride])
    if not expected:
        return
    x, y = np.concatenate(expected).ravel(), np.concatenate(seen).ravel()
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if xx == 0.0 or yy == 0.0 or abs(xy) < CLEAR * np.sqrt(xx * yy):
        return
    slope = xy / xx
    at = f"{samples.file}: {_named(samples.columns.angular_velocity or ())} in set '{samples.name}'"
    if slope < 0.0:
        raise LogError(
            f"{at} turn gravity the wrong way round; turn their signs, or give both of the IMU's vectors in "
            "one right-handed frame."
        )
    if 0.01 < slope < 0.03:
        raise LogError(
            f"{at} say {1 / slope:.2g} times the rate at which gravity turns; they look like deg/s: say "
            "units.angular_velocity = 'deg/s'."
        )
    if not 0.5 < slope < 2.0:
        raise LogError(
            f"{at} say {1 / slope:.2g} times the rate at which gravity turns; give rad/s, and time in "
            "seconds."
        )


def check_against_factory(
    sets: list[tuple[Samples, NDArray[np.float64]]], matrix: NDArray[np.float64] | None, notices: list[str]
) -> None:
    """Compare gravity with the force by the factory matrix: what hangs is pulled down.

    Args:
        sets: Each with gravity in the sensor's frame, shape (n, 3).
        matrix: The factory's, shape (6, k), if it is known.
        notices: Is added to.

    Raises:
        LogError: If the force is along minus gravity: one of the two signs is wrong.
    """
    samples = sets[0][0]
    if matrix is None:
        notices.append(
            f"{samples.file}: there is no factory matrix to check the accelerometer's sign with, and a "
            "wrong one would turn the calibrated wrench round; see that a limb that hangs pulls along "
            "gravity."
        )
        return
    if matrix.shape[1] != samples.raw.shape[1]:
        raise LogError(
            f"{samples.file}: has {samples.raw.shape[1]} channels and the factory matrix {matrix.shape[1]} "
            "columns; name the channels under columns.raw in the matrix's order."
        )
    force_parts, gravity_parts = [], []
    for samples, gravity in sets:
        whole = np.isfinite(samples.raw).all(axis=1)
        force = samples.raw[whole] @ matrix[:3].T
        force_parts.append(force - force.mean(axis=0))
        gravity_parts.append(gravity[whole] - gravity[whole].mean(axis=0))
    force, pull = np.concatenate(force_parts).ravel(), np.concatenate(gravity_parts).ravel()
    alike = float(force @ pull / max(np.linalg.norm(force) * np.linalg.norm(pull), 1e-300))
    columns = _named(samples.acceleration_names)
    if alike < -CLEAR:
        other = "specific_force" if samples.points_down else "gravity"
        raise LogError(
            f"{samples.file}: by the factory matrix the limb pulls against gravity (correlation "
            f"{alike:.2f}): {columns} have the other sign. Name them under columns.{other} (at rest specific "
            "force points up and gravity down); if the matrix gives the wrench of the robot on the limb, "
            "turn its signs instead."
        )
    if alike < CLEAR:
        notices.append(
            f"{samples.file}: by the factory matrix the limb's pull and gravity hardly agree (correlation "
            f"{alike:.2f}); {columns} may be in other axes than the sensor's (accelerometer."
            "R_sensor_accelerometer), channels may be in another order, or the matrix may be another "
            "sensor's."
        )


def _named(columns: tuple[str, ...]) -> str:
    return f"columns '{columns[0]}' to '{columns[-1]}'"
