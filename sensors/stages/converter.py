"""The converter of a voltage: it adds noise, clips and rounds."""

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors.configuration import check_not_negative
from surefoot.sensors.corruption import Corruption, Rng, limit, stateless
from surefoot.sensors.randomness import normal


def white_noise(std: float) -> Corruption[tuple[()]]:
    """Add independent normal noise of a standard deviation to every reading; 0 draws nothing."""
    check_not_negative(std=std)

    def add(reading: Floats, rng: Rng, dt: float) -> Floats:
        if std == 0.0:
            return reading + 0.0
        return reading + std * normal(rng, reading.shape)

    return stateless(add)


def saturate(low: float, high: float) -> Corruption[tuple[()]]:
    """Clip readings to a range; an empty one is refused with a ValueError."""
    if not low < high:
        raise ValueError(f"'low' must be below 'high', got [{low}, {high}].")
    return stateless(lambda reading, rng, dt: limit(reading, low, high))


def quantize(resolution: float) -> Corruption[tuple[()]]:
    """Round readings to whole multiples of a resolution (halves to even); 0 leaves them as they are."""
    check_not_negative(resolution=resolution)

    def round_to(reading: Floats, rng: Rng, dt: float) -> Floats:
        if resolution == 0.0:
            return reading + 0.0
        whole = resolution == 1.0
        rounded: Floats = np.rint(reading) if whole else np.rint(reading / resolution) * resolution
        return rounded

    return stateless(round_to)
