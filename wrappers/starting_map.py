"""The map that a calibrator starts from, as a user gives it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Parameters


class StartingMap:
    """A known map, the data sheet's, or what a bench would have found.

    Args:
        initial: ``"nominal"``, ``"bench"``, or one scale and one offset a channel, as
            :class:`~surefoot.calibration.Parameters` or a mapping.
        nominal: The data sheet's map, shape (K,).
        bench_scale_error: Relative standard deviation of a scale from the bench.
        bench_offset_error: Standard deviation of an offset from the bench in N.

    Attributes:
        given: Whether it was given as numbers.
        of_bench: Whether it is a bench's.
        known: What is known of it beforehand: the map as given, or else the data sheet's, shape (K,).

    Raises:
        ValueError: If it is none of these, or an error is negative or not finite.
    """

    def __init__(
        self, initial: Any, nominal: Parameters, bench_scale_error: float, bench_offset_error: float
    ) -> None:
        for name, value in {
            "bench_scale_error": bench_scale_error,
            "bench_offset_error": bench_offset_error,
        }.items():
            if not 0.0 <= value < float("inf"):
                raise ValueError(f"'{name}' must be finite and not negative, got {value}.")
        read = _read(initial, len(nominal.scale))
        self.given = isinstance(read, Parameters)
        self.of_bench = isinstance(read, str) and read == "bench"
        self.known = read if isinstance(read, Parameters) else nominal
        self._errors = bench_scale_error, bench_offset_error

    def recorded(self) -> str | dict[str, list[float]]:
        """Say what was given in plain words and numbers."""
        if self.given:
            return {name: part.tolist() for name, part in self.known._asdict().items()}
        return "bench" if self.of_bench else "nominal"

    def off(self, true: Parameters, drawn: NDArray[np.float64]) -> Parameters:
        """Let a true map be off by a bench's errors, drawn as standard normal numbers, shape (2, ..., K)."""
        scale_error, offset_error = self._errors
        return Parameters(1.0 + scale_error * drawn[0], offset_error * drawn[1]).after(true)


def _read(initial: Any, channels: int) -> str | Parameters:
    """Read the map to start from."""
    if isinstance(initial, str) and initial in ("nominal", "bench"):
        return initial
    if isinstance(initial, Parameters):
        initial = initial._asdict()
    if not isinstance(initial, Mapping):
        raise ValueError(
            "'initial' must be 'nominal', 'bench' or Parameters (scale, offset), also as a mapping, "
            f"got {initial!r}."
        )
    if set(initial) != set(Parameters._fields):
        raise ValueError(
            f"'initial' as a mapping must have exactly the keys {list(Parameters._fields)}, "
            f"got {list(initial)}."
        )
    return Parameters(*(_channels(name, initial[name], channels) for name in Parameters._fields))


def _channels(name: str, given: Any, channels: int) -> NDArray[np.float64]:
    """Read one finite number a channel."""
    try:
        # A copy: what the caller does to its array later must not change where an episode starts.
        part = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        part = np.empty(0)
    if part.shape != (channels,) or not np.isfinite(part).all():
        raise ValueError(
            f"'initial.{name}' must hold one finite number for each of the {channels} channels, "
            f"got {given!r}."
        )
    return part
