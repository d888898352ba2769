"""The truth at the end of a step as an environment's ``info`` tells it."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from surefoot.envs.instrumentation.truth import FeetTruth
from surefoot.envs.truth import cop_in_sole

Array = NDArray[np.float64]


class StepTruth(Mapping[str, Array]):
    """Arrays at the last row, each computed when it is asked for; pickled and copied as a ``dict``.

    Args:
        truth: What was read, shape (S, ...).
    """

    def __init__(self, truth: FeetTruth) -> None:
        self._truth = truth

    def __getitem__(self, name: str) -> Array:
        return _TOLD[name](self._truth)

    def __iter__(self) -> Iterator[str]:
        return iter(_TOLD)

    def __len__(self) -> int:
        return len(_TOLD)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Mapping) or set(other) != set(self):
            return False
        return all(np.array_equal(self[name], other[name], equal_nan=True) for name in self)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr(dict(self))

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)


def _force_cell(truth: FeetTruth) -> Array:
    if truth.layout.flaw:
        return np.full(4 * len(truth.layout.feet), np.nan)
    force: Array = truth.force_cell[-1].copy()
    return force


def _cop_foot(truth: FeetTruth) -> Array:
    has_area = np.array([not foot.flaw for foot in truth.layout.feet])
    return np.where(has_area[:, None], cop_in_sole(truth.wrench_sole[-1]), np.nan)


_TOLD: Final[dict[str, Callable[[FeetTruth], Array]]] = {
    "force_cell": _force_cell,
    "vgrf": FeetTruth.vgrf,
    "cop_world": FeetTruth.cop_world,
    "cop_foot": _cop_foot,
    "com": lambda truth: truth.com[-1].copy(),
    "wrench_sole": lambda truth: truth.wrench_sole[-1].copy(),
}
"""How each quantity follows from a step's truth."""

TOLD: Final = tuple(_TOLD)
"""Names of what is told of a step."""
