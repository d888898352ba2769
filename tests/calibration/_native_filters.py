"""Logs, robots and comparisons for tests of filters in C."""

from functools import cache

import numpy as np
from _ankles import on_ankles
from _robots import BAD
from _synthetic import DT, NOMINAL, walk

from surefoot.calibration import Reference

SAMPLES, AT = 2000, 800
CLOSE = 1e-9

walk_once = cache(walk)


class Log:
    """Two thousand samples of one robot, to be spoilt: readings, beliefs, times, and when it is retracted."""

    at = AT

    def __init__(self, layout, seed=1, noise=0.05):
        rng = self.rng = np.random.default_rng([61, seed])
        own = walk_once(seed, 0.1, SAMPLES * DT - 3.0, 3.0, BAD)
        cells, ankles = NOMINAL.force(own.raw), None
        if "cells" not in layout:
            ankles = on_ankles(seed, 0.1, SAMPLES * DT - 1.0).force[:SAMPLES]
            ankles = ankles * (1.0 + 0.05 * rng.normal(size=12)) + 0.5 * rng.normal(size=12)
            ankles = ankles + noise * rng.normal(size=ankles.shape)
        if "both" in layout:
            self.force = np.concatenate([cells[:, :4], ankles[:, :6], cells[:, 4:], ankles[:, 6:]], axis=1)
        else:
            self.force = cells if ankles is None else ankles
        self.reference = Reference(*(part.copy() for part in own.reference))
        self.times = np.full(SAMPLES, DT)
        self.retracted = set()

    def row(self, k):
        return Reference(*(part[k] for part in self.reference))


def same(name, expected, found, close=CLOSE, spread=1.0):
    """Assert that two arrays are the same: discrete ones exactly, covariances by their own deviations.

    ``spread`` is by how much farther apart covariances may be than all else.
    """
    expected, found = np.asarray(expected), np.asarray(found)
    assert (expected.shape, expected.dtype) == (found.shape, found.dtype), name
    if expected.dtype.kind != "f":
        np.testing.assert_array_equal(found, expected, err_msg=name)
        return
    size = np.abs(expected).max(initial=0.0, where=np.isfinite(expected)) + np.zeros(expected.shape)
    if name in ("nis", "vgrf"):
        size = np.maximum(size, 1.0)  # a sum of squares, each of order one; a difference of forces of newtons
    if "covariance" in name:
        std = np.sqrt(np.abs(np.diagonal(expected, axis1=-2, axis2=-1)))
        size = spread * std[..., :, None] * std[..., None, :]
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected), err_msg=name)
    there = ~np.isnan(expected)
    off = np.abs(found - expected)[there] - close * size[there]
    assert (off <= 0.0).all(), f"{name}: {np.max(off)} too far"


def same_estimate(expected, found, **tolerance):
    for name, a, b in zip(expected._fields, expected, found, strict=True):
        if a is None:
            assert b is None, name
        else:
            same(name, a, b, **tolerance)
