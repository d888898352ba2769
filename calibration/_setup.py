"""What an online method is, and what it must be told; private, public in the package's own namespace."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from surefoot.calibration.cop import FORCE_THRESHOLD
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY, Reference

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""


OLD_NAMES: Mapping[str, str] = MappingProxyType({"surefoot": "moment"})
"""Today's names of methods by the names that they had before."""


def method_name(name: str) -> str:
    """Return a method's name of today; an old one is accepted with a ``DeprecationWarning`` that says it."""
    if name not in OLD_NAMES:
        return name
    today = OLD_NAMES[name]
    warnings.warn(f"The method {name!r} is called {today!r} now.", DeprecationWarning, stacklevel=3)
    return today


class OnlineMethod(NamedTuple):
    """An online calibrator as a pair of pure functions.

    Attributes:
        init: ``init(raw) -> state``. ``raw`` only tells the library, dtype, device and batch shape.
        update: ``update(state, raw, reference, dt) -> (state, Estimate)``.
    """

    init: Callable[[Array], Any]
    update: Callable[[Any, Array, Reference, float], tuple[Any, Estimate]]


@dataclass(frozen=True, eq=False, kw_only=True)
class OnlineSetup:
    """What every online method must be told about the robot."""

    layout: FeetLayout
    """How the channels make up the feet's wrenches."""

    mass: float
    """Mass of the robot as it believes it, in kg."""

    initial: Parameters
    """The map (c0, d0) to start from: the nominal or the bench calibration, shape (K,) each."""

    dt: float = 1.0 / 80.0
    """Nominal time between samples in s."""

    lag: int = 2
    """How many samples ago the foot sample was taken that a reference describes. The CoP paper's telemetry
    comes 20 ms late, which is between one and two samples at 80 Hz; 0 on a robot without that delay."""

    foot_length: float | None = None
    """Length in m that errors of the centre of pressure are measured by; by default the cells' extent."""

    force_threshold: float = FORCE_THRESHOLD
    """Vertical force in N at or below which there is no centre of pressure."""

    plausible_weights: float = 20.0
    """Force of one channel, in body weights, beyond which a reading is taken for an error."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_positive(self, "mass", "dt", "plausible_weights")
        check_not_negative(self, "force_threshold")
        if not isinstance(self.initial, Parameters):
            raise TypeError(
                f"'initial' must be Parameters(scale, offset), got {type(self.initial).__name__}."
            )
        if not _is_whole(self.lag) or self.lag < 0:
            raise ValueError(f"'lag' must be a whole number of samples from 0 on, got {self.lag}.")
        for field, value in zip(Parameters._fields, self.initial, strict=True):
            shape = np.shape(value)
            if shape != (self.layout.channels,):
                raise ValueError(
                    f"'initial.{field}' must hold one number for each of the {self.layout.channels} channels "
                    f"{self.layout.channel_names}, shape ({self.layout.channels},), got shape {shape}."
                )
            if not np.isfinite(value).all():
                raise ValueError(f"'initial.{field}' holds values that are not finite: {value}.")
        if (np.asarray(self.initial.scale) == 0.0).any():
            raise ValueError(f"'initial.scale' must not be zero, got {self.initial.scale}.")
        if self.foot_length is not None:
            check_positive(self, "foot_length")
        elif any(foot.position_cell_sole is None for foot in self.layout.feet):
            raise ValueError(
                "'foot_length' must be given in m for a layout whose channels have no positions of their own."
            )

    @property
    def weight(self) -> float:
        """The robot's weight in N."""
        return self.mass * GRAVITY

    @property
    def length(self) -> float:
        """The length of a foot in m: as given, or the longest extent of a foot's cells."""
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
    """Make a setup, and hand back the options that are not the setup's but the method's.

    Without an initial map readings are taken for newtons.
    """
    own = {"foot_length", "force_threshold", "plausible_weights"} & set(options)
    setup = OnlineSetup(
        layout=layout,
        mass=mass,
        initial=Parameters(np.ones(layout.channels), np.zeros(layout.channels))
        if initial is None
        else initial,
        dt=dt,
        lag=lag,
        **{name: options[name] for name in own},
    )
    return setup, {name: value for name, value in options.items() if name not in own}


def check_positive(config: Any, *fields: str) -> None:
    """Refuse fields that are not positive and finite, with the field and the value in the message."""
    for field in fields:
        check_value(field, getattr(config, field), positive=True)


def check_not_negative(config: Any, *fields: str) -> None:
    """Refuse fields that are negative or not finite, with the field and the value in the message."""
    for field in fields:
        check_value(field, getattr(config, field), positive=False)


def check_count(config: Any, *fields: str) -> None:
    """Refuse fields that are not whole numbers from one on, with the field and the value in the message."""
    for field in fields:
        value = getattr(config, field)
        if not _is_whole(value) or value < 1:
            raise ValueError(f"'{field}' must be a whole number from 1 on, got {value}.")


def check_value(name: str, value: Any, *, positive: bool) -> None:
    """Refuse what is no number, not finite, negative or, where it must be positive, zero."""
    try:
        finite = bool(np.isfinite(value))
    except (TypeError, ValueError):
        raise TypeError(f"'{name}' must be a number, got {value!r} of type {type(value).__name__}.") from None
    if positive and not (finite and value > 0):
        raise ValueError(f"'{name}' must be positive and finite, got {value}.")
    if not (finite and value >= 0):
        raise ValueError(f"'{name}' must not be negative and must be finite, got {value}.")


def _is_whole(value: Any) -> bool:
    """Tell whether a value is a whole number; infinities, NaN and what is no number are not."""
    try:
        return not isinstance(value, bool) and bool(value == int(value))
    except (TypeError, ValueError, OverflowError):
        return False
