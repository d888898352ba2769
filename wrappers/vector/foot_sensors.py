"""Sensors between the truth of many robots and their observer."""

from collections.abc import Mapping
from typing import Any, Unpack

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from surefoot.envs.batch import BatchVectorEnv
from surefoot.pickles import OfOneVersion
from surefoot.robot.sensing.device import FootDevice
from surefoot.robot.sensing.foot_equipment import FootEquipment, FootOptions, equip
from surefoot.robot.sensing.raw_view import TRUTH_KEY
from surefoot.wrappers.source import refuse_second, split_options
from surefoot.wrappers.vector.sensors import BatchSensors, BatchSensorsFace, merge_rows
from surefoot.wrappers.vector.truth_row import AnyVectorWrapper, VectorTruthRow

Infos = dict[str, Any]


class VectorFootSensors(OfOneVersion, BatchSensorsFace, AnyVectorWrapper):
    """Read many robots through load cells or ankle sensors, joint encoders and IMUs.

    It wraps a vector environment whose copies are wrapped in :class:`~surefoot.wrappers.TruthRow`, or a
    :class:`~surefoot.envs.batch.BatchVectorEnv`. The observation is a ``Dict`` without truth and with
    ``"foot_raw"`` (N, K) counts. If the copies have a ``state_layout``, telemetry replaces
    ``joint_position``, ``joint_velocity``, ``tilt`` and ``gyroscope`` in ``"state"``. Each robot has the
    readings that :class:`~surefoot.wrappers.FootSensors` would give it.

    ``infos["surefoot"]["truth"]`` holds (N, ...) arrays
    (:func:`surefoot.envs.instrumentation.means.mean_truth`).

    All three autoreset modes are supported. A reset of a robot keeps its sensors, which continue to drift as
    hardware does; ``fresh=True`` draws fresh ones. A reset with a seed draws fresh sensors for the robots
    that are seeded, and ``options={"surefoot": {"sensors": "fresh" or "keep"}}`` decides for one reset. Each
    robot has its own random streams: a copy that is reset with a seed has the sensors of a
    :class:`~surefoot.wrappers.FootSensors` that is reset with it, at any place in the vector.

    Args:
        env: A vector environment.
        config: The instruments under the feet, or all sensors as one
            :class:`~surefoot.wrappers.FootEquipment`.
        measure_state: Whether encoders and IMU replace the parts that a ``state_layout`` names.
        options: Fields of :class:`~surefoot.wrappers.FootEquipment`, as for
            :class:`~surefoot.wrappers.FootSensors`.

    Attributes:
        sensors: The sensors of all robots.

    Raises:
        TypeError: If copies have no row of truth, or already have sensors.
        ValueError: If copies differ in their observation space or in the robot, a preset is unknown, a value
            is refused, or the sensors do not fit the robot.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        config: str | Mapping[str, Any] | FootDevice | FootEquipment | None = None,
        *,
        measure_state: bool = True,
        **options: Unpack[FootOptions],
    ) -> None:
        if not isinstance(env, VectorEnv):
            raise TypeError(
                f"VectorFootSensors goes around many robots, as gym.make_vec(...) makes them, got {env!r}; "
                "for the one that gym.make(...) makes there is FootSensors, for Stable-Baselines3's many "
                "VecFootSensors in surefoot.wrappers.vector.sb3."
            )
        refuse_second("VectorFootSensors", env)
        if isinstance(env.unwrapped, BatchVectorEnv) and not isinstance(env, VectorTruthRow):
            env = VectorTruthRow(env, lends=True)
        super().__init__(env)
        copies: Any = env if isinstance(env, VectorTruthRow) else env.unwrapped
        space, count = env.single_observation_space, env.num_envs
        self.sensors = BatchSensors(
            "VectorFootSensors", count, space, copies.get_attr, equip(config, **options), measure_state
        )
        self.single_observation_space = self.sensors.view.space
        self.observation_space = batch_space(self.single_observation_space, count)
        self._mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        self._done = np.zeros(count, dtype=bool)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, Infos]:
        """Reset all robots, or those of ``options["reset_mask"]``.

        Args:
            seed: A number or one per robot. It seeds the environments and the sensors.
            options: ``options["surefoot"]["sensors"]`` may be ``"fresh"`` or ``"keep"``. Other options are
                passed to the environments.

        Raises:
            ValueError: If a choice does not exist.
        """
        rest, asked = split_options(options, "sensors", "calibration")
        mask = None if rest is None else rest.get("reset_mask")
        # Vector environments remove the mask from the options.
        observations, infos = self.env.reset(seed=seed, options=None if rest is None else dict(rest))
        self._done[slice(None) if mask is None else mask] = False
        self.sensors.reset(observations[TRUTH_KEY], mask, seed, asked)
        return self.sensors.show(observations), self._with_truth(infos)

    def step(self, actions: Any) -> tuple[Any, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Step all robots and read their sensors."""
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        rows, done = observations[TRUTH_KEY], terminations | truncations
        if self._mode is AutoresetMode.SAME_STEP and done.any():
            finals = {robot: infos["final_obs"][robot] for robot in np.flatnonzero(done).tolist()}
            self.sensors.step(merge_rows(rows, finals), fell=terminations)
            shown = infos["final_obs"].copy()
            for robot, final in finals.items():
                shown[robot] = self.sensors.show_one(final, robot)
            infos = {**infos, "final_obs": shown}
            self.sensors.begin(rows, done)
        else:
            starting = self._done if self._mode is AutoresetMode.NEXT_STEP and self._done.any() else None
            self.sensors.step(rows, starting, terminations)
        self._done = done
        return self.sensors.show(observations), rewards, terminations, truncations, self._with_truth(infos)

    def _with_truth(self, infos: Infos) -> Infos:
        known, below, sensors = infos.get("surefoot", {}), self.env, self.sensors
        truth = (
            below.mean_truth | sensors.true_conditions()
            if isinstance(below, VectorTruthRow)
            else sensors.truth
        )
        return {**infos, "surefoot": {**known, "truth": truth}}
