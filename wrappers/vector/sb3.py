"""Sensors and calibrators for many robots in Stable-Baselines3, which has vector environments of its own.

Needs the extra ``surefoot[rl]``. What happens to readings is in :mod:`surefoot.wrappers.vector.sensors`
and :mod:`surefoot.wrappers.vector.calibration`; here is only how SB3 gathers robots: it resets one in the
step in which its episode ends, and hands the last observation over as ``infos[i]["terminal_observation"]``.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.calibration import Parameters
from surefoot.extras import not_installed
from surefoot.sensors import Encoders, Imu, Link
from surefoot.wrappers.belief_errors import USUAL, BeliefErrors, belief_errors
from surefoot.wrappers.foot_device import FootDevice
from surefoot.wrappers.foot_sensors import SENSOR_STREAM
from surefoot.wrappers.foot_view import DEFAULT
from surefoot.wrappers.self_calibration import BELIEF_STREAM
from surefoot.wrappers.vector.calibration import BatchCalibration
from surefoot.wrappers.vector.sensors import BatchSensors, choose_devices
from surefoot.wrappers.vector.truth import batch_truth
from surefoot.wrappers.vector.truth_row import TRUTH_KEY
from surefoot.wrappers.vector.view import BatchView, check_copies, merge_rows

try:
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
except ModuleNotFoundError as missing:
    raise not_installed("surefoot.wrappers.vector.sb3", missing, "rl") from None


class VecFootSensors(VecEnvWrapper):
    """Read the robots of an SB3 ``VecEnv`` as :class:`VectorFootSensors` reads those of Gymnasium's.

    Each copy needs a :class:`~surefoot.wrappers.vector.truth_row.TruthRow` around it.

    Args:
        venv: A vector environment of SB3.
        config: As of :class:`~surefoot.wrappers.vector.foot_sensors.VectorFootSensors`, like all others.
        imu: The IMUs.
        encoders: The joint encoders.
        link: The links over which they reach the hosts.
        severity: Factor of all errors of the feet's sensors.
        fresh: Whether a robot that is reset gets fresh sensors.
        stream: Number of the random stream.

    Attributes:
        sensors: The sensors of all robots.
        seeds: What the robots were seeded with at the last reset; ``None`` without a seed.

    Raises:
        TypeError: If copies have no row of truth, or show readings already.
        ValueError: If copies differ, a preset is unknown, a value is refused, or the sensors do not fit.
    """

    def __init__(
        self,
        venv: VecEnv,
        config: str | Mapping[str, Any] | FootDevice | None = None,
        *,
        imu: str | Mapping[str, Any] | Imu = "nao-imu",
        encoders: str | Mapping[str, Any] | Encoders = "nao-encoders",
        link: str | Mapping[str, Any] | Link = "nao-wlan",
        severity: float = 1.0,
        fresh: bool = False,
        stream: int = SENSOR_STREAM,
    ) -> None:
        space: Any = venv.observation_space
        drawing, meaning = check_copies("VecFootSensors", space, venv.get_attr)
        devices = choose_devices("VecFootSensors", drawing, config, imu, encoders, link, severity, stream)
        self.sensors = BatchSensors(venv.num_envs, drawing, meaning, devices, stream=stream, fresh=fresh)
        self._view = BatchView(self.sensors, space)
        super().__init__(venv, observation_space=self._view.space)
        self.seeds: Sequence[int | None] | None = None
        self._next_seeds: Sequence[int | None] | None = None

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the environments and the sensors at the next reset."""
        self._next_seeds = self.venv.seed(seed)
        return self._next_seeds

    def reset(self) -> dict[str, Any]:
        """Reset all robots."""
        observations: Any = self.venv.reset()
        self.seeds, self._next_seeds = self._next_seeds, None
        key, averaged = self.venv.get_attr("row_key", 0)[0], self.venv.get_attr("row_averaged", 0)[0]
        self.sensors.set_rows(key, averaged)
        self.sensors.reset(observations[TRUTH_KEY], None, self.seeds)
        return self._view.show(observations)

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Finish a step and read the sensors."""
        given: Any
        given, rewards, dones, infos = self.venv.step_wait()
        rows = given[TRUTH_KEY]
        finals = {robot: infos[robot]["terminal_observation"] for robot in np.flatnonzero(dones).tolist()}
        self.sensors.step(merge_rows(rows, finals))
        for robot, final in finals.items():
            infos[robot] = {**infos[robot], "terminal_observation": self._view.show_one(final, robot)}
        if finals:
            self.sensors.begin_episode(rows, dones)
        return self._view.show(given), rewards, dones, infos

    @property
    def truth(self) -> dict[str, NDArray[Any]]:
        """What really happened at the end of the last step, to score against."""
        return batch_truth(self.sensors.truth, self.sensors.drawing)


class VecSelfCalibration(VecEnvWrapper):
    """Calibrate the readings of :class:`VecFootSensors` while the robots move, and observe the result.

    Args:
        venv: :class:`VecFootSensors` around a vector environment.
        method: As of :class:`~surefoot.wrappers.vector.self_calibration.VectorSelfCalibration`, like all.
        initial: The map to start from.
        show: What is observed.
        lag: How many samples ago a reference describes the feet.
        fresh: Whether the calibration of a robot starts fresh at each of its resets.
        errors: How wrong the robots are about themselves, also as a mapping of some of the fields.
        stream: Number of the random stream.
        options: Options of the method.

    Attributes:
        calibration: The calibration of all robots.

    Raises:
        TypeError: If it is not right around :class:`VecFootSensors`.
        ValueError: If the method or an option does not exist, or a value has no meaning.
    """

    def __init__(
        self,
        venv: VecEnv,
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
        if not isinstance(venv, VecFootSensors):
            raise TypeError(
                "VecSelfCalibration calibrates the counts of VecFootSensors and goes right around them: "
                f"VecSelfCalibration(VecFootSensors(venv)). Got {type(venv).__name__}."
            )
        self._feet = venv
        self.calibration = BatchCalibration(
            venv.sensors,
            method,
            initial=initial,
            show=show,
            lag=lag,
            fresh=fresh,
            errors=belief_errors(errors, options),
            stream=stream,
            options=options,
        )
        space: Any = venv.observation_space
        feet = self.calibration.feet
        shown = spaces.Dict(feet.around(space.spaces, feet.spaces))
        super().__init__(venv, observation_space=shown)

    def reset(self) -> dict[str, Any]:
        """Reset all robots; calibration starts fresh if they were seeded."""
        observations = self._feet.reset()
        self.calibration.reset(None, self._feet.seeds)
        return self.calibration.feet.around(observations, self.calibration.feet.shown)

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Finish a step and calibrate by one sample."""
        observations, rewards, dones, infos = self._feet.step_wait()
        calibration = self.calibration
        calibration.step()
        for robot in np.flatnonzero(dones).tolist():
            final = calibration.feet.around(
                infos[robot]["terminal_observation"], calibration.feet.last_of(robot)
            )
            infos[robot] = {**infos[robot], "terminal_observation": final}
        if dones.any():
            calibration.begin_episode(dones)
        return calibration.feet.around(observations, calibration.feet.shown), rewards, dones, infos
