"""What a vector environment is seeded with."""

from collections.abc import Sequence

Seeds = int | Sequence[int | None] | None
"""One number for all robots, or one or none a robot."""


def seed_numbers(seed: Seeds) -> list[int]:
    """List the numbers of what a vector environment is seeded with; none without a seed."""
    if seed is None:
        return []
    if isinstance(seed, Sequence):
        return [int(number) for number in seed if number is not None]
    return [int(seed)]


def seed_of_each(seed: Seeds, count: int) -> list[int | None]:
    """Tell what each of ``count`` robots is seeded with; one number counts for all."""
    return list(seed) if isinstance(seed, Sequence) else [seed] * count
