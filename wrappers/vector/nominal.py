"""The models that N robots have of themselves, side by side in one MuJoCo model.

Called robot by robot, MuJoCo's kinematics of a skeleton take less time than the call itself. The robots are
therefore copies of one skeleton in one world, each with masses that are off in its own way.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.envs import RobotDrawing
from surefoot.wrappers.belief_errors import BeliefErrors
from surefoot.wrappers.nominal import NominalModel, update_posture

Floats = NDArray[np.float64]


class Postures(NamedTuple):
    """Kinematics of N robots, in their torsos' frames.

    Attributes:
        com: Centres of mass in m, shape (N, 3).
        momentum: Angular momenta about them in kg m^2/s, shape (N, 3).
        sites: Places of the IMU and of both soles in m, shape (N, 3, 3).
        axes: Axes x, y and z of the left and of the right sole, shape (N, 6, 3).
    """

    com: Floats
    momentum: Floats
    sites: Floats
    axes: Floats


class BatchNominal:
    """N robots as they believe themselves to be.

    Args:
        drawing: The robot, on two feet.
        count: Number of robots N.
        errors: As of :class:`~surefoot.wrappers.NominalModel`.

    Attributes:
        drawn_mass: Mass of the drawing in kg.
        mass: Masses that the robots believe they have in kg, shape (N,).

    Raises:
        ValueError: If a joint is neither the free one nor a hinge.
    """

    def __init__(self, drawing: RobotDrawing, count: int, errors: BeliefErrors) -> None:
        sites = (drawing.imu, drawing.soles[0], drawing.soles[1])
        self._robot = NominalModel.of_drawing(drawing, errors)
        self.drawn_mass = self._robot.mass
        self.mass: Floats = np.full(count, self.drawn_mass)
        world = mujoco.MjSpec()
        for robot in range(count):
            world.attach(drawing.spec(), prefix=f"{robot}/", frame=world.worldbody.add_frame())
        self._model = model = world.compile()
        self._data = data = mujoco.MjData(model)
        bodies = (model.nbody - 1) // count
        first = np.arange(count) * bodies + 1
        self._torso = first + model.body(f"0/{drawing.torso}").id - 1
        parent = model.body_parentid[1:].reshape(count, bodies)
        # The last body of a branch first.
        self._parents = [(body, int(parent[0, body]) - 1) for body in range(bodies - 1, 0, -1)]
        numbers = np.array([model.site(f"0/{name}").id for name in sites])
        step = model.nsite // count
        self._sites = numbers + step * np.arange(count)[:, None]
        data.qpos.reshape(count, -1)[:, :7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        self._view()

    def _view(self) -> None:
        """Keep views of MuJoCo's own arrays."""
        model, data, count = self._model, self._data, len(self.mass)
        self._mass, self._inertia, self._subtree = (
            part[1:].reshape(count, -1, *part.shape[1:])
            for part in (model.body_mass, model.body_inertia, model.body_subtreemass)
        )
        qpos, qvel = data.qpos.reshape(count, -1), data.qvel.reshape(count, -1)
        self._position, self._velocity, self._spin = qpos[:, 7:], qvel[:, 6:], qvel[:, 3:6]
        self._com, self._momentum = data.subtree_com, data.subtree_angmom
        self._place, self._turn = data.site_xpos, data.site_xmat.reshape(-1, 3, 3)

    def __setstate__(self, kept: dict[str, Any]) -> None:
        # In a copy what were views are arrays that MuJoCo does not know.
        self.__dict__.update(kept)
        self._view()

    def draw(self, robots: Iterable[int], rng: np.random.Generator) -> None:
        """Draw fresh errors for some robots, one after the other."""
        for robot in robots:
            self._robot.draw(rng)
            self.mass[robot] = self._robot.mass
            masses = self._robot.masses
            self._mass[robot], self._inertia[robot] = masses.mass[1:], masses.inertia[1:]
            self._model.body_ipos[self._torso[robot]] = masses.com_torso
            subtree = self._subtree[robot]
            subtree[:] = masses.mass[1:]
            for body, parent in self._parents:
                if parent >= 0:
                    subtree[parent] += subtree[body]

    def evaluate(self, position: Floats, velocity: Floats, spin: Floats) -> Postures:
        """Compute the postures.

        Args:
            position: Joint positions in rad, shape (N, J).
            velocity: Joint velocities in rad/s, shape (N, J).
            spin: Angular velocities of the torsos in their own axes in rad/s, shape (N, 3).
        """
        model, data = self._model, self._data
        self._position[:] = position
        self._velocity[:] = velocity
        self._spin[:] = spin
        update_posture(model, data)
        sites, torso = self._sites, self._torso
        # MuJoCo hands out rotations by rows; transposed they are the axes one by one.
        axes = self._turn[sites[:, 1:]].swapaxes(-1, -2).reshape(len(torso), 6, 3)
        return Postures(self._com[torso], self._momentum[torso], self._place[sites], axes)
