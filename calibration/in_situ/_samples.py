"""Which samples of a set take part, and their means over short windows; private."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

__all__ = ["Averages", "averages", "outliers"]

Matrix = NDArray[np.float64]

_GATE = 1e-9
"""Probability at which a sample of nothing but noise would be rejected."""

_FLOOR = 1e-9
"""Deviations below this share of a channel's spread are rounding, not noise."""

_ROUNDS = 12

_ROWS = 2000
"""Means of windows that a set is reduced to, as far as it turns slowly enough."""

_WITHIN = 1e-3
"""Share of the signals' spread that may be lost within windows."""


@dataclass(frozen=True, eq=False)
class Averages:
    """Means over windows of the samples that take part, m of them.

    Attributes:
        signals: Mean signals, shape (m, s).
        raw: Mean readings, shape (m, k).
        weight: Square roots of the numbers of samples, shape (m,).
        index: Mean place of the samples in the set, shape (m,).
        width: Samples of a window.
    """

    signals: Matrix
    raw: Matrix
    weight: NDArray[np.float64]
    index: NDArray[np.float64]
    width: int


def averages(signals: Matrix, raw: Matrix, used: NDArray[np.bool_], width: int | None) -> Averages:
    """Average over windows in which the signals hardly change; the model is linear, so means follow it too.

    Args:
        signals: Shape (n, s).
        raw: Shape (n, k).
        used: Which samples take part, shape (n,).
        width: Samples of a window; as many as the signals allow if not given.
    """
    place = np.flatnonzero(used)
    columns = np.concatenate([signals, raw], axis=1)
    columns = columns if len(place) == len(columns) else columns[place]
    inputs = signals.shape[1]
    if width is None:
        width = _window(columns[:, :inputs])
    mean = _means(columns, width)
    count = np.full(len(mean), width)
    count[-1] = len(place) - width * (len(mean) - 1)
    return Averages(
        signals=mean[:, :inputs],
        raw=mean[:, inputs:],
        weight=np.sqrt(count),
        index=_means(place[:, None].astype(np.float64), width)[:, 0],
        width=width,
    )


def _window(signals: Matrix) -> int:
    """Longest window within which the signals hardly change."""
    width = max(len(signals) // _ROWS, 1)
    total = np.var(signals, axis=0)
    moving = total > 0.0
    while (
        width > 1 and np.max(1.0 - np.var(_means(signals, width), axis=0)[moving] / total[moving]) > _WITHIN
    ):
        width //= 2
    return width


def _means(columns: Matrix, width: int) -> Matrix:
    """Means of windows of rows; the last window takes what is left over."""
    windows = max(len(columns) // width, 1)
    whole = columns[: (windows - 1) * width].reshape(windows - 1, width, columns.shape[1])
    rest = columns[(windows - 1) * width :]
    return np.concatenate([whole.mean(axis=1), rest.mean(axis=0, keepdims=True)])


def outliers(columns: Matrix, raw: Matrix) -> NDArray[np.bool_]:
    """Find samples that disagree with all others, shape (n,).

    Least squares with Cauchy's weights finds what most samples agree on; what is left is held against its own
    median. A clean set needs one look and no weights.

    Args:
        columns: What explains the readings, shape (n, c).
        raw: Shape (n, k).
    """
    floor = _FLOOR * np.std(raw, axis=0) + np.finfo(float).tiny
    weight = np.ones(len(columns))
    limit = float(chi2.isf(_GATE, raw.shape[1]))
    distance = np.zeros(len(columns))
    for i in range(_ROUNDS):
        root = weight[:, None]
        residual = raw - columns @ np.linalg.solve(columns.T @ (root * columns), columns.T @ (root * raw))
        deviation = np.maximum(1.4826 * np.median(np.abs(residual), axis=0), floor)
        distance = np.sum((residual / deviation) ** 2, axis=1)
        if i == 0 and not (distance > limit).any():
            break
        before, weight = weight, 1.0 / (1.0 + distance / raw.shape[1])
        if np.max(np.abs(weight - before)) < 1e-3:
            break
    return np.asarray(distance > limit)
