"""References from logged joints and IMU, as :mod:`surefoot.wrappers.beliefs` makes them, but not late."""

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Reference
from surefoot.experiments.logs.description import MotionFacts
from surefoot.experiments.logs.model import LogModel
from surefoot.experiments.logs.motion import Motion
from surefoot.experiments.logs.table import LogError
from surefoot.sensors.transport.link import Packet
from surefoot.wrappers.beliefs import Beliefs
from surefoot.wrappers.telemetry import TelemetryLayout

FASTER, FAST = 15.0, 0.3
"""A gyroscope that turns this many times faster than the robot on its soles, and by more rad/s than this, is
in other units: degrees are 57 times as many."""

APART = 0.1  # time in s over which turning is taken
AHEAD = 3  # rows of motion after a moment that differences and interpolation may need
NEEDED = 2  # rows without a loss that a moment must have before and behind it


def make_reference(
    time: NDArray[np.float64], motion: Motion, facts: MotionFacts, model: LogModel, mass: float
) -> Reference:
    """Return references for times of the feet in s, (N,); NaN where joints and IMU do not reach.

    Contacts are left open. The drawing's angular momentum is scaled to the log's mass in kg.
    """
    where = TelemetryLayout(len(model.joint_names))
    beliefs = Beliefs(model, where, motion.period, 0.0, facts.averaged)  # type: ignore[arg-type]
    force, spin = (part @ model.R_torso_imu.T for part in (motion.accelerometer, motion.gyroscope))
    moments = time - facts.readings_age_s
    place = np.searchsorted(motion.time, moments)
    known = _surrounded(motion, place)
    nobody = np.zeros(2, dtype=bool)
    rows: list[Reference] = []
    fed, values = 0, np.zeros(where.size)
    for moment, row, fine in zip(moments.tolist(), place.tolist(), known.tolist(), strict=True):
        while fed < min(row + AHEAD, len(motion.time)):
            values[where.joint_position] = motion.joint[fed]
            values[where.accelerometer], values[where.gyroscope] = force[fed], spin[fed]
            beliefs.update((Packet(int(motion.number[fed]), float(motion.time[fed]), values.copy()),))
            fed += 1
        found = beliefs.reference(moment, nobody, nobody)
        rows.append(found if fine else _unknown(found))
    reference = Reference(*(np.stack(part) for part in zip(*rows, strict=True)))
    return reference._replace(angular_momentum_rate=reference.angular_momentum_rate * (mass / model.mass))


def _surrounded(motion: Motion, place: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return which moments lie among rows of which none is lost."""
    first, last = place - NEEDED, place + NEEDED - 1
    inside = (first >= 0) & (last < len(motion.number))
    span = motion.number[np.where(inside, last, 0)] - motion.number[np.where(inside, first, 0)]
    found: NDArray[np.bool_] = inside & (span == 2 * NEEDED - 1)
    return found


def _unknown(reference: Reference) -> Reference:
    stance, swing = reference.stance, reference.swing
    blank = Reference(*(np.full(np.shape(part), np.nan) for part in reference))
    return blank._replace(stance=stance, swing=swing)


def check_spin(motion: Motion, model: LogModel, file: str) -> None:
    """Raise LogError if a gyroscope is far faster than the torso over the sole that turns less under it."""
    stride = max(round(APART / motion.period), 1)
    still = np.zeros(len(model.joint_names)), np.zeros(3)
    axes = np.array([model.evaluate(joint, *still)[3].copy() for joint in motion.joint[::stride]])
    R = axes.reshape(-1, 2, 3, 3)
    cosine = 0.5 * (np.einsum("nfij,nfij->nf", R[1:], R[:-1]) - 1.0)
    turned = np.arccos(np.clip(cosine, -1.0, 1.0)).min(axis=1) / (stride * motion.period)
    felt = np.linalg.norm(motion.gyroscope, axis=1)
    spin, known = (float(np.sqrt(np.mean(part**2))) for part in (felt, turned))
    if spin > FAST and spin > FASTER * known:
        raise LogError(
            f"{file}: columns 'gyroscope_x_rad_s' to '_z_rad_s' turn by {spin:.3g} (rms) where the joints "
            f"turn the torso by {known:.3g} rad/s over its soles; give rad/s, not degrees per second."
        )
