"""How long emulated load cells take in NumPy: 4,096 robots of 8 cells at once, and one robot.

Run ``python benchmarks/sensor_speed.py``. The whole chain is the preset ``hx711-bar-cells``: each link of the
mechanics, the bridge, the converter with its clock and filter, and the wire. Each link is timed as what the
cells take with it alone, less what they take without any. Medians over rounds, in which the variants take
turns, so that a busy machine slows all alike.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np

from surefoot.sensors import LoadCells, Mechanics, Wire, load_cells
from surefoot.sensors.presets import BAR_CELLS_ON_HX711 as WHOLE
from surefoot.sensors.presets import HX711_LOAD_CELLS

DT = 1 / 80
BARE = replace(HX711_LOAD_CELLS, scale_drift=0.0, offset_drift=0.0, input_noise=0.0, rate=None)


def variants() -> dict[str, LoadCells]:
    """The whole, the default device, nothing but a fixed bridge and a converter, and each link alone."""
    found = {"whole chain": WHOLE, "hx711-load-cells": HX711_LOAD_CELLS, "bare": BARE}
    drifts = {"scale_drift": WHOLE.scale_drift, "offset_drift": WHOLE.offset_drift}
    found["drift of scale and offset"] = replace(BARE, **drifts)
    found["noise"] = replace(BARE, input_noise=WHOLE.input_noise)
    found["temperature"] = replace(
        BARE,
        scale_tempco=WHOLE.scale_tempco,
        offset_tempco=WHOLE.offset_tempco,
        temperature_ramp=WHOLE.temperature_ramp,
        temperature_rise=WHOLE.temperature_rise,
    )
    found["clock"] = replace(BARE, rate=WHOLE.rate)
    found["clock and filter"] = replace(BARE, rate=WHOLE.rate, settling=WHOLE.settling)
    spring, way = WHOLE.mechanics, WHOLE.wire
    for name, part in (
        ("nonlinearity", Mechanics(nonlinearity=spring.nonlinearity)),
        ("hysteresis", Mechanics(hysteresis=spring.hysteresis)),
        (
            "creep",
            Mechanics(creep_shares=spring.creep_shares, creep_time_constants=spring.creep_time_constants),
        ),
        ("mounting", Mechanics(mounting_warp_std=spring.mounting_warp_std)),
        ("overload", Mechanics(overload_share=spring.overload_share)),
    ):
        found[name] = replace(BARE, mechanics=part)
    for field in fields(Wire):
        if field.name in ("spike_rate", "wrong_words", "stale_repeats", "packet_loss", "gap_share", "delay"):
            found[field.name] = replace(
                BARE, wire=Wire(**{field.name: getattr(way, field.name)}, under_way=4)
            )
    return found


def stepper(config: LoadCells, block: Any, rng: Any) -> Callable[[], None]:
    """Make a function that passes loads through the cells once."""
    cells = load_cells(config)
    state = cells.init((*block.shape[:-2], config.channels), rng)
    loads = [block + 2.0 * rng.standard_normal(block.shape) for _ in range(5)]
    count = 0

    def step() -> None:
        nonlocal state, count
        _, state = cells.apply(loads[count % 5], state, rng, DT)
        count += 1

    return step


def medians(steps: dict[str, Callable[[], None]], rounds: int, each: int) -> dict[str, float]:
    """Time every variant in turns; microseconds a step."""
    taken: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(rounds):
        for name, step in steps.items():
            step()
            start = time.perf_counter()
            for _ in range(each):
                step()
            taken[name].append(1e6 * (time.perf_counter() - start) / each)
    return {name: float(np.median(values)) for name, values in taken.items()}


def show(title: str, result: dict[str, float]) -> None:
    print(f"\n{title}")
    for name, value in result.items():
        alone = name in ("whole chain", "hx711-load-cells", "bare")
        print(f"  {name:24s} {value if alone else value - result['bare']:9.1f} us{'' if alone else ' more'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=4096)
    parser.add_argument("--substeps", type=int, default=1, help="substeps of a block for the batch")
    parser.add_argument("--rounds", type=int, default=15)
    arguments = parser.parse_args()

    rng = np.random.default_rng(0)
    for robots, shape, each in (
        (f"{arguments.robots} robots", (arguments.robots, arguments.substeps, WHOLE.channels), 20),
        ("one robot", (10, WHOLE.channels), 200),
    ):
        block = 10.0 + rng.standard_normal(shape)
        steps = {name: stepper(config, block, rng) for name, config in variants().items()}
        show(f"{robots}, S = {shape[-2]}", medians(steps, arguments.rounds, each))


if __name__ == "__main__":
    main()
