"""Self-calibration of many robots while they walk, each with what it knows of itself."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from surefoot.calibration import Parameters
from surefoot.wrappers.belief_errors import USUAL, BeliefErrors, belief_errors
from surefoot.wrappers.foot_view import DEFAULT
from surefoot.wrappers.self_calibration import BELIEF_STREAM
from surefoot.wrappers.source import find_sensors, split_options
from surefoot.wrappers.vector.calibration import BatchCalibration
from surefoot.wrappers.vector.foot_sensors import Infos, VectorFootSensors


class VectorSelfCalibration(VectorWrapper[Any, Any, Any, Any, Any]):
    """Calibrate the readings of :class:`VectorFootSensors` while the robots move, and observe the result.

    The observation loses ``"foot_raw"`` and gains ``"foot_force"`` (N, K), ``"cop_foot"`` (N, 2, 2),
    ``"cop"`` (N, 2) and ``"cop_valid"`` (N, 3), or what else ``show`` names, as
    :class:`~surefoot.wrappers.SelfCalibration` has them for one robot. The robots are calibrated by one
    calibrator for all, each with errors of its own beliefs.

    ``infos["surefoot"]`` gains ``"parameters"`` and ``"lag"`` (N), and at steps ``"flags"`` (N, K),
    ``"vgrf"`` (N, 2) N and ``"reference"``: a reset only applies what was learnt to the first readings. All
    are arrays, or mappings of arrays, with the robots in front.

    What was learnt is kept when a robot is reset. Nothing is learnt from samples of two episodes, nor from
    robots that are not upright (:class:`~surefoot.wrappers.contacts.Upright`). Calibration starts fresh at a
    reset with a seed or with fresh sensors, with ``fresh=True`` at each reset, and
    ``options={"surefoot": {"calibration": "fresh" or "keep"}}`` decides for one.

    Args:
        env: A vector environment with :class:`VectorFootSensors` around it.
        method: A key of :data:`surefoot.calibration.METHODS`.
        initial: The map to start from: ``"nominal"``, ``"calibrated"`` or
            :class:`~surefoot.calibration.Parameters`.
        show: What is observed: of these four, ``"foot_load"`` (N, K), forces in body weights, and
            ``"foot_raw"`` (N, K).
        lag: How many samples ago a reference describes the feet; by default as few as the link allows.
        fresh: Whether the calibration of a robot starts fresh at each of its resets.
        errors: How wrong the robots are about themselves, also as a mapping of some of the fields.
        stream: Number of the random stream, for other errors of beliefs on the same episodes.
        options: Options of the method.

    Attributes:
        calibration: The calibration of all robots.

    Raises:
        TypeError: If there is no :class:`VectorFootSensors` below, or another wrapper of this kind.
        ValueError: If the method or an option does not exist, a value has no meaning, or the robot is none
            that a nominal model can be made of.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        method: str = "moment",
        *,
        initial: str | Parameters | Mapping[str, Any] = "nominal",
        show: Sequence[str] = DEFAULT,
        lag: int | None = None,
        fresh: bool = False,
        errors: BeliefErrors | Mapping[str, Any] = USUAL,
        stream: int = BELIEF_STREAM,
        **options: Any,
    ) -> None:
        super().__init__(env)
        self._sensors = find_sensors(env, VectorSelfCalibration, VectorFootSensors, VectorWrapper).sensors
        self.calibration = BatchCalibration(
            self._sensors,
            method,
            initial=initial,
            show=show,
            lag=lag,
            fresh=fresh,
            errors=belief_errors(errors, options),
            stream=stream,
            options=options,
        )
        space: Any = env.single_observation_space
        if not isinstance(space, spaces.Dict):
            raise TypeError(
                "VectorSelfCalibration adds to a Dict of observations, as VectorFootSensors shows them, and "
                f"found {type(space).__name__}; put whatever changes observations around both."
            )
        single = spaces.Dict(self.calibration.feet.around(space.spaces, self.calibration.feet.spaces))
        self.single_observation_space = single
        self.observation_space = batch_space(single, env.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, Infos]:
        """Reset all robots, or those of ``options["reset_mask"]``, with calibration kept or fresh.

        Args:
            seed: A number or one a robot: calibration of robots that are seeded starts fresh.
            options: ``options["surefoot"]["calibration"]`` may be ``"fresh"`` or ``"keep"``; handed on.

        Raises:
            ValueError: If a choice does not exist.
        """
        rest, asked = split_options(options, "sensors", "calibration")
        mask = None if rest is None else rest.get("reset_mask")
        observations, infos = self.env.reset(seed=seed, options=options)
        self.calibration.reset(mask, seed, asked.get("calibration"))
        feet = self.calibration.feet
        return feet.around(observations, feet.shown), self._with_calibration(infos, False)

    def step(self, actions: Any) -> tuple[Any, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Step all robots and calibrate by one sample."""
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        calibration, started_within = self.calibration, self._sensors.started_within
        calibration.step()
        calibration.retract(terminations)
        if started_within is not None:
            finals = infos["final_obs"].copy()
            for robot in np.flatnonzero(started_within).tolist():
                finals[robot] = calibration.feet.around(finals[robot], calibration.feet.last_of(robot))
            infos = {**infos, "final_obs": finals}
            calibration.begin_episode(started_within)
        shown = calibration.feet.around(observations, calibration.feet.shown)
        return shown, rewards, terminations, truncations, self._with_calibration(infos, True)

    def _with_calibration(self, infos: Infos, stepped: bool) -> Infos:
        return {**infos, "surefoot": {**infos["surefoot"], **self.calibration.info(stepped)}}
