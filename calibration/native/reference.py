"""A reference as the library holds it, which a calibrator takes as it is."""

from operator import attrgetter
from typing import Any

import numpy as np

from surefoot.calibration.reference import MomentumReference, Reference, reference_shapes
from surefoot.native import Library, Record

_DTYPE, _SHAPE = attrgetter("dtype"), attrgetter("shape")

_RECORDS: dict[type[Any], tuple[str, tuple[str, ...]]] = {
    Reference: ("belief", ("known",)),
    MomentumReference: ("momentum_belief", ("known", "momentum")),
}
"""Names of the records of both kinds, and fields that they have besides."""


class ReferenceRecord(Record):
    """One moment of a robot with some feet, of a kind of reference, overwritten by the next.

    ``dtype`` is its layout, ``real`` the dtype of its numbers; ValueError if the library has no room for so
    many feet.
    """

    def __init__(self, library: Library, kind: type[Reference] | type[MomentumReference], feet: int) -> None:
        shapes, (name, besides) = reference_shapes(feet), _RECORDS[kind]
        own = {field: shapes[field] for field in kind._fields}
        dtype = library.record(name, own | dict.fromkeys(besides, ()))
        if dtype is None:
            most = library.places["reference"]["stance"][2]
            raise ValueError(
                f"The library was compiled for at most {most} feet, and the robot has {feet}; compile it "
                f"with -DSF_FEET={feet}, or let Python do the work."
            )
        super().__init__(dtype)
        self.library, self.kind, self.feet = library, kind, feet
        self.dtype, self.real = dtype, library.real
        self._places = [self.now[name] for name in kind._fields]
        self._dtypes, self._shapes = list(map(_DTYPE, self._places)), list(map(_SHAPE, self._places))
        if kind is MomentumReference:
            self.now["momentum"] = True

    def takes(self, reference: Reference | MomentumReference) -> bool:
        """Return whether the arrays of a reference of its kind are as it wants them."""
        return (
            list(map(type, reference)) == [np.ndarray] * len(self._places)
            and list(map(_DTYPE, reference)) == self._dtypes
            and list(map(_SHAPE, reference)) == self._shapes
        )

    def fill(self, reference: Reference | MomentumReference) -> None:
        """Take over its values."""
        for place, part in zip(self._places, reference, strict=True):
            place[...] = part
        self.now["known"] = reference.com[0] == reference.com[0]

    @property
    def known(self) -> bool:
        """Whether it is anything."""
        return bool(self.now["known"])

    @property
    def standing(self) -> bool:
        """Whether a foot surely stood."""
        return any(self.now["stance"].tolist())

    def reference(self) -> Any:
        """Return a copy, of its kind."""
        one = self.copy()
        return self.kind(*(one[name] for name in self.kind._fields))
