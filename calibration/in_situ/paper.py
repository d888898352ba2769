"""The paper's own regressions (Traversaro, Pucci and Nori, 2015): offsets (III-B) and the matrix (III-C).

**III-B.** At rest r = C^-1 M g + o (Eq. 7) lies in a three-dimensional affine space, whatever the limb's mass
(Lemma 1), and on an ellipsoid in it with the offset in its centre. In an orthonormal basis U1 of that space

    U1' (r_i - r_mean) = K g_i + lambda,                                                    (13)

and its value for no gravity is the offset, o = r_mean + U1 lambda (11). The paper stacks 3 N rows of 12
columns with the Kronecker product (14-17); the three rows of a sample share their regressors and the
readings' mean is zero, so that lambda = -K g_mean and K is a regression of 3 unknowns on centred samples.
Gravity must turn in all three dimensions. K takes up any rotation and any scale between the accelerometer and
the sensor, but a **bias of the accelerometer** goes straight into the offset as K b. Noise of gravity
shrinks K.

**III-C.** C (r - o) = (M_b + M_a^j) g holds for the samples of the j-th added mass (18): M_a^j is known, the
matrix C and the limb's own mass and first moment in M_b are not. With M(m, c) = [m I; m [c]x] and
[c]x g = -[g]x c, the upper and the lower three rows share no unknown,

    C_force  (r - o) - m_b g           = m_a g,               3 k + 1 unknowns,
    C_torque (r - o) + [g]x (m_b c_b)  = -[g]x (m_a c_a),     3 k + 3 unknowns,

which together are the paper's 6 N rows and 40 unknowns for k = 6 (21-24). All rows of a set are the same
linear function of (g, r - o): the triangular factor of [g, r - o], nine rows, stands for the set. That is the
stacked solution itself, and unlike normal equations it does not square the condition number. Of k > 6
channels, readings at rest span six dimensions; C is zero across them (the smallest C).

**Lemma 2**: fewer than three sets leave C undetermined (25). Three do not always suffice: masses must differ,
and the whole limb's centres of mass must not lie on one line. Noise would fill any direction, so that the
rank is judged by the readings' part that gravity explains, against the noise.

**The weakness of the method**: the noise sits in the regressors r. Least squares then shrinks C and, with it,
the limb's mass (errors in variables). With white noise of 0.3 % of each channel's spread, a leg of 4.9 kg
under the paper's masses comes out at 3.8 kg while the semi-axes of its forces agree within 3 % and the added
masses within 0.05 kg: neither check shows it, and more samples do not help. So no covariance is given; for
work, fit where the noise is (:func:`~surefoot.calibration.in_situ.calibrate_in_situ`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.arrays import of_unit_length
from surefoot.calibration.imu.gravity_spread import MINIMUM_SPREAD, check_gravity_spread
from surefoot.calibration.in_situ.data import InSituSet, Matrix
from surefoot.calibration.in_situ.fit import Limb
from surefoot.calibration.in_situ.model import (
    AXES,
    ENOUGH_MASSES,
    SPREAD_ROUNDING,
    different_masses,
    inertial_parameters,
    stack_equations,
    transform_basis,
)
from surefoot.calibration.results import CalibrationRefused


@dataclass(frozen=True, eq=False)
class OffsetFit:
    """The offset of a sensor and the space that its readings lie in.

    Attributes:
        offset: o in counts, shape (k,).
        basis: U1, orthonormal, in the order of falling spread, shape (k, 3).
        mean: r_mean in counts, shape (k,).
        response: K in counts per m/s^2: the semi-axes of the ellipsoid are its singular values times g, shape
            (3, 3).
        affine_residual: Residual outside the three-space of Lemma 1 as a share of the readings' spread (root
            of the ratio of the squares), between 0 and 1.
    """

    offset: NDArray[np.float64]
    basis: NDArray[np.float64]
    mean: NDArray[np.float64]
    response: NDArray[np.float64]
    affine_residual: float

    def coordinates(self, raw: ArrayLike) -> NDArray[np.float64]:
        """Return readings in the three-space, U1' (r - r_mean) (in-situ paper, Eq. 13, left; Fig. 5).

        Args:
            raw: Counts, shape (..., k).

        Returns:
            Coordinates in counts, shape (..., 3); the offset's are ``coordinates(offset)``.
        """
        return np.asarray((np.asarray(raw, dtype=np.float64) - self.mean) @ self.basis)


def estimate_offset(
    raw: ArrayLike, gravity: ArrayLike, *, minimum_spread: float = MINIMUM_SPREAD
) -> OffsetFit:
    """Return a sensor's offset from readings at rest in many orientations (in-situ paper, Eqs. 9-17).

    Args:
        raw: Counts, shape (n, k) with k >= 3. Samples that are not finite are left out.
        gravity: In the sensor's frame, or in any frame that is fixed to it, in m/s^2, shape (n, 3).
        minimum_spread: Standard deviation of gravity along its least seen direction, over gravity's size,
            that is asked for. It must lie above the noise of ``gravity``.

    Returns:
        The offset.

    Raises:
        ValueError: If the shapes do not belong together.
        CalibrationRefused: If gravity was not seen in enough directions, or the readings did not react to it.

    >>> gravity = 9.81 * np.vstack([np.eye(3), -np.eye(3)])
    >>> response = np.arange(18.0).reshape(3, 6) ** 2
    >>> estimate_offset(gravity @ response + 250.0, gravity).offset.round(6)
    array([250., 250., 250., 250., 250., 250.])
    """
    r, g = _finite_rows(raw, gravity)
    r_mean, g_mean = r.mean(axis=0), g.mean(axis=0)  # (9)
    factor = np.asarray(np.linalg.qr(np.column_stack([g - g_mean, r - r_mean]), mode="r"))
    g_factor, r_factor = factor[:, :3], factor[:, 3:]
    check_gravity_spread(
        g_factor,
        float(np.linalg.norm(g)),
        minimum_spread,
        "the offset across it",
        "Turn the limb about two axes: tilt it sideways as well as back and forth.",
    )
    _, singular, right = np.linalg.svd(r_factor, full_matrices=False)  # (10)
    _check_reaction(singular)
    basis = right[:3].T
    # The centred form of (14-17): the mean of U1' (r - r_mean) is zero.
    K = np.linalg.solve(g_factor[:3], r_factor[:3] @ basis).T
    offset = r_mean - basis @ (K @ g_mean)  # (11) with lambda = -K g_mean

    return OffsetFit(
        offset=offset,
        basis=basis,
        mean=r_mean,
        response=K,
        affine_residual=float(np.linalg.norm(singular[3:]) / np.linalg.norm(singular)),
    )


def _finite_rows(raw: ArrayLike, gravity: ArrayLike) -> tuple[Matrix, Matrix]:
    """Return the samples that are finite."""
    r, g = np.asarray(raw, dtype=np.float64), np.asarray(gravity, dtype=np.float64)
    if r.ndim != 2 or r.shape[1] < 3:
        raise ValueError(f"'raw' must have shape (n, k) with k >= 3, got {r.shape}.")
    if g.shape != (len(r), 3):
        raise ValueError(f"'gravity' must have shape ({len(r)}, 3) like 'raw', got {g.shape}.")
    finite = np.isfinite(np.hstack([r, g])).all(axis=1)
    if not finite.any():
        raise CalibrationRefused(
            f"None of the {len(r)} samples was finite.", "Check the names and the units of the columns."
        )
    return r[finite], g[finite]


def _check_reaction(singular: Matrix) -> None:
    """Refuse readings, by their singular values, that gravity does not move along three dimensions."""
    if singular[2] <= SPREAD_ROUNDING * singular[0]:
        raise CalibrationRefused(
            "The readings span fewer than the three dimensions of gravity (Lemma 1), so that the sensor did "
            "not react to all of it.",
            "Check that the channels are alive and that the columns are those of this sensor.",
        )


def _noise_of_columns(sets: Sequence[InSituSet], factors: list[Matrix], samples: int) -> Matrix:
    """Return the singular values that white noise of the readings would have, of each column."""
    # The rows beyond gravity's three hold the part that gravity does not explain.
    spare = max(samples - 3 * len(sets), 1)
    noise = np.sqrt(sum(np.sum(factor[3:, 3:] ** 2, axis=0) for factor in factors) / spare)
    return np.asarray(np.sqrt(3 * len(sets)) * noise)


def _check_rank(
    sets: Sequence[InSituSet], factors: list[Matrix], length: Matrix, tolerance: float, noise: Matrix
) -> None:
    """Refuse sets that leave an unknown, one for each of the columns' lengths, undetermined."""
    explained = np.linalg.svd(_stack(sets, [factor[:3] for factor in factors])[0] / length, compute_uv=False)
    least = max(tolerance * explained[0], float(np.max(noise / length[: len(noise)])))
    rank, unknowns = int(np.sum(explained > least)), len(length)
    if rank < unknowns:
        raise CalibrationRefused(
            f"The sets determine {rank} of {unknowns} unknowns of matrix and limb although they hold three "
            "different added masses: beside the noise of the readings, the centres of mass lie on one line, "
            "or gravity hardly turned.",
            "Hang a heavier mass beside that line, and turn the limb about two axes in every set.",
        )


