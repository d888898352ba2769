"""Compute references from joint angles, an IMU and the model of a robot.

The model is an MJCF or URDF file with a floating body that carries the IMU, hinges, and two soles (sites or
bodies). State estimation is that of :mod:`surefoot.robot.beliefs`, packet by packet but without delay. Rows
of a fast link are joined as there.
"""

from math import ceil

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats, RowCollector
from surefoot.calibration import FeetLayout, MomentumReference, Reference
from surefoot.experiments.logs.description import MotionFacts
from surefoot.experiments.logs.motion import Motion
from surefoot.experiments.logs.table import LogError
from surefoot.robot.beliefs.believed import nothing, unknown
from surefoot.robot.beliefs.lag import packets_per_join
from surefoot.robot.beliefs.momentum import MomentumBeliefs
from surefoot.robot.beliefs.native import native_beliefs
from surefoot.robot.beliefs.nominal import NominalModel
from surefoot.robot.beliefs.references import Beliefs
from surefoot.robot.model_file import ModelPartError, nominal_model, read_spec, touching_points
from surefoot.sensors.telemetry.computer import TelemetryLayout
from surefoot.sensors.transport.link import Packet

POSTURES, MOVES = 8, 1e-3  # number of postures that are compared; least motion of a sole in m, or of its axes


def load_model(facts: MotionFacts, file: str) -> tuple[NominalModel, Floats]:
    """Load the model of a robot, and the rotation from the axes of the IMU to those of the torso, (3, 3).

    Raises LogError if it cannot be read, lacks a part, or does not consist of a floating body and hinges.
    """
    if not facts.model.is_file():
        raise LogError(
            f"{file}: the description's motion.model '{facts.model}' is not there; give its path from the "
            "log's folder."
        )
    try:
        return nominal_model(read_spec(facts.model), facts.torso, facts.imu, facts.soles)
    except ModelPartError as error:
        raise LogError(f"{file}: the description's motion.{error}") from None
    except (ValueError, mujoco.FatalError) as error:
        cure = ""
        if "opening file" in str(error):
            cure = "; a link without a mass takes it from its mesh: put the file there, or give it its mass."
        raise LogError(f"{file}: the model '{facts.model.name}' cannot be used: {error}{cure}") from None


def moving_soles(model: NominalModel, joint: Floats) -> list[str]:
    """Return the joints whose sign affects the places of the soles in some of the postures (M, J)."""
    still = np.zeros(joint.shape[1]), np.zeros(3)
    found = []
    for i, name in enumerate(model.joint_names):
        for posture in joint[:: max(len(joint) // POSTURES, 1)]:
            turned = posture.copy()
            turned[i] *= -1.0
            places = [np.vstack(model.evaluate(one, *still)[2:]) for one in (posture, turned)]
            if np.abs(places[0] - places[1]).max() > MOVES:
                found.append(name)
                break
    return found


FASTER, FAST = 15.0, 0.3
"""A gyroscope is in other units if it reads this many times the rotation of the torso over the soles, and
more than this rotation in rad/s. Degrees give 57 times as much."""

APART = 0.1  # time in s over which rotations are computed
AHEAD = 3  # number of joined rows after a moment that differences and interpolation need
NEEDED = 2  # number of joined rows that are needed before and after a moment


def make_beliefs(
    time: Floats,
    motion: Motion,
    facts: MotionFacts,
    model: NominalModel,
    mass: float,
    layout: FeetLayout,
    dt: float,
) -> tuple[Reference, MomentumReference]:
    """Compute references for times of the feet in s, (N,), ``dt`` s apart; NaN where there is no motion.

    The results are a reference with accelerations and one with momentum, both without contacts. The angular
    momentum of the model is scaled to the mass of the log in kg. The contact points are the cells of the
    feet, or the origins of the soles.
    """
    where = TelemetryLayout(len(model.joint_names))
    link, joined = (motion.period, 0.0, facts.averaged), packets_per_join(motion.period)
    touching = touching_points(layout)
    python = MomentumBeliefs(Beliefs(model, where, *link, dt=dt, joined=joined, touching=touching))
    beliefs = native_beliefs(python)  # ten times as fast, and equal up to rounding
    moments = time - facts.readings_age_s
    place = np.searchsorted(motion.time, moments)
    known = _has_neighbours(motion, place, python.beliefs.filled, joined)
    nobody = np.zeros(2, dtype=bool)
    references, momenta = RowCollector(len(time)), RowCollector(len(time))
    fed, values = 0, np.zeros(where.size)
    ahead = AHEAD * joined + ceil(0.5 * dt / motion.period)
    whole = zip(moments.tolist(), place.tolist(), known.tolist(), strict=True)
    for i, (moment, row, fine) in enumerate(whole):
        while fed < min(row + ahead, len(motion.time)):
            values[where.joint_position] = motion.joint[fed]
            values[where.accelerometer], values[where.gyroscope] = (
                motion.accelerometer[fed],
                motion.gyroscope[fed],
            )
            beliefs.update((Packet(int(motion.number[fed]), float(motion.time[fed]), values.copy()),))
            fed += 1
        references.put(i, beliefs.reference(moment, nobody, nobody) if fine else nothing(2))
        momenta.put(i, beliefs.momentum(moment, nobody, nobody) if fine else unknown(2))
    reference: Reference = references.collect()
    momentum: MomentumReference = momenta.collect()
    scale = mass / model.mass
    return (
        reference._replace(angular_momentum_rate=scale * reference.angular_momentum_rate),
        momentum._replace(angular_momentum=scale * momentum.angular_momentum),
    )


def _has_neighbours(motion: Motion, place: NDArray[np.intp], filled: int, joined: int) -> NDArray[np.bool_]:
    """Return which moments have neighbouring rows without longer gaps than state estimation fills.

    ``joined`` is the number of rows that are joined into one.
    """
    first, last = place - NEEDED * joined, place + NEEDED * joined - 1
    inside = (first >= 0) & (last < len(motion.number))
    long = np.append(0, np.cumsum(np.diff(motion.number) > filled + 1))
    found: NDArray[np.bool_] = inside & (long[np.where(inside, last, 0)] == long[np.where(inside, first, 0)])
    return found


def check_spin(motion: Motion, model: NominalModel, file: str) -> None:
    """Raise LogError if a gyroscope reads far more than the rotation of the torso over the steadier sole."""
    stride = max(round(APART / motion.period), 1)
    still = np.zeros(motion.joint.shape[1]), np.zeros(3)
    axes = np.array([model.evaluate(joint, *still)[3] for joint in motion.joint[::stride]])
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
