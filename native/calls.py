"""Call a function of a library for many robots, with newly allocated results for each call."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.native.library import Library
from surefoot.native.records import PointerRecord
from surefoot.native.threads import call_for_many


class Call:
    """A function of the library for N robots, which writes to arrays that are allocated for each call.

    Args:
        library: The library.
        function: The function's name.
        room: The record with the offset of each array in the results.
        constants: The record that is the function's first argument.
        fields: Dtype and shape of each result for one robot.
        robots: Number of robots N, the first axis of the arrays. ``None`` for a single robot without this
            axis.
    """

    def __init__(
        self,
        library: Library,
        function: str,
        room: str,
        constants: PointerRecord,
        fields: Mapping[str, tuple[Any, tuple[int, ...]]],
        robots: int | None,
    ) -> None:
        front = () if robots is None else (robots,)
        self._results = np.dtype([(name, dtype, (*front, *shape)) for name, (dtype, shape) in fields.items()])
        places = self._results.fields
        assert places is not None
        offsets = PointerRecord(library, room, {name: places[name][1] for name in fields})
        self._referenced = constants, offsets  # kept alive, because the library holds their addresses
        self._function = partial(getattr(library.functions, function), constants.address, offsets.address)
        self._robots = np.arange(robots or 1, dtype=np.int32)
        self._first = self._robots.ctypes.data

    def __call__(self, *inputs: NDArray[Any], threads: int = 1) -> NDArray[Any]:
        """Return a new record of all results.

        Args:
            inputs: Contiguous arrays with the robots on the first axis.
            threads: See :func:`~surefoot.native.call_for_many`.
        """
        results = np.empty((), self._results)
        addresses = [array.ctypes.data for array in (*inputs, results)]
        if len(self._robots) == 1:
            self._function(*addresses, self._first, 1)
        else:
            call_for_many(partial(self._function, *addresses), (self._robots,), threads)
        return results
