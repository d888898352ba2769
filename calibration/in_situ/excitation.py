r"""Plans of which postures and masses to calibrate with: those whose readings bring most information.

A reading y of a pose, linear in the unknowns :math:`\theta` with covariance P
(:mod:`surefoot.calibration.in_situ.model`; whitened rows H, n samples averaged), informs of quantities q
among them (the ``goal``), by the mutual information of Gaussian variables,

.. math:: I(q; y) = \tfrac12 \log\frac{\det P_{qq}}{\det P_{qq}^+}
    = \tfrac12 \log\det\bigl(H P H' + \tfrac1n\bigr) - \tfrac12 \log\det\bigl(H P_{|q} H' + \tfrac1n\bigr),
    \qquad P_{|q} = P - P_{\cdot q} P_{qq}^{-1} P_{q \cdot},

in nats: by how much the logarithm of the volume of q's uncertainty shrinks. All other unknowns are nuisances
and share the reading. Every mass that hangs brings an offset of its own, as offsets jump from set to set, so
the first poses of a new mass bring little: masses are compared by the information of ``block`` poses with
each (poses far apart, each exchanged for the best beside the others: Fedorov, 1972), and the best
block is taken, P is updated by it (:mod:`surefoot.calibration.kalman`), and so on.

Covariances do not depend on the readings to come but, as the model is bilinear, on the assumed A and
limb. From a factory matrix alone a plan is good, not optimal: fit the readings and plan again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.checks import check_value
from surefoot.calibration.in_situ.data import KnownLimb, Matrix
from surefoot.calibration.in_situ.fit import ErrorColumns, InSituFit, Limb, check_calibrated, error_covariance
from surefoot.calibration.in_situ.model import (
    AXES,
    MASS,
    MOMENT,
    RELATIVE_ERRORS,
    STATIC,
    LinearSensor,
    inertial_parameters,
    offset_covariance,
)
from surefoot.calibration.kalman import kalman_step

_RESPONSE = slice(0, RELATIVE_ERRORS)
_LIMB = slice(_RESPONSE.stop, _RESPONSE.stop + STATIC)
_SHARED = slice(0, _LIMB.stop)
"""Places of D, of the limb and of both, which all sets share; behind them stands an offset for each mass."""

GOALS = {
    "calibration": _SHARED,
    "matrix": _RESPONSE,
    "limb": _LIMB,
    "mass": slice(_LIMB.start + MASS, _LIMB.start + MASS + 1),
    "offset": slice(_SHARED.stop, _SHARED.stop),
}
"""Goals of a plan: matrix and limb, the matrix, the limb, its mass alone, or the offset of the first mass
(behind the others, as wide as the sensor has channels)."""

_SWEEPS = 4
"""Times that the poses of a block are exchanged at most."""

_LEAST_STD, _ANYWHERE = 1e-9, 1.0
"""Relative error of an axis at least, so that covariances have inverses, and deviation in m of a centre
of mass that is not given."""


class MassCandidate(NamedTuple):
    """A mass that can be hung on the limb.

    Attributes:
        mass: In kg; 0 for the bare limb.
        com: Its centre of mass in the sensor's frame in m.
        offset_covariance: Covariance of the offset while it hangs, in counts^2, shape (k, k); None takes
            the prior's ``new_offset``.
    """

    mass: float
    com: tuple[float, float, float] | NDArray[np.float64] = (0.0, 0.0, 0.0)
    offset_covariance: Matrix | None = None


@dataclass(frozen=True, eq=False)
class ExcitationPrior:
    """A sensor and its limb as they are known before a plan.

    Attributes:
        response: A in counts per N and N m, shape (k, 6).
        noise: Covariance of a sample in counts^2, shape (k, k).
        limb: The bare limb.
        covariance: Of (D row by row, m, m c), D the relative error of the response, shape (40, 40).
        new_offset: Covariance of a new set's offset in counts^2, shape (k, k).
    """

    response: Matrix
    noise: Matrix
    limb: Limb
    covariance: Matrix
    new_offset: Matrix


class PlannedPose(NamedTuple):
    """One reading to take.

    Attributes:
        orientation: Index of the orientation.
        mass: Index of the mass.
        information: Information that it adds on the goal, in nats.
    """

    orientation: int
    mass: int
    information: float


@dataclass(frozen=True, eq=False)
class ExcitationPlan:
    """Readings to take, and the information that they will bring.

    Attributes:
        poses: In the order of choice, a block with one mass after the other.
        mass_information: On the goal by the best first block with each mass, in nats, shape (M,).
        pose_information: By each single reading then, in nats, shape (N, M).
        before: Covariance of (D, m, m c) before, shape (40, 40).
        after: And after all poses.
        total: Information of all poses on the goal together, in nats.
    """

    poses: tuple[PlannedPose, ...]
    mass_information: NDArray[np.float64]
    pose_information: Matrix
    before: Matrix
    after: Matrix
    total: float


def plan_excitation(
    prior: InSituFit | ExcitationPrior,
    gravity: ArrayLike,
    masses: Sequence[MassCandidate | tuple[Any, ...]] = (MassCandidate(0.0),),
    *,
    count: int = 12,
    goal: str = "calibration",
    block: int = 4,
    samples: int = 100,
) -> ExcitationPlan:
    """Plan which readings to take next.

    Args:
        prior: A calibration, or a maker's matrix with :func:`prior_from_factory`.
        gravity: Reachable orientations, as g in the sensor's frame in m/s^2, pointing down, shape (N, 3).
        masses: Masses that can be hung, M of them, each a set with an offset of its own.
        count: Readings to propose.
        goal: Quantities to learn, a key of :data:`GOALS`.
        block: Readings with one mass before masses are compared again; fewer than four do not separate a
            new set's offset from its load.
        samples: Samples that are averaged in each pose.

    Returns:
        The plan.

    Raises:
        ValueError: If an argument has no meaning.

    >>> from surefoot.calibration.in_situ.data import KnownLimb
    >>> C = np.diag([0.01, 0.01, 0.01, 2e-4, 2e-4, 2e-4])
    >>> prior = prior_from_factory(C, KnownLimb(5.0, 0.5, np.array([0.0, 0.0, 0.2])))
    >>> down, ahead, aside = 9.81 * np.eye(3)[[2, 0, 1]]
    >>> plan = plan_excitation(prior, [down, ahead, aside, -ahead], [MassCandidate(0.0)], count=4)
    >>> sorted(pose.orientation for pose in plan.poses)
    [0, 1, 2, 3]
    """
    g, candidates = _check_plan(gravity, masses, goal, {"count": count, "block": block, "samples": samples})
    known = prior if isinstance(prior, ExcitationPrior) else prior_from_fit(prior)
    wanted = _offset_of(0, len(known.response)) if goal == "offset" else GOALS[goal]
    design = _Design(known, g, candidates, wanted, samples, block)
    P = design.start()
    pose_information = np.stack([design.information(P, mass) for mass in range(len(candidates))], axis=1)
    mass_information = np.zeros(0)
    poses: list[PlannedPose] = []
    while len(poses) < count:
        blocks = [design.block(P, mass, min(block, count - len(poses))) for mass in range(len(candidates))]
        brought = np.array([sum(pose.information for pose in chosen) for chosen in blocks])
        mass_information = mass_information if poses else brought
        chosen = blocks[int(np.argmax(brought))]
        for pose in chosen:
            P = design.after(P, pose.orientation, pose.mass)
        poses.extend(chosen)
    return ExcitationPlan(
        poses=tuple(poses),
        mass_information=mass_information,
        pose_information=pose_information,
        before=known.covariance,
        after=P[_SHARED, _SHARED],
        total=sum(pose.information for pose in poses),
    )


def _check_plan(
    gravity: ArrayLike, masses: Sequence[MassCandidate | tuple[Any, ...]], goal: str, counts: dict[str, int]
) -> tuple[Matrix, list[MassCandidate]]:
    """Return gravity and masses as they are used, or raise ValueError if an argument has no meaning."""
    if goal not in GOALS:
        raise ValueError(f"'goal' must be one of {list(GOALS)}, got {goal!r}.")
    for name, value in counts.items():
        if isinstance(value, bool) or value != int(value) or value < 1:
            raise ValueError(f"'{name}' must be a whole number from 1 on, got {value!r}.")
    g = np.asarray(gravity, dtype=np.float64)
    if g.ndim != 2 or g.shape[1] != 3 or not len(g) or not np.isfinite(g).all():
        raise ValueError(f"'gravity' must be finite and of shape (N, 3), N at least 1, got shape {g.shape}.")
    candidates = [mass if isinstance(mass, MassCandidate) else MassCandidate(*mass) for mass in masses]
    if not candidates:
        raise ValueError("Give at least one mass; MassCandidate(0.0) is the bare limb.")
    return g, candidates


def prior_from_fit(
    fit: InSituFit, *, offset_force: float = 300.0, offset_torque: float = 5.0
) -> ExcitationPrior:
    """Make a prior of a calibration.

    Args:
        fit: The calibration, also one that leans on a factory matrix.
        offset_force: Standard deviation of a new set's offset along each axis in N.
        offset_torque: The same for torques in N m.

    Raises:
        ValueError: If the fit was refused or a deviation is not positive.
    """
    check_calibrated(fit, "A plan")
    columns = ErrorColumns.of(len(fit.offset))
    all_but_offset = slice(columns.response.start, columns.limb.stop)
    shared = error_covariance(fit)[all_but_offset, all_but_offset]
    new = _covariance_of(fit.response, offset_force, offset_torque)
    return ExcitationPrior(fit.response, fit.noise, fit.limb, shared, new)


def prior_from_factory(
    matrix: ArrayLike,
    limb: KnownLimb,
    *,
    scale_std: float = 0.2,
    cross_talk_std: float = 0.03,
    full_scale: tuple[float, float] = (1500.0, 35.0),
    noise_force: float = 0.1,
    noise_torque: float = 0.0025,
    offset_force: float = 300.0,
    offset_torque: float = 5.0,
) -> ExcitationPrior:
    """Make a prior of a maker's matrix and a guess of the limb.

    Args:
        matrix: C in N and N m per count, shape (6, k).
        limb: Assumed values of the limb; an unknown centre of mass counts as the sensor's origin.
        scale_std: Standard deviation of each axis's scale, relative.
        cross_talk_std: Standard deviation of an axis's share of another's load, in shares of the full scales.
        full_scale: Largest force in N and torque in N m.
        noise_force: Standard deviation of a sample in N.
        noise_torque: The same for torques in N m.
        offset_force: Standard deviation of a set's offset along each axis in N.
        offset_torque: The same for torques in N m.

    Raises:
        ValueError: If the matrix is not of rank 6 or a value has no meaning.
    """
    C = np.asarray(matrix, dtype=np.float64)
    if C.ndim != 2 or C.shape[0] != AXES or not np.isfinite(C).all() or np.linalg.matrix_rank(C) < AXES:
        raise ValueError(f"'matrix' must be finite, of rank 6 and of shape (6, k), got shape {C.shape}.")
    given = {"scale_std": scale_std, "noise_force": noise_force, "noise_torque": noise_torque}
    for name, value in given.items():
        check_value(name, value, positive=True)
    check_value("cross_talk_std", cross_talk_std, positive=False)
    size = np.repeat(full_scale, 3)
    std = np.where(np.eye(AXES, dtype=bool), scale_std, cross_talk_std * size[:, None] / size)
    com = np.zeros(3) if limb.com is None else np.asarray(limb.com)
    response = np.asarray(np.linalg.pinv(C), dtype=np.float64)
    # m c = m times c: a mass that is off moves it along c.
    root = np.zeros((STATIC, STATIC))
    root[:, MASS] = limb.mass_std * np.concatenate([[1.0], com])
    root[MOMENT, MOMENT] = limb.mass * (limb.com_std if limb.com is not None else _ANYWHERE) * np.eye(3)
    covariance = np.zeros((_SHARED.stop, _SHARED.stop))
    covariance[_RESPONSE, _RESPONSE] = np.diag(np.maximum(std, _LEAST_STD).ravel() ** 2)
    covariance[_LIMB, _LIMB] = root @ root.T
    return ExcitationPrior(
        response,
        _covariance_of(response, noise_force, noise_torque),
        Limb(limb.mass, limb.mass * com),
        covariance,
        _covariance_of(response, offset_force, offset_torque),
    )


def _offset_of(mass: int, channels: int) -> slice:
    """Return the places of the offset while a mass hangs."""
    return slice(_SHARED.stop + channels * mass, _SHARED.stop + channels * (mass + 1))


def _covariance_of(response: Matrix, force: float, torque: float) -> Matrix:
    check_value("force", force, positive=True)
    check_value("torque", torque, positive=True)
    return offset_covariance(response, force, torque)


class _Design:
    """Rows of all candidates by (D, m, m c, an offset for each mass)."""

    def __init__(
        self,
        prior: ExcitationPrior,
        gravity: Matrix,
        masses: list[MassCandidate],
        goal: slice,
        samples: int,
        block: int,
    ) -> None:
        self._prior, self._masses = prior, masses
        k = len(prior.response)
        self._offsets = [_offset_of(index, k) for index in range(len(masses))]
        self._size = size = self._offsets[-1].stop
        limb = prior.limb.parameters[:STATIC]
        self._rows = []
        for own, mass in zip(self._offsets, masses, strict=True):
            check_value("mass", mass.mass, positive=False)
            added = inertial_parameters(float(mass.mass), np.asarray(mass.com, dtype=np.float64), False)
            sensor = LinearSensor(prior.response, prior.noise, limb + added)
            rows = np.zeros((len(gravity), k, size))
            rows[..., _SHARED] = sensor.rows(gravity)
            rows[..., own] = sensor.whitening
            self._rows.append(rows)
        self._goal = goal
        self._variance = np.full(k, 1.0 / samples)
        self._spread = _spread(gravity, block)

    def start(self) -> Matrix:
        """Return P before anything is read."""
        P = np.zeros((self._size, self._size))
        P[_SHARED, _SHARED] = self._prior.covariance
        for own, mass in zip(self._offsets, self._masses, strict=True):
            P[own, own] = self._prior.new_offset if mass.offset_covariance is None else mass.offset_covariance
        return P

    def information(self, P: Matrix, mass: int) -> NDArray[np.float64]:
        """Return I(q; y) of each orientation with a mass in nats, shape (N,)."""
        q = self._goal
        known = np.linalg.solve(P[q, q], P[q])
        rows = self._rows[mass]
        return np.asarray(0.5 * (self._volume(rows, P) - self._volume(rows, P - P[:, q] @ known)))

    def after(self, P: Matrix, orientation: int, mass: int) -> Matrix:
        """Return P once a pose has been read."""
        rows = self._rows[mass][orientation]
        nothing = np.zeros(self._size)
        y, learnt = np.zeros(len(rows)), nothing + 1.0
        step = kalman_step(nothing, P, rows, y, self._variance, learnt, np.inf)
        return np.asarray(step.covariance)

    def block(self, P: Matrix, mass: int, size: int) -> list[PlannedPose]:
        """Return poses with one mass: each of an even start exchanged for the best beside the others."""
        chosen = self._spread[:size]
        for _ in range(_SWEEPS):
            before = chosen.copy()
            for place in range(size):
                beside = P
                for other in chosen[:place] + chosen[place + 1 :]:
                    beside = self.after(beside, other, mass)
                chosen[place] = int(np.argmax(self.information(beside, mass)))
            if chosen == before:
                break
        poses = []
        for orientation in chosen:
            poses.append(PlannedPose(orientation, mass, float(self.information(P, mass)[orientation])))
            P = self.after(P, orientation, mass)
        return poses

    def _volume(self, rows: Matrix, P: Matrix) -> NDArray[np.float64]:
        V = rows @ P @ rows.mT + np.diag(self._variance)
        return np.asarray(np.linalg.slogdet(V)[1])


def _spread(gravity: Matrix, count: int) -> list[int]:
    """Return orientations far from each other: each the farthest from those before it."""
    chosen = [int(np.argmax(np.linalg.norm(gravity - gravity.mean(axis=0), axis=1)))]
    while len(chosen) < count:
        apart = np.linalg.norm(gravity[:, None] - gravity[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(apart)))
    return chosen
