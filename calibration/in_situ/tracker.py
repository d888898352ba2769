r"""Follow a calibrated six-axis sensor while its limb hangs in the air: offset, and gains where they show.

A calibration ages: zeros walk with heat and use, gains a little. Whenever nothing but its own weight hangs on
the sensor, a reading in motion or at rest is (in-situ paper, Eqs. 2 and 5, with errors written out)

.. math:: r = A\,[(1 + D)\, w + h] + o(t) + e, \qquad w = T(\varphi)\, u,

and linear in what may have changed: the offset o, which walks; relative errors D of the response; errors of
the limb's mass and first moment; and h, by which the sensor lags behind its load. A Kalman filter takes them
in (:mod:`surefoot.calibration.moment.kalman`, the step of the walking estimator), from an
:class:`~surefoot.calibration.in_situ.fit.InSituFit` with its covariance as the prior.

* **What one hanging limb cannot tell is considered, not estimated** (Schmidt, 1966): the limb always, and of
  D all that ``learn`` does not name. Their uncertainty enters every gain, so the claimed deviations hold.
  (If the limb were estimated along, it would take hysteresis in.)
* **Observability first.** A limb that does not turn cannot tell gains from offset, and the covariance knows
  that. Hysteresis h changes with the way the load has turned and not with time: while the limb stands still
  it cannot be told from the offset either, however many samples say the same.
* **Touch.** With ``in_air=False``, or where a reading is off beyond all chance, something else than the
  limb's weight acts: nothing is learnt, and the walk's variance grows. A zero that has leapt far looks alike:
  :meth:`InSituTracker.doubt` tells the tracker that it may have.
* Heat that moves the zero is followed through the walk.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from array_api_compat import is_array_api_obj
from numpy.typing import ArrayLike

from surefoot.calibration._setup import check_not_negative, check_positive
from surefoot.calibration.in_situ.fit import InSituFit

__all__ = [
    "InSituEstimate",
    "InSituMethod",
    "InSituTracker",
    "InSituTrackerConfig",
    "in_situ_tracker",
]

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""

LEARN = ("offset", "axes", "matrix")
"""What a tracker can estimate: the offset alone, with one relative factor an axis, with all of D."""


@dataclass(frozen=True, kw_only=True)
class InSituTrackerConfig:
    """Options of the tracker; the defaults are those of strain gauges in a leg."""

    learn: str = "offset"
    """What is estimated: ``"offset"`` alone, ``"axes"`` with a relative factor for each axis, or
    ``"matrix"`` with all 36 relative errors of the response. The rest is considered."""

    walk_force: float = 0.1 / 60.0**0.5
    """Random walk of the offset as the matrix shows it, in N/sqrt(s): 0.1 N per square root of a minute."""

    walk_torque: float = 0.002 / 60.0**0.5
    """The same for torques in N m/sqrt(s)."""

    walk_gain: float = 5e-4 / 60.0**0.5
    """Random walk of each axis's relative gain in 1/sqrt(s)."""

    since_fit_force: float = 0.5
    """How far the offset may have moved along each axis since the calibration, in N: zeros jump from one
    power-up to the next, on some sensors by hundreds."""

    since_fit_torque: float = 0.01
    """The same for torques in N m."""

    lag: float | None = None
    """Standard deviation of what hysteresis adds to an axis, as a share of half the load's size; None takes
    the shares that the fit found, or none."""

    lag_angle: float = 0.5
    """Angle in rad by which gravity turns before hysteresis has forgotten."""

    added_mass: float = 0.0
    """Mass in kg that hangs on the limb, known, such as a shoe."""

    added_com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Its centre of mass in the sensor's frame in m."""

    gate: float = 3.0
    """Standard deviations beyond which a row pulls no harder."""

    reject: float = 5.0
    """Standard deviations of a whole reading (Mahalanobis) beyond which something touches the limb, if what
    it adds is also beyond ``touch``."""

    touch: float = 0.05
    """Share of the limb's weight, and of the weight's largest torque, below which an innovation is taken for
    an error of the sensor, however unlikely: it pulls at the gate."""

    code_range: tuple[float, float] | None = None
    """Lowest and highest count of the converter; a reading with a channel there is not learnt from."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        if self.learn not in LEARN:
            raise ValueError(f"'learn' must be one of {LEARN}, got {self.learn!r}.")
        check_positive(self, "lag_angle", "gate", "reject")
        check_not_negative(
            self,
            "walk_force",
            "walk_torque",
            "walk_gain",
            "since_fit_force",
            "since_fit_torque",
            "added_mass",
            "touch",
        )
        if self.lag is not None:
            check_not_negative(self, "lag")
        if self.code_range is not None and not self.code_range[0] < self.code_range[1]:
            raise ValueError(f"'code_range' must be (lowest, highest), got {self.code_range!r}.")


class InSituEstimate(NamedTuple):
    """One reading by what is known now; any leading batch dimensions ``...``; k channels. Always finite.

    Attributes:
        wrench: What the limb exerts on the robot, at and in the sensor's frame in N and N m, shape (..., 6).
        wrench_std: Its standard deviation by the calibration, without the sample's noise, shape (..., 6).
        offset: o in counts, shape (..., k).
        offset_std: Its standard deviation, shape (..., k).
        gain: 1 + D, shape (..., 6, 6): the response is now A (1 + D).
        gain_std: Standard deviation of its entries, also of those not estimated, shape (..., 6, 6).
        covariance: Of (offset, D row by row), shape (..., k + 36, k + 36).
        nis: Normalised innovation squared of this sample, shape (...), NaN where nothing was learnt.
        nis_rows: Its degrees of freedom, shape (...).
        learnt: Whether the sample was learnt from (bool), shape (...).
        flags: Bits of :class:`~surefoot.calibration.estimate.Flag`, shape (..., k): MISSING, OUT_OF_RANGE
            and SATURATED of a channel; REFERENCE (gravity or motion is not finite or not physical), GAP (no
            time has passed, or no number), REJECTED (a touch) and SINGULAR of all.
    """

    wrench: Array
    wrench_std: Array
    offset: Array
    offset_std: Array
    gain: Array
    gain_std: Array
    covariance: Array
    nis: Array
    nis_rows: Array
    learnt: Array
    flags: Array


class InSituMethod(NamedTuple):
    """A tracker as a pair of pure functions on the array API standard.

    Attributes:
        init: ``init(raw) -> state``. ``raw``, shape (..., k), tells the library, dtype, device and batch.
        update: ``update(state, raw, gravity, dt, *, angular_velocity=None, angular_acceleration=None,
            in_air=True) -> (state, InSituEstimate)``.
    """

    init: Callable[[Array], Any]
    update: Callable[..., tuple[Any, InSituEstimate]]


def in_situ_tracker(fit: InSituFit, config: InSituTrackerConfig | None = None) -> InSituMethod:
    """Build a tracker as a pair of pure functions.

    Args:
        fit: The calibration to begin from.
        config: Options.

    Raises:
        ValueError: If the fit was refused, or its limb is not known well enough to say what it weighs.
    """
    from surefoot.calibration.in_situ._stream import InSituStream

    stream = InSituStream(fit, config or InSituTrackerConfig())
    return InSituMethod(stream.init, stream.update)


class InSituTracker:
    """Follow one sensor, or a batch: a thin object that carries the state of :func:`in_situ_tracker` along.

    Args:
        fit: The calibration to begin from.
        options: Fields of :class:`InSituTrackerConfig`.

    Raises:
        ValueError: If the fit was refused, or an option has a value without meaning.
    """

    def __init__(self, fit: InSituFit, **options: Any) -> None:
        from surefoot.calibration.in_situ._stream import InSituStream

        self.config = InSituTrackerConfig(**options)
        self._stream = InSituStream(fit, self.config)
        self._state: Any = None

    @property
    def state(self) -> Any:
        """The state, a value to keep (:func:`~surefoot.calibration.state.save_state`) and to put back.

        ``None`` before the first sample.
        """
        return self._state

    @state.setter
    def state(self, state: Any) -> None:
        self._state = state

    def update(
        self,
        raw: ArrayLike | Array,
        gravity: ArrayLike | Array,
        dt: float,
        angular_velocity: ArrayLike | Array | None = None,
        angular_acceleration: ArrayLike | Array | None = None,
        in_air: bool | Array = True,
    ) -> InSituEstimate:
        """Take in one sample.

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
        """Allow that the zero has leapt, after an overload or a power-up.

        Args:
            force: Standard deviation of the leap along each axis in N.
            torque: The same for torques in N m.

        Raises:
            RuntimeError: If no sample came yet: then say so by ``since_fit_force`` and ``since_fit_torque``.
        """
        if self._state is None:
            raise RuntimeError("There is nothing to doubt before the first update().")
        self._state = self._stream.doubt(self._state, force, torque)

    def reset(self) -> None:
        """Forget everything since the calibration."""
        self._state = None


def _array(values: ArrayLike | Array) -> Array:
    if not is_array_api_obj(values) or (isinstance(values, np.ndarray) and values.dtype.kind in "iu"):
        return np.asarray(values, dtype=np.float64)
    return values
