r"""Preview control of the centre of mass, so that the zero-moment point goes where it should.

After Kajita, Kanehiro, Kaneko, Fujiwara, Harada, Yokoi and Hirukawa, "Biped walking pattern generation by
using preview control of zero-moment point", ICRA 2003. The robot is a cart on a table: a mass at constant
height :math:`z_c` whose jerk :math:`u` is the input,

.. math:: p = x - \frac{z_c}{g} \ddot x.

Sampled with period :math:`T`, the state :math:`(x, \dot x, \ddot x)` obeys

.. math::
    A = \begin{pmatrix} 1 & T & T^2/2 \\ 0 & 1 & T \\ 0 & 0 & 1 \end{pmatrix},\quad
    B = \begin{pmatrix} T^3/6 \\ T^2/2 \\ T \end{pmatrix},\quad
    C = \begin{pmatrix} 1 & 0 & -z_c/g \end{pmatrix},

and the controller that minimises :math:`\sum Q_e e^2 + R\, \Delta u^2`, :math:`e = p - p^{ref}`, knowing the
reference :math:`N` samples ahead, is

.. math:: u_k = -G_i \sum_{i \le k} e_i - G_x x_k - \sum_{j=1}^{N} G_p(j)\, p^{ref}_{k+j}.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from surefoot.arrays import Floats

GRAVITY = 9.81
"""Acceleration of free fall in m/s²."""

HORIZON = 2.0  # how far ahead the reference is known, in s

ERROR_WEIGHT = 1.0  # :math:`Q_e`, per m² of zero-moment point error
INPUT_WEIGHT = 1e-6  # :math:`R`, per (m/s³)² of jerk increment


class CartTable:
    """The cart-table model, with the centre of mass at a height in m above the ground, in steps of ``dt`` s.

    State transition ``A``, (3, 3), input ``B``, (3,), and output ``C``, (3,): the zero-moment point.
    """

    def __init__(self, height: float, dt: float) -> None:
        self.height, self.dt = height, dt
        self.A = np.array([[1.0, dt, dt * dt / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
        self.B = np.array([dt**3 / 6, dt * dt / 2, dt])
        self.C = np.array([1.0, 0.0, -height / GRAVITY])


class PreviewTrack(NamedTuple):
    """A motion of the centre of mass along some axes, each of shape (ticks, axes)."""

    position: Floats  # in m
    velocity: Floats  # in m/s
    acceleration: Floats  # in m/s²
    zmp: Floats  # zero-moment point of the cart-table in m


def preview_gains(model: CartTable) -> tuple[float, Floats, Floats]:
    """Solve the Riccati equation of the cart-table augmented by the summed error.

    Gains on the summed error, on the state, shape (3,), and on the reference one to N samples ahead, (N,).
    """
    A, B, C = model.A, model.B, model.C
    # The augmented state is (e, dx): the error and the change of the cart's state.
    A_augmented = np.block([[np.ones((1, 1)), (C @ A)[None]], [np.zeros((3, 1)), A]])
    B_augmented = np.concatenate([[C @ B], B])[:, None]
    Q = np.zeros((4, 4))
    Q[0, 0] = ERROR_WEIGHT
    P = solve_discrete_are(A_augmented, B_augmented, Q, np.array([[INPUT_WEIGHT]]))
    inverse = 1.0 / (INPUT_WEIGHT + float(B_augmented[:, 0] @ P @ B_augmented[:, 0]))
    gain = inverse * (B_augmented[:, 0] @ P @ A_augmented)
    closed = A_augmented - np.outer(B_augmented[:, 0], gain)
    samples = round(HORIZON / model.dt)
    preview = np.empty(samples)
    # The reference enters the augmented system through the error alone.
    X = -closed.T @ P[:, 0] * ERROR_WEIGHT
    preview[0] = -gain[0]
    for j in range(1, samples):
        preview[j] = inverse * float(B_augmented[:, 0] @ X)
        X = closed.T @ X
    return float(gain[0]), gain[1:], preview


def track_zmp(reference: Floats, model: CartTable) -> PreviewTrack:
    """Move the cart so that its zero-moment point follows a reference in m, shape (ticks, axes).

    It starts at rest above the reference's start; beyond its end the reference stays where it ended. One that
    is not finite or not of that shape is refused with a ValueError.
    """
    reference = np.asarray(reference, dtype=np.float64)
    if reference.ndim != 2 or not len(reference):
        raise ValueError(f"'reference' must have shape (ticks, axes), got {reference.shape}.")
    if not np.isfinite(reference).all():
        raise ValueError("'reference' holds values that are not finite.")
    integral, of_state, preview = preview_gains(model)
    ticks, axes = reference.shape
    ahead = len(preview)
    # Measured from where it starts, the reference is zero before the walk, and so is every sum.
    origin = reference[0]
    shifted = reference - origin
    padded = np.concatenate([shifted, np.repeat(shifted[-1:], ahead, axis=0)])
    previewed = np.stack(
        [np.convolve(padded[1:, axis], preview[::-1], mode="valid") for axis in range(axes)], axis=1
    )
    A, B, C = model.A, model.B[:, None], model.C
    state, total = np.zeros((3, axes)), np.zeros(axes)
    states = np.empty((ticks, 3, axes))
    for k in range(ticks):
        states[k] = state
        total = total + (C @ state - shifted[k])
        jerk = -integral * total - of_state @ state - previewed[k]
        state = A @ state + B * jerk
    zmp = np.einsum("s,ksa->ka", C, states) + origin
    return PreviewTrack(states[:, 0] + origin, states[:, 1], states[:, 2], zmp)
