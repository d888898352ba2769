"""The rows of a robot: read from sensors in its model, or computed beside the simulation from a copy."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.arrays import Floats
from surefoot.envs.instrumentation.drawing import draw_robot
from surefoot.envs.instrumentation.feet import standing_pose
from surefoot.envs.instrumentation.geometry import below
from surefoot.envs.instrumentation.robot import TORSO, TORSO_WIDTH, FootColumns, encoders, measure_robot
from surefoot.envs.instrumentation.spec import Instrumentation, find_imu
from surefoot.envs.instrumentation.swap import sensors_off
from surefoot.envs.instrumentation.truth import FeetTruth, cross

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


_INTEGRATORS = {
    mujoco.mjtIntegrator.mjINT_EULER: mujoco.mj_Euler,
    mujoco.mjtIntegrator.mjINT_RK4: lambda model, data: mujoco.mj_RungeKutta(model, data, 4),
    mujoco.mjtIntegrator.mjINT_IMPLICIT: mujoco.mj_implicit,
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST: mujoco.mj_implicit,
}
"""How a substep ends after ``mj_forward``."""


def specific_force(velocity: Floats, axes: Floats, interval: float, gravity: Floats) -> Floats:
    """Return the mean specific force between instants in the IMU's axes in m/s^2, shape (n, 3).

    Args:
        velocity: Velocity of the IMU in the world at n + 1 instants in m/s, shape (n + 1, 3).
        axes: The IMU's three axes in the world one after another, shape (n + 1, 3, 3).
        interval: Time between two instants in s.
        gravity: Acceleration of free fall in the world in m/s^2, shape (3,).
    """
    gained = np.diff(velocity, axis=0) / interval - gravity
    middle = 0.5 * (axes[1:] + axes[:-1])
    force: Floats = (middle @ gained[:, :, None])[:, :, 0]
    return force


class Imu(NamedTuple):
    """An IMU on a torso: an object of a model that moves with it and has its axes."""

    kind: mujoco.mjtObj  # site or body
    number: int  # of that site or body
    torso: int  # number of the body that carries it

    def follow(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Evaluate positions and velocities of the bodies at a state."""
        for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
            compute(model, data)

    def motion(self, model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Floats, Floats, Floats]:
        """Return its angular velocity in its axes, its velocity in the world, and its axes, (3), (3), (9)."""
        spatial, R = np.zeros(6), data.xmat[self.torso].reshape(3, 3)
        mujoco.mj_objectVelocity(model, data, self.kind, self.number, spatial, 0)
        return spatial[:3] @ R, spatial[3:], R.T.ravel()

    def gain(self, model: mujoco.MjModel, data: mujoco.MjData) -> Floats:
        """Integrate a state after ``mj_forward``; return the specific force in that substep, shape (3,)."""
        _, *before = self.motion(model, data)
        _INTEGRATORS[mujoco.mjtIntegrator(model.opt.integrator)](model, data)
        self.follow(model, data)
        _, *after = self.motion(model, data)
        velocity, axes = (np.stack(pair) for pair in zip(before, after, strict=True))
        forces = specific_force(velocity, axes.reshape(2, 3, 3), model.opt.timestep, model.opt.gravity)
        return np.array(forces[0])


