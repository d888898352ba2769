"""The matrix of a six-axis F/T sensor from known masses hung on its limb (in-situ paper, III-C).

With the offsets taken off, C (r - o) = (M_b + M_a^j) g holds for the samples of the j-th added mass (18):
M_a^j is known, the matrix C and the limb's own mass and first moment in M_b are not. With
M(m, c) = [m I; m [c]x] and [c]x g = -[g]x c, the upper and the lower three rows share no unknown,

    C_force  (r - o) - m_b g           = m_a g,               3 k + 1 unknowns,
    C_torque (r - o) + [g]x (m_b c_b)  = -[g]x (m_a c_a),     3 k + 3 unknowns,

which together are the paper's 6 N rows and 40 unknowns for k = 6 (21-24). Every row is the same linear
function of (g, r - o) for all samples of a set, so that any orthogonal mixture of samples gives the same
least squares: the triangular factor of [g, r - o], nine rows, stands for the set. That is the stacked
solution itself, not an approximation, and unlike normal equations it does not square the condition number.

**Lemma 2**: fewer than three sets leave C undetermined (25). Three do not always suffice: masses must differ,
and the whole limb's centres of mass must not lie on one line. The rank shows whether they did. Noise would
fill any direction, so that the rank is judged by the readings' part that gravity explains, against the noise.

**The weakness of the method**: the noise sits in the regressors r. Least squares then shrinks C and, with it,
the limb's mass (errors in variables). With white noise of 0.3 % of each channel's spread, a leg of 4.9 kg
under the paper's masses comes out at 3.8 kg while the semi-axes of its forces agree within 3 % and the added
masses within 0.05 kg: neither check shows it. With 1 % it comes out at 1.2 kg, and a foot of 0.6 kg at
0.56 kg. The covariance knows nothing of it, and more samples do not help. Use it to reproduce the paper; for
work, fit where the noise is, r = C^-1 (M_b + M_a) g + o + noise.

**More than six channels**: readings at rest span six dimensions, and C is unknown beyond them. It is solved
within the six leading directions of the part that gravity explains and is zero across them (the smallest C).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.fit import Limb
from surefoot.calibration.in_situ.model import ENOUGH_MASSES, different_masses, inertial_parameters
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats

Matrix = NDArray[np.float64]

_SAME_MASS = 1e-9
"""Added masses that differ by less, in kg, are one."""


@dataclass(frozen=True, eq=False)
class PaperMatrixFit:
    """The matrix C of a sensor with k channels and the limb that hung on it.

    Attributes:
        matrix: C in N and N m per count, shape (6, k).
        limb: The body beyond the sensor without the added masses.
        covariance: Of (C row by row, the limb's mass, its first moment), shape (6 k + 4, 6 k + 4), from the
            scatter of the residuals as if readings were free of noise: it does not know of the attenuation.
        residual_force: Root mean square of the residual of Eq. 21 in N.
        residual_torque: The same of the lower rows in N m.
        result: Always determined: a matrix that is not is refused.
        stats: Of Eq. 21 over all sets, with 40 unknowns; the residual adds N and N m up as the paper does.
    """

    matrix: Matrix
    limb: Limb
    covariance: Matrix
    residual_force: float
    residual_torque: float
    result: FitResult
    stats: FitStats

    def wrench(self, raw: ArrayLike, offset: ArrayLike) -> Matrix:
        """Return w = C (r - o) in N and N m (in-situ paper, Eq. 2).

        Args:
            raw: Counts, shape (..., k).
            offset: o in counts, shape (..., k).

        Returns:
            Wrench of the limb on the robot, at and in the sensor's frame, shape (..., 6).
        """
        return np.asarray((np.asarray(raw, dtype=np.float64) - np.asarray(offset)) @ self.matrix.T)


def estimate_matrix(
    sets: Sequence[InSituSet], offsets: ArrayLike, *, tolerance: float = 1e-4, noise_margin: float = 5.0
) -> PaperMatrixFit:
    """Return a sensor's matrix from sets with known added masses (in-situ paper, Eqs. 18-25).

    Args:
        sets: Samples at rest; those that are not finite are left out.
        offsets: o in counts, of each set, shape (J, k), or of all, shape (k,).
        tolerance: Singular values at or below this share of the largest, with columns scaled to one length,
            count as not determined. An iCub leg of 5 kg under the paper's masses of 0.7 kg shows 0.0015.
        noise_margin: The same for those at or below this multiple of the singular value that white noise of
            the readings would have; 0 leaves the noise out of account.

    Returns:
        The matrix and the limb.

    Raises:
        ValueError: If the shapes do not belong together.
        CalibrationRefused: If a set has no finite sample, or the sets leave some unknown undetermined.
    """
    every_offset = _check_offsets(sets, offsets)
    _check_masses(sets)
    channels = sets[0].channels
    compressed = [_compress(one, offset) for one, offset in zip(sets, every_offset, strict=True)]
    samples = sum(count for _, count in compressed)
    factors = [factor for factor, _ in compressed]
    directions = _signal_directions(factors, channels)
    p = directions.shape[1]
    factors = [np.hstack([factor[:, :3], factor[:, 3:] @ directions]) for factor in factors]

    # In a factor, the rows beyond gravity's three hold the part that gravity does not explain.
    spare = max(samples - 3 * len(sets), 1)
    noise = np.sqrt(sum(np.sum(factor[3:, 3:] ** 2, axis=0) for factor in factors) / spare)
    noise = noise_margin * np.sqrt(3 * len(sets)) * noise
    blocks = [_stack(sets, factors, rows=None), _stack(sets, factors, rows=3)]
    force, torque = (
        _solve(full, target, signal, tolerance, noise, 3 * samples)
        for (full, target), (signal, _) in zip(*blocks, strict=True)
    )
    rank, unknowns = force.rank + torque.rank, 6 * p + 4
    if rank < unknowns:
        raise CalibrationRefused(
            f"The sets determine {rank} of {unknowns} unknowns of matrix and limb although they hold three "
            "different added masses: beside the noise of the readings, the centres of mass lie on one line, "
            "or gravity hardly turned.",
            "Hang a heavier mass beside that line, and turn the limb about two axes in every set.",
        )

    of_matrix, of_limb = slice(0, 3 * p), slice(3 * p, None)
    matrix = np.vstack([half.solution[of_matrix].reshape(3, p) @ directions.T for half in (force, torque)])
    to_matrix = np.asarray(np.kron(np.eye(3), directions), dtype=np.float64)
    square = force.square + torque.square
    return PaperMatrixFit(
        matrix=matrix,
        limb=Limb(mass=float(force.solution[of_limb].item()), mass_com=torque.solution[of_limb]),
        covariance=_join(force.covariance, torque.covariance, to_matrix),
        residual_force=float(np.sqrt(force.square / (3 * samples))),
        residual_torque=float(np.sqrt(torque.square / (3 * samples))),
        result=FitResult.DETERMINED,
        stats=FitStats(
            samples=samples,
            dropped=sum(len(one.raw) for one in sets) - samples,
            gated=0,
            residual_rms=float(np.sqrt(square / (6 * samples))),
            rank=rank,
            unknowns=unknowns,
            condition=max(force.condition, torque.condition),
        ),
    )


@dataclass(frozen=True, eq=False)
class _Solved:
    """One half of Eq. 21: its unknowns, how sure they are, and the residual."""

    solution: Matrix
    covariance: Matrix
    square: float
    rank: int
    condition: float


def _compress(one: InSituSet, offset: Matrix) -> tuple[Matrix, int]:
    """Return the triangular factor of a set's rows [g, r - o], (3 + k, 3 + k) at most, and their number."""
    rows = np.column_stack([one.gravity, one.raw - offset])
    rows = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) == 0:
        raise CalibrationRefused(
            f"'{one.name}': none of its {len(one.raw)} samples was finite.",
            "Check the names and the units of the columns, or leave the set out.",
        )
    return np.asarray(np.linalg.qr(rows, mode="r")), len(rows)


