"""Log how accurate calibrated feet are while a policy of Stable-Baselines3 trains: TensorBoard, CSV.

Needs the extra ``surefoot[rl]``.
"""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import MomentumReference, Reference
from surefoot.calibration.cop import cop_of_feet, sole_wrenches
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.extras import not_installed
from surefoot.wrappers.self_calibration import SelfCalibration
from surefoot.wrappers.vector.sb3 import VecSelfCalibration

try:
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import unwrap_vec_wrapper
except ModuleNotFoundError as missing:
    raise not_installed(__name__, missing, "rl") from None

TRUE_ERROR: Final = "feet/true_cop_error_m"
"""Root mean square difference in m, over samples and both axes, between the centres of pressure that the
learnt map and the true map make of the same readings."""

STATED_STD: Final = "feet/stated_cop_std_m"
"""Standard deviation of the same that the calibrator states, root mean square in m."""

FLAGGED: Final = "feet/flagged_channels"
"""Share of channels with any flag, over samples; behind a slash, that with one of them."""


_BITS: Final = np.array([sum(Flag), *Flag])


class CalibrationLog(BaseCallback):
    """Log the calibration error of all robots since the logger last wrote.

    | Key | Value | Unit |
    |-----|-------|------|
    | ``feet/true_cop_error_m`` | error of the common centre of pressure by the learnt map, rms | m |
    | ``feet/stated_cop_std_m`` | its standard deviation as the calibrator reports it, rms | m |
    | ``feet/flagged_channels`` | share of channels with any flag | 1 |
    | ``feet/flagged_channels/spike`` | share with this one, for each flag that was raised | 1 |

    The error is that of the map alone: the learnt and the true scales and offsets are applied to the same
    readings. A consistent calibrator has about the same error and standard deviation. Neither contains the
    age and the noise of the readings, which move the centre of pressure by more while a policy explores. A
    method without a covariance has no standard deviation. Policy and calibrator never see the truth.

    It goes with :class:`~surefoot.wrappers.vector.sb3.VecSelfCalibration` anywhere among the wrappers, or
    with :class:`~surefoot.wrappers.SelfCalibration` around each copy (without the last sample of an episode).

    Args:
        every: Looks are this many steps apart, by default ten a second at 80 Hz: each costs time.

    Raises:
        ValueError: If ``every`` is no whole number from 1 on.
        TypeError: As training starts, if nothing calibrates the environment.
    """

    def __init__(self, every: int = 8) -> None:
        super().__init__()
        if isinstance(every, bool) or not isinstance(every, int) or every < 1:
            raise ValueError(f"'every' must be a whole number of steps from 1 on, got {every!r}.")
        self._every = every

    def _on_training_start(self) -> None:
        env = self.training_env
        self._many = unwrap_vec_wrapper(env, VecSelfCalibration)
        if self._many is None and not all(env.env_is_wrapped(SelfCalibration)):
            raise TypeError(
                "CalibrationLog logs calibrated feet and found none; wrap in this order: "
                f"VecSelfCalibration(VecFootSensors(venv)). Got {env}."
            )
        self._layout = self._many.calibration.setup.layout if self._many else env.get_attr("layout")[0]

    def _on_rollout_start(self) -> None:
        if FLAGGED not in self.logger.name_to_value:
            self._squares: NDArray[np.float64] = np.zeros((2, 2))
            self._flagged: NDArray[np.float64] = np.zeros(1 + len(Flag))
            self._channels = 0

    def _on_step(self) -> bool:
        if self.n_calls % self._every or not (samples := list(self._samples())):
            return True
        estimates, references, readings, maps = zip(*samples, strict=True)
        position, R = (
            np.array([getattr(own, name) for own in references]) for name in ("position_sole", "R_level_sole")
        )
        raw = np.array(readings)
        learnt, true = (
            cop_of_feet(sole_wrenches(np.array(scale) * raw + np.array(offset), self._layout), position, R)
            for scale, offset in (
                zip(*((own.scale, own.offset) for own in estimates), strict=True),
                zip(*maps, strict=True),
            )
        )
        error = learnt - true
        known = np.isfinite(error).all(axis=1)
        if estimates[0].cop_covariance is not None:
            covariance = np.array([own.cop_covariance for own in estimates])
            known &= np.isfinite(covariance).all(axis=(1, 2))
            self._add(1, np.diagonal(covariance[known], axis1=1, axis2=2))
        self._add(0, error[known] ** 2)
        raised = np.concatenate([own.flags for own in estimates])[:, None] & _BITS
        self._flagged += np.count_nonzero(raised, axis=0)
        self._channels += len(raised)
        return True

    def _add(self, place: int, squares: NDArray[np.float64]) -> None:
        self._squares[place] += squares.sum(), squares.size

    def _on_rollout_end(self) -> None:
        for name, (total, count) in zip((TRUE_ERROR, STATED_STD), self._squares.tolist(), strict=True):
            if count:
                self.logger.record(name, (total / count) ** 0.5)
        whole, *each = (self._flagged / max(self._channels, 1)).tolist()
        self.logger.record(FLAGGED, whole)
        for flag, share in zip(Flag, each, strict=True):
            if share:
                self.logger.record(f"{FLAGGED}/{str(flag.name).lower()}", share)

    def _samples(self) -> Iterator[tuple[Estimate, Reference | MomentumReference, Any, Any]]:
        """Yield each robot's estimate, its reference, its readings (K,) and the true map of these."""
        if self._many is not None:
            for robot, sensors in zip(
                self._many.calibration.robots, self._many.venv.sensors.robots, strict=True
            ):
                yield robot.estimate, robot.reference, sensors.raw, sensors.true_parameters()
            return
        env = self.training_env
        parts = (env.get_attr(name) for name in ("estimate", "reference", "raw"))
        for *own, true_map, done in zip(
            *parts, env.env_method("true_parameters"), self.locals["dones"], strict=True
        ):
            if not done:  # else all are of the next episode
                yield (*own, true_map)
