"""The truth of one control step, at every substep of the simulation.

Signs and frames are defined here, once. MuJoCo's force and torque sensors measure the load that the parent
exerts on the child; a load cell or an ankle sensor measures the load from the ground, so both change sign. A
cell reads zero under its own sole plate: the plate's weight is added back, and the rest of the reading
besides the ground is the plate's inertia while it accelerates or tilts, as on a real shoe.

A row is MuJoCo's state at the beginning of a substep together with the forces of that instant, so that all
quantities of a row belong together; the last row lies one substep before the end of the control step.
"""

from collections.abc import Sequence
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.envs.instrumentation.means import FootPlaces
from surefoot.envs.instrumentation.plate import SolePlate
from surefoot.envs.instrumentation.truth import SensedColumns, centre_of_pressure, cross
from surefoot.envs.observation import Places
from surefoot.envs.robots.nao import FEET, cell_positions, hinge_joint_names


class TruthChannels:
    """Where MuJoCo's sensors lie in one row of sensor data, and how the plates share their loads.

    Args:
        model: A compiled model with the sensors of nao.xml.
        stiffness: Relative stiffnesses of the eight cells, shape (8,).
    """

    def __init__(self, model: mujoco.MjModel, stiffness: Sequence[float]) -> None:
        def block(first: str, last: str) -> slice:
            start, end = model.sensor(first), model.sensor(last)
            return slice(int(start.adr[0]), int(end.adr[0] + end.dim[0]))

        joints = hinge_joint_names(model)
        self.size = int(model.nsensordata)
        self.time = int(model.sensor("time").adr[0])
        self.plate = block("left_plate_force", "right_plate_torque")
        self.ankle = block("left_ankle_force", "right_ankle_torque")
        self.ground = block("left_ground", "right_ground")
        self.position_sole = block("left_sole_position", "right_sole_position")
        self.axes_sole = block("left_sole_x", "right_sole_z")
        self.position_torso = block("torso_position", "torso_position")
        self.axes_torso = block("torso_x", "torso_z")
        self.accelerometer = block("accelerometer", "accelerometer")
        self.gyroscope = block("gyroscope", "gyroscope")
        self.inertial = block("accelerometer", "gyroscope")
        self.com = block("com", "com")
        self.com_velocity = block("com_velocity", "com_velocity")
        self.angular_momentum = block("angular_momentum", "angular_momentum")
        self.joint_position = block(f"{joints[0]}_position", f"{joints[-1]}_position")
        self.joint_velocity = block(f"{joints[0]}_velocity", f"{joints[-1]}_velocity")

        weight = float(np.linalg.norm(model.opt.gravity))
        self.plates = tuple(
            SolePlate(position, stiffness[4 * i : 4 * i + 4])
            for i, position in enumerate(cell_positions(model))
        )
        # Cell forces are linear in the 12 readings of both plate sensors: -reading plus the preload.
        self.force_of_plates: NDArray[np.float64] = np.zeros((12, 8))
        self.shear_of_plates: NDArray[np.float64] = np.zeros((12, 2, 8))
        preload = np.zeros(12)
        for i, (foot, plate) in enumerate(zip(FEET, self.plates, strict=True)):
            self.force_of_plates[6 * i + 2 : 6 * i + 5, 4 * i : 4 * i + 4] = -plate.share.T
            sideways = -plate.across.T.reshape(3, 2, 4)
            self.shear_of_plates[6 * i + np.array([0, 1, 5]), :, 4 * i : 4 * i + 4] = sideways
            body = model.body(f"{foot}_plate")
            load = np.array([0.0, 0.0, weight * body.mass[0]])
            arm = body.ipos - model.site(f"{foot}_sole").pos
            preload[6 * i : 6 * i + 6] = np.concatenate([load, np.cross(arm, load)])
        self.preload: NDArray[np.float64] = -preload @ self.force_of_plates
        contact, sole, axes = self.ground.start, self.position_sole.start, self.axes_sole.start
        feet = FootPlaces(
            ankle=(self.ankle.start, self.ankle.start + 6),
            contact=(contact, contact + 9),
            up=1.0,
            position_sole=(sole, sole + 3),
            axes_sole=(axes, axes + 9),
            com=self.com.start,
            force_cell=self._force_cell,
            flat=(True, True),
        )
        self.places = Places(
            feet,
            axes_torso=self.axes_torso.start,
            position_torso=self.position_torso.start,
            gyroscope=self.gyroscope.start,
            com_velocity=self.com_velocity.start,
            joints=self.joint_position,
            joint_dofs=np.array([model.joint(name).dofadr[0] for name in joints]),
        )

    def _force_cell(self, last: NDArray[np.float64], wrench: NDArray[np.float64]) -> NDArray[np.float64]:
        force: NDArray[np.float64] = (last[..., None, self.plate] @ self.force_of_plates)[..., 0, :]
        return force + self.preload


