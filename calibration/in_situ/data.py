"""Input of a calibration: sets of readings, options, and known values of the limb.

Conventions of this part of the library:

* The wrench w is the one that the limb exerts on the robot through the sensor, at and in the sensor's frame,
  in N and N m. At rest it is the weight of the limb beyond the sensor, w = M(m, c) g with M = [m I; m [c]x]
  (in-situ paper, Eqs. 3-5). Under a foot that stands the ground's wrench adds to it.
* ``gravity`` is g in the sensor's frame and points **down**: the negative of an accelerometer's reading at
  rest. While the limb moves it is g - a with the acceleration a of the sensor's origin.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.checks import check_not_negative, check_positive

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

MatrixMode = Literal["keep", "update", "free"]  # how a factory matrix is used


@dataclass(frozen=True, eq=False)
class InSituSet:
    """The readings of one F/T sensor while one added mass hung on the limb (in-situ paper, III-C).

    Arrays are converted to float64 and checked at construction.

    Attributes:
        raw: Counts of the k >= 6 channels, shape (n, k); NaN where no sample arrived.
        gravity: g (moving: g - a) in the sensor's frame in m/s^2, pointing down, shape (n, 3).
        added_mass: Mass added to the limb in kg; in motion it counts as a cube of steel.
        added_com: Its centre of mass in the sensor's frame in m, shape (3,).
        angular_velocity: Of the limb in the sensor's frame in rad/s, shape (n, 3); None if it stood still.
        angular_acceleration: In the sensor's frame in rad/s^2, shape (n, 3); given with the velocity
            or not at all.
        temperature: Of the sensor in K or degrees Celsius, shape (n,); None if it was not measured.
        time: Of the samples in s, increasing, shape (n,); None for samples without an order in time.
        name: Name of the set in messages.

    Raises:
        ValueError: If shapes do not belong together, time does not increase, or the mass is negative or not
            finite.

    >>> InSituSet(np.zeros((2, 6)), np.tile([0.0, 0.0, -9.81], (2, 1)), added_mass=0.5, name="cube").channels
    6
    """

    raw: NDArray[np.float64]
    gravity: NDArray[np.float64]
    added_mass: float = 0.0
    added_com: Any = (0.0, 0.0, 0.0)
    angular_velocity: NDArray[np.float64] | None = None
    angular_acceleration: NDArray[np.float64] | None = None
    temperature: NDArray[np.float64] | None = None
    time: NDArray[np.float64] | None = None
    name: str = "set"

    def __post_init__(self) -> None:
        """Convert all arrays to float64, and raise ValueError if they do not belong together."""
        raw = np.asarray(self.raw, dtype=np.float64)
        if raw.ndim != 2 or raw.shape[1] < 6:
            raise ValueError(f"'{self.name}': 'raw' must have shape (n, k) with k >= 6, got {raw.shape}.")
        object.__setattr__(self, "raw", raw)
        rows = len(raw)
        self._convert("gravity", self.gravity, (rows, 3))
        for name in ("angular_velocity", "angular_acceleration"):
            self._convert(name, getattr(self, name), (rows, 3))
        if (self.angular_velocity is None) != (self.angular_acceleration is None):
            raise ValueError(f"'{self.name}': give angular velocity and acceleration together, or neither.")
        for name in ("temperature", "time"):
            self._convert(name, getattr(self, name), (rows,))
        if self.time is not None and rows and not np.all(np.diff(self.time) > 0.0):
            raise ValueError(f"'{self.name}': 'time' must be finite and increase from sample to sample.")
        self._convert("added_com", self.added_com, (3,))
        if not np.all(np.isfinite(self.added_com)):
            raise ValueError(f"'{self.name}': 'added_com' must be finite, got {self.added_com}.")
        if not np.isfinite(self.added_mass) or self.added_mass < 0.0:
            raise ValueError(
                f"'{self.name}': 'added_mass' must be at least 0 kg and finite, got {self.added_mass!r}."
            )
        object.__setattr__(self, "added_mass", float(self.added_mass))

    @property
    def channels(self) -> int:
        """Number of channels k."""
        return int(self.raw.shape[1])

    @property
    def moves(self) -> bool:
        """Whether the limb's motion was recorded: it need not be at rest then."""
        return self.angular_velocity is not None

    def _convert(self, name: str, value: ArrayLike | None, shape: tuple[int, ...]) -> None:
        if value is None:
            return
        array = np.asarray(value, dtype=np.float64)
        if array.shape != shape:
            raise ValueError(f"'{self.name}': '{name}' must have shape {shape}, got {array.shape}.")
        object.__setattr__(self, name, array)


