"""How right calibrated feet are while a policy of Stable-Baselines3 trains, for its logger: TensorBoard, CSV.

Needs the extra ``surefoot[rl]``.
"""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import MomentumReference, Reference
from surefoot.calibration.cop import cop_of_feet
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
"""Root mean square over samples and both axes of the estimated less the true centre of pressure in m."""

STATED_STD: Final = "feet/stated_cop_std_m"
"""Standard deviation of the same that the calibrator states, root mean square in m."""

FLAGGED: Final = "feet/flagged_channels"
"""Share of channels with any flag, over samples; behind a slash, that with one of them."""


_BITS: Final = np.array([sum(Flag), *Flag])


class CalibrationLog(BaseCallback):
    """Log how right the feet are: over all looks at all robots since the logger wrote last.

    | Key | Value | Unit |
    |-----|-------|------|
    | ``feet/true_cop_error_m`` | error of the common centre of pressure against the truth, rms | m |
    | ``feet/stated_cop_std_m`` | its standard deviation as the calibrator states it, rms | m |
    | ``feet/flagged_channels`` | share of channels with any flag | 1 |
    | ``feet/flagged_channels/spike`` | share with this one, for each flag that was raised | 1 |

    A calibrator that knows how wrong it is has about the same error and standard deviation. The true forces
    are placed under the soles that the estimate is placed under, so that both speak of forces alone. A method
    that states no covariance has no standard deviation. It is for the eye: neither policy nor calibrator sees
    the truth.

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
                "CalibrationLog tells of calibrated feet and found none; wrap in this order: "
                f"VecSelfCalibration(VecFootSensors(venv)). Got {env}."
            )

    def _on_rollout_start(self) -> None:
        if FLAGGED not in self.logger.name_to_value:
            self._squares: NDArray[np.float64] = np.zeros((2, 2))
            self._flagged: NDArray[np.float64] = np.zeros(1 + len(Flag))
            self._channels = 0

    def _on_step(self) -> bool:
        if self.n_calls % self._every or not (samples := list(self._samples())):
            return True
        estimates, references, wrenches = zip(*samples, strict=True)
        position, R = (
            np.array([getattr(own, name) for own in references]) for name in ("position_sole", "R_level_sole")
        )
        error = np.array([own.cop for own in estimates]) - cop_of_feet(np.array(wrenches), position, R)
        known = np.isfinite(error).all(axis=1)
        self._add(0, error[known] ** 2)
        if estimates[0].cop_covariance is not None:
            covariance = np.array([own.cop_covariance for own in estimates])[known]
            self._add(1, np.diagonal(covariance, axis1=1, axis2=2))
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

    def _samples(self) -> Iterator[tuple[Estimate, Reference | MomentumReference, Any]]:
        """Yield each robot's estimate, its reference and the true wrenches at its soles (2, 6)."""
        if self._many is not None:
            wrenches = self._many.venv.truth["wrench_sole"]
            for robot, wrench_sole in zip(self._many.calibration.robots, wrenches, strict=True):
                yield robot.estimate, robot.reference, wrench_sole
            return
        env, infos, dones = self.training_env, self.locals["infos"], self.locals["dones"]
        found = zip(env.get_attr("estimate"), env.get_attr("reference"), infos, dones, strict=True)
        for estimate, reference, info, done in found:
            if not done:  # else both are of the next episode
                yield estimate, reference, info["surefoot"]["truth"]["wrench_sole"]
