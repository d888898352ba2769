"""Call a library for many robots in several threads, without the interpreter's lock."""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import pairwise
from typing import Any

from numpy.typing import NDArray

LEAST = 16
"""Minimum number of robots per thread. With fewer, waking a thread takes longer than their step."""

_POOL: list[ThreadPoolExecutor] = []


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def call_for_many(function: Callable[..., Any], rows: tuple[NDArray[Any], ...], threads: int) -> None:
    """Call a function for all rows of arrays, in contiguous parts, with one thread per part.

    Args:
        function: Takes the addresses of the first rows and the number of rows. It must write to these rows
            only.
        rows: Contiguous arrays of the same length.
        threads: Maximum number of parts.
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
    # A forked process does not inherit the threads of the pool.
    os.register_at_fork(after_in_child=_POOL.clear)
