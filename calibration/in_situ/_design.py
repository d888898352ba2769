"""What readings of every pose and mass would tell, and blocks of them; private.

Its theory is in :mod:`surefoot.calibration.in_situ.excitation`.
"""

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration._setup import check_value
from surefoot.calibration.in_situ._linear import LinearSensor
from surefoot.calibration.in_situ._model import inertial_parameters
from surefoot.calibration.in_situ.excitation_plan import PlannedPose
from surefoot.calibration.in_situ.excitation_prior import SHARED, ExcitationPrior, MassCandidate
from surefoot.calibration.moment.kalman import kalman_step

__all__ = ["Design"]

Matrix = NDArray[np.float64]

_SWEEPS = 4
"""How often the poses of a block are exchanged at most."""


class Design:
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
        self._size = size = SHARED + k * len(masses)
        limb = np.concatenate([[prior.limb.mass], prior.limb.mass_com])
        self._rows = []
        for index, mass in enumerate(masses):
            check_value("mass", mass.mass, positive=False)
            added = inertial_parameters(float(mass.mass), np.asarray(mass.com, dtype=np.float64), False)
            sensor = LinearSensor(prior.response, prior.noise, limb + added)
            rows = np.zeros((len(gravity), k, size))
            rows[..., :SHARED] = sensor.rows(gravity)
            first = SHARED + k * index
            rows[..., first : first + k] = sensor.whitening
            self._rows.append(rows)
        self._goal = goal
        self._variance = np.full(k, 1.0 / samples)
        self._identity = np.eye(size)
        self._spread = _spread(gravity, block)

    def start(self) -> Matrix:
        """P before anything is read."""
        k = len(self._prior.response)
        P = np.zeros((self._size, self._size))
        P[:SHARED, :SHARED] = self._prior.covariance
        for index, mass in enumerate(self._masses):
            own = slice(SHARED + k * index, SHARED + k * (index + 1))
            P[own, own] = self._prior.new_offset if mass.offset_covariance is None else mass.offset_covariance
        return P

    def gains(self, P: Matrix, mass: int) -> NDArray[np.float64]:
        """I(q; y) of each orientation with a mass in nats, shape (N,)."""
        q = self._goal
        known = np.linalg.solve(P[q, q], P[q])
        rows = self._rows[mass]
        return np.asarray(0.5 * (self._volume(rows, P) - self._volume(rows, P - P[:, q] @ known)))

    def after(self, P: Matrix, orientation: int, mass: int) -> Matrix:
        """P once a pose has been read."""
        rows = self._rows[mass][orientation]
        nothing = np.zeros(self._size)
        step = kalman_step(
            nothing, P, rows, np.zeros(len(rows)), self._variance, nothing + 1.0, self._identity, np.inf
        )
        return np.asarray(step.covariance)

    def block(self, P: Matrix, mass: int, size: int) -> list[PlannedPose]:
        """Choose poses with one mass, exchanged from a greedy and from an even start; the better of both."""
        greedy: list[int] = []
        reached = P
        for _ in range(size):
            greedy.append(int(np.argmax(self.gains(reached, mass))))
            reached = self.after(reached, greedy[-1], mass)
        starts = [greedy] if size == 1 else [greedy, self._spread[:size]]
        blocks = [self._told(P, mass, self._exchanged(P, mass, start)) for start in starts]
        return max(blocks, key=lambda poses: sum(pose.gain for pose in poses))

    def _exchanged(self, P: Matrix, mass: int, start: list[int]) -> list[int]:
        """Exchange each pose in turn for the best beside the others, until none changes."""
        chosen = start.copy()
        for _ in range(_SWEEPS if len(chosen) > 1 else 0):
            before = chosen.copy()
            for place in range(len(chosen)):
                beside = P
                for other in chosen[:place] + chosen[place + 1 :]:
                    beside = self.after(beside, other, mass)
                chosen[place] = int(np.argmax(self.gains(beside, mass)))
            if chosen == before:
                break
        return chosen

    def _told(self, P: Matrix, mass: int, chosen: list[int]) -> list[PlannedPose]:
        poses = []
        for orientation in chosen:
            poses.append(PlannedPose(orientation, mass, float(self.gains(P, mass)[orientation])))
            P = self.after(P, orientation, mass)
        return poses

    def _volume(self, rows: Matrix, P: Matrix) -> NDArray[np.float64]:
        V = rows @ P @ rows.mT + np.diag(self._variance)
        return np.asarray(np.linalg.slogdet(V)[1])


def _spread(gravity: Matrix, count: int) -> list[int]:
    """Orientations as far as can be from each other: each the farthest from those before it."""
    chosen = [int(np.argmax(np.linalg.norm(gravity - gravity.mean(axis=0), axis=1)))]
    while len(chosen) < count:
        apart = np.linalg.norm(gravity[:, None] - gravity[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(apart)))
    return chosen
