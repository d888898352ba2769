"""The rows of a robot in whose model there are sensors."""

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from surefoot.envs.instrumentation.spec import Instrumentation
from surefoot.envs.instrumentation.truth import FeetTruth


class SensorReader:
    """Reads the sensors that were added to a model, and keeps them still where they would be seen.

    Args:
        model: The instrumented robot.
        data: Its state.
        instrumentation: What was added.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, instrumentation: Instrumentation) -> None:
        columns = instrumentation.columns(model)
        first = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, instrumentation.first_sensor)
        self._model, self._data, self._layout = model, data, instrumentation.layout
        self._row = data.sensordata[None, columns]
        self._scratch = mujoco.MjData(model)
        self._scratch_row = self._scratch.sensordata[None, columns]
        self._kind = mujoco.mjtState.mjSTATE_INTEGRATION
        self._state = np.empty(mujoco.mj_stateSize(model, self._kind))
        self._stages = model.sensor_needstage[first:]
        self._stages_on = self._stages.copy()

    def after_step(self) -> FeetTruth:
        """Read what was at the beginning of the last substep, shape (1, ...)."""
        return FeetTruth(self._row, self._layout)

    def now(self) -> FeetTruth:
        """Read what is in the present state, of which a copy is evaluated, shape (1, ...)."""
        mujoco.mj_getState(self._model, self._data, self._state, self._kind)
        mujoco.mj_setState(self._model, self._scratch, self._state, self._kind)
        mujoco.mj_forward(self._model, self._scratch)
        return FeetTruth(self._scratch_row, self._layout)

    @contextmanager
    def still(self) -> Iterator[None]:
        """Leave the sensors out meanwhile: some make MuJoCo compute what is zero without them."""
        self._stages[:] = 0
        try:
            yield
        finally:
            self._stages[:] = self._stages_on
