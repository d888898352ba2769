"""Time one update of every online method.

    OMP_NUM_THREADS=1 python benchmarks/method_update.py

Methods take turns sample by sample in one process, so that other work of the machine hits all of them
alike. The sliding window solves on every fourth sample (40 samples, 5 iterations, 16 parameters; the CoP
paper: 2.5 ms), the moment filter on every sixteenth. The moment filter runs in C as well, called by
``FootCalibrator``. No test asserts these figures.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import (
    GRAVITY,
    METHODS,
    FootCalibrator,
    OnlineSetup,
    Parameters,
    Reference,
    nao_shoe_layout,
    online_method,
)
from surefoot.calibration.native import NativeState

DT = 1.0 / 80.0
EVERY = {"moment": 16, "moment, in C": 16}
MASS = 5.305


def stepping_robot(samples: int, seed: int = 0) -> tuple[NDArray[np.float64], Reference]:
    """Shift the weight from foot to foot once in 0.8 s; readings in N with gains off by 10 %."""
    rng = np.random.default_rng(seed)
    moment = np.arange(samples) * DT
    share = np.clip(0.5 + np.sin(2 * np.pi * moment / 1.6), 0.0, 1.0)
    load = np.repeat(np.stack([share, 1.0 - share], axis=1), 4, axis=1) * MASS * GRAVITY / 4.0
    gain = 1.0 + 0.1 * rng.normal(size=8)
    reading = load * gain + 0.05 * rng.normal(size=(samples, 8))
    soles = np.array([(0.0, 0.05, 0.0), (0.0, -0.05, 0.0)])
    zero = np.zeros((samples, 3))
    standing = np.stack([share > 0.0, share < 1.0], axis=1)
    return reading, Reference(
        com=np.stack([0.024 + 0 * share, 0.1 * share - 0.05, 0.26 + 0 * share], axis=1),
        com_acceleration=zero,
        angular_momentum_rate=zero,
        position_sole=np.broadcast_to(soles, (samples, 2, 3)),
        R_level_sole=np.broadcast_to(np.eye(3), (samples, 2, 3, 3)),
        stance=standing,
        swing=~standing,
        accelerometer=zero + np.array([0.0, 0.0, GRAVITY]),
        gyroscope=zero,
    )


def measure(samples: int) -> None:
    """Print medians for all methods."""
    reading, reference = stepping_robot(samples)
    layout = nao_shoe_layout()
    setup = OnlineSetup(layout=layout, mass=MASS, initial=Parameters(np.ones(8), np.zeros(8)))
    steps = {name: stepper(name, setup, reading[0]) for name in METHODS}
    in_c = FootCalibrator(layout, mass=MASS)
    in_c.update(reading[0], Reference(*(part[0] for part in reference)))
    if isinstance(in_c._state, NativeState):
        in_c.reset()
        steps["moment, in C"] = in_c.update
    seconds: dict[str, list[float]] = {name: [] for name in steps}
    for k in range(samples):
        row = Reference(*(part[k] for part in reference))
        for name, step in steps.items():
            start = time.perf_counter()
            step(reading[k], row)
            seconds[name].append(time.perf_counter() - start)
    print(f"{samples} samples, in microseconds:")
    settled = np.arange(samples) >= samples // 2
    for name, taken in seconds.items():
        spent = 1e6 * np.array(taken)
        solving = (np.arange(samples) + 1) % EVERY.get(name, 4) == 0
        with_solve, without = (np.median(spent[settled & part]) for part in (solving, ~solving))
        mean, (median, tail) = spent[settled].mean(), np.percentile(spent[settled], [50, 99])
        print(
            f"  {name:14s} sample {without:8.2f}   with update {with_solve:8.2f}   mean {mean:8.2f}"
            f"   median {median:8.2f}   p99 {tail:8.2f}"
        )


def stepper(name: str, setup: OnlineSetup, raw: NDArray[np.float64]) -> Callable[[Any, Reference], None]:
    """Make a function that feeds samples one by one to a method's pure functions."""
    method = online_method(name, setup)
    state = method.init(raw)

    def step(raw: Any, reference: Reference) -> None:
        nonlocal state
        state, _ = method.update(state, raw, reference, DT)

    return step


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=2000)
    measure(parser.parse_args().samples)
