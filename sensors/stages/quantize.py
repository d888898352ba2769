"""What a converter does to a voltage: it clips, and it rounds."""

from surefoot.sensors._arrays import limit, round_off
from surefoot.sensors.corruption import Array, Corruption, Rng, stateless


def saturate(low: float, high: float) -> Corruption[tuple[()]]:
    """Clip readings to a range; what is beyond it is lost.

    Args:
        low: Lowest reading.
        high: Highest reading.

    Raises:
        ValueError: If the range is empty.
    """
    if not low < high:
        raise ValueError(f"'low' must be below 'high', got [{low}, {high}].")

    def clip(reading: Array, rng: Rng) -> Array:
        return limit(reading, low, high)

    return stateless(clip)


def quantize(resolution: float) -> Corruption[tuple[()]]:
    """Round readings to whole multiples of a resolution (halves to even).

    Args:
        resolution: The step in the unit of the readings; 0 leaves them as they are.

    Raises:
        ValueError: If it is negative.
    """
    if not 0.0 <= resolution < float("inf"):
        raise ValueError(f"'resolution' must be finite and not negative, got {resolution}.")

    def apply(reading: Array, rng: Rng) -> Array:
        if resolution == 0.0:
            return reading + 0.0
        if resolution == 1.0:
            return round_off(reading)
        return round_off(reading / resolution) * resolution

    return stateless(apply)
