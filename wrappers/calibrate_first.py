"""Calibrate the feet by a calibration motion before each episode."""

from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np

from surefoot.calibration.excitation.certainty import ENOUGH, Certainty
from surefoot.wrappers.self_calibration import SelfCalibration

TRIES = 3
"""Number of attempts to start an episode without a fall before an error is raised."""


class CalibrateFirst(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Play the environment's prelude within :meth:`reset`, and stop it when the calibrator is certain.

    The wrapped environment must have a ``prelude`` (``surefoot calibrate motion`` writes one). The caller
    steps through the episode only, with a calibrator that has used the prelude. ``info["surefoot"]`` gains
    ``"certain"``, ``"cop_std"`` in m, averaged over a second, and at a reset ``"prelude_time"``, the duration
    of the prelude in s.

    Args:
        env: An environment with :class:`SelfCalibration` around it.
        enough: The prelude stops when the standard deviation of the centre of pressure in m falls below this.
            With 0 the prelude is played to its end.
        again: Limit of this standard deviation in m for :attr:`wanted`, by default 1.5 times ``enough``.

    Raises:
        TypeError: If ``env`` does not contain a :class:`SelfCalibration`.
        ValueError: If the environment lacks a prelude, the calibrator does not report a covariance, or a
            number is out of its range.
    """

    def __init__(self, env: gym.Env[Any, Any], *, enough: float = ENOUGH, again: float | None = None) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, enough=enough, again=again)
        gym.Wrapper.__init__(self, env)
        below: Any = env
        while isinstance(below, gym.Wrapper) and not isinstance(below, SelfCalibration):
            below = below.env
        if not isinstance(below, SelfCalibration):
            raise TypeError(f"CalibrateFirst needs SelfCalibration below it, got {env}.")
        self._calibration = below
        self._prelude: Any = getattr(env.unwrapped, "prelude", None)
        if self._prelude is None or self._prelude.duration == 0.0:
            raise ValueError(
                f"{env.unwrapped} has no prelude to calibrate by; make it with prelude=..., the path of what "
                "surefoot calibrate motion wrote."
            )
        self._stops = enough > 0.0
        bare: Any = env.unwrapped
        self._dt = float(bare.dt)
        self._certainty = Certainty(enough if self._stops else ENOUGH, again, dt=self._dt)

    @property
    def wanted(self) -> bool:
        """Whether the uncertainty has grown above the limit, so that the robot should calibrate again."""
        return not self._certainty.certain

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode and calibrate.

        Args:
            seed: Passed on to the environment.
            options: Passed on to the environment.

        Raises:
            RuntimeError: If the robot falls during its prelude in each of :data:`TRIES` attempts.
        """
        still = np.zeros(self.action_space.shape or (), dtype=np.float32)
        for _ in range(TRIES):
            observation, info = self.env.reset(seed=seed, options=options)
            self._certainty.forget()
            steps, fell = 0, False
            while self._prelude.playing and not fell:
                observation, _, fell, _, info = self.env.step(still)
                steps += 1
                self._watch(info)
                if self._stops and self._certainty.certain:
                    self._prelude.stop()
            if not fell:
                info["surefoot"]["prelude_time"] = steps * self._dt
                return observation, info
            seed = None
        raise RuntimeError(
            f"The robot fell in its prelude {TRIES} times; plan one with a larger margin or less torque."
        )

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step, and report how certain the calibrator is."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._watch(info)
        return observation, reward, terminated, truncated, info

    def _watch(self, info: dict[str, Any]) -> None:
        covariance = self._calibration.estimate.cop_covariance
        if covariance is None:
            raise ValueError("CalibrateFirst needs a method that says how certain it is, such as 'moment'.")
        self._certainty.update(np.sqrt(np.diagonal(np.asarray(covariance))))
        info["surefoot"] |= {"certain": self._certainty.certain, "cop_std": self._certainty.std}
