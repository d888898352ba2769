"""Sensors between the truth of many robots and who observes them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from surefoot.calibration import Parameters
from surefoot.envs.batch import BatchVectorEnv
from surefoot.sensors import Encoders, Imu, Link
from surefoot.wrappers.foot_device import FootDevice
from surefoot.wrappers.foot_sensors import SENSOR_STREAM
from surefoot.wrappers.source import split_options
from surefoot.wrappers.vector.sensors import BatchSensors, choose_devices
from surefoot.wrappers.vector.truth import batch_truth
from surefoot.wrappers.vector.truth_row import TRUTH_KEY, VectorTruthRow
from surefoot.wrappers.vector.view import Attribute, BatchView, check_copies, merge_rows

Infos = dict[str, Any]


class VectorFootSensors(VectorWrapper[Any, Any, Any, Any, Any]):
    """Read many robots through load cells or ankle sensors, joint encoders and IMUs.

    It goes right around a vector environment whose copies have :class:`~surefoot.wrappers.TruthRow` around
    them, or around a :class:`~surefoot.envs.batch.BatchVectorEnv` as it is. The observation is a ``Dict``
    without truth and with ``"foot_raw"`` (N, K) counts, and where copies have a ``state_layout``, telemetry
    takes the place of ``joint_position``, ``joint_velocity``, ``tilt`` and ``gyroscope`` in ``"state"``: as
    :class:`~surefoot.wrappers.FootSensors` does for one robot, but for three simplifications. Loads are known
    at the ends of control steps, with straight lines between; telemetry comes once a control step; and it is
    late by the link's mean delay in whole steps, without jitter.

    ``infos["surefoot"]["truth"]`` holds (N, ...) arrays (:func:`surefoot.wrappers.vector.truth.batch_truth`).

    All three autoreset modes are served. Sensors stay as they are when a robot is reset, and drift on, as
    hardware does; ``fresh=True`` gives a robot that is reset fresh ones. A reset with a seed draws fresh
    ones for the robots that are seeded; ``options={"surefoot": {"sensors": "fresh" or "keep"}}`` decides for
    one reset. Each robot draws from streams of its own: a copy that is reset with a seed has the sensors of a
    :class:`~surefoot.wrappers.FootSensors` that is reset with it, wherever it stands.

    Args:
        env: A vector environment.
        config: What is under the feet: a preset's name, a mapping or a configuration; ``None`` for the cells
            of ``"hx711-load-cells"``, or larger ones for a robot that is too heavy for these.
        imu: The IMUs, likewise.
        encoders: The joint encoders, likewise.
        link: The links over which encoders and IMUs reach the hosts, likewise.
        severity: Factor of all errors of the feet's sensors, see :func:`~surefoot.sensors.scaled`.
        fresh: Whether a robot that is reset gets fresh sensors.
        stream: Number of the random stream, for independent sensors on the same episodes.

    Attributes:
        sensors: The sensors of all robots.

    Raises:
        TypeError: If copies have no row of truth, or show readings already.
        ValueError: If copies differ in their observation space or in the robot, a preset is unknown, a value
            is refused, or the sensors do not fit the robot.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        config: str | Mapping[str, Any] | FootDevice | None = None,
        *,
        imu: str | Mapping[str, Any] | Imu = "nao-imu",
        encoders: str | Mapping[str, Any] | Encoders = "nao-encoders",
        link: str | Mapping[str, Any] | Link = "nao-wlan",
        severity: float = 1.0,
        fresh: bool = False,
        stream: int = SENSOR_STREAM,
    ) -> None:
        if isinstance(env.unwrapped, BatchVectorEnv) and not isinstance(env, VectorTruthRow):
            env = VectorTruthRow(env)
        super().__init__(env)
        copies: Any = env if isinstance(env, VectorTruthRow) else env.unwrapped
        self._attribute: Attribute = copies.get_attr
        space: Any = env.single_observation_space
        drawing, meaning = check_copies("VectorFootSensors", space, self._attribute)
        devices = choose_devices("VectorFootSensors", drawing, config, imu, encoders, link, severity, stream)
        count = env.num_envs
        self.sensors = BatchSensors(count, drawing, meaning, devices, stream=stream, fresh=fresh)
        self._view = BatchView(self.sensors, space)
        self.single_observation_space = self._view.space
        self.observation_space = batch_space(self._view.space, count)
        self._mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        self._done = np.zeros(count, dtype=bool)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, Infos]:
        """Reset all robots, or those of ``options["reset_mask"]``.

        Args:
            seed: A number or one a robot: seeds the environments, and the sensors of those that are seeded.
            options: ``options["surefoot"]["sensors"]`` may be ``"fresh"`` or ``"keep"``; the rest is handed
                to the environments.

        Raises:
            ValueError: If a choice does not exist.
        """
        rest, asked = split_options(options, "sensors", "calibration")
        mask = None if rest is None else rest.get("reset_mask")
        # Vector environments take the mask out of what they are given.
        observations, infos = self.env.reset(seed=seed, options=None if rest is None else dict(rest))
        self._done[slice(None) if mask is None else mask] = False
        key, averaged = (self._attribute(name)[0] for name in ("row_key", "row_averaged"))
        self.sensors.set_rows(key, averaged)
        self.sensors.reset(observations[TRUTH_KEY], mask, seed, asked.get("sensors"))
        return self._view.show(observations), self._with_truth(infos)

    def step(self, actions: Any) -> tuple[Any, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Step all robots and read their sensors."""
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        rows, done = observations[TRUTH_KEY], terminations | truncations
        if self._mode is AutoresetMode.SAME_STEP and done.any():
            finals = {robot: infos["final_obs"][robot] for robot in np.flatnonzero(done).tolist()}
            self.sensors.step(merge_rows(rows, finals))
            shown = infos["final_obs"].copy()
            for robot, final in finals.items():
                shown[robot] = self._view.show_one(final, robot)
            infos = {**infos, "final_obs": shown}
            self.sensors.begin_episode(rows, done)
        else:
            starting = self._done if self._mode is AutoresetMode.NEXT_STEP and self._done.any() else None
            self.sensors.step(rows, starting)
        self._done = done
        return self._view.show(observations), rewards, terminations, truncations, self._with_truth(infos)

    def true_parameters(self) -> Parameters:
        """Return the maps that undo the cells' errors now, shape (N, K): truth, to score against."""
        return self.sensors.true_parameters()

    def _with_truth(self, infos: Infos) -> Infos:
        known = infos.get("surefoot", {})
        truth = batch_truth(self.sensors.truth, self.sensors.drawing)
        return {**infos, "surefoot": {**known, "truth": truth}}
