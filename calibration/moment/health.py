"""How sure the estimates are: of forces, of the centre of pressure, of contact, and of the filter itself."""

import numpy as np
from scipy.special import ndtr

from surefoot.calibration.arrays import Array
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.front_end.readings import Sample
from surefoot.calibration.moment.columns import Columns

MOST_LOAD = 1.5
"""Body weights over which the chance of a foot's load is spread, each as likely: a step's, and no limit, as a
G1 by policy lands with 2.5."""

LEAST_ROW = 1e-6
"""Least share of the vertical that a foot sees, squared: a sole that stands on its edge sees nothing."""


def map_covariance(
    published: Array, covariance: Array, columns: Columns, weight: float, walked: Array
) -> Array:
    """Return the covariance of (a, b) in F = a F0 + b, b in N, that drift on, shape (2K, 2K).

    Args:
        published: Scales, offsets and drift, shape (M,).
        covariance: Theirs, shape (M, M).
        columns: The unknowns.
        weight: W in N.
        walked: Variances that each scale, and each zero in W^2, drifts by until it is used, shape (2, K).
    """
    K = columns.scale.stop
    at = np.arange(K)
    J = np.zeros((2 * K, len(published)))
    J[at, at] = 1.0
    J[K + at, K + at] = J[K + at, 2 * K + at] = weight
    learnt: Array = J @ covariance @ J.T
    learnt = 0.5 * (learnt + learnt.T)
    learnt[at, at] += walked[0]
    learnt[K + at, K + at] += walked[1] * (published[columns.scale] * weight) ** 2
    return learnt


def uncertainty(
    estimate: Estimate, sample: Sample, learnt: Array, spare: Array, spare_std: Array
) -> dict[str, Array]:
    """Return how sure an estimate is, by the names of its fields.

    Args:
        estimate: The estimate.
        sample: The sample that it is of.
        learnt: Covariance of (a, b), shape (2K, 2K).
        spare: How forces are made of the channels that are not out, shape (K, K).
        spare_std: Standard deviation of reconstructed forces in N, shape (K,).
    """
    to_force = spare @ np.hstack([np.diag(sample.force), np.eye(len(spare))])
    variance = variances(to_force, learnt) + spare_std**2
    row = sample.rows.sum(axis=0) @ to_force
    turned = to_cop(row, estimate.cop, estimate.vgrf.sum() if estimate.cop_valid else 1.0)
    return {
        "covariance": learnt,
        "force_std": np.sqrt(np.maximum(variance, 0.0)),
        "cop_covariance": turned @ learnt @ turned.T,
    }


def contact_probability(
    load: Array, rows: Array, learnt: Array, force: Array, noise: float, weight: float
) -> Array:
    """Return the probability that a foot bears load, shape (F,).

    By Bayes, of two things that are as likely beforehand: a foot without load, of which the estimate is off
    as its covariance says, and one with any load, of the density that :data:`MOST_LOAD` gives.

    Args:
        load: Vertical forces of the feet in N, shape (F,).
        rows: Of the vertical forces by channel, shape (F, K).
        learnt: Covariance of (a, b), shape (2K, 2K).
        force: F0 in N, shape (K,).
        noise: Standard deviation of a channel's reading in N.
        weight: W in N.
    """
    to_load = np.hstack([rows * force, rows])
    own = np.maximum((rows**2).sum(axis=1), LEAST_ROW) * noise**2
    std = np.sqrt(np.maximum(variances(to_load, learnt), 0.0) + own)
    most = MOST_LOAD * weight
    with_load = ndtr(load / std) / most
    without = np.exp(-0.5 * np.minimum(load / std, 30.0) ** 2) / (np.sqrt(2.0 * np.pi) * std)
    # A pull of no sole counts as no load.
    without = np.where(load <= 0.0, np.maximum(without, 1.0 / most), without)
    found: Array = with_load / (with_load + without)
    return found


def variances(row: Array, covariance: Array) -> Array:
    """Return variances along rows, shapes (m, n) and (n, n) to (m,)."""
    return ((row @ covariance) * row).sum(axis=1)


def to_cop(row: Array, cop: Array, load: float) -> Array:
    """Return rows that take errors of moments to the centre of pressure, to first order.

    With F_i = a_i F0_i + b_i and p = n / Fz they are (p_i - p) / Fz times the row (F0_i, 1) of each channel.

    Args:
        row: Rows of (Fz, Fz px, Fz py), shape (3, n).
        cop: Centre of pressure in m, shape (2,).
        load: Fz in N.

    Returns:
        Shape (2, n).
    """
    return (row[1:] - cop[:, None] * row[:1]) / load
