"""Calls of a library for many robots, shared among threads that do not hold the interpreter's lock."""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import pairwise
from typing import Any

from numpy.typing import NDArray

LEAST = 16
"""Robots that a thread is given at least: with fewer of them, waking it takes longer than their step."""

_POOL: list[ThreadPoolExecutor] = []


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def call_for_many(function: Callable[..., Any], rows: tuple[NDArray[Any], ...], threads: int) -> None:
    """Call a function for all rows of arrays, in parts that follow each other, one a thread.

    Args:
        function: Takes the addresses of the first rows and the number of rows; it writes to rows alone that
            are its own.
        rows: Contiguous arrays of the same length.
        threads: How many parts there are at most.
    """
    count = len(rows[0])
    parts = max(1, min(threads, count // LEAST))
    ends = [count * part // parts for part in range(parts + 1)]
    waiting: list[Future[Any]] = []
    for start, stop in pairwise(ends):
        arguments = *(array.ctypes.data + start * array.strides[0] for array in rows), stop - start
        if stop < count:
            waiting.append(_pool().submit(function, *arguments))
        else:
            function(*arguments)
    for part in waiting:
        part.result()


def _pool() -> ThreadPoolExecutor:
    if not _POOL:
        _POOL.append(ThreadPoolExecutor(max(1, cores() - 1), thread_name_prefix="surefoot"))
    return _POOL[0]


if hasattr(os, "register_at_fork"):
    # The threads of a pool stay behind in a process that was forked.
    os.register_at_fork(after_in_child=_POOL.clear)
