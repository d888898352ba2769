r"""Draws from a stream of a robot's own or from a NumPy generator: no stage needs to know which.

A :class:`Stream` is counter-based (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011).
A block of four words is a function, Philox4x32-10, of a key and of the block's number alone, so that a
robot's device draws the same wherever the robot stands. Its words a, b, c, d give two uniform numbers,

.. math:: u_1 = (\lfloor a / 2^5 \rfloor 2^{26} + \lfloor b / 2^6 \rfloor) / 2^{53}

and the same of c and d, and two normal ones by Box and Muller,
:math:`\sqrt{-2 \log(1 - u_1)}\, (\cos 2 \pi u_2, \sin 2 \pi u_2)`. A draw of n numbers takes
:math:`\lceil n / 2 \rceil` blocks; the rest of the last one is dropped.
``native/surefoot_random.h`` is the same in C, and draws here where it is compiled.
"""

from math import prod
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.native import SENSORS

AHEAD = 256  # blocks that are made at a time where there is no library


def philox(counter: NDArray[np.uint32], key: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return blocks of four words by Philox4x32-10: of the blocks' numbers, (N, 4), and their key, (2,)."""
    a, b, c, d = counter.T.astype(np.uint64)
    k, m = key.astype(np.uint64)
    half, low = np.uint64(32), np.uint64(0xFFFFFFFF)
    for _ in range(10):
        first, second = np.uint64(0xD2511F53) * a, np.uint64(0xCD9E8D57) * c
        a, b, c, d = (second >> half) ^ b ^ k, second & low, (first >> half) ^ d ^ m, first & low
        k, m = (k + np.uint64(0x9E3779B9)) & low, (m + np.uint64(0xBB67AE85)) & low
    return np.stack([a, b, c, d], axis=1).astype(np.uint32)


def _uniforms(key: Any, number: NDArray[np.uint64]) -> Floats:
    """Return the two uniform numbers of each of N blocks, shape (N, 2)."""
    half, low = np.uint64(32), np.uint64(0xFFFFFFFF)
    nothing = np.zeros_like(number)
    counter = np.stack([number & low, number >> half, nothing, nothing], axis=1).astype(np.uint32)
    words = philox(counter, np.array([key & low, key >> half], dtype=np.uint32)).astype(np.float64)
    high, rest = np.floor(words[:, ::2] / 2.0**5), np.floor(words[:, 1::2] / 2.0**6)
    drawn: Floats = (high * 2.0**26 + rest) / 2.0**53
    return drawn


def _normals(uniforms: Floats) -> Floats:
    """Return two normal numbers for two uniform ones, shape (N, 2)."""
    # Gaps between numbers would change how NumPy rounds.
    first, second = np.ascontiguousarray(uniforms.T)
    radius, angle = np.sqrt(-2.0 * np.log(1.0 - first)), 2.0 * np.pi * second
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


class Stream:
    """Random numbers of one device.

    Args:
        key: The key, a whole number of 64 bits.

    >>> one, same = Stream.of(7, 3), Stream.of(7, 3)
    >>> bool((one.standard_normal((2, 8)) == same.standard_normal((2, 8))).all())
    True
    """

    record: NDArray[Any]
    """The key and the number of the next block, fields ``key`` and ``count``, shape (): the whole state, as C
    has it."""
    _first: int
    _uniform: Floats
    _normal: Floats

    def __init__(self, key: int | np.uint64) -> None:
        self.record = np.zeros((), dtype=[("key", np.uint64), ("count", np.uint64)])
        self.record["key"] = key
        self._settle()

    @classmethod
    def of(cls, *numbers: int) -> Self:
        """Return the stream of a key's parts, such as a seed and a device's number; by chance without."""
        sequence = np.random.SeedSequence(numbers or None)
        return cls(sequence.generate_state(1, np.uint64)[0])

    @property
    def address(self) -> int:
        """Where :attr:`record` lies in memory."""
        return self._address

    def random(self, shape: tuple[int, ...] = ()) -> Floats:
        """Draw from [0, 1), numbers of a shape."""
        return self._draw(shape, False)

    def standard_normal(self, shape: tuple[int, ...] = ()) -> Floats:
        """Draw standard normal numbers of a shape."""
        return self._draw(shape, True)

    def _draw(self, shape: tuple[int, ...], normal: bool) -> Floats:
        library = SENSORS.installed()
        if library is None:
            return self._next(prod(shape), normal).reshape(shape)
        out = np.empty(shape)
        library.functions.surefoot_draw(self._address, normal, out.size, out.ctypes.data)
        return out

    def _next(self, total: int, normal: bool) -> Floats:
        """Return the next numbers in Python, of blocks that are made many at a time."""
        at, blocks = int(self.record["count"]), (total + 1) // 2
        start = 2 * (at - self._first)
        if not 0 <= start <= len(self._uniform) - 2 * blocks:
            start, self._first = 0, at
            number = np.uint64(at) + np.arange(max(AHEAD, blocks), dtype=np.uint64)
            uniforms = _uniforms(self.record["key"][()], number)
            self._uniform, self._normal = uniforms.ravel(), _normals(uniforms).ravel()
        self.record["count"] = at + blocks
        made = self._normal if normal else self._uniform
        return made[start : start + total].copy()

    def _settle(self) -> None:
        self._address = self.record.ctypes.data
        self._first, self._uniform, self._normal = 0, np.empty(0), np.empty(0)

    def __getstate__(self) -> dict[str, Any]:
        return {"record": self.record}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.record = kept["record"]
        self._settle()


def normal(rng: np.random.Generator | Stream, shape: tuple[int, ...]) -> Floats:
    """Draw standard normal numbers of a shape from a stream or a NumPy generator; TypeError for another."""
    _check(rng)
    return rng.standard_normal(shape)


def uniform(rng: np.random.Generator | Stream, low: float, high: float, shape: tuple[int, ...]) -> Floats:
    """Draw numbers uniformly from [low, high); arguments as for :func:`normal`."""
    _check(rng)
    drawn = rng.random(shape)
    return drawn if (low, high) == (0.0, 1.0) else low + (high - low) * drawn


def _check(rng: Any) -> None:
    if not isinstance(rng, (Stream, np.random.Generator)):
        raise TypeError(
            "Sensors draw from a numpy.random.Generator or a Stream, "
            f"got {type(rng).__name__}; pass numpy.random.default_rng(seed)."
        )
