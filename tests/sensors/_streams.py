"""Readings that stream through a stage or a device."""

from typing import Any

import numpy as np

DT = 1 / 80


def leaves(state: Any) -> list[Any]:
    return [leaf for part in state for leaf in leaves(part)] if isinstance(state, tuple) else [state]


def follow(stage: Any, loads: Any, seed: int = 0, dt: float = DT, state: Any = None) -> tuple[Any, Any]:
    """Pass readings (N, K) or blocks (N, S, K) through a stage in turn; its readings and state."""
    rng, read = np.random.default_rng(seed), []
    state = stage.init(loads.shape[-1:], rng) if state is None else state
    for load in loads:
        reading, state = stage.apply(load, state, rng, dt)
        read.append(reading)
    return np.stack(read), state


def stream(stage: Any, loads: Any, seed: int = 0, dt: float = DT) -> Any:
    return follow(stage, loads, seed, dt)[0]
