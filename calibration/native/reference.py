"""A reference as the library holds it, which a calibrator takes as it is."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from surefoot.calibration.reference import MomentumReference, Reference
from surefoot.native import Library, Record

_RECORDS: dict[type[Any], tuple[str, tuple[str, ...]]] = {
    Reference: ("belief", ()),
    MomentumReference: ("momentum_belief", ("momentum",)),
}
"""Names of the records of both kinds, and fields that they have besides."""

_SHAPES: dict[str, tuple[int, ...]] = {
    "com": (3,), "com_acceleration": (3,), "angular_momentum_rate": (3,), "com_velocity": (3,),
    "angular_momentum": (3,), "position_sole": (2, 3), "R_level_sole": (2, 3, 3), "stance": (2,),
    "swing": (2,), "accelerometer": (3,), "gyroscope": (3,),
}  # fmt: skip


def reference_dtype(
    library: Library, kind: type[Any], shapes: Mapping[str, tuple[int, ...]]
) -> np.dtype[Any] | None:
    """Return the layout of a reference; ``None`` if the library has no room for one.

    Args:
        library: The library.
        kind: :class:`Reference` or :class:`MomentumReference`.
        shapes: The shape of each field.
    """
    name, besides = _RECORDS[kind]
    return library.record(name, {field: shapes[field] for field in kind._fields} | dict.fromkeys(besides, ()))


class ReferenceRecord:
    """One moment of a robot on two feet, overwritten by the next.

    Args:
        library: The library.
        kind: :class:`Reference`, or :class:`MomentumReference` for one that holds momentum.

    Attributes:
        kind: The same.
        address: Where the library finds it.
        dtype: Its layout.
        real: The dtype of its numbers.
    """

    def __init__(self, library: Library, kind: type[Reference] | type[MomentumReference] = Reference) -> None:
        dtype = reference_dtype(library, kind, _SHAPES)
        assert dtype is not None
        self.kind, self.dtype, self.real = kind, dtype, library.real
        self._record = Record(dtype)
        self._nothing = Record(dtype)
        self.address = self._record.address

    def fill(self, reference: Reference | MomentumReference) -> None:
        """Take over its values."""
        for name, part in reference._asdict().items():
            self._record.now[name] = part

    def reference(self) -> Any:
        """Return a copy, of its kind."""
        return self.kind(*self.mapping().values())

    def mapping(self, known: bool = True) -> dict[str, np.ndarray]:
        """Return a copy of each field by its name; zeros where nothing is known, contacts excepted."""
        one = self._record.copy()
        if not known:
            zeros = self._nothing.copy()
            zeros["stance"], zeros["swing"] = one["stance"], one["swing"]
            one = zeros
        return {name: one[name] for name in self.kind._fields}
