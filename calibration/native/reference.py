"""A reference as the library holds it, which a calibrator takes as it is."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from surefoot.calibration.reference import MomentumReference, Reference, reference_shapes
from surefoot.native import Library, Record

_RECORDS: dict[type[Any], tuple[str, tuple[str, ...]]] = {
    Reference: ("belief", ("known",)),
    MomentumReference: ("momentum_belief", ("known", "momentum")),
}
"""Names of the records of both kinds, and fields that they have besides."""


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


def feet_beyond(library: Library, feet: int) -> str:
    """Say that a library has no room for so many feet, and the way out."""
    most = library.places["reference"]["stance"][2]
    return (
        f"The library was compiled for at most {most} feet, and the robot has {feet}; compile it with "
        f"-DSF_FEET={feet}, or let Python do the work."
    )


class ReferenceRecord:
    """One moment of a robot, overwritten by the next.

    Args:
        library: The library.
        kind: :class:`Reference`, or :class:`MomentumReference` for one that holds momentum.
        feet: Number of its feet.

    Attributes:
        library: The same.
        kind: The same.
        feet: The same.
        address: Where the library finds it.
        dtype: Its layout.
        real: The dtype of its numbers.

    Raises:
        ValueError: If the library has no room for so many feet.
    """

    def __init__(self, library: Library, kind: type[Reference] | type[MomentumReference], feet: int) -> None:
        dtype = reference_dtype(library, kind, reference_shapes(feet))
        if dtype is None:
            raise ValueError(feet_beyond(library, feet))
        self.library, self.real = library, library.real
        self.kind, self.feet, self.dtype = kind, feet, dtype
        self._record = Record(dtype)
        self._nothing = Record(dtype)
        self.address = self._record.address

    def fill(self, reference: Reference | MomentumReference) -> None:
        """Take over its values."""
        for name, part in reference._asdict().items():
            self._record.now[name] = part
        self._record.now["known"] = not np.isnan(reference.com[0])

    @property
    def known(self) -> bool:
        """Whether it is anything."""
        return bool(self._record.now["known"])

    @property
    def standing(self) -> bool:
        """Whether a foot surely stood."""
        return any(self._record.now["stance"].tolist())

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
