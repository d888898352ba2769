"""Noise that is fresh in every reading."""

from surefoot.sensors.corruption import Array, Corruption, Rng, check_not_negative, stateless
from surefoot.sensors.randomness import normal


def white_noise(std: float) -> Corruption[tuple[()]]:
    """Add independent normal noise to every reading.

    Args:
        std: Its standard deviation in the unit of the readings; 0 draws nothing.

    Raises:
        ValueError: If it is negative.
    """
    check_not_negative(std=std)

    def add(reading: Array, rng: Rng) -> Array:
        if std == 0.0:
            return reading + 0.0
        return reading + std * normal(rng, tuple(reading.shape), reading.dtype)

    return stateless(add)


def noise_density(density: float) -> Corruption[tuple[()]]:
    """Add white noise given by its density, as data sheets of inertial sensors do.

    A sample that stands for a time dt has a standard deviation of density / sqrt(dt): of noise that
    is white up to half the sampling rate, averages over a given time spread alike at any rate.

    Args:
        density: In the unit of the readings per square root of Hz.

    Raises:
        ValueError: If it is negative.
    """
    check_not_negative(density=density)

    def init(shape: tuple[int, ...], rng: Rng, dtype: object = None) -> tuple[()]:
        return ()

    def apply(reading: Array, state: tuple[()], rng: Rng, dt: float) -> tuple[Array, tuple[()]]:
        if density == 0.0:
            return reading + 0.0, state
        return reading + density / dt**0.5 * normal(rng, tuple(reading.shape), reading.dtype), state

    return Corruption(init, apply)
