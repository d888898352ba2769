"""The truth of one control step, at every substep of the simulation.

Signs and frames are defined here, once. MuJoCo's force and torque sensors measure the load that the parent
exerts on the child; a load cell or an ankle sensor measures the load from the ground, so both change sign. A
cell reads zero under its own sole plate: the plate's weight is added back, and the rest of the reading
besides the ground is the plate's inertia while it accelerates or tilts, as on a real shoe.

A row is MuJoCo's state at the beginning of a substep together with the forces of that instant, so that all
quantities of a row belong together; the last row lies one substep before the end of the control step.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.envs.instrumentation.means import FootPlaces
from surefoot.envs.instrumentation.plate import SolePlate
from surefoot.envs.instrumentation.robot import RowColumns, SensedColumns
from surefoot.envs.instrumentation.truth import RobotTruth
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

        def of_feet(what: str, numbers: int) -> NDArray[np.intp]:
            part = block(f"left_{what.split()[0]}", f"right_{what.split()[-1]}")
            return np.arange(part.start, part.stop).reshape(len(FEET), numbers)

        joints = hinge_joint_names(model)
        self.size = int(model.nsensordata)
        self.plate = block("left_plate_force", "right_plate_torque")
        self.joint_velocity = block(f"{joints[0]}_velocity", f"{joints[-1]}_velocity")
        ankle, inertial = of_feet("ankle_force ankle_torque", 6), block("accelerometer", "gyroscope")
        joint_position = block(f"{joints[0]}_position", f"{joints[-1]}_position")
        self.columns = RowColumns(
            ankle,
            of_feet("ground", 9),
            up=1.0,
            position_sole=of_feet("sole_position", 3),
            axes_sole=of_feet("sole_x sole_z", 9),
            position_torso=block("torso_position", "torso_position"),
            axes_torso=block("torso_x", "torso_z"),
            inertial=inertial,
            joint_position=joint_position,
            sensed=SensedColumns(
                joint_position.start, inertial.start, int(ankle[0, 0]), self.plate.start, stride=6
            ),
            time=int(model.sensor("time").adr[0]),
            **{
                name: block(name, name)
                for name in ("com", "com_velocity", "angular_momentum", "accelerometer", "gyroscope")
            },
        )

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
        dofs = np.array([model.joint(name).dofadr[0] for name in joints])
        feet = FootPlaces.of(self.columns, self._force_cell, (True, True))
        self.places = Places.of(feet, self.columns, dofs)

    def _force_cell(self, last: NDArray[np.float64], wrench: NDArray[np.float64]) -> NDArray[np.float64]:
        force: NDArray[np.float64] = (last[..., None, self.plate] @ self.force_of_plates)[..., 0, :]
        return force + self.preload


class Truth(RobotTruth):
    """The last control step, S substeps, as of :class:`RobotTruth`.

    Args:
        rows: One row of sensor data a substep, shape (S, channels).
        channels: The meaning of the columns.
    """

    def __init__(self, rows: NDArray[np.float64], channels: TruthChannels) -> None:
        super().__init__(rows, channels.columns)
        self.channels = channels

    @property
    def cell_data(self) -> NDArray[np.float64]:
        """The readings of both plates' sensors in N and N m, shape (S, 12)."""
        return self.rows[..., self.channels.plate]

    def cell_map(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As of :class:`RobotTruth`: factors (12, 8), and the plates' weight in N, (8,)."""
        return self.channels.force_of_plates, self.channels.preload

    def shear_map(self) -> NDArray[np.float64]:
        """As of :class:`RobotTruth`, shape (12, 16)."""
        return self.channels.shear_of_plates.reshape(12, 16)

    @property
    def joint_velocity(self) -> NDArray[np.float64]:
        """Speeds of all hinge joints in rad/s, shape (S, J)."""
        return self.rows[..., self.channels.joint_velocity]
