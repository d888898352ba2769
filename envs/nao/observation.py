"""What the bare NaoEnv shows: the state vector and the true forces under the feet.

Everything is made from the last row of the control step's truth. The few numbers that it takes are handled as
plain floats, which for arrays this small is several times faster than NumPy.
"""

from math import asin, atan2
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.envs.command import Command, command_state, turned
from surefoot.envs.instrumentation.truth import CONTACT_FORCE
from surefoot.envs.nao.truth import Truth, TruthChannels
from surefoot.envs.observation import FORCE_BOUND, Observation, ObservationTable
from surefoot.envs.robots.nao import hinge_joint_names


class NaoObserver:
    """Turns truth and command into an observation; holds the last valid centres of pressure.

    Args:
        model: The compiled robot.
        channels: Where the sensors lie in a row of truth.

    Attributes:
        space: The observation space.
        state_layout: Where each part lies in the state vector.
    """

    def __init__(self, model: Any, channels: TruthChannels) -> None:
        joints = len(hinge_joint_names(model))
        self.channels = channels
        self._table = ObservationTable(joints, FORCE_BOUND)
        self.space, self.state_layout = self._table.space, self._table.state_layout
        self._measured = slice(0, 2 * joints)
        self._joints = slice(channels.joint_position.start, channels.joint_velocity.stop)
        self.reset()

    def reset(self) -> None:
        """Start with centres of pressure at the origin."""
        self._cop = [0.0, 0.0]
        self._cop_foot = [[0.0, 0.0], [0.0, 0.0]]

    def observe(self, truth: Truth, command: Command) -> tuple[Observation, dict[str, NDArray[np.float64]]]:
        """Show the last row of a control step.

        Args:
            truth: The control step.
            command: What the robot commands at its end.

        Returns:
            The observation, and the truth at the control rate for ``info``.
        """
        last = truth.rows[-1]
        row: list[float] = last.tolist()
        where = self.channels
        force_cell = last[where.plate] @ where.force_of_plates + where.preload

        wrench, vgrf, cop_foot, foot_valid = [], [], [], []
        ground, origin, axes = where.ground.start, where.position_sole.start, where.axes_sole.start
        load = moment_x = moment_y = 0.0
        for foot in (0, 1):
            i, j, k = ground + 9 * foot, origin + 3 * foot, axes + 9 * foot
            fx, fy, fz, tx, ty, tz, px, py, pz = row[i : i + 9]
            x0, y0, z0 = row[j : j + 3]
            xx, xy, xz, yx, yy, yz, zx, zy, zz = row[k : k + 9]
            load += fz
            moment_x += tx + py * fz
            moment_y += ty - px * fz
            rx, ry, rz = px - x0, py - y0, pz - z0
            tx, ty, tz = tx + ry * fz - rz * fy, ty + rz * fx - rx * fz, tz + rx * fy - ry * fx
            normal = zx * fx + zy * fy + zz * fz
            torque_x = xx * tx + xy * ty + xz * tz
            torque_y = yx * tx + yy * ty + yz * tz
            wrench.append(
                [
                    xx * fx + xy * fy + xz * fz,
                    yx * fx + yy * fy + yz * fz,
                    normal,
                    torque_x,
                    torque_y,
                    zx * tx + zy * ty + zz * tz,
                ]
            )
            vgrf.append(fz)
            valid = normal > CONTACT_FORCE
            foot_valid.append(valid)
            if valid:
                self._cop_foot[foot] = [-torque_y / normal, torque_x / normal]
            cop_foot.append(self._cop_foot[foot] if valid else [0.0, 0.0])

        valid = load > CONTACT_FORCE
        cop_world = [0.0, 0.0]
        if valid:
            cop_world = [-moment_y / load, moment_x / load]
            heading = atan2(row[axes + 1] + row[axes + 10], row[axes] + row[axes + 9])
            middle_x, middle_y = (
                0.5 * (row[origin] + row[origin + 3]),
                0.5 * (row[origin + 1] + row[origin + 4]),
            )
            self._cop = turned(cop_world[0] - middle_x, cop_world[1] - middle_y, heading)

        state, valids = self._state(last, row, command), [valid, *foot_valid]
        return self._table.bounded(state, force_cell, self._cop_foot, self._cop, valids), {
            "force_cell": force_cell,
            "vgrf": np.array(vgrf),
            "cop_world": np.array(cop_world),
            "cop_foot": np.array(cop_foot),
            "cop_valid": np.array(valids),
            "com": last[where.com].copy(),
            "wrench_sole": np.array(wrench),
        }

    def _state(self, last: NDArray[np.float64], row: list[float], command: Command) -> NDArray[np.float32]:
        torso = self.channels.axes_torso.start
        x_up, y_up, z_up = row[torso + 2], row[torso + 5], row[torso + 8]
        gyro = self.channels.gyroscope.start
        state = np.empty(self._table.size, dtype=np.float32)
        state[self._measured] = last[self._joints]
        state[self._measured.stop :] = [
            atan2(y_up, z_up),
            -asin(max(-1.0, min(1.0, x_up))),
            *row[gyro : gyro + 3],
            *command_state(command),
        ]
        return state
