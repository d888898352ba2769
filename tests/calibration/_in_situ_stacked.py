"""Section III of the in-situ paper literally: Kronecker products, permutator and one large least squares."""

import numpy as np


def skew(vector):
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def wrench_of_gravity(mass, com):
    """M(m, c) = [m I; m [c]x], shape (6, 3)."""
    return np.vstack([mass * np.eye(3), mass * skew(com)])


def estimate_offset_stacked(raw, gravity):
    """Eqs. 9-17: the unknown is (vec K, lambda), 12 numbers for 3 N rows."""
    n = len(raw)
    mean = raw.mean(axis=0)  # (9)
    U, _, _ = np.linalg.svd((raw - mean).T, full_matrices=False)  # (10)
    U1 = U[:, :3]
    coordinates = (raw - mean) @ U1
    stacked = np.hstack([np.kron(gravity, np.eye(3)), np.kron(np.ones((n, 1)), np.eye(3))])  # (16)
    unknown, *_ = np.linalg.lstsq(stacked, coordinates.ravel(), rcond=None)  # (14), (15)
    return mean + U1 @ unknown[9:]  # (11)


def permutator():
    """P of Eq. 23, vec [m I; [m c]x] = P (m, m c), shape (18, 4)."""
    columns = [wrench_of_gravity(1.0, np.zeros(3)).ravel(order="F")]
    columns += [np.vstack([np.zeros((3, 3)), skew(axis)]).ravel(order="F") for axis in np.eye(3)]
    return np.stack(columns, axis=-1)


def estimate_matrix_stacked(sets, offsets):
    """Eqs. 18-25: the unknown is (vec C, m_b, m_b c_b), 40 numbers for 6 N_T rows.

    Returns:
        C, shape (6, 6), the limb's mass and first moment, and the rank.
    """
    rows, targets = [], []
    for one, offset in zip(sets, offsets, strict=True):
        known = wrench_of_gravity(one.added_mass, one.added_com)
        of_matrix = np.kron(one.raw - offset, np.eye(6))  # vec(C r) = (r' kron I) vec C (1)
        of_limb = np.kron(one.gravity, np.eye(6)) @ permutator()
        rows.append(np.hstack([of_matrix, -of_limb]))  # (23)
        targets.append((one.gravity @ known.T).ravel())  # (22)
    unknown, _, rank, _ = np.linalg.lstsq(np.vstack(rows), np.concatenate(targets), rcond=None)  # (21)
    return unknown[:36].reshape(6, 6, order="F"), unknown[36], unknown[37:], int(rank)
