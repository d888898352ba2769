"""Follows a model that was replaced, for code outside of the environment that still refers to it.

An instrumented model takes the place of the one that an environment was made with. A script that keeps
``model = env.unwrapped.model`` and randomises it from episode to episode would then change nothing, so these
changes are carried over. References inside the environment are found before the exchange
(:func:`~surefoot.envs.instrumentation.swap.find_holder`), and its model is left alone.
"""

from collections.abc import Iterator
from typing import Any
from weakref import ref

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.envs.instrumentation.swap import changeable_arrays, options, original_ids, public, put_array


class ReplacedModel:
    """The numbers of a replaced model, which live as long as somebody else refers to them.

    Args:
        old: The replaced model.
        prefix: The beginning of the names of what was added to its successor.
    """

    def __init__(self, old: mujoco.MjModel, prefix: str) -> None:
        self._prefix = prefix
        self._model = ref(old)
        # Views of an array outlive the model, and keep the array.
        self._arrays = {name: ref(array) for name, array in changeable_arrays(old)}
        self._before: dict[str, Any] = {}

    def follow(self) -> bool:
        """Remember the present numbers, after the exchange; return whether anything still refers to them."""
        self._before = dict(self._numbers())
        return bool(self._before)

    def changes(self) -> dict[str, Any]:
        """Return the numbers that have changed since they were last asked for, by their names."""
        now = dict(self._numbers())
        changed = {name: value for name, value in now.items() if value != self._before.get(name, value)}
        self._before = now
        return changed

    def carry_over(self, new: mujoco.MjModel) -> None:
        """Copy what has changed to the model that took its place."""
        kept = original_ids(new, self._prefix)
        for name in self.changes():
            if name in self._arrays:
                array = self._arrays[name]()
                if array is not None:
                    put_array(new, name, array, kept)
            else:
                part, field = name.split(".")
                theirs, value = options(new)[int(part)], getattr(options(self._model())[int(part)], field)
                if isinstance(value, np.ndarray):
                    getattr(theirs, field)[...] = value
                else:
                    setattr(theirs, field, value)

    def _numbers(self) -> Iterator[tuple[str, Any]]:
        """List all numbers that are still referred to, in a form that compares fast."""
        for name, held in self._arrays.items():
            array: NDArray[Any] | None = held()
            if array is not None:
                yield name, array.tobytes()
        model = self._model()
        for number, part in enumerate(() if model is None else options(model)):
            for field, value in public(part):
                if isinstance(value, np.ndarray):
                    yield f"{number}.{field}", value.tobytes()
                elif isinstance(value, int | float):
                    yield f"{number}.{field}", value
