"""What the bare NaoEnv shows: the state vector and the true forces under the feet.

Everything is made from the last row of the control step's truth, for one robot or for many.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.envs.command import Command, command_state, turned
from surefoot.envs.instrumentation.truth import CONTACT_FORCE
from surefoot.envs.nao.truth import TruthChannels
from surefoot.envs.numbers import ONE, Number, Numbers
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
        numbers: Whether it sees one robot, or many.
    """

    numbers: Numbers = ONE

    def __init__(self, model: Any, channels: TruthChannels) -> None:
        joints = len(hinge_joint_names(model))
        self.channels = channels
        self._table = ObservationTable(joints, FORCE_BOUND)
        self.space, self.state_layout = self._table.space, self._table.state_layout
        self._measured = slice(0, 2 * joints)
        self._joints = slice(channels.joint_position.start, channels.joint_velocity.stop)
        self._cop: list[Number] = [0.0, 0.0]
        self._cop_foot: list[list[Number]] = [[0.0, 0.0], [0.0, 0.0]]

    def reset(self, robots: Any = True) -> None:
        """Start with centres of pressure at the origin; of many robots, for those of a mask."""
        cop, where = [self._cop, *self._cop_foot], self.numbers.where
        self._cop, *self._cop_foot = [[where(robots, 0.0, part) for part in place] for place in cop]

    def observe(
        self, last: NDArray[np.float64], row: Any, command: Command
    ) -> tuple[Observation, dict[str, NDArray[np.float64]]]:
        """Show the last row of a control step.

        Args:
            last: The row, shape (..., channels).
            row: Its parts.
            command: What the robot commands at its end.

        Returns:
            The observation, and the truth at the control rate for ``info``.
        """
        m, where, choose = self.numbers, self.channels, self.numbers.where
        force_cell = (last[..., None, where.plate] @ where.force_of_plates)[..., 0, :] + where.preload

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
            safe = choose(valid, normal, 1.0)
            x, y = -torque_y / safe, torque_x / safe
            held_x, held_y = self._cop_foot[foot]
            cop_foot.append([choose(valid, x, 0.0), choose(valid, y, 0.0)])
            self._cop_foot[foot] = [choose(valid, x, held_x), choose(valid, y, held_y)]

        valid = load > CONTACT_FORCE
        safe = choose(valid, load, 1.0)
        cop_world = [choose(valid, -moment_y / safe, 0.0), choose(valid, moment_x / safe, 0.0)]
        middle_x, middle_y, heading = where.level(row, m)
        x, y = turned(cop_world[0] - middle_x, cop_world[1] - middle_y, heading, m)
        held_x, held_y = self._cop
        self._cop = [choose(valid, x, held_x), choose(valid, y, held_y)]

        state, valids = self._state(last, row, command), [valid, *foot_valid]
        return self._table.bounded(state, force_cell, self._cop_foot, self._cop, valids, m), {
            "force_cell": force_cell,
            "vgrf": m.array(vgrf),
            "cop_world": m.array(cop_world),
            "cop_foot": m.array(cop_foot),
            "cop_valid": m.array(valids),
            "com": last[..., where.com].copy(),
            "wrench_sole": m.array(wrench),
        }

    def _state(self, last: NDArray[np.float64], row: Any, command: Command) -> NDArray[np.float32]:
        m, torso, gyro = self.numbers, self.channels.axes_torso.start, self.channels.gyroscope.start
        x_up, y_up, z_up = row[torso + 2], row[torso + 5], row[torso + 8]
        state = np.empty((*last.shape[:-1], self._table.size), dtype=np.float32)
        state[..., self._measured] = last[..., self._joints]
        state[..., self._measured.stop :] = m.array(
            [
                m.atan2(y_up, z_up),
                -m.asin(m.clip(x_up, -1.0, 1.0)),
                *row[gyro : gyro + 3],
                *command_state(command, m),
            ]
        )
        return state
