"""Load cells for a robot of another weight."""

from dataclasses import replace
from typing import Final

from surefoot.sensors.devices.load_cell_config import LoadCells

REFERENCE_WEIGHT: Final = 5.305 * 9.81
"""Weight in N of the robot, a NAO, under which the presets' cells have their sizes."""


def sized(config: LoadCells, weight: float) -> LoadCells:
    """Choose cells of the same kind for a robot of another weight.

    All that is told in newtons goes with the weight: capacity, zeros with their drift and temperature
    coefficient, what impacts do to them and from which change on. What is relative stays; noise and rounding,
    shares of the range, go along by themselves.

    Args:
        config: Cells as they would be under a NAO of 52 N; it is not changed.
        weight: Weight of the robot in N.

    Raises:
        ValueError: If the weight is not positive and finite.

    >>> cells = sized(LoadCells(), 33.3 * 9.81)
    >>> round(cells.capacity), round(cells.initial_zero_std, 1), cells.initial_gain_std
    (616, 9.4, 0.12)
    """
    if not 0.0 < weight < float("inf"):
        raise ValueError(f"'weight' must be finite and positive, in N, got {weight}.")
    factor, mechanics = float(weight) / REFERENCE_WEIGHT, config.mechanics
    return replace(
        config,
        capacity=config.capacity * factor,
        initial_zero_std=config.initial_zero_std * factor,
        zero_drift=config.zero_drift * factor,
        zero_tempco=config.zero_tempco * factor,
        mechanics=replace(
            mechanics,
            mounting_warp_std=mechanics.mounting_warp_std * factor,
            mounting_common_std=mechanics.mounting_common_std * factor,
            impact_threshold=mechanics.impact_threshold * factor,
        ),
    )