def _signal_directions(factors: Sequence[Matrix], channels: int) -> Matrix:
    """Return the six directions of the readings that gravity explains most of, shape (k, 6)."""
    if channels == 6:
        return np.eye(6)
    # The first three rows of a factor are the readings' regression on gravity.
    _, _, right = np.linalg.svd(np.vstack([factor[:3, 3:] for factor in factors]), full_matrices=True)
    return np.asarray(right[:6].T)


def _stack(
    sets: Sequence[InSituSet], factors: Sequence[Matrix], rows: int | None
) -> list[tuple[Matrix, Matrix]]:
    """Return regressors and targets of Eq. 21, for the forces and for the torques."""
    force, torque = [], []
    for one, factor in zip(sets, factors, strict=True):
        g, r = factor[:rows, :3], factor[:rows, 3:]
        zero = np.zeros(len(g))
        gx, gy, gz = g.T
        cross = np.vstack(  # [g]x of all rows: first the x components, then y, then z
            [
                np.column_stack([zero, -gz, gy]),
                np.column_stack([gz, zero, -gx]),
                np.column_stack([-gy, gx, zero]),
            ]
        )
        of_matrix = np.kron(np.eye(3), r)
        level = g.T.reshape(-1, 1)
        force.append((np.hstack([of_matrix, -level]), one.added_mass * level[:, 0]))
        torque.append((np.hstack([of_matrix, cross]), -cross @ (one.added_mass * one.added_com)))
    return [
        (np.vstack([part[0] for part in parts]), np.concatenate([part[1] for part in parts]))
        for parts in (force, torque)
    ]


