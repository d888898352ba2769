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

from surefoot.envs.instrumentation.plate import SolePlate
from surefoot.envs.instrumentation.robot import RowColumns, RowLayout, SensedColumns, share_loads
from surefoot.envs.robots.nao import FEET, cell_positions, hinge_joint_names


def truth_layout(model: mujoco.MjModel, stiffness: Sequence[float]) -> RowLayout:
    """Find where MuJoCo's sensors lie in the sensor data of nao.xml, and how the plates share their loads.

    ``stiffness`` are the relative stiffnesses of the eight cells, shape (8,).
    """

    def block(first: str, last: str) -> slice:
        start, end = model.sensor(first), model.sensor(last)
        return slice(int(start.adr[0]), int(end.adr[0] + end.dim[0]))

    def of_feet(what: str, numbers: int) -> NDArray[np.intp]:
        part = block(f"left_{what.split()[0]}", f"right_{what.split()[-1]}")
        return np.arange(part.start, part.stop).reshape(len(FEET), numbers)

    joints = hinge_joint_names(model)
    ankle, inertial = of_feet("ankle_force ankle_torque", 6), block("accelerometer", "gyroscope")
    joint_position = block(f"{joints[0]}_position", f"{joints[-1]}_position")
    plates = block("left_plate_force", "right_plate_torque").start
    whole = ("com", "com_velocity", "angular_momentum", "accelerometer", "gyroscope")
    columns = RowColumns(
        ankle,
        of_feet("ground", 9),
        up=1.0,
        position_sole=of_feet("sole_position", 3),
        axes_sole=of_feet("sole_x sole_z", 9),
        position_torso=block("torso_position", "torso_position"),
        axes_torso=block("torso_x", "torso_z"),
        inertial=inertial,
        joint_position=joint_position,
        sensed=SensedColumns(joint_position.start, inertial.start, int(ankle[0, 0]), plates, stride=6),
        time=int(model.sensor("time").adr[0]),
        **{name: block(name, name) for name in whole},
    )
    places = zip(cell_positions(model), np.reshape(stiffness, (len(FEET), 4)), strict=True)
    up, across = share_loads([SolePlate(*place) for place in places])
    # Cell forces are linear in the 12 readings of both plate sensors: -reading plus the preload.
    weight, preload = float(np.linalg.norm(model.opt.gravity)), []
    for foot in FEET:
        body = model.body(f"{foot}_plate")
        load = np.array([0.0, 0.0, weight * body.mass[0]])
        preload += [load, np.cross(body.ipos - model.site(f"{foot}_sole").pos, load)]
    factors = 0.0 - up
    cell_map = factors, -np.concatenate(preload) @ factors
    return RowLayout(int(model.nsensordata), columns, (True, True), "", cell_map, 0.0 - across)