class SensorReader:
    """Reads the sensors that were added to a model, and keeps them still where they would be seen.

    MuJoCo keeps each sensor's last ``samples`` values in a ring (``data.history``), with a row's time in its
    clock's column. It evaluates sensors at the beginning of a substep: forces and contacts are then those
    that act in it. Angles and gyroscope are moved on to its end, where the next substep begins, and the last
    ones are taken from the state. The accelerometer is the velocity that the IMU gains in the substep,
    because MuJoCo's own sensor omits what implicit damping or a Runge-Kutta step add to the motion.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, instrumentation: Instrumentation, samples: int
    ) -> None:
        columns = instrumentation.columns(model)
        first = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, instrumentation.first_sensor)
        self._model, self._layout, self._columns = model, instrumentation.layout.rows, columns
        self._instrumentation, self._samples = instrumentation, samples
        self._scratch = mujoco.MjData(model)
        self._scratch_row = self._scratch.sensordata[columns]
        self._state = np.empty(mujoco.mj_stateSize(model, _STATE))
        self._first = first
        self._gyroscope, self._joints = self._layout.columns.gyroscope, self._layout.columns.joint_position
        torso = model.body(instrumentation.torso).id
        self._encoders = model.jnt_qposadr[list(encoders(model, torso))]
        self._imu = Imu(mujoco.mjtObj.mjOBJ_SITE, model.site(instrumentation.imu).id, torso)
        if samples > 1:
            self._places = self._places_in_ring(first)
        self.watch(data)

    def watch(self, data: mujoco.MjData) -> None:
        """Read another simulation of the model from now on."""
        self._data, self._sensed = data, data.sensordata[self._columns]
        if self._samples > 1:
            self._cursor = data.history[self._model.sensor_historyadr[self._first] + 1 :][:1]
        self._read_until = data.time

    def _places_in_ring(self, first: int) -> NDArray[np.intp]:
        """Find where in the history each number of each row lies, shape (S, columns), the ring's start first.

        A sensor's part is two numbers of MuJoCo's own, the S times and the S values.
        """
        model, count = self._model, self._samples
        sensors = range(first, model.nsensor)
        start = [int(model.sensor_historyadr[i]) + 2 + count for i in sensors]
        places = np.concatenate(
            [
                at + model.sensor_dim[i] * np.arange(count)[:, None] + np.arange(model.sensor_dim[i])
                for i, at in zip(sensors, start, strict=True)
            ],
            axis=1,
        )
        for ends in (self._gyroscope, self._joints):
            places[:, ends] = np.roll(places[:, ends], -1, axis=0)
        return places.astype(np.intp)

    def __reduce__(self) -> tuple[Any, ...]:
        # Rows are views of MuJoCo's own arrays, which copies would lose.
        return SensorReader, (self._model, self._data, self._instrumentation, self._samples)

    def after_step(self) -> FeetTruth:
        """Read the substeps of the last control step, shape (S, ...)."""
        data, before = self._data, self._read_until
        self._read_until = now = data.time
        if self._samples == 1:
            rows = self._sensed[None].copy()
        else:
            rows = data.history.take(self._places)
            newest = int(self._cursor[0])
            if newest != self._samples - 1:
                rows = np.roll(rows, -newest - 1, axis=0)
        rows[-1, self._joints] = data.qpos[self._encoders]
        scratch, h = self._scratch, self._model.opt.timestep
        scratch.qpos[:], scratch.qvel[:] = data.qpos, data.qvel
        self._imu.follow(self._model, scratch)
        rows[-1, self._gyroscope], velocity, axes = self._imu.motion(self._model, scratch)
        columns = self._layout.columns
        velocities = np.vstack([rows[:, columns.velocity_imu], velocity])
        R = np.vstack([rows[:, columns.axes_torso], axes]).reshape(-1, 3, 3)
        rows[:, columns.accelerometer] = specific_force(velocities, R, h, self._model.opt.gravity)
        if abs(now - before - self._samples * h) > 0.5 * h:
            return self._after_other_step(rows, round((now - before if now > before else now) / h))
        return FeetTruth(rows, self._layout)

    def _after_other_step(self, rows: Floats, fresh: int) -> FeetTruth:
        """Read a control step with another number of substeps; the first one fills in for missing ones.

        Time goes back if MuJoCo resets a simulation that has diverged.
        """
        if fresh < 1:
            return self.now()
        fresh = min(fresh, len(rows))
        rows[: len(rows) - fresh] = rows[len(rows) - fresh]
        return FeetTruth(rows, self._layout)

    def now(self) -> FeetTruth:
        """Evaluate a copy of the present state, and return it in S equal rows."""
        mujoco.mj_getState(self._model, self._data, self._state, _STATE)
        mujoco.mj_setState(self._model, self._scratch, self._state, _STATE)
        mujoco.mj_forward(self._model, self._scratch)
        row = self._scratch_row.copy()
        row[self._layout.columns.accelerometer] = self._imu.gain(self._model, self._scratch)
        self._read_until = self._data.time
        return FeetTruth(np.tile(row, (self._samples, 1)), self._layout)

    def still(self) -> AbstractContextManager[None]:
        """Return a context in which the sensors are disabled, because a reset must not notice them."""
        return sensors_off(self._model, self._first)


class FeetReader:
    """Reads the feet of a robot without changing its model or its data.

    The state and the applied forces are copied, the dynamics of the copy are evaluated by ``mj_forward``, and
    the contacts of each foot are summed. Loads of the ankles follow from ``cfrc_int``. The row equals that of
    sensors at the same instant, at the cost of one more evaluation of the dynamics.

    Args:
        model: The robot; its numbers may change later.
        data: Its state.
        feet: Names of the feet's bodies in order; None for the two lowest leaves, the left one first.
        cells: Places of the load cells in the sole's frame in m, shape (4, 2), by the foot's body; others lie
            in the soles' corners.
        margin: How far these are drawn in from the sole's edges in m.
        prefix: The beginning of the names of sites in the drawing.

    Attributes:
        layout: The measures of the robot.
        drawing: The drawing by its maker.

    Raises:
        TypeError: If ``feet`` is a single name.
        ValueError: If feet cannot be found, cannot touch or have no name, or a layout is wrong.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        feet: Sequence[str] | None = None,
        *,
        cells: Mapping[str, ArrayLike] | None = None,
        margin: float = 0.005,
        prefix: str = "surefoot/",
    ) -> None:
        pose = standing_pose(model)
        self.layout = measure_robot(model, pose, feet, cells, margin)
        imu = find_imu(model, self.layout.torso)
        self.drawing = draw_robot(model, pose, self.layout, imu=imu, prefix=prefix)
        self._model, self._watched, self._data = model, data, mujoco.MjData(model)
        self._state = np.empty(mujoco.mj_stateSize(model, _STATE))
        self._torso = model.body(self.layout.torso).id
        self._feet = [model.body(foot.body).id for foot in self.layout.feet]
        self._encoders = model.jnt_qposadr[list(encoders(model, self._torso))]
        # The last column stands for what is no geom, such as a cloth.
        inside = [below(model, body)[model.geom_bodyid] for body in self._feet]
        self._is_foot = np.pad(np.array(inside, dtype=int), ((0, 0), (0, 1)))
        self._imu = Imu(mujoco.mjtObj.mjOBJ_XBODY, self._torso, self._torso)
        if imu:
            self._imu = Imu(mujoco.mjtObj.mjOBJ_SITE, model.site(imu).id, self._torso)

    def watch(self, data: mujoco.MjData) -> None:
        """Read another simulation of the model from now on."""
        self._watched = data

    def after_step(self) -> FeetTruth:
        """Read the state at the end of a step, shape (1, ...)."""
        return self.now()

    def now(self) -> FeetTruth:
        """Read the present state, shape (1, ...)."""
        return FeetTruth(self.row()[None], self.layout.rows)

    def still(self) -> AbstractContextManager[None]:
        """Do nothing: there is nothing in the model that could be seen."""
        return nullcontext()

    def row(self) -> Floats:
        """Compute the sensors' measurements in the present state, shape (27 F + 31 + J,)."""
        model, own = self._model, self._data
        mujoco.mj_getState(model, self._watched, self._state, _STATE)
        mujoco.mj_setState(model, own, self._state, _STATE)
        mujoco.mj_forward(model, own)
        mujoco.mj_rnePostConstraint(model, own)
        mujoco.mj_subtreeVel(model, own)
        row = np.zeros(self.layout.rows.size)
        split = FootColumns.width * len(self._feet)
        feet = row[:split].reshape(-1, FootColumns.width)
        for i, foot in enumerate(feet):
            self._read_foot(i, foot)
        self._add_contacts(feet)
        torso = slice(split, split + TORSO_WIDTH)
        row[torso.stop : -1] = own.qpos[self._encoders]
        row[-1] = own.time
        self._read_torso(row[torso])
        return row

    def _read_foot(self, i: int, row: Floats) -> None:
        """Read the ankle and the sole's frame of a foot."""
        own, body, foot = self._data, self._feet[i], self.layout.feet[i]
        R_world_foot = own.xmat[body].reshape(3, 3)
        ankle = own.xpos[body] + R_world_foot @ foot.position_ankle_foot
        # MuJoCo refers its spatial forces to the centre of mass of the whole robot.
        torque, force = own.cfrc_int[body].reshape(2, 3)
        at_ankle = torque + cross(own.subtree_com[self._torso] - ankle, force)
        row[FootColumns.ankle] = np.concatenate([force @ R_world_foot, at_ankle @ R_world_foot])
        row[FootColumns.place] = row[FootColumns.position_sole] = (
            own.xpos[body] + R_world_foot @ foot.position_sole_foot
        )
        row[FootColumns.axes_sole] = (R_world_foot @ foot.R_foot_sole).T.ravel()

    def _add_contacts(self, feet: Floats) -> None:
        """Add the feet's contacts, as forces of the feet at the soles' origins."""
        own, local = self._data, np.zeros(6)
        geoms = own.contact.geom
        sides = self._is_foot[:, geoms[:, 1]] - self._is_foot[:, geoms[:, 0]]
        for k in np.flatnonzero(sides.any(axis=0)):
            mujoco.mj_contactForce(self._model, own, k, local)
            # From the first geom on the second, along the rows of the contact's frame.
            force, torque = local.reshape(2, 3) @ own.contact.frame[k].reshape(3, 3)
            for foot, side in zip(feet, sides[:, k], strict=True):
                foot[FootColumns.force] -= side * force
                arm = own.contact.pos[k] - foot[FootColumns.position_sole]
                foot[FootColumns.torque] -= side * (torque + cross(arm, force))

    def _read_torso(self, row: Floats) -> None:
        """Read the torso's frame, the whole robot's motion and the IMU; moves the copied state."""
        model, own, torso = self._model, self._data, self._torso
        row[TORSO["position_torso"]] = own.xpos[torso]
        row[TORSO["axes_torso"]] = own.xmat[torso].reshape(3, 3).T.ravel()
        row[TORSO["com"]] = own.subtree_com[torso]
        row[TORSO["com_velocity"]] = own.subtree_linvel[torso]
        row[TORSO["angular_momentum"]] = own.subtree_angmom[torso]
        row[TORSO["gyroscope"]], row[TORSO["velocity_imu"]], _ = self._imu.motion(model, own)
        row[TORSO["accelerometer"]] = self._imu.gain(model, own)