@dataclass(frozen=True, eq=False)
class PaperMatrixFit:
    """The matrix C of a sensor with k channels and the limb that hung on it.

    Attributes:
        matrix: C in N and N m per count, shape (6, k).
        limb: The body beyond the sensor without the added masses.
    """

    matrix: Matrix
    limb: Limb


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

    noise = noise_margin * _noise_of_columns(sets, factors, samples)
    rows, target = _stack(sets, factors)
    rows, length = of_unit_length(rows)
    _check_rank(sets, factors, length, tolerance, noise)
    solution = np.linalg.lstsq(rows, target, rcond=None)[0] / length
    return PaperMatrixFit(
        matrix=solution[: AXES * p].reshape(AXES, p) @ directions.T,
        limb=Limb(mass=float(solution[AXES * p]), mass_com=solution[AXES * p + 1 :]),
    )


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


def _stack(sets: Sequence[InSituSet], factors: Sequence[Matrix]) -> tuple[Matrix, Matrix]:
    """Return regressors and targets of Eq. 21 by rows [g, r - o] of each set."""
    added = [inertial_parameters(one.added_mass, one.added_com, moving=False) for one in sets]
    parts = [(factor[:, :3], factor[:, 3:]) for factor in factors]
    return stack_equations(transform_basis(moving=False), parts, added)


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
    if np.ptp(masses) == 0.0:
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
