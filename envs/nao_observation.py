"""What the bare NaoEnv shows: the state vector and the true forces under the feet.

Everything is made from the last row of the control step's truth. The few numbers that it takes are handled as
plain floats, which for arrays this small is several times faster than NumPy.
"""

from math import asin, atan2, cos, nan, sin
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.envs.command import Command
from surefoot.envs.robot import hinge_joint_names
from surefoot.envs.truth import CONTACT_FORCE, Truth, TruthChannels

Observation = dict[str, NDArray[Any]]

FORCE_BOUND = 1000.0
COP_BOUND = 1.0


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
        bounds = {
            "joint_position": (joints, np.pi),
            "joint_velocity": (joints, 50.0),
            "tilt": (2, np.pi),
            "gyroscope": (3, 50.0),
            "com_reference": (2, 1.0),
            "com_reference_velocity": (2, 2.0),
            "cop_reference": (2, 1.0),
            "stance": (2, 1.0),
            "phase": (2, 1.0),
        }
        self.state_layout: dict[str, slice] = {}
        end = 0
        for name, (size, _) in bounds.items():
            self.state_layout[name] = slice(end, end + size)
            end += size
        self._high = np.concatenate([np.full(n, high, dtype=np.float32) for n, high in bounds.values()])
        self._low = -self._high
        self._low[self.state_layout["stance"]] = 0.0
        self._measured = slice(0, 2 * joints)
        self._joints = slice(channels.joint_position.start, channels.joint_velocity.stop)
        self.space: Any = spaces.Dict(
            {
                "state": spaces.Box(self._low.copy(), self._high.copy(), dtype=np.float32),
                "foot_force": spaces.Box(-FORCE_BOUND, FORCE_BOUND, (8,), dtype=np.float32),
                "cop_foot": spaces.Box(-COP_BOUND, COP_BOUND, (2, 2), dtype=np.float32),
                "cop": spaces.Box(-COP_BOUND, COP_BOUND, (2,), dtype=np.float32),
                "cop_valid": spaces.MultiBinary(3),
            }
        )
        self.reset()

    def reset(self) -> None:
        """Forget the centres of pressure of the last episode."""
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
            cop_foot.append(self._cop_foot[foot] if valid else [nan, nan])

        valid = load > CONTACT_FORCE
        cop_world = [nan, nan]
        if valid:
            cop_world = [-moment_y / load, moment_x / load]
            heading = atan2(row[axes + 1] + row[axes + 10], row[axes] + row[axes + 9])
            middle_x, middle_y = (
                0.5 * (row[origin] + row[origin + 3]),
                0.5 * (row[origin + 1] + row[origin + 4]),
            )
            self._cop = _level(cop_world[0] - middle_x, cop_world[1] - middle_y, heading)

        observation: Observation = {
            "state": self._state(last, row, command),
            "foot_force": _clipped(force_cell, FORCE_BOUND),
            "cop_foot": _clipped(self._cop_foot, COP_BOUND),
            "cop": _clipped(self._cop, COP_BOUND),
            "cop_valid": np.array([valid, *foot_valid], dtype=np.int8),
        }
        return observation, {
            "force_cell": force_cell,
            "vgrf": np.array(vgrf),
            "cop_world": np.array(cop_world),
            "cop_foot": np.array(cop_foot),
            "com": last[where.com].copy(),
            "wrench_sole": np.array(wrench),
        }

    def _state(self, last: NDArray[np.float64], row: list[float], command: Command) -> NDArray[np.float32]:
        torso = self.channels.axes_torso.start
        x_up, y_up, z_up = row[torso + 2], row[torso + 5], row[torso + 8]
        gyro = self.channels.gyroscope.start
        soles = command.position_sole.tolist()
        left, right = command.yaw_sole.tolist()
        middle_x, middle_y = 0.5 * (soles[0][0] + soles[1][0]), 0.5 * (soles[0][1] + soles[1][1])
        heading = atan2(sin(left) + sin(right), cos(left) + cos(right))
        com, velocity, cop = command.com.tolist(), command.com_velocity.tolist(), command.cop.tolist()
        angle = 2.0 * np.pi * command.phase
        state = np.empty(self._high.size, dtype=np.float32)
        state[self._measured] = last[self._joints]
        state[self._measured.stop :] = [
            atan2(y_up, z_up),
            -asin(max(-1.0, min(1.0, x_up))),
            *row[gyro : gyro + 3],
            *_level(com[0] - middle_x, com[1] - middle_y, heading),
            *_level(velocity[0], velocity[1], heading),
            *_level(cop[0] - middle_x, cop[1] - middle_y, heading),
            *command.stance.tolist(),
            sin(angle),
            cos(angle),
        ]
        np.maximum(state, self._low, out=state)
        np.minimum(state, self._high, out=state)
        return state


def _clipped(value: Any, bound: float) -> NDArray[np.float32]:
    clipped = np.array(value, dtype=np.float32)
    np.maximum(clipped, -bound, out=clipped)
    np.minimum(clipped, bound, out=clipped)
    return clipped


def _level(x: float, y: float, heading: float) -> list[float]:
    c, s = cos(heading), sin(heading)
    return [c * x + s * y, c * y - s * x]
