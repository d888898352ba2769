r"""Draws from a stream of a robot's own or from a NumPy generator: no stage needs to know which.

A :class:`Stream` is counter-based (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011).
A block of four words is a function, Philox4x32-10, of a key and of the block's number alone, so that a
robot's device draws the same wherever the robot stands. Its words a, b, c, d give two uniform numbers,

.. math:: u_1 = (\lfloor a / 2^5 \rfloor 2^{26} + \lfloor b / 2^6 \rfloor) / 2^{53}

and the same of c and d, and two normal ones by Box and Muller,
:math:`\sqrt{-2 \log(1 - u_1)}\, (\cos 2 \pi u_2, \sin 2 \pi u_2)`. A draw of n numbers takes
:math:`\lceil n / 2 \rceil` blocks; what is left of the last one is dropped.
``sensors/native/surefoot_random.h`` is the same in C, and draws here where it is compiled.
"""

from collections.abc import Iterable, Sequence
from math import prod
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.sensors.native import installed

AHEAD = 256
"""Blocks that a lone robot's stream makes at a time where there is no library."""


def philox(counter: NDArray[np.uint32], key: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return blocks of four words by Philox4x32-10.

    Args:
        counter: Numbers of the blocks, shape (..., 4).
        key: Their keys, shape (..., 2).
    """
    a, b, c, d = (counter[..., i].astype(np.uint64) for i in range(4))
    k, m = (key[..., i].astype(np.uint64) for i in range(2))
    half, low = np.uint64(32), np.uint64(0xFFFFFFFF)
    for _ in range(10):
        first, second = np.uint64(0xD2511F53) * a, np.uint64(0xCD9E8D57) * c
        a, b, c, d = (second >> half) ^ b ^ k, second & low, (first >> half) ^ d ^ m, first & low
        k, m = (k + np.uint64(0x9E3779B9)) & low, (m + np.uint64(0xBB67AE85)) & low
    return np.stack(np.broadcast_arrays(a, b, c, d), axis=-1).astype(np.uint32)


def _uniforms(key: NDArray[np.uint64], number: NDArray[np.uint64]) -> NDArray[np.float64]:
    """Return the two uniform numbers of each block, shape (..., 2)."""
    half, low = np.uint64(32), np.uint64(0xFFFFFFFF)
    nothing = np.zeros_like(number)
    counter = np.stack([number & low, number >> half, nothing, nothing], axis=-1).astype(np.uint32)
    words = philox(counter, np.stack([key & low, key >> half], axis=-1).astype(np.uint32)).astype(np.float64)
    high, rest = np.floor(words[..., ::2] / 2.0**5), np.floor(words[..., 1::2] / 2.0**6)
    drawn: NDArray[np.float64] = (high * 2.0**26 + rest) / 2.0**53
    return drawn


def _normals(uniforms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return two normal numbers for two uniform ones, shape (..., 2)."""
    # Gaps between numbers would change how NumPy rounds.
    first, second = (np.ascontiguousarray(uniforms[..., i]) for i in range(2))
    radius, angle = np.sqrt(-2.0 * np.log(1.0 - first)), 2.0 * np.pi * second
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def _key(numbers: Sequence[int]) -> np.uint64:
    sequence = np.random.SeedSequence(list(numbers) or None)
    key: np.uint64 = sequence.generate_state(1, np.uint64)[0]
    return key


class _Ahead(NamedTuple):
    """Numbers made at a time: the first block's, and uniform and normal ones."""

    first: int
    rows: tuple[NDArray[np.float64], NDArray[np.float64]]


class Stream:
    """Random numbers of one device, of a robot or of each of N robots.

    Args:
        key: The key, shape () for one robot or (N,).

    Attributes:
        record: Keys and numbers of the next blocks, fields ``key`` and ``count``, shape () or (N,): the whole
            state, as C has it.

    >>> one, many = Stream.of(7, 3), Stream.of_each([(7, 2), (7, 3)])
    >>> bool((one.standard_normal((2, 8)) == many.standard_normal((2, 2, 8), before=1)[:, 1]).all())
    True
    """

    record: NDArray[Any]
    _ahead: _Ahead

    def __init__(self, key: ArrayLike) -> None:
        keys = np.asarray(key, dtype=np.uint64)
        self.record = np.zeros(keys.shape, dtype=[("key", np.uint64), ("count", np.uint64)])
        self.record["key"] = keys
        self._settle(None)

    @classmethod
    def of(cls, *numbers: int) -> Self:
        """Return the stream of one robot.

        Args:
            *numbers: What the key is made of, such as a seed and the device's number; without, nobody knows.
        """
        return cls(_key(numbers))

    @classmethod
    def of_each(cls, numbers: Iterable[Sequence[int]]) -> Self:
        """Return the stream of N robots, each as :meth:`of` makes it of the same numbers."""
        return cls([_key(own) for own in numbers])

    @property
    def address(self) -> int:
        """Where :attr:`record` lies in memory."""
        return self._address

    def only(self, mask: NDArray[np.bool_]) -> Self:
        """Return the same stream, of which some robots' numbers are used up and the others' are not.

        Args:
            mask: These robots, shape (N,).
        """
        part = object.__new__(type(self))
        part.record = self.record
        part._settle(np.ascontiguousarray(mask, dtype=np.bool_))
        return part

    def take(self, other: Self, mask: NDArray[np.bool_]) -> None:
        """Let some robots, shape (N,), go on with their parts of another stream."""
        self.record[mask] = other.record[mask]

    def random(self, shape: tuple[int, ...] = (), before: int = 0) -> NDArray[np.float64]:
        """Draw from [0, 1); arguments as for :meth:`standard_normal`."""
        return self._draw(shape, before, False)

    def standard_normal(self, shape: tuple[int, ...] = (), before: int = 0) -> NDArray[np.float64]:
        """Draw standard normal numbers.

        Args:
            shape: The shape of the result; one axis of a stream of N robots is the robots'.
            before: How many axes come before that one.

        Raises:
            ValueError: If that axis is not of N robots.
        """
        return self._draw(shape, before, True)

    def _draw(self, shape: tuple[int, ...], before: int, normal: bool) -> NDArray[np.float64]:
        robots = 1
        if self.record.ndim:
            robots = len(self.record)
            if shape[before : before + 1] != (robots,):
                raise ValueError(
                    f"A stream of {robots} robots draws shapes whose axis {before} is theirs, got {shape}."
                )
        total = prod(shape)
        library = installed()
        if library is not None and total:
            out = np.empty(shape)
            rest = prod(shape[before + 1 :]) if self.record.ndim else total
            library.functions.surefoot_draw(
                self._address, self._marks_address, robots, total // robots, rest, normal, out.ctypes.data
            )
            return out
        blocks = (total // robots + 1) // 2
        if not self.record.ndim:
            return self._from_ahead(blocks, normal)[:total].reshape(shape)
        count = self.record["count"]
        drawn = _uniforms(self.record["key"][:, None], count[:, None] + np.arange(blocks, dtype=np.uint64))
        drawn = _normals(drawn) if normal else drawn
        count += np.uint64(blocks) * (np.uint64(1) if self._marks is None else self._marks.astype(np.uint64))
        own = (*shape[:before], *shape[before + 1 :])
        rows = drawn.reshape(robots, -1)[:, : total // robots].reshape(robots, *own)
        return np.ascontiguousarray(np.moveaxis(rows, 0, before))

    def _from_ahead(self, blocks: int, normal: bool) -> NDArray[np.float64]:
        """Return the numbers of the next blocks of one robot, made many at a time."""
        at, ahead = int(self.record["count"]), self._ahead
        if not ahead.first <= at <= ahead.first + len(ahead.rows[0]) // 2 - blocks:
            number = np.uint64(at) + np.arange(max(AHEAD, blocks), dtype=np.uint64)
            uniforms = _uniforms(np.broadcast_to(self.record["key"], number.shape), number)
            ahead = self._ahead = _Ahead(at, (uniforms.ravel(), _normals(uniforms).ravel()))
        self.record["count"] = at + blocks
        start = 2 * (at - ahead.first)
        return ahead.rows[normal][start : start + 2 * blocks].copy()

    def _settle(self, marks: NDArray[np.bool_] | None) -> None:
        self._address, self._marks = self.record.ctypes.data, marks
        self._marks_address = None if self._marks is None else self._marks.ctypes.data
        self._ahead = _Ahead(0, (np.empty(0), np.empty(0)))

    def __getstate__(self) -> dict[str, Any]:
        return {"record": self.record, "_marks": self._marks}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.record = kept["record"]
        self._settle(kept["_marks"])


def normal(
    rng: np.random.Generator | Stream, shape: tuple[int, ...], *, before: int = 0
) -> NDArray[np.float64]:
    """Draw standard normal numbers.

    Args:
        rng: A stream or a NumPy generator.
        shape: The shape of the result.
        before: How many of the axes come before those of a batch of robots.

    Raises:
        TypeError: If ``rng`` is neither.
    """
    if isinstance(rng, Stream):
        return rng.standard_normal(shape, before)
    _check(rng)
    return rng.standard_normal(shape)


def uniform(
    rng: np.random.Generator | Stream, low: float, high: float, shape: tuple[int, ...], *, before: int = 0
) -> NDArray[np.float64]:
    """Draw numbers uniformly from [low, high); arguments as for :func:`normal`."""
    if isinstance(rng, Stream):
        drawn = rng.random(shape, before)
    else:
        _check(rng)
        drawn = rng.random(shape)
    return drawn if (low, high) == (0.0, 1.0) else low + (high - low) * drawn


def _check(rng: Any) -> None:
    if not isinstance(rng, np.random.Generator):
        raise TypeError(
            "Sensors draw from a numpy.random.Generator or a Stream, "
            f"got {type(rng).__name__}; pass numpy.random.default_rng(seed)."
        )
