"""Calls for many robots: every row once, in whatever thread, in a forked process as well."""

import ctypes
import multiprocessing
import sys

import numpy as np
import pytest

from surefoot.native import call_for_many, cores
from surefoot.native.threads import LEAST

DOUBLE = ctypes.POINTER(ctypes.c_double)


def add_one(numbers, others, count):
    """Do what a library does: change rows that are its own, by their addresses."""
    for i in range(count):
        ctypes.cast(numbers, DOUBLE)[i] += ctypes.cast(others, DOUBLE)[2 * i]


def ran(count, threads):
    numbers, others = np.arange(count, dtype=float), np.ones((count, 2))
    call_for_many(add_one, (numbers, others), threads)
    return numbers.tolist() == [i + 1.0 for i in range(count)]


@pytest.mark.parametrize("threads", [1, 2, 3, 100])
@pytest.mark.parametrize("count", [0, 1, LEAST, 2 * LEAST, 7 * LEAST + 3])
def test_every_row_is_called_once(count, threads):
    assert ran(count, threads)


def test_an_error_of_any_part_is_raised():
    def refuse(address, count):
        if count < 2 * LEAST:
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        call_for_many(refuse, (np.zeros(2 * LEAST),), 2)


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux")
def test_a_forked_process_has_threads_of_its_own():
    assert ran(4 * LEAST, 4)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply_async(ran, (4 * LEAST, 4)).get(timeout=60)


def test_there_are_cores():
    assert cores() >= 1
