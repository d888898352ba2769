"""Options of in-situ calibration and of its tracker, and what may be known of the limb."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.checks import check_not_negative, check_positive

__all__ = ["InSituOptions", "InSituTrackerConfig", "KnownLimb"]

MOST_DRIFT = 8
"""Most cosines along which an offset may drift: more would follow the limb's turning."""


@dataclass(frozen=True, eq=False)
class KnownLimb:
    """What is known of the limb beforehand, such as from a model of the robot or from scales.

    Attributes:
        mass: m in kg.
        mass_std: Its standard deviation in kg.
        com: Centre of mass in the sensor's frame in m, shape (3,); None if only the mass is known.
        com_std: Its standard deviation along each axis in m.

    Raises:
        ValueError: If a value is not positive or not finite.
    """

    mass: float
    mass_std: float
    com: NDArray[np.float64] | None = None
    com_std: float = 0.005

    def __post_init__(self) -> None:
        """Raise ValueError if a value is not positive and finite."""
        check_positive(self, "mass", "mass_std", "com_std")
        if self.com is not None:
            com = np.asarray(self.com, dtype=np.float64)
            if com.shape != (3,) or not np.all(np.isfinite(com)):
                raise ValueError(f"'com' must be three finite numbers in m, got {self.com!r}.")
            object.__setattr__(self, "com", com)


@dataclass(frozen=True)
class InSituOptions:
    """Options of :func:`~surefoot.calibration.in_situ.calibrate_in_situ`."""

    drift: int | None = None
    """How offsets may drift within a set. None lets the residuals tell how fast they walk, if they do, and
    weighs what is slow by that; 0 is for none. A number of cosines over a set's time leaves these free,
    whatever their size: what else is as slow is lost. Sets without times have none, and each takes 8 s."""

    robust: bool = True
    """Whether samples that disagree with all others are left out."""

    hysteresis: bool = True
    """Whether the sensor's hysteresis is part of the fit where sets have times and show it beyond chance."""

    factory_std: tuple[float, ...] | None = None
    """How far each axis of the sensor may be from the factory matrix, as a share of its full scale, (6,).
    None learns one share for all from the readings; only used with a factory matrix."""

    estimate_rotation: bool = False
    """Whether the rotation from the accelerometer's frame to the sensor's is unknown (in-situ paper, remark
    of II-B). Added masses at places known in the sensor's frame show it; limb at rest only."""

    full_scale: tuple[float, ...] | None = None
    """Full scales of the axes by the sensor's sheet in N and N m, (6,), in shares of which a maker's errors
    are; None takes those that channels of one range would have by the factory matrix."""

    code_range: tuple[float, float] | None = None
    """Lowest and highest count of the converter; channels that stay there are saturated."""

    residual_tolerance: float = 0.03
    """Share of a set's spread that may be left unexplained before the set is refused."""

    bending_tolerance: float | None = None
    """Share of a set's spread that may go with gravity's squares before the set is refused; beyond a tenth of
    ``residual_tolerance``, or while hysteresis may be part of it a third, a warning says so, and matrix and
    offset are as unsure. None is for no more than that."""

    mass_tolerance: float = 0.05
    """Share of the largest added mass, or of its lever, by which readings may contradict what was added."""

    scale_tolerance: float = 0.1
    """Standard deviation of the limb's mass, as a share of it, beyond which the scale counts as unknown."""

    axis_tolerance: float = 0.5
    """Standard deviation of an axis, as a share of its load, beyond which it counts as unseen."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value has no meaning."""
        check_positive(self, "residual_tolerance", "mass_tolerance", "scale_tolerance", "axis_tolerance")
        if self.bending_tolerance is not None:
            check_positive(self, "bending_tolerance")
        if self.drift is not None and self.drift not in range(MOST_DRIFT + 1):
            raise ValueError(
                f"'drift' must be a whole number from 0 to {MOST_DRIFT}, or None, got {self.drift!r}."
            )
        stds = self.factory_std
        if stds is not None and (len(stds) != 6 or not all(value > 0.0 for value in stds)):
            raise ValueError(f"'factory_std' must hold six positive shares, one an axis, got {stds!r}.")
        scales = self.full_scale
        if scales is not None and (len(scales) != 6 or not all(value > 0.0 for value in scales)):
            raise ValueError(f"'full_scale' must hold six positive values in N and N m, got {scales!r}.")
        _check_code_range(self.code_range)


@dataclass(frozen=True, kw_only=True)
class InSituTrackerConfig:
    """Options of :class:`~surefoot.calibration.in_situ.InSituTracker`, for strain gauges in a leg."""

    drift_force: float = 0.1 / 60.0**0.5
    """Random walk of the offset as the matrix shows it, in N/sqrt(s): 0.1 N per square root of a minute."""

    drift_torque: float = 0.002 / 60.0**0.5
    """The same for torques in N m/sqrt(s)."""

    since_fit_force: float = 0.5
    """How far the offset may have moved along each axis since the calibration, in N: offsets jump from one
    power-up to the next, on some sensors by hundreds."""

    since_fit_torque: float = 0.01
    """The same for torques in N m."""

    lag: float | None = None
    """Width of the loop of hysteresis, as a share of the load's swing; None takes the shares that the fit
    found, or none."""

    lag_angle: float = 0.5
    """Angle in rad by which gravity turns before h is another: a quarter of a swing of two radians."""

    added_mass: float = 0.0
    """Mass in kg that hangs on the limb, known, such as a shoe ..."""

    added_com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """... and its centre of mass in the sensor's frame in m."""

    reject: float = 5.0
    """Standard deviations of a whole reading (Mahalanobis) beyond which something touches the limb, if what
    it adds is also beyond ``touch``; if not, it pulls no harder than one at that distance."""

    touch: float = 0.05
    """Share of the limb's weight, and of the weight's largest torque, below which an innovation is taken for
    an error of the sensor, however unlikely."""

    code_range: tuple[float, float] | None = None
    """Lowest and highest count of the converter; a reading with a channel there is not learnt from."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value has no meaning."""
        check_positive(self, "lag_angle", "reject")
        drifts = ("drift_force", "drift_torque", "since_fit_force", "since_fit_torque")
        check_not_negative(self, *drifts, "added_mass", "touch")
        if self.lag is not None:
            check_not_negative(self, "lag")
        _check_code_range(self.code_range)


def _check_code_range(span: tuple[float, float] | None) -> None:
    """Raise ValueError unless a range of counts is (lowest, highest) or None."""
    if span is not None and not span[0] < span[1]:
        raise ValueError(f"'code_range' must be (lowest, highest), got {span!r}.")
