"""The last reference of a robot's beliefs: whether anything is known, and how ``info`` shows it."""

from typing import Any, TypeVar

import numpy as np

from surefoot.calibration import MomentumReference, Reference

Believes = TypeVar("Believes", Reference, MomentumReference)


class Believed:
    """The last reference, as beliefs of any kind report it."""

    believed: Reference | MomentumReference  # the result of the last ``sample()``

    @property
    def known(self) -> bool:
        """Whether anything is believed."""
        return bool(self.believed.com[0] == self.believed.com[0])

    @property
    def standing(self) -> bool:
        """Whether a foot surely stood."""
        return bool(self.believed.stance.any())

    def info(self) -> dict[str, Any]:
        """Return the beliefs, for ``info``."""
        return reference_info(self.believed)


def nothing(feet: int) -> Reference:
    """Return the reference of a robot that knows nothing: NaN, and no foot in stance or swing."""
    return _unknown(Reference, feet)


def unknown(feet: int) -> MomentumReference:
    """Return the same with the momentum."""
    return _unknown(MomentumReference, feet)


def _unknown(kind: type[Believes], feet: int) -> Believes:
    vectors, soles, unsure = np.full((5, 3), np.nan), np.full((feet, 4, 3), np.nan), np.zeros((2, feet), bool)
    feet_own = {"position_sole": soles[:, 3], "R_level_sole": soles[:, :3]}
    feet_own |= {"stance": unsure[0], "swing": unsure[1]}
    others = (name for name in kind._fields if name not in feet_own)
    return kind(**feet_own, **dict(zip(others, vectors, strict=False)))


def reference_info(reference: Reference | MomentumReference) -> dict[str, Any]:
    """Return references (...) for ``info``, as arrays of their own without NaN, which is unlike itself.

    Unknown numbers are 0 there, and ``"known"`` (...) says where something is known.
    """
    known = ~np.isnan(reference.com[..., 0])
    info: dict[str, Any] = {"known": known if known.ndim else bool(known)}
    for name, part in reference._asdict().items():
        where = known.reshape(known.shape + (1,) * (part.ndim - known.ndim))
        info[name] = part.copy() if part.dtype == bool else np.where(where, part, 0.0)
    return info
