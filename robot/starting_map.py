"""The map from which a calibrator starts, as specified by the user."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import Curves, Parameters
from surefoot.calibration.weights.known_map import is_file_of_map, read_map
from surefoot.robot.beliefs.errors import BeliefErrors


class StartingMap:
    """A known map, the nominal map of the data sheet, or a calibrated start, as from known weights.

    Args:
        initial: ``"nominal"``, ``"calibrated"``, or one scale and one offset per channel, as
            :class:`~surefoot.calibration.Parameters` or a mapping, which may contain ``curves``. Also the
            JSON file of ``surefoot calibrate weights``, or its contents.
        nominal: The map of the data sheet, shape (K,).
        errors: The errors of a calibrated start.
        names: Names of the channels, for maps from files.

    Attributes:
        given: Whether it was specified as numbers.
        calibrated: Whether it is a calibrated start.
        known: The map that is known in advance: the specified map, or else the nominal map, shape (K,).
        curves: The curves that are applied before the map, or ``None``.

    Raises:
        ValueError: If ``initial`` is none of these.
    """

    def __init__(
        self, initial: Any, nominal: Parameters, errors: BeliefErrors, names: Sequence[str] = ()
    ) -> None:
        self.curves: Curves | None = None
        if is_file_of_map(initial):
            initial, curves = read_map(initial, names)
            self.curves = curves if curves.any else None
        elif isinstance(initial, Mapping) and "curves" in initial:
            initial = dict(initial)
            self.curves = Curves.from_plain(initial.pop("curves"), len(nominal.scale))
        read = _read(initial, len(nominal.scale))
        self.given = isinstance(read, Parameters)
        self.calibrated = isinstance(read, str) and read == "calibrated"
        self.known = read if isinstance(read, Parameters) else nominal
        self._errors = errors

    def as_plain(self) -> str | dict[str, Any]:
        """Return the argument as plain strings and numbers."""
        if self.given:
            curves = {} if self.curves is None else {"curves": self.curves.as_plain()}
            return {name: part.tolist() for name, part in self.known._asdict().items()} | curves
        return "calibrated" if self.calibrated else "nominal"

    def off(self, true: Parameters, drawn: Floats) -> Parameters:
        """Return a true map, shape (..., K), with the errors of a calibrated start.

        ``drawn`` contains standard normal numbers, shape (2, ..., K).
        """
        return Parameters(1.0 + self._errors.scale * drawn[0], self._errors.offset * drawn[1]).after(true)


def _read(initial: Any, channels: int) -> str | Parameters:
    """Convert the argument ``initial`` to a map or a name."""
    if isinstance(initial, str) and initial in ("nominal", "calibrated"):
        return initial
    if isinstance(initial, Parameters):
        initial = initial._asdict()
    if not isinstance(initial, Mapping):
        raise ValueError(
            "'initial' must be 'nominal', 'calibrated' or Parameters (scale, offset), also as a mapping, "
            f"got {initial!r}."
        )
    if set(initial) != set(Parameters._fields):
        raise ValueError(
            f"'initial' as a mapping must have exactly the keys {list(Parameters._fields)}, "
            f"got {list(initial)}."
        )
    return Parameters(*(_channels(name, initial[name], channels) for name in Parameters._fields))


def _channels(name: str, given: Any, channels: int) -> Floats:
    """Return one finite number per channel."""
    try:
        # This is a copy, so that later changes of the caller's array do not change the starting map.
        part = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        part = np.empty(0)
    if part.shape != (channels,) or not np.isfinite(part).all():
        raise ValueError(
            f"'initial.{name}' must hold one finite number for each of the {channels} channels, "
            f"got {given!r}."
        )
    return part
