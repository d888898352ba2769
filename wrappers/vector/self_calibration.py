"""Self-calibration of many robots while they walk, each with its own state estimates."""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from surefoot.calibration.online import MethodOptions
from surefoot.pickles import OfOneVersion
from surefoot.wrappers.source import find_sensors
from surefoot.wrappers.vector.calibration import BatchCalibration, BatchCalibrationFace
from surefoot.wrappers.vector.foot_sensors import Infos, VectorFootSensors
from surefoot.wrappers.vector.truth_row import AnyVectorWrapper


class VectorSelfCalibration(OfOneVersion, BatchCalibrationFace, AnyVectorWrapper):
    """Calibrate the readings of :class:`VectorFootSensors` while the robots move, and observe the result.

    The observation loses ``"foot_raw"`` and gains the parts that ``show`` names, ``infos["surefoot"]`` gains
    ``"parameters"``, ``"covariance"``, ``"flags"``, ``"vgrf"``, ``"reference"`` and ``"lag"``: all as in
    :class:`~surefoot.wrappers.SelfCalibration`, with the robots as first axis of each array. Each robot has
    its own beliefs and calibrator, and its calibration does not depend on the other robots.

    A reset keeps the calibration of a robot. Samples of different episodes are never combined, and robots
    that are not upright do not calibrate (:class:`~surefoot.robot.beliefs.contacts.Upright`). Calibration
    starts again at a reset with a seed or with fresh sensors, and with ``fresh=True`` at each reset.
    ``options={"surefoot": {"calibration": "fresh" or "keep"}}`` decides for one reset.

    Args:
        env: A vector environment with :class:`VectorFootSensors` around it.
        method: A key of :data:`surefoot.calibration.METHODS`.
        options: ``initial``, ``show``, ``lag``, ``fresh``, ``errors`` and ``stream``, as for
            :class:`~surefoot.wrappers.SelfCalibration`, and options of the method.

    Attributes:
        calibration: The calibration of all robots.

    Raises:
        TypeError: If there is no :class:`VectorFootSensors` below, or another wrapper of this kind.
        ValueError: If the method or an option does not exist, a value is out of range, or no nominal model
            can be built for the robot.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], method: str | MethodOptions = "moment", **options: Any
    ) -> None:
        super().__init__(env)
        sensors = find_sensors(env, VectorSelfCalibration, VectorFootSensors, VectorWrapper).sensors
        self._sensors = sensors
        self.calibration = BatchCalibration("VectorSelfCalibration", sensors, method, **options)
        space: Any = env.single_observation_space
        if not isinstance(space, spaces.Dict):
            raise TypeError(
                "VectorSelfCalibration adds to a Dict of observations, as VectorFootSensors shows them, and "
                f"found {type(space).__name__}; put whatever changes observations around both."
            )
        single = spaces.Dict(self.calibration.around(space.spaces, self.calibration.setup.spaces))
        self.single_observation_space = single
        self.observation_space = batch_space(single, env.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, Infos]:
        """Reset all robots, or those of ``options["reset_mask"]``, and keep or restart their calibration.

        Args:
            seed: A number or one per robot. The calibration of robots with a seed starts again.
            options: ``options["surefoot"]["calibration"]`` may be ``"fresh"`` or ``"keep"``. All options are
                passed on.

        Raises:
            ValueError: If a choice does not exist.
        """
        observations, infos = self.env.reset(seed=seed, options=options)
        return self._show(observations), self._with_calibration(infos)

    def step(self, actions: Any) -> tuple[Any, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Step all robots and calibrate by one sample."""
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        done = terminations | truncations
        if "final_obs" in infos and done.any():
            finals, calibration = infos["final_obs"].copy(), self.calibration
            for robot in np.flatnonzero(done).tolist():
                finals[robot] = calibration.around(finals[robot], calibration.last_of(robot))
            infos = {**infos, "final_obs": finals}
        return self._show(observations), rewards, terminations, truncations, self._with_calibration(infos)

    def _show(self, observations: dict[str, Any]) -> dict[str, Any]:
        return self.calibration.around(observations, self.calibration.shown)

    def _with_calibration(self, infos: Infos) -> Infos:
        return {**infos, "surefoot": {**infos["surefoot"], **self.calibration.told}}