class Truth:
    """The last control step, S substeps; every array belongs to the truth and is not to be changed.

    Args:
        rows: One row of sensor data a substep, shape (S, channels).
        channels: The meaning of the columns.
    """

    def __init__(self, rows: NDArray[np.float64], channels: TruthChannels) -> None:
        self.rows = rows
        self.channels = channels

    @property
    def time(self) -> NDArray[np.float64]:
        """Simulated time in s, shape (S,)."""
        return self.rows[:, self.channels.time]

    @property
    def plate(self) -> NDArray[np.float64]:
        """The readings of both plates' sensors in N and N m, shape (S, 12)."""
        return self.rows[:, self.channels.plate]

    def sensor_columns(self) -> SensedColumns:
        """Return where in a row the sensors' loads stand."""
        parts = self.channels
        return SensedColumns(
            parts.joint_position.start, parts.inertial.start, parts.ankle.start, parts.plate.start, stride=6
        )

    def cell_map(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the map from :attr:`plate` to :attr:`force_cell`: factors (12, 8) and N to add (8,)."""
        return self.channels.force_of_plates, self.channels.preload

    @property
    def shear_cell(self) -> NDArray[np.float64]:
        """Horizontal forces of the load cells in N, along x of all eight, and then along y, shape (S, 16)."""
        return self.plate @ self.shear_map()

    def shear_map(self) -> NDArray[np.float64]:
        """Return the map from :attr:`plate` to the cells' horizontal forces, (12, 16): along x, then y."""
        return self.channels.shear_of_plates.reshape(12, 16)

    @cached_property
    def force_cell(self) -> NDArray[np.float64]:
        """Forces of the load cells in N, (left FL, FR, RL, RR, right FL, FR, RL, RR), shape (S, 8)."""
        factors, added = self.cell_map()
        return self.plate @ factors + added

    @cached_property
    def wrench_sole(self) -> NDArray[np.float64]:
        """Wrenches of the ground on the robot at and in the sole frames in N and N m, shape (S, 2, 6)."""
        ground = self.rows[:, self.channels.ground].reshape(-1, 2, 9)
        force, torque, position = ground[..., :3], ground[..., 3:6], ground[..., 6:]
        moment = torque + cross(position - self.position_sole, force)
        world = np.stack([force, moment], axis=-2)
        return (world @ self.R_world_sole).reshape(-1, 2, 6)

    @cached_property
    def wrench_ankle(self) -> NDArray[np.float64]:
        """Wrenches that the feet pass up at and in the ankle sensors' frames in N and N m, shape (S, 2, 6).

        The ground's load on the foot, and gravity less inertia of all that hangs below the sensor
        (:attr:`RobotDrawing.below_ankle`): a foot in the air reads its own weight, downwards.
        """
        return -self.rows[:, self.channels.ankle].reshape(-1, 2, 6)

    @property
    def position_sole(self) -> NDArray[np.float64]:
        """Origins of the sole frames in the world in m, shape (S, 2, 3)."""
        return self.rows[:, self.channels.position_sole].reshape(-1, 2, 3)

    @property
    def R_world_sole(self) -> NDArray[np.float64]:  # noqa: N802
        """Rotations from the sole frames to the world, shape (S, 2, 3, 3)."""
        return self.rows[:, self.channels.axes_sole].reshape(-1, 2, 3, 3).swapaxes(-1, -2)

    @property
    def position_torso(self) -> NDArray[np.float64]:
        """Origin of the torso frame in the world in m, shape (S, 3)."""
        return self.rows[:, self.channels.position_torso]

    @property
    def R_world_torso(self) -> NDArray[np.float64]:  # noqa: N802
        """Rotation from the torso frame to the world, shape (S, 3, 3)."""
        return self.rows[:, self.channels.axes_torso].reshape(-1, 3, 3).swapaxes(-1, -2)

    @property
    def com(self) -> NDArray[np.float64]:
        """Centre of mass in the world in m, shape (S, 3)."""
        return self.rows[:, self.channels.com]

    @property
    def com_velocity(self) -> NDArray[np.float64]:
        """Velocity of the centre of mass in the world in m/s, shape (S, 3)."""
        return self.rows[:, self.channels.com_velocity]

    @property
    def angular_momentum(self) -> NDArray[np.float64]:
        """Angular momentum about the centre of mass, in the world's axes, in kg m^2/s, shape (S, 3)."""
        return self.rows[:, self.channels.angular_momentum]

    @property
    def joint_position(self) -> NDArray[np.float64]:
        """Angles of all hinge joints in rad, shape (S, J)."""
        return self.rows[:, self.channels.joint_position]

    @property
    def joint_velocity(self) -> NDArray[np.float64]:
        """Speeds of all hinge joints in rad/s, shape (S, J)."""
        return self.rows[:, self.channels.joint_velocity]

    @property
    def accelerometer(self) -> NDArray[np.float64]:
        """Specific force at the IMU in its own axes in m/s^2, shape (S, 3)."""
        return self.rows[:, self.channels.accelerometer]

    @property
    def gyroscope(self) -> NDArray[np.float64]:
        """Angular velocity of the torso in the IMU's axes in rad/s, shape (S, 3)."""
        return self.rows[:, self.channels.gyroscope]

    @property
    def inertial(self) -> NDArray[np.float64]:
        """Accelerometer and gyroscope, shape (S, 6)."""
        return self.rows[:, self.channels.inertial]

    def vgrf(self) -> NDArray[np.float64]:
        """Vertical ground reaction forces (left, right) in the world at the last row in N, shape (2,)."""
        return self.rows[-1, self.channels.ground].reshape(2, 9)[:, 2].copy()

    def cop_world(self) -> NDArray[np.float64]:
        """Centre of pressure of both feet together at the last row in the world in m, shape (2,).

        NaN where both feet together bear no more than 5 N.
        """
        cop: NDArray[np.float64] = centre_of_pressure(self.rows[-1, self.channels.ground].reshape(2, 9))
        return cop
