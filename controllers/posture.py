"""Four ways to shift a standing biped's posture, and how fast: the commands of a balance policy."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.controllers.stabiliser import ACTION_SIZE, ANKLE_PITCH, ANKLE_ROLL, HIP_PITCH, HIP_ROLL

POSTURES = ("sway forward", "sway left", "bow forward", "bow left")
"""Ankles and hips against each other, which keeps the torso upright; and the hips alone, which tilts it."""


def posture_matrix() -> NDArray[np.float64]:
    """Return residuals of the leg motors per unit of each posture, shape (11, 4).

    >>> forward, _, _, _ = posture_matrix().T
    >>> float(forward[[2, 4]].sum())  # hip and ankle pitch cancel: the torso stays upright
    0.0
    """
    matrix: NDArray[np.float64] = np.zeros((ACTION_SIZE, len(POSTURES)))
    # A positive ankle pitch turns the toes down, or, with the sole on the ground, the leg backwards.
    sway_forward, sway_left, bow_forward, bow_left = range(len(POSTURES))
    matrix[ANKLE_PITCH, sway_forward], matrix[HIP_PITCH, sway_forward] = -1.0, 1.0
    matrix[ANKLE_ROLL, sway_left], matrix[HIP_ROLL, sway_left] = 1.0, -1.0
    matrix[HIP_PITCH, bow_forward] = -1.0
    matrix[HIP_ROLL, bow_left] = -1.0
    return matrix


class PostureDrive:
    """Turns speeds of postures into residuals of the leg motors.

    Because of the integrator, a small constant error is removed almost completely, and random exploration of
    a policy becomes a slow sway instead of a shiver. The integrator leaks: without commands, the posture
    returns to the pattern's.

    Args:
        matrix: Residuals per unit of posture, shape (M, A).
        speed: Change of a posture per second at a full command.
        memory: Time constant in s with which a posture returns.
        dt: Duration of a step in s.

    Attributes:
        posture: Where each posture is now, within [-1, 1], shape (A,).

    Raises:
        ValueError: If a number is not finite, or one that must be positive is not.
    """

    def __init__(
        self, matrix: ArrayLike, speed: float = 1.5, memory: float = 1.0, dt: float = 1.0 / 80.0
    ) -> None:
        self.matrix = np.array(matrix, dtype=np.float64)
        if self.matrix.ndim != 2 or not np.isfinite(self.matrix).all():
            raise ValueError(
                f"'matrix' must be finite, shape (motors, postures), got shape {self.matrix.shape}."
            )
        for name, value in {"speed": speed, "memory": memory, "dt": dt}.items():
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"'{name}' must be finite and positive, got {value}.")
        self.speed, self.memory, self.dt = float(speed), float(memory), float(dt)
        self.reset()

    @property
    def size(self) -> int:
        """Number of postures, A."""
        return int(self.matrix.shape[1])

    def reset(self) -> None:
        """Go back to the pattern's posture."""
        self.posture = np.zeros(self.size)

    def __call__(self, command: ArrayLike) -> NDArray[np.float32]:
        """Move postures on by shares of the full speed, (A,), cut off at 1: residuals in [-1, 1], (M,)."""
        share = np.clip(np.asarray(command, dtype=np.float64), -1.0, 1.0)
        moved = self.posture + self.dt * (self.speed * share - self.posture / self.memory)
        self.posture = np.clip(moved, -1.0, 1.0)
        residual: NDArray[np.float32] = np.clip(self.matrix @ self.posture, -1.0, 1.0).astype(np.float32)
        return residual
