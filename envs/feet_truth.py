"""What an instrumented robot's sensors tell about its feet, in signs and frames that are settled here.

A row holds what MuJoCo's sensors measured at one instant: after a step, that at its beginning. MuJoCo's force
and torque sensors tell what the parent exerts on the child, and its contact sensor what the first body exerts
on the other; both change sign, so that all wrenches here go up into the robot.

The cells are springs under a massless plate that covers the sole (:class:`~surefoot.envs.SolePlate`): they
share what the ground exerts, and their centre of pressure is that of the contacts.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from surefoot.envs.foot_geometry import FootGeometry
from surefoot.envs.plate import SolePlate
from surefoot.envs.truth import CONTACT_FORCE

FOOT_WIDTH: Final = 27
"""Columns of a foot: ankle's force and torque, contacts' force, torque and place, sole's place and axes."""

TRUNK_WIDTH: Final = 27
"""Columns after the feet: trunk's place and axes, CoM, its velocity, angular momentum, IMU."""


class FeetTruth:
    """What F feet and the trunk felt at one instant, or at many.

    Args:
        rows: Readings, shape (..., 27 F + 27); they are copied.
        feet: The feet's geometry, in the order of the rows.
        plates: How the cells of each foot share a load; None for a foot with a flaw.
    """

    def __init__(
        self,
        rows: NDArray[np.float64],
        feet: tuple[FootGeometry, ...],
        plates: tuple[SolePlate | None, ...],
    ) -> None:
        self.feet = feet
        self._plates = plates
        split = FOOT_WIDTH * len(feet)
        rows = rows.copy()
        self._foot = rows[..., :split].reshape(*rows.shape[:-1], len(feet), FOOT_WIDTH)
        self._trunk = rows[..., split:]

    @property
    def wrench_ankle(self) -> NDArray[np.float64]:
        """Wrenches that the feet pass up at the ankles in the feet's axes in N and N m, shape (..., F, 6)."""
        return -self._foot[..., :6]

    @property
    def force_world(self) -> NDArray[np.float64]:
        """Forces of everything that touches a foot on it, in the world in N, shape (..., F, 3)."""
        return -self._foot[..., 6:9]

    @property
    def wrench_sole(self) -> NDArray[np.float64]:
        """Wrenches of the ground on the robot at and in the sole frames in N and N m, shape (..., F, 6).

        Whatever else touches a foot, such as the other foot, counts as ground.
        """
        force = self.force_world
        moment = -self._foot[..., 9:12] + np.cross(self._foot[..., 12:15] - self.position_sole, force)
        world = np.stack([force, moment], axis=-2)
        return (world @ self.R_world_sole).reshape(*world.shape[:-2], 6)

    @property
    def vgrf(self) -> NDArray[np.float64]:
        """Vertical ground reaction forces in the world in N, shape (..., F)."""
        return self.force_world[..., 2]

    @property
    def position_sole(self) -> NDArray[np.float64]:
        """Origins of the sole frames in the world in m, shape (..., F, 3)."""
        return self._foot[..., 15:18]

    @property
    def R_world_sole(self) -> NDArray[np.float64]:  # noqa: N802
        """Rotations from the sole frames to the world, shape (..., F, 3, 3)."""
        return _rotation(self._foot[..., 18:27])

    @property
    def cop_sole(self) -> NDArray[np.float64]:
        """Centres of pressure in the sole frames in m, shape (..., F, 2); NaN at no more than 5 N.

        Raises:
            ValueError: If a foot has no area, with the reason.
        """
        self._refuse_flaws()
        wrench = self.wrench_sole
        load = np.where(wrench[..., 2] > CONTACT_FORCE, wrench[..., 2], np.nan)
        return np.stack([-wrench[..., 4] / load, wrench[..., 3] / load], axis=-1)

    @property
    def force_cell(self) -> NDArray[np.float64]:
        """Forces of the load cells in N, foot by foot FL, FR, RL, RR, shape (..., F, 4).

        A cell is pulled where the ground pushes outside the cells.

        Raises:
            ValueError: If a foot has no area, with the reason.
        """
        plates = self._refuse_flaws()
        wrench = self.wrench_sole[..., 2:5]
        return np.stack([wrench[..., i, :] @ plate.share.T for i, plate in enumerate(plates)], axis=-2)

    @property
    def position_trunk(self) -> NDArray[np.float64]:
        """Origin of the trunk's frame in the world in m, shape (..., 3)."""
        return self._trunk[..., :3]

    @property
    def R_world_trunk(self) -> NDArray[np.float64]:  # noqa: N802
        """Rotation from the trunk's frame to the world, shape (..., 3, 3)."""
        return _rotation(self._trunk[..., 3:12])

    @property
    def com(self) -> NDArray[np.float64]:
        """Centre of mass of the robot in the world in m, shape (..., 3)."""
        return self._trunk[..., 12:15]

    @property
    def com_velocity(self) -> NDArray[np.float64]:
        """Velocity of the centre of mass in the world in m/s, shape (..., 3)."""
        return self._trunk[..., 15:18]

    @property
    def angular_momentum(self) -> NDArray[np.float64]:
        """Angular momentum about the centre of mass, in the world's axes, in kg m^2/s, shape (..., 3)."""
        return self._trunk[..., 18:21]

    @property
    def accelerometer(self) -> NDArray[np.float64]:
        """Specific force at the IMU in its own axes in m/s^2, shape (..., 3)."""
        return self._trunk[..., 21:24]

    @property
    def gyroscope(self) -> NDArray[np.float64]:
        """Angular velocity of the IMU in its own axes in rad/s, shape (..., 3)."""
        return self._trunk[..., 24:27]

    def _refuse_flaws(self) -> list[SolePlate]:
        """Refuse what a foot without area cannot tell."""
        for foot in self.feet:
            if foot.flaw:
                raise ValueError(foot.flaw)
        return [plate for plate in self._plates if plate is not None]


def _rotation(axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn three axes in a row, shape (..., 9), into a rotation with these columns, shape (..., 3, 3)."""
    return axes.reshape(*axes.shape[:-1], 3, 3).swapaxes(-1, -2)
