"""The rows of a robot: read from sensors in its model, or computed beside the simulation from a copy."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

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


class SensorReader:
    """Reads the sensors that were added to a model, and keeps them still where they would be seen.

    MuJoCo keeps each sensor's last ``samples`` values in a ring (``data.history``), with a row's time in its
    clock's column. It evaluates sensors at the beginning of a substep: forces, accelerations and contacts are
    then those that act in it. Angles and gyroscope are moved on to its end, where the next substep begins,
    and the last ones are taken from the state.
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
        joint = model.body_jntadr[torso]
        free = joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        spin = model.jnt_dofadr[joint] + 3 if free else 0
        self._spin = slice(spin, spin + 3) if free else None
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
        if self._spin is not None:
            rows[-1, self._gyroscope] = data.qvel[self._spin]
        h = self._model.opt.timestep
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
        self._read_until = self._data.time
        return FeetTruth(np.tile(self._scratch_row, (self._samples, 1)), self._layout)

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
        self._imu = (mujoco.mjtObj.mjOBJ_XBODY, self._torso)
        if imu:
            self._imu = (mujoco.mjtObj.mjOBJ_SITE, model.site(imu).id)

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
        """Compute the sensors' measurements in the present state, shape (27 F + 28 + J,)."""
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
        self._read_torso(row[torso])
        row[torso.stop : -1] = own.qpos[self._encoders]
        row[-1] = own.time
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
        """Read the torso's frame, the whole robot's motion and the IMU."""
        model, own, torso, spatial = self._model, self._data, self._torso, np.zeros(6)
        row[TORSO["position_torso"]] = own.xpos[torso]
        row[TORSO["axes_torso"]] = own.xmat[torso].reshape(3, 3).T.ravel()
        row[TORSO["com"]] = own.subtree_com[torso]
        row[TORSO["com_velocity"]] = own.subtree_linvel[torso]
        row[TORSO["angular_momentum"]] = own.subtree_angmom[torso]
        mujoco.mj_objectAcceleration(model, own, *self._imu, spatial, 1)
        row[TORSO["accelerometer"]] = spatial[3:]
        mujoco.mj_objectVelocity(model, own, *self._imu, spatial, 1)
        row[TORSO["gyroscope"]] = spatial[:3]
