r"""Choose which postures and masses to calibrate with: those whose readings tell most.

A reading y of a pose, linear in the unknowns :math:`\theta` with covariance P
(:mod:`surefoot.calibration.in_situ._linear`; whitened rows H, n samples averaged), tells of quantities q
among them (what ``goal`` names), by the mutual information of Gaussian variables,

.. math:: I(q; y) = \tfrac12 \log\frac{\det P_{qq}}{\det P_{qq}^+}
    = \tfrac12 \log\det\bigl(H P H' + \tfrac1n\bigr) - \tfrac12 \log\det\bigl(H P_{|q} H' + \tfrac1n\bigr),
    \qquad P_{|q} = P - P_{\cdot q} P_{qq}^{-1} P_{q \cdot},

in nats: by how much the logarithm of the volume of q's uncertainty shrinks. All other unknowns are nuisances
and share the reading. Every mass that hangs brings an offset of its own, as zeros jump from set to set, so
the first poses of a new mass tell little: masses are compared by what ``block`` poses with each would tell
together (greedy, then each pose exchanged for the best beside the others: Fedorov, 1972), and the best
block is taken, P is updated by it (:mod:`surefoot.calibration.moment.kalman`), and so on.

Covariances do not depend on what will be read but, as the model is bilinear, on where A and the limb are
thought to be. From a factory matrix alone a plan is good, not optimal: fit what was read and plan again.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.in_situ._design import Design
from surefoot.calibration.in_situ._linear import GAINS
from surefoot.calibration.in_situ.excitation_plan import ExcitationPlan, PlannedPose
from surefoot.calibration.in_situ.excitation_prior import (
    SHARED,
    ExcitationPrior,
    MassCandidate,
    prior_from_factory,
    prior_from_fit,
)
from surefoot.calibration.in_situ.fit import InSituFit

__all__ = [
    "GOALS",
    "ExcitationPlan",
    "ExcitationPrior",
    "MassCandidate",
    "PlannedPose",
    "plan_excitation",
    "prior_from_factory",
    "prior_from_fit",
]

GOALS = {
    "calibration": slice(0, SHARED),
    "matrix": slice(0, GAINS),
    "limb": slice(GAINS, SHARED),
    "mass": slice(GAINS, GAINS + 1),
    "offset": slice(SHARED, SHARED),
}
"""What a plan can be for: matrix and limb, the matrix, the limb, its mass alone, or the offset of the first
mass that is given."""


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
    """Propose what to read next.

    Args:
        prior: A calibration, or what :func:`prior_from_factory` makes of a maker's matrix.
        gravity: Reachable orientations, as g in the sensor's frame in m/s^2, pointing down, shape (N, 3).
        masses: Masses that can be hung, M of them, each a set with an offset of its own.
        count: Readings to propose.
        goal: What they are for, a key of :data:`GOALS`.
        block: Readings with one mass before masses are compared anew; fewer than four cannot tell a new
            set's offset from its load.
        samples: Samples that are averaged in each pose.

    Returns:
        The plan.

    Raises:
        ValueError: If an argument has no meaning.

    >>> from surefoot.calibration.in_situ.options import KnownLimb
    >>> C = np.diag([0.01, 0.01, 0.01, 2e-4, 2e-4, 2e-4])
    >>> prior = prior_from_factory(C, KnownLimb(5.0, 0.5, np.array([0.0, 0.0, 0.2])))
    >>> down, ahead, aside = 9.81 * np.eye(3)[[2, 0, 1]]
    >>> plan = plan_excitation(prior, [down, ahead, aside, -ahead], [MassCandidate(0.0)], count=4)
    >>> sorted(pose.orientation for pose in plan.poses)
    [0, 1, 2, 3]
    """
    if goal not in GOALS:
        raise ValueError(f"'goal' must be one of {list(GOALS)}, got {goal!r}.")
    for name, value in {"count": count, "block": block, "samples": samples}.items():
        if isinstance(value, bool) or value != int(value) or value < 1:
            raise ValueError(f"'{name}' must be a whole number from 1 on, got {value!r}.")
    g = np.asarray(gravity, dtype=np.float64)
    if g.ndim != 2 or g.shape[1] != 3 or not len(g) or not np.isfinite(g).all():
        raise ValueError(f"'gravity' must be finite and of shape (N, 3), N at least 1, got shape {g.shape}.")
    candidates = [mass if isinstance(mass, MassCandidate) else MassCandidate(*mass) for mass in masses]
    if not candidates:
        raise ValueError("Give at least one mass; MassCandidate(0.0) is the bare limb.")
    known = prior if isinstance(prior, ExcitationPrior) else prior_from_fit(prior)
    first_offset = slice(SHARED, SHARED + len(known.response))
    wanted = first_offset if goal == "offset" else GOALS[goal]
    design = Design(known, g, candidates, wanted, samples, block)
    P = design.start()
    pose_gain = np.stack([design.gains(P, mass) for mass in range(len(candidates))], axis=1)
    mass_gain: NDArray[np.float64] | None = None
    poses: list[PlannedPose] = []
    while len(poses) < count:
        size = min(block, count - len(poses))
        blocks = [design.block(P, mass, size) for mass in range(len(candidates))]
        told = np.array([sum(pose.gain for pose in chosen) for chosen in blocks])
        mass_gain = told if mass_gain is None else mass_gain
        chosen = blocks[int(np.argmax(told))]
        for pose in chosen:
            P = design.after(P, pose.orientation, pose.mass)
        poses.extend(chosen)
    assert mass_gain is not None
    return ExcitationPlan(
        poses=tuple(poses),
        mass_gain=mass_gain,
        pose_gain=pose_gain,
        before=known.covariance,
        after=P[:SHARED, :SHARED],
        total=sum(pose.gain for pose in poses),
    )
