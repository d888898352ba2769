"""Sensors and calibrators for the vector environments of Stable-Baselines3.

Needs the extra ``surefoot[rl]``. Readings are processed in :mod:`surefoot.wrappers.vector.sensors` and
:mod:`surefoot.wrappers.vector.calibration`. This module adapts them to SB3, which resets a robot in the step
in which its episode ends, and returns the last observation in ``infos[i]["terminal_observation"]``.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.calibration.online import MethodOptions
from surefoot.extras import not_installed
from surefoot.robot.sensing.device import FootDevice
from surefoot.robot.sensing.foot_equipment import FootEquipment, FootOptions, equip
from surefoot.robot.sensing.raw_view import TRUTH_KEY
from surefoot.wrappers.source import OPTIONS, refuse_second, split_options
from surefoot.wrappers.vector.calibration import BatchCalibration, BatchCalibrationFace
from surefoot.wrappers.vector.sensors import BatchSensors, BatchSensorsFace, merge_rows

try:
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
except ModuleNotFoundError as missing:
    raise not_installed("surefoot.wrappers.vector.sb3", missing, "rl") from None


class VecFootSensors(BatchSensorsFace, VecEnvWrapper):
    """The wrapper :class:`VectorFootSensors` for a ``VecEnv`` of Stable-Baselines3.

    Each copy needs a :class:`~surefoot.wrappers.vector.truth_row.TruthRow` around it.

    Args:
        venv: A vector environment of SB3.
        config: As for :class:`~surefoot.wrappers.vector.foot_sensors.VectorFootSensors`.
        measure_state: Whether encoders and IMU replace the parts that a ``state_layout`` names.
        options: Fields of :class:`~surefoot.wrappers.FootEquipment`.

    Attributes:
        sensors: The sensors of all robots.
        seeds: The seed of each robot at the last reset; ``None`` without a seed.

    Raises:
        TypeError: If it is not a ``VecEnv``, or copies have no row of truth, or already have sensors.
        ValueError: If copies differ, a preset is unknown, a value is out of range, or the sensors do not fit.
    """

    def __init__(
        self,
        venv: VecEnv,
        config: str | Mapping[str, Any] | FootDevice | FootEquipment | None = None,
        *,
        measure_state: bool = True,
        **options: Unpack[FootOptions],
    ) -> None:
        if not isinstance(venv, VecEnv):
            raise TypeError(
                "VecFootSensors goes around a vector environment of Stable-Baselines3, such as "
                f"DummyVecEnv([lambda: TruthRow(gym.make(...))]), got {venv!r}."
            )
        refuse_second("VecFootSensors", venv)
        self.sensors = BatchSensors(
            "VecFootSensors",
            venv.num_envs,
            venv.observation_space,
            venv.get_attr,
            equip(config, **options),
            measure_state,
        )
        super().__init__(venv, observation_space=self.sensors.view.space)
        self.seeds: Sequence[int | None] = [None] * venv.num_envs
        self._asked: Mapping[str, str] = {}

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Set the options of the next reset.

        Args:
            options: For all robots, or one per robot. ``options["surefoot"]`` is as for
                :meth:`VectorFootSensors.reset`, and the same for all. Other options are passed on.

        Raises:
            ValueError: If a choice does not exist or differs between robots, or there are more or fewer
                options than robots.
        """
        each = options if isinstance(options, list) else [options] * self.num_envs
        if len(each) != self.num_envs:
            raise ValueError(f"'options' must be of each of {self.num_envs} robots, got {len(each)}.")
        rest, asked = zip(*(split_options(own, "sensors", "calibration") for own in each), strict=True)
        if any(own != asked[0] for own in asked):
            raise ValueError(f"options['{OPTIONS}'] must be the same for all robots, got {list(asked)}.")
        self._asked = asked[0]
        self.venv.set_options([own or {} for own in rest])

    def reset(self) -> dict[str, Any]:
        """Reset all robots."""
        # Stored in the base environment until a reset: it may have been seeded before it had sensors.
        self.seeds, asked, self._asked = list(self.venv.unwrapped._seeds), self._asked, {}
        observations: Any = self.venv.reset()
        self.sensors.reset(observations[TRUTH_KEY], None, self.seeds, asked)
        return self.sensors.show(observations)

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Finish a step and read the sensors."""
        given: Any
        given, rewards, dones, infos = self.venv.step_wait()
        rows, infos = given[TRUTH_KEY], list(infos)  # SubprocVecEnv returns a tuple
        finals = {robot: infos[robot]["terminal_observation"] for robot in np.flatnonzero(dones).tolist()}
        fell = dones & ~np.array([info.get("TimeLimit.truncated", False) for info in infos])
        self.sensors.step(merge_rows(rows, finals), fell=fell)
        for robot, final in finals.items():
            infos[robot] = {**infos[robot], "terminal_observation": self.sensors.show_one(final, robot)}
        if finals:
            self.sensors.begin(rows, dones)
        return self.sensors.show(given), rewards, dones, infos

    @property
    def truth(self) -> dict[str, NDArray[Any]]:
        """The truth at the end of the last step, for scoring."""
        return self.sensors.truth


class VecSelfCalibration(BatchCalibrationFace, VecEnvWrapper):
    """Calibrate the readings of :class:`VecFootSensors` while the robots move, and observe the result.

    Args:
        venv: :class:`VecFootSensors` around a vector environment.
        method: As for :class:`~surefoot.wrappers.vector.self_calibration.VectorSelfCalibration`.
        options: ``initial``, ``show`` and so on, and options of the method.

    Attributes:
        calibration: The calibration of all robots.

    Raises:
        TypeError: If it does not wrap :class:`VecFootSensors` directly.
        ValueError: If the method or an option does not exist, or a value is out of range.
    """

    venv: VecFootSensors

    def __init__(self, venv: VecEnv, method: str | MethodOptions = "moment", **options: Any) -> None:
        if not isinstance(venv, VecFootSensors):
            raise TypeError(
                "VecSelfCalibration calibrates the counts of VecFootSensors and goes right around them: "
                f"VecSelfCalibration(VecFootSensors(venv)). Got {type(venv).__name__}."
            )
        self.calibration = BatchCalibration("VecSelfCalibration", venv.sensors, method, **options)
        space: Any = venv.observation_space
        shown = spaces.Dict(self.calibration.around(space.spaces, self.calibration.setup.spaces))
        super().__init__(venv, observation_space=shown)

    def reset(self) -> dict[str, Any]:
        """Reset all robots. Calibration starts again if they were seeded."""
        observations: Any = self.venv.reset()
        return self.calibration.around(observations, self.calibration.shown)

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Finish a step and calibrate by one sample."""
        observations: Any
        observations, rewards, dones, infos = self.venv.step_wait()
        calibration = self.calibration
        for robot in np.flatnonzero(dones).tolist():
            final = calibration.around(infos[robot]["terminal_observation"], calibration.last_of(robot))
            infos[robot] = {**infos[robot], "terminal_observation": final}
        return calibration.around(observations, calibration.shown), rewards, dones, infos
