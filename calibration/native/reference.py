"""A reference as the library holds it, which a calibrator takes as it is."""

import numpy as np

from surefoot.calibration.reference import Reference
from surefoot.native import Library

_SHAPES = {
    "com": (3,), "com_acceleration": (3,), "angular_momentum_rate": (3,), "position_sole": (2, 3),
    "R_level_sole": (2, 3, 3), "accelerometer": (3,), "gyroscope": (3,),
}  # fmt: skip
"""Its numbers, in the library's order."""


class ReferenceRecord:
    """One moment of a robot on two feet, overwritten by the next.

    Args:
        library: The library.

    Attributes:
        address: Where the library finds it.
        real: The dtype of its numbers.
    """

    def __init__(self, library: Library) -> None:
        shapes: dict[str, tuple[int, ...]] = {**_SHAPES, "stance": (2,), "swing": (2,)}
        dtype = library.record("belief", shapes)
        assert dtype is not None
        assert dtype.fields is not None
        record = np.zeros((), dtype)
        self.address, self.real, self._record = record.ctypes.data, library.real, record
        size = library.real.itemsize
        end = int(dtype.fields["gyroscope"][1]) + 3 * size
        self._numbers = record.reshape(1).view(np.uint8)[:end].view(library.real)
        self._zero = np.zeros_like(self._numbers)
        starts = (int(dtype.fields[name][1]) // size for name in _SHAPES)
        self._parts = [
            (slice(start, start + int(np.prod(shape))), shape)
            for start, shape in zip(starts, _SHAPES.values(), strict=True)
        ]
        self._stance, self._swing = record["stance"], record["swing"]

    def fill(self, reference: Reference) -> None:
        """Take over what it is."""
        for name, part in reference._asdict().items():
            self._record[name] = part

    def reference(self, unknown: float = np.nan) -> Reference:
        """Return a copy.

        Args:
            unknown: What stands for numbers where the robot knows nothing.
        """
        numbers = self._numbers
        numbers = self._zero.copy() if unknown == 0.0 and numbers[0] != numbers[0] else numbers.copy()
        com, acceleration, rate, position, R, accelerometer, gyroscope = (
            numbers[part] if len(shape) == 1 else numbers[part].reshape(shape) for part, shape in self._parts
        )
        stance, swing = self._stance.copy(), self._swing.copy()
        return Reference(com, acceleration, rate, position, R, stance, swing, accelerometer, gyroscope)
