"""Curves of channels that no line fits, such as force-sensing resistors.

A curve stands in front of the linear map, F = c g(s) + d: g is increasing and makes readings s straight. It
is a monotone cubic (Fritsch and Carlson 1980; SciPy's PCHIP) through knots, both in counts, with g(s) = s at
its two ends, beyond which it goes on straight. c and d are learnt behind it as ever, so that a method that
follows drift knows nothing of it. A channel without a curve is left as it is, bit for bit.

Which curve known weights show is judged at weights that were left out: a power law s = z + A F^p, a monotone
cubic through the medians of the loads, or none, if a line predicts them about as well.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from surefoot.arrays import Floats

LEAST = 0.002
"""Share of the range of loads up to which a line is good enough; cheap load cells are linear to 0.0005."""

ODDS = 1e3  # of a curve against a line, by the errors at loads that were left out, from which on it is taken
KNOTS = 33  # of a power law
EXPONENTS = (0.1, 10.0)  # of a power law; 1 is a line

_KEYS = ("count", "straight_count")


class Curves:
    """The curves of K channels.

    Args:
        knots: For each channel ``None``, or readings and straight readings in counts, both increasing, shape
            (2, m).

    Raises:
        ValueError: If knots do not increase.

    >>> import numpy as np
    >>> curves = Curves([None, [[0.0, 300.0, 800.0], [0.0, 200.0, 800.0]]])
    >>> curves.straighten(np.array([[300.0, 300.0], [900.0, 800.0]]))
    array([[300., 200.],
           [900., 800.]])
    """

    def __init__(self, knots: Sequence[ArrayLike | None]) -> None:
        self.knots = tuple(None if one is None else np.array(one, dtype=np.float64) for one in knots)
        for i, one in enumerate(self.knots):
            if one is None:
                continue
            increasing = (
                one.ndim == 2 and one.shape[0] == 2 and one.shape[1] > 1 and (np.diff(one) > 0.0).all()
            )
            if not (increasing and np.isfinite(one).all()):
                raise ValueError(
                    f"The curve of channel {i} must have two or more finite readings and as many straight "
                    f"ones, both increasing, got {np.asarray(knots[i]).tolist()}."
                )
        self._cubics = {
            i: scipy.interpolate.PchipInterpolator(*one)
            for i, one in enumerate(self.knots)
            if one is not None
        }

    @property
    def any(self) -> bool:
        """Whether any channel has a curve."""
        return bool(self._cubics)

    def straighten(self, raw: Floats) -> Floats:
        """Return straight readings in counts.

        Args:
            raw: Readings, shape (K,) or, of N samples, (N, K); NaN stays NaN.

        Raises:
            ValueError: If there are not as many channels as curves.
        """
        if raw.shape[-1:] != (len(self.knots),):
            raise ValueError(f"Curves are of {len(self.knots)} channels, got readings of shape {raw.shape}.")
        straight = raw
        for i, cubic in self._cubics.items():
            straight = raw.copy() if straight is raw else straight
            low, high = cubic.x[[0, -1]]
            inside = np.clip(raw[..., i], low, high)
            slope = np.where(raw[..., i] < low, *cubic.derivative()(cubic.x[[0, -1]]))
            straight[..., i] = cubic(inside) + slope * (raw[..., i] - inside)
        return straight

    @property
    def cubics(self) -> Mapping[int, "scipy.interpolate.PchipInterpolator"]:
        """The cubic of each channel that has one."""
        return self._cubics

    def as_plain(self) -> list[dict[str, list[float]] | None]:
        """Return them as values that JSON can hold."""
        return [None if one is None else dict(zip(_KEYS, one.tolist(), strict=True)) for one in self.knots]

    @classmethod
    def from_plain(cls, given: Any, channels: int) -> "Curves":
        """Return the curves of :meth:`as_plain`; ValueError if they are none of so many channels."""
        if not isinstance(given, Sequence) or isinstance(given, str) or len(given) != channels:
            raise ValueError(f"'curves' must be a list of {channels}, null for a channel without one.")
        if not all(one is None or (isinstance(one, Mapping) and set(_KEYS) <= set(one)) for one in given):
            raise ValueError(f"A curve must be null or have {' and '.join(map(repr, _KEYS))}, got {given!r}.")
        return cls([None if one is None else [one[key] for key in _KEYS] for one in given])


@dataclass(frozen=True, eq=False)
class CurveFit:
    """The curve of one channel under known weights."""

    shape: str  # ``"power law"`` or ``"monotone cubic"``
    knots: Floats = field(repr=False)  # readings and straight readings in counts, shape (2, m)
    std: float  # error in N at loads that were left out of the fit, root mean square
    line_std: float  # that of a line there


class _Shape(NamedTuple):
    """Readings in counts, increasing, and loads in N of a curve, shape (m,) each."""

    reading: Floats
    load: Floats

    def force(self, count: float) -> float:
        """Return the load of a reading between the outermost ones, in N."""
        curve = scipy.interpolate.PchipInterpolator(self.reading, self.load)
        return float(curve(np.clip(count, *self.reading[[0, -1]])))


def fit_curve(code: ArrayLike, load: ArrayLike) -> CurveFit | None:
    """Fit a curve to a channel's finite counts under known loads in N, (n,) each, if a line will not do.

    ``None`` if there are fewer than five loads, readings do not go one way with them, or a line does as well.
    """
    raw, known = np.asarray(code, dtype=np.float64), np.asarray(load, dtype=np.float64)
    loads, number = np.unique(known, return_counts=True)
    if len(loads) < 5:
        return None
    middle = np.array([np.median(raw[known == one]) for one in loads])
    turned = 1.0 if middle[-1] > middle[0] else -1.0
    points = turned * middle, loads, number.astype(np.float64)
    errors = {name: _errors_left_out(shape, *points) for name, shape in _SHAPES.items()}
    rms = {name: float(np.sqrt(np.mean(one**2))) for name, one in errors.items() if one is not None}
    if "line" not in rms or len(rms) < 2 or rms["line"] < LEAST * np.ptp(loads):
        return None
    name = min((one for one in rms if one != "line"), key=lambda one: rms[one])
    if (len(loads) - 2) * np.log(rms["line"] / max(rms[name], 1e-300)) < np.log(ODDS):
        return None
    found = _SHAPES[name](*points)
    if found is None:
        return None
    count, force = found if turned > 0.0 else _Shape(-found.reading[::-1], found.load[::-1])
    straight = count[0] + (force - force[0]) * (count[-1] - count[0]) / (force[-1] - force[0])
    return CurveFit(name, np.array([count, straight]), rms[name], rms["line"])


def _errors_left_out(shape: Any, count: Floats, load: Floats, number: Floats) -> Floats | None:
    """Return errors in N at the inner loads, each left out of the fit; ``None`` if one cannot be fitted."""
    errors = []
    for i in range(1, len(load) - 1):
        others = np.arange(len(load)) != i
        found = shape(count[others], load[others], number[others])
        if found is None:
            return None
        errors.append(found.force(count[i]) - load[i])
    return np.array(errors)


def _line(count: Floats, load: Floats, number: Floats) -> _Shape | None:
    slope, level = np.polyfit(load, count, 1, w=np.sqrt(number))
    return _Shape(slope * load + level, load) if slope > 0.0 else None


def _cubic(count: Floats, load: Floats, number: Floats) -> _Shape | None:
    level = scipy.optimize.isotonic_regression(count, weights=number).x
    # Loads that no reading tells apart are one knot.
    groups = np.split(np.arange(len(level)), np.flatnonzero(np.diff(level) > 0.0) + 1)
    if len(groups) < 3:
        return None
    return _Shape(level[[part[0] for part in groups]], np.array([load[part].mean() for part in groups]))


def _power(count: Floats, load: Floats, number: Floats) -> _Shape | None:
    low, high, rise = float(load.min()), float(load.max()), float(np.ptp(count))
    if low < 0.0:
        return None

    def law(share: Floats, zero: float, size: float, exponent: float) -> Floats:
        return np.asarray(zero + size * share**exponent)

    start, bounds = (0.0, 1.0, 1.0), ((-np.inf, 0.0, EXPONENTS[0]), (np.inf, np.inf, EXPONENTS[1]))
    try:
        given: Any = {"p0": start, "bounds": bounds, "sigma": 1.0 / np.sqrt(number)}
        found, _ = scipy.optimize.curve_fit(law, load / high, (count - count[0]) / rise, **given)
    except RuntimeError:
        return None  # no convergence
    grid = low + (high - low) * np.linspace(0.0, 1.0, KNOTS) ** 2
    level = count[0] + rise * law(grid / high, *found)
    return _Shape(level, grid) if (np.diff(level) > 0.0).all() else None


_SHAPES = {"line": _line, "power law": _power, "monotone cubic": _cubic}