def _solve(
    regressors: Matrix,
    target: Matrix,
    signal: Matrix,
    tolerance: float,
    noise: Matrix,
    rows: int,
) -> _Solved:
    """Return the least-squares solution of one half, with its rank from the part that gravity explains."""
    length = np.linalg.norm(regressors, axis=0)
    length[length == 0.0] = 1.0
    singular = np.linalg.svd(signal / length, compute_uv=False)
    least = max(tolerance * singular[0], np.max(noise / length[: len(noise)]))
    rank = int(np.sum(singular > least))
    left, full, right = np.linalg.svd(regressors / length, full_matrices=False)
    unknowns = len(length)
    if rank < unknowns:
        nothing = np.full(unknowns, np.nan)
        return _Solved(nothing, np.diag(nothing), np.nan, rank, np.inf)
    back = (right.T / full) / length[:, None]
    solution = back @ (left.T @ target)
    square = float(np.sum((target - regressors @ solution) ** 2))
    variance = square / (rows - unknowns) if rows > unknowns else np.nan
    return _Solved(solution, variance * back @ back.T, square, rank, float(full[0] / full[-1]))


def _join(force: Matrix, torque: Matrix, to_matrix: Matrix) -> Matrix:
    """Return the covariances of (C_force, m) and (C_torque, m c) in the order (C, m, m c)."""
    p, entries = to_matrix.shape[1], to_matrix.shape[0]
    carry = np.zeros((2 * entries + 4, 2 * p + 4))
    carry[:entries, :p] = to_matrix
    carry[2 * entries, p] = 1.0
    carry[entries : 2 * entries, p + 1 : 2 * p + 1] = to_matrix
    carry[2 * entries + 1 :, 2 * p + 1 :] = np.eye(3)
    return np.asarray(carry @ block_diag(force, torque) @ carry.T)


def _check_masses(sets: Sequence[InSituSet]) -> None:
    """Raise CalibrationRefused if no such sets can determine all unknowns (Lemma 2)."""
    masses = np.array([one.added_mass for one in sets])
    added = [inertial_parameters(one.added_mass, one.added_com, moving=False) for one in sets]
    different = different_masses(np.array(added))
    if different < ENOUGH_MASSES:
        count = "one added mass" if different == 1 else "two different added masses"
        raise CalibrationRefused(
            f"The sets hold {count}, and three are needed (Lemma 2) to determine the matrix.",
            "Add sets with other masses at other places; one without any added mass counts as well.",
        )
    if np.ptp(masses) <= _SAME_MASS:
        raise CalibrationRefused(
            f"All {len(sets)} sets bear the same added mass of {masses[0]:g} kg, so that nothing shows how "
            "heavy the limb itself is.",
            "Add a set with another mass, such as none.",
        )


def _check_offsets(sets: Sequence[InSituSet], offsets: ArrayLike) -> Matrix:
    """Return the offsets, shape (J, k), or raise ValueError if sets and offsets are not of one sensor."""
    if len(sets) == 0:
        raise ValueError("'sets' must hold at least one set, got none.")
    channels = sets[0].channels
    for one in sets:
        if one.channels != channels:
            raise ValueError(
                f"'{one.name}' has {one.channels} channels, but '{sets[0].name}' has {channels}: all sets "
                "must be of one sensor."
            )
    every = np.asarray(offsets, dtype=np.float64)
    if every.shape not in ((channels,), (len(sets), channels)):
        raise ValueError(
            f"'offsets' must have shape ({channels},) or ({len(sets)}, {channels}), got {every.shape}."
        )
    if not np.isfinite(every).all():
        raise ValueError(f"'offsets' must be finite, got {every}.")
    return np.broadcast_to(every, (len(sets), channels))
