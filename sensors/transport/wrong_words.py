"""Wrong words: a bit of a code arrives the wrong way round.

An interrupt between two clock edges of a bit-banged bus, or noise on its line, turns a bit over. What that
does depends on which one it was: from a count, which nobody sees, to half of the range. Readings of HX711
chips were seen off by 320,000 counts now and then (esphome#2996); how often depends on the host,
and nobody has published a rate.
"""

import numpy as np
from array_api_compat import array_namespace

from surefoot.sensors._arrays import Table, limit, namespace
from surefoot.sensors.corruption import Array, Corruption, Rng, stateless
from surefoot.sensors.randomness import uniform
from surefoot.sensors.transport.rare import change_at_random

CODINGS = ("offset-binary", "two's complement")
"""How a word stands for a number; the names of :class:`~surefoot.sensors.LoadCells`."""


def wrong_words(probability: float, bits: int = 24, coding: str = "offset-binary") -> Corruption[tuple[()]]:
    """Turn one bit of a reading over now and then, every bit alike.

    Readings are counts, whole numbers that the word can hold; what is not (NaN) stays as it is. float32 holds
    words of up to 24 bits.

    Args:
        probability: Probability that a word is wrong, for each channel and reading on its own.
        bits: Bits of a word, 1 to 32.
        coding: ``"offset-binary"``, from 0 to 2^bits - 1, or ``"two's complement"``, from -2^(bits - 1) to
            2^(bits - 1) - 1, of which the highest bit counts negative.

    Raises:
        ValueError: If the probability does not lie in [0, 1], or there is no such word.

    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> word = wrong_words(1.0, bits=3, coding="two's complement")
    >>> {int(word.apply(np.array([2.0]), (), rng, 1.0)[0][0]) for _ in range(100)} == {0, 3, -2}
    True
    """
    if not 0.0 <= probability <= 1.0:
        raise ValueError(f"'probability' must lie in [0, 1], got {probability}.")
    if not isinstance(bits, int) or isinstance(bits, bool) or not 1 <= bits <= 32:
        raise ValueError(f"'bits' must be a whole number from 1 to 32, got {bits!r}.")
    if coding not in CODINGS:
        raise ValueError(f"'coding' must be one of {CODINGS}, got {coding!r}.")
    places = 2.0 ** np.arange(bits)
    signs = np.where((places == places[-1]) & (coding == CODINGS[1]), -1.0, 1.0)
    # A reading adds what the bit is worth where it was 0 and loses it where it was 1.
    table = Table([places, places * signs])

    def flip(word: Array, rng: Rng) -> Array:
        xp = namespace(word)
        drawn = uniform(rng, 0.0, 1.0, tuple(word.shape), word.dtype)
        which = array_namespace(drawn).astype(limit(drawn * bits, 0.0, bits - 1.0), xp.int64)
        place, worth = (
            xp.reshape(xp.take(values, xp.reshape(which, (-1,)), axis=0), word.shape)
            for values in table.like(word)
        )
        # Halving rounds down, so negative words show the bits of their two's complement.
        above = xp.floor(word / place)
        bit = above - 2.0 * xp.floor(above / 2.0)
        return word + (1.0 - 2.0 * bit) * worth

    def read(reading: Array, rng: Rng) -> Array:
        return change_at_random(reading, probability, lambda words: flip(words, rng), rng)

    return stateless(read)
