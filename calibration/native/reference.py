"""A reference as the library holds it, which a calibrator takes as it is."""

import numpy as np

from surefoot.calibration.reference import Reference
from surefoot.native import Library, Record

_SHAPES: dict[str, tuple[int, ...]] = {
    "com": (3,), "com_acceleration": (3,), "angular_momentum_rate": (3,), "position_sole": (2, 3),
    "R_level_sole": (2, 3, 3), "stance": (2,), "swing": (2,), "accelerometer": (3,), "gyroscope": (3,),
}  # fmt: skip


class ReferenceRecord:
    """One moment of a robot on two feet, overwritten by the next.

    Args:
        library: The library.

    Attributes:
        address: Where the library finds it.
        dtype: Its layout.
        real: The dtype of its numbers.
    """

    def __init__(self, library: Library) -> None:
        dtype = library.record("belief", _SHAPES)
        assert dtype is not None
        self.dtype, self.real = dtype, library.real
        self._record = Record(dtype)
        self._nothing = Record(dtype)
        self.address = self._record.address

    def fill(self, reference: Reference) -> None:
        """Take over what it is."""
        for name, part in reference._asdict().items():
            self._record.now[name] = part

    def reference(self) -> Reference:
        """Return a copy."""
        return Reference(*self.mapping().values())

    def mapping(self, known: bool = True) -> dict[str, np.ndarray]:
        """Return a copy of each field by its name; zeros where nothing is known, contacts excepted."""
        one = self._record.copy()
        if not known:
            zeros = self._nothing.copy()
            zeros["stance"], zeros["swing"] = one["stance"], one["swing"]
            one = zeros
        return {name: one[name] for name in _SHAPES}
