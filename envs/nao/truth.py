"""Where the truth of one control step stands in the sensor data of nao.xml, at every substep.

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

from surefoot.envs.instrumentation.means import foot_places
from surefoot.envs.instrumentation.plate import SolePlate
from surefoot.envs.instrumentation.robot import RowColumns, SensedColumns
from surefoot.envs.observation import Places
from surefoot.envs.robots.nao import FEET, cell_positions, hinge_joint_names


class TruthChannels:
    """Where MuJoCo's sensors lie in one row of sensor data, and how the plates share their loads.

    It is a :class:`~surefoot.envs.instrumentation.robot.RowLayout`.

    Args:
        model: A compiled model with the sensors of nao.xml.
        stiffness: Relative stiffnesses of the eight cells, shape (8,).
    """

    flat, flaw = (True, True), ""

    def __init__(self, model: mujoco.MjModel, stiffness: Sequence[float]) -> None:
        def block(first: str, last: str) -> slice:
            start, end = model.sensor(first), model.sensor(last)
            return slice(int(start.adr[0]), int(end.adr[0] + end.dim[0]))

        def of_feet(what: str, numbers: int) -> NDArray[np.intp]:
            part = block(f"left_{what.split()[0]}", f"right_{what.split()[-1]}")
            return np.arange(part.start, part.stop).reshape(len(FEET), numbers)

        joints = hinge_joint_names(model)
        self.size = int(model.nsensordata)
        plates = block("left_plate_force", "right_plate_torque")
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
                joint_position.start, inertial.start, int(ankle[0, 0]), plates.start, stride=6
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
        factors, across, preload = np.zeros((12, 8)), np.zeros((12, 2, 8)), np.zeros(12)
        for i, (foot, plate) in enumerate(zip(FEET, self.plates, strict=True)):
            factors[6 * i + 2 : 6 * i + 5, 4 * i : 4 * i + 4] = -plate.share.T
            sideways = -plate.across.T.reshape(3, 2, 4)
            across[6 * i + np.array([0, 1, 5]), :, 4 * i : 4 * i + 4] = sideways
            body = model.body(f"{foot}_plate")
            load = np.array([0.0, 0.0, weight * body.mass[0]])
            arm = body.ipos - model.site(f"{foot}_sole").pos
            preload[6 * i : 6 * i + 6] = np.concatenate([load, np.cross(arm, load)])
        self.cell_map = factors, -preload @ factors
        self.shear_map: NDArray[np.float64] = across.reshape(12, 16)
        dofs = np.array([model.joint(name).dofadr[0] for name in joints])
        self.places = Places(foot_places(self), dofs)