@dataclass(frozen=True, eq=False)
class KnownLimb:
    """Known values of the limb, such as from a model of the robot or from scales.

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

    drift: bool = True
    """Whether offsets may drift within a set: the residuals tell how fast they walk, if they do."""

    robust: bool = True
    """Whether samples that disagree with all others are left out."""

    hysteresis: bool = True
    """Whether the sensor may have hysteresis: it is part of the fit where sets have times and show it beyond
    chance, and of the covariance where they cannot show it."""

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

    def __post_init__(self) -> None:
        """Raise ValueError if a value has no meaning."""
        for name, unit in (("factory_std", "shares, one an axis"), ("full_scale", "values in N and N m")):
            values = getattr(self, name)
            if values is not None and (len(values) != 6 or not all(value > 0.0 for value in values)):
                raise ValueError(f"'{name}' must hold six positive {unit}, got {values!r}.")
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
    """Standard deviations of a whole reading (Mahalanobis) beyond which something touches the limb, if the
    added wrench is also beyond ``touch``; if not, it pulls no harder than one at that distance."""

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


@dataclass(frozen=True, eq=False)
class Task:
    """The input of a calibration; ValueError if its parts do not belong together."""

    sets: tuple[InSituSet, ...]  # of one sensor, as they were read
    factory: NDArray[np.float64] | None = None  # the maker's C in N and N m per count, shape (6, k), or None
    limb: KnownLimb | None = None  # known values of the limb, or None
    options: InSituOptions = field(default_factory=InSituOptions)  # how to fit
    mode: MatrixMode = "update"  # how the factory matrix is used

    def __post_init__(self) -> None:
        """Raise ValueError if sets, matrix and mode do not belong together."""
        if not self.sets:
            raise ValueError("Give at least one set of readings.")
        channels = sorted({data.channels for data in self.sets})
        if len(channels) > 1:
            raise ValueError(f"All sets must have the same number of channels, got {channels}.")
        if self.mode not in ("keep", "update", "free"):
            raise ValueError(f"'matrix' must be 'keep', 'update' or 'free', got {self.mode!r}.")
        if self.factory is not None:
            factory = np.asarray(self.factory, dtype=np.float64)
            if factory.shape != (6, channels[0]):
                raise ValueError(f"'factory_matrix' must have shape (6, {channels[0]}), got {factory.shape}.")
            if not np.all(np.isfinite(factory)) or np.linalg.matrix_rank(factory) < 6:
                raise ValueError(
                    "'factory_matrix' must be finite and of rank 6, as all matrices of makers are."
                )
            object.__setattr__(self, "factory", factory)
        elif self.mode == "keep":
            raise ValueError("'matrix' is 'keep', and there is none to keep: give 'factory_matrix'.")
        if self.options.estimate_rotation and self.moving:
            raise ValueError("'estimate_rotation' needs a limb at rest: leave the angular velocities out.")

    @property
    def moving(self) -> bool:
        """Whether a limb's motion was recorded."""
        return any(data.moves for data in self.sets)

    @property
    def timed(self) -> bool:
        """Whether all sets have times."""
        return all(data.time is not None for data in self.sets)

    @property
    def owner(self) -> str:
        """Whose the matrix is, in words: the driver's if it is one, of newtons; empty without a matrix."""
        if self.factory is None:
            return ""
        return "driver's" if np.array_equal(self.factory, np.eye(*self.factory.shape)) else "factory's"


def change_motion(data: InSituSet, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> InSituSet:
    """Return a set whose gravity and motion, shape (n, 3) each, are changed alike."""
    names = ("gravity", "angular_velocity", "angular_acceleration")
    given = {name: value for name in names if (value := getattr(data, name)) is not None}
    changed: dict[str, Any] = {name: change(value) for name, value in given.items()}
    return replace(data, **changed)


def read_later(values: NDArray[np.float64], data: InSituSet, delay: float) -> NDArray[np.float64]:
    """Return values of a set, shape (n, 3), as they were read later by a delay in s; the ends stay."""
    time = data.time
    assert time is not None
    return np.stack([np.interp(time + delay, time, one) for one in values.T], axis=1)


def shift(data: InSituSet, delay: float) -> InSituSet:
    """Return a set with gravity and motion as they were read later by the delay; the ends drop out."""
    if not delay:
        return data
    late, time = change_motion(data, lambda values: read_later(values, data, delay)), data.time
    assert time is not None
    kept = (time + delay >= time[0]) & (time + delay <= time[-1])
    names = ("raw", "gravity", "angular_velocity", "angular_acceleration", "temperature", "time")
    given: dict[str, Any] = {n: value[kept] for n in names if (value := getattr(late, n)) is not None}
    return replace(late, **given)
