r"""A calibrated sensor, followed while its limb hangs in the air: offset, and scales where they show.

A calibration ages: offsets drift with heat and use, scales a little. Whenever nothing but its own weight
hangs on the sensor, a reading in motion or at rest is (in-situ paper, Eqs. 2 and 5, with errors written out)

.. math:: r = A\,[(1 + D)\, w + h] + o(t) + e, \qquad w = T(\varphi)\, u,

and linear in what may have changed: the offset o, a random walk; relative errors D of the response; errors of
the limb's mass and first moment; and h, by which the sensor lags behind its load. A Kalman filter takes them
in (:mod:`surefoot.calibration.moment.kalman`, the step of the walking estimator), from an
:class:`~surefoot.calibration.in_situ.fit.InSituFit` with its covariance as the prior.

* **What one hanging limb does not determine is considered, not estimated** (Schmidt, 1966): the limb always,
  and of D all that ``learn`` does not name. Their uncertainty enters every gain of the filter, so that
  the reported deviations hold. (If the limb were estimated along, it would take hysteresis in.)
* **Observability first.** A limb that does not turn does not separate scales from offset, and the covariance
  knows that. Hysteresis h changes with the way the load has turned and not with time: while the limb stands
  still nothing separates it from the offset either, however many samples repeat the same.
* **Touch.** With ``in_air=False``, or where a reading is off beyond all chance, something else than the
  limb's weight acts: nothing is learnt, and the variance of the drift grows. An offset that has leapt far
  looks alike: :meth:`InSituTracker.doubt` allows for that.
* Heat that moves the offset is followed through the drift.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.arrays import Array
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.calibration.in_situ.options import InSituTrackerConfig
from surefoot.calibration.in_situ.stream import InSituEstimate, InSituStream

__all__ = ["InSituMethod", "InSituTracker", "in_situ_tracker"]


class InSituMethod(NamedTuple):
    """A tracker as a pair of pure functions.

    Attributes:
        init: ``init(raw) -> state``. ``raw``, shape (..., k), sets the batch.
        update: ``update(state, raw, gravity, dt, *, angular_velocity=None, angular_acceleration=None,
            in_air=True) -> (state, InSituEstimate)``.
    """

    init: Callable[[Array], Any]
    update: Callable[..., tuple[Any, InSituEstimate]]


def in_situ_tracker(fit: InSituFit, config: InSituTrackerConfig | None = None) -> InSituMethod:
    """Return a tracker as a pair of pure functions.

    Args:
        fit: The calibration to begin from.
        config: Options.

    Raises:
        ValueError: If the fit was refused.
    """
    stream = InSituStream(fit, config or InSituTrackerConfig())
    return InSituMethod(stream.init, stream.update)


class InSituTracker:
    """A tracker of one sensor, or of a batch, with the state of :func:`in_situ_tracker` inside.

    Args:
        fit: The calibration to begin from.
        options: Fields of :class:`InSituTrackerConfig`.

    Raises:
        ValueError: If the fit was refused, or an option has a value without meaning.
    """

    def __init__(self, fit: InSituFit, **options: Any) -> None:
        self.config = InSituTrackerConfig(**options)
        self._stream = InSituStream(fit, self.config)
        self._state: Any = None

    @property
    def state(self) -> Any:
        """The state, a value to save (:func:`~surefoot.calibration.state.save_state`) and to set later.

        ``None`` before the first sample.
        """
        return self._state

    @state.setter
    def state(self, state: Any) -> None:
        self._state = state

    def update(
        self,
        raw: ArrayLike,
        gravity: ArrayLike,
        dt: float,
        angular_velocity: ArrayLike | None = None,
        angular_acceleration: ArrayLike | None = None,
        in_air: bool | Array = True,
    ) -> InSituEstimate:
        """Return the estimate after one more sample.

        Args:
            raw: Counts, shape (..., k); NaN where none arrived.
            gravity: g, moving g - a, in the sensor's frame in m/s^2, pointing down, shape (..., 3).
            dt: Time since the last sample in s.
            angular_velocity: Of the limb in the sensor's frame in rad/s, shape (..., 3); None at rest, or
                where motion is slow enough to be left out.
            angular_acceleration: In rad/s^2, shape (..., 3); given with the velocity or not at all.
            in_air: Whether nothing touches the limb, one for all or shape (...).

        Returns:
            The wrench, and what is known of the sensor.

        Raises:
            ValueError: If a shape does not fit, or motion is given for a limb without inertia.
        """
        raw = _array(raw)
        state = self._stream.init(raw) if self._state is None else self._state
        motion = {
            "angular_velocity": None if angular_velocity is None else _array(angular_velocity),
            "angular_acceleration": None if angular_acceleration is None else _array(angular_acceleration),
        }
        self._state, estimate = self._stream.update(state, raw, _array(gravity), dt, **motion, in_air=in_air)
        return estimate

    def doubt(self, force: float, torque: float) -> None:
        """Allow for a leap of the offset, after an overload or a power-up.

        Args:
            force: Standard deviation of the leap along each axis in N.
            torque: The same for torques in N m.

        Raises:
            RuntimeError: If no sample came yet: ``since_fit_force`` and ``since_fit_torque`` are for that.
        """
        if self._state is None:
            raise RuntimeError("There is nothing to doubt before the first update().")
        self._state = self._stream.doubt(self._state, force, torque)

    def reset(self) -> None:
        """Go back to the calibration."""
        self._state = None


def _array(values: ArrayLike) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)
