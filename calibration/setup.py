"""The type of an online method, and the setup that describes the robot to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import check_not_negative, check_positive
from surefoot.calibration.cop import FORCE_THRESHOLD
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY
from surefoot.checks import check_count, check_kind


def method_name(name: Any) -> str:
    """Return a method's name, such as ``"moment"`` or ``"module:name"``, or raise TypeError."""
    if not isinstance(name, str):
        raise TypeError(
            "'method' must be a name, such as 'moment', or its options, such as Moment(scale_std=0.2), "
            f"got {name!r} of {type(name).__name__}."
        )
    return name


class _Functions(NamedTuple):
    init: Callable[[Array], Any]
    update: Callable[[Any, Array, Any, float], tuple[Any, Estimate]]
    retract: Callable[[Any], Any]


class OnlineMethod(_Functions):
    """An online calibrator of one robot as pure functions. It unpacks to ``init, update, retract``.

    Attributes:
        init: ``init(raw) -> state``. ``raw``, float64 of shape (K,), is a reading. Its values are not used.
        update: ``update(state, raw, reference, dt) -> (state, Estimate)``. The reference is a
            :class:`~surefoot.calibration.reference.Reference`, or another type that the method takes.
        retract: ``retract(state) -> state`` discards what was learnt in the last seconds, because an event
            such as a fall begins before it is detected. Methods without earlier states return ``state``.
        limits: Smallest and largest values of leaves of the state, by the last part of their names. A saved
            state outside them is refused (:func:`surefoot.calibration.state.load_state`).
        adopt: ``adopt(state, share) -> state`` converts a saved state of the same robot, whose weight was
            ``share`` of the present one.
    """

    limits: Mapping[str, tuple[Any, Any]]
    adopt: Callable[[Any, float], Any]

    def __new__(
        cls,
        init: Callable[[Array], Any],
        update: Callable[[Any, Array, Any, float], tuple[Any, Estimate]],
        retract: Callable[[Any], Any] = lambda state: state,
        limits: Mapping[str, tuple[Any, Any]] = MappingProxyType({}),
        adopt: Callable[[Any, float], Any] = lambda state, share: state,
    ) -> "OnlineMethod":
        """Store the functions as a tuple, and the other parts as attributes."""
        self = super().__new__(cls, init, update, retract)
        self.limits, self.adopt = limits, adopt
        return self


@dataclass(frozen=True, eq=False, kw_only=True)
class OnlineSetup:
    """The description of the robot that every online method receives."""

    layout: FeetLayout
    """How the channels make up the feet's wrenches."""

    mass: float
    """Mass of the robot as the robot knows it, in kg."""

    initial: Parameters
    """The starting map (c0, d0): the nominal one or one from known weights, shape (K,) each."""

    dt: float = 1.0 / 80.0
    """Nominal time between samples in s."""

    lag: int = 2
    """How many samples ago the foot sample was taken that a reference describes. The CoP paper's telemetry
    arrives 20 ms late, which is between one and two samples at 80 Hz. Zero without delay."""

    gravity: float = GRAVITY
    """Acceleration of free fall at the robot's location (or in its simulation) in m/s^2."""

    foot_length: float | None = None
    """Unit of length for errors of the centre of pressure in m, by default the extent of the cells."""

    force_threshold: float = FORCE_THRESHOLD
    """Vertical force in N at or below which the centre of pressure is not defined."""

    plausible_weights: float = 20.0
    """Force of one channel, in body weights, above which a reading counts as an error."""

    age: ArrayLike = 0.0
    """Mean age of a reading when it is sampled in s, one value or one per channel: half a conversion time of
    a chip with its own clock, half of the time over which it averages, and the transport delay. A reference
    describes that moment, ``lag`` samples ago. Estimates are extrapolated from there to the current time."""

    def __post_init__(self) -> None:
        """Raise an error if a value is out of range."""
        check_kind("layout", self.layout, FeetLayout)
        check_positive(self, "mass", "dt", "gravity", "plausible_weights")
        if self.dt > 1.0:
            raise ValueError(f"'dt' must be at most 1 s between samples, to follow a step; got {self.dt} s.")
        check_not_negative(self, "force_threshold")
        if not isinstance(self.initial, Parameters):
            raise TypeError(
                f"'initial' must be Parameters(scale, offset), got {type(self.initial).__name__}."
            )
        object.__setattr__(self, "lag", check_count("lag", self.lag, 0))
        for field, value in zip(Parameters._fields, self.initial, strict=True):
            shape = np.shape(value)
            if shape != (self.layout.channels,):
                raise ValueError(
                    f"'initial.{field}' must hold one number for each of the {self.layout.channels} channels "
                    f"{self.layout.channel_names}, shape ({self.layout.channels},), got shape {shape}."
                )
            if not np.isfinite(value).all():
                raise ValueError(f"'initial.{field}' holds values that are not finite: {value}.")
        age = np.asarray(self.age, dtype=np.float64)
        if age.shape not in ((), (self.layout.channels,)) or not ((age >= 0.0) & (age < np.inf)).all():
            raise ValueError(
                f"'age' must be finite and not negative, in s, one number or one for each of the "
                f"{self.layout.channels} channels, got {self.age}."
            )
        if (np.asarray(self.initial.scale) == 0.0).any():
            raise ValueError(f"'initial.scale' must not be zero, got {self.initial.scale}.")
        if self.foot_length is not None:
            check_positive(self, "foot_length")
        elif any(foot.position_cell_sole is None for foot in self.layout.feet):
            raise ValueError(
                "'foot_length' is required (in m) for a layout whose channels have no positions."
            )

    @property
    def weight(self) -> float:
        """The robot's weight in N."""
        return self.mass * self.gravity

    @property
    def length(self) -> float:
        """The length of a foot in m: ``foot_length``, or the largest extent of a foot's cells."""
        if self.foot_length is not None:
            return self.foot_length
        return max(
            float(np.ptp(foot.position_cell_sole[:, :2], axis=0).max())
            for foot in self.layout.feet
            if foot.position_cell_sole is not None
        )


def setup_from_options(
    layout: FeetLayout,
    *,
    mass: float,
    initial: Parameters | None,
    dt: float,
    lag: int,
    options: dict[str, Any],
) -> tuple[OnlineSetup, dict[str, Any]]:
    """Return a setup, and the remaining options, which are those of the method.

    Without an initial map, readings are forces in newtons.
    """
    check_kind("layout", layout, FeetLayout)
    of_setup = {"gravity", "foot_length", "force_threshold", "plausible_weights", "age"} & set(options)
    setup = OnlineSetup(
        layout=layout,
        mass=mass,
        initial=Parameters(np.ones(layout.channels), np.zeros(layout.channels))
        if initial is None
        else initial,
        dt=dt,
        lag=lag,
        **{name: options[name] for name in of_setup},
    )
    return setup, {name: value for name, value in options.items() if name not in of_setup}
