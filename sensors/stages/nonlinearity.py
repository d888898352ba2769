r"""Nonlinearity: a reading that is right without a load and at the full scale, and off in between.

With the load in shares of the full scale, :math:`u = x / x_{FS}`, the reading is a polynomial through zero
and the full scale, the two ends that a terminal-based straight line joins (ISA-51.1),

.. math:: y = x + x_{FS} \Big( 4 a\, u (1 - u) + \tfrac{3 \sqrt 3}{2} b\, u (1 - u^2) \Big).

The factors make :math:`a` and :math:`b` the numbers of a data sheet: the largest departure of each term from
the line, as a share of the full scale, at :math:`u = 1/2` and :math:`u = 1/\sqrt 3`. The quadratic term is
that of a bridge of unequal arms and tells pressing from pulling: at :math:`u = -1` it is off by :math:`-8 a`.
The cubic one is odd and so right at both full scales. Data sheets give :math:`2 \cdot 10^{-4}` for a bar cell
of class C3, :math:`5 \cdot 10^{-4}` for a cheap one, :math:`2 \cdot 10^{-3}` for a ring.

The element of a six-axis sensor bends in all directions at once. There the cubic term of each axis has
company of products, :math:`x_{FS} \sum_{j < k} c_{jk} u_j u_k`, that vanish while one axis alone is loaded.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.sensors.configuration import check_not_negative
from surefoot.sensors.corruption import Corruption, Rng, limit, stateless
from surefoot.sensors.randomness import uniform

CUBIC_PEAK = 1.5 * 3.0**0.5  # one over the largest value of u (1 - u^2) between 0 and 1


def nonlinearity(quadratic: ArrayLike, cubic: ArrayLike, full_scale: ArrayLike) -> Corruption[tuple[()]]:
    """Add a quadratic and a cubic error that vanish without a load and at the full scale.

    Loads beyond the full scale keep the error that they have there.

    Args:
        quadratic: Departure at half of the full scale in shares of the full scale, reported more than true;
            a number or shape (K,), either sign.
        cubic: The same for the cubic term, at 0.577 of the full scale.
        full_scale: Full scale in the unit of the readings, a number or shape (K,).

    Raises:
        ValueError: If a share is not finite, a full scale is not positive, or the terms are so large that
            readings would fall while the load grows.

    >>> import numpy as np
    >>> cell, rng = nonlinearity(0.002, 0.0, 100.0), np.random.default_rng(0)
    >>> cell.apply(np.array([0.0, 50.0, 100.0]), (), rng, 0.0125)[0]
    array([  0. ,  50.2, 100. ])
    """
    a, b, scale = (np.asarray(values, dtype=np.float64) for values in (quadratic, cubic, full_scale))
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError(f"'quadratic' and 'cubic' must be finite, got {quadratic!r} and {cubic!r}.")
    if not np.all((scale > 0.0) & np.isfinite(scale)):
        raise ValueError(f"'full_scale' must be finite and positive, got {full_scale!r}.")
    a, b = np.broadcast_arrays(4.0 * a, CUBIC_PEAK * b)
    # The slope is a parabola in u: it is least at an end or at its vertex.
    vertex = np.clip(-a / np.where(b == 0.0, 1.0, 3.0 * b), -1.0, 1.0)
    if not all(np.all(1.0 + a * (1.0 - 2.0 * u) + b * (1.0 - 3.0 * u**2) > 0.0) for u in (-1.0, 1.0, vertex)):
        raise ValueError(
            "'quadratic' and 'cubic' must leave readings that grow with the load from minus to plus the full "
            f"scale, got {quadratic!r} and {cubic!r}; one alone may be below 0.083 or 0.19."
        )
    first, second = a * scale, b * scale

    def bend(reading: Floats, rng: Rng, dt: float) -> Floats:
        u = limit(reading / scale, -1.0, 1.0)
        return reading + u * (1.0 - u) * (first + second * (1.0 + u))

    return stateless(bend)


class NonlinearityState(NamedTuple):
    """Nonlinearity of the channels."""

    quadratic: Floats
    """Departure at half of the full scale in shares of it, shape (K,); constant from power-up."""


def random_nonlinearity(most: float, full_scale: ArrayLike) -> Corruption[NonlinearityState]:
    """Add a quadratic error that each channel draws for itself at power-up.

    Terms are drawn uniformly from ``-most`` to ``most``, the largest departure by a data sheet, in shares of
    the full scale, a number or shape (K,); errors are those of :func:`nonlinearity` for the worst.
    """
    check_not_negative(most=most)
    nonlinearity(most, 0.0, full_scale)
    scale = np.asarray(full_scale, dtype=np.float64)

    def init(shape: tuple[int, ...], rng: Rng) -> NonlinearityState:
        return NonlinearityState(uniform(rng, -most, most, shape))

    def apply(
        reading: Floats, state: NonlinearityState, rng: Rng, dt: float
    ) -> tuple[Floats, NonlinearityState]:
        return bent(reading, state, scale), state

    return Corruption(init, apply)


def bent(reading: Floats, state: NonlinearityState, full_scale: Floats | float) -> Floats:
    """Apply :func:`random_nonlinearity` to readings, shape (K,) or (N, K)."""
    u = limit(reading / full_scale, -1.0, 1.0)
    off: Floats = (4.0 * state.quadratic * full_scale) * (u - u * u)
    return reading + off


class CoupledState(NamedTuple):
    """Nonlinearity of axes that feel each other; constant from power-up."""

    cubic: Floats  # departure of each axis at 0.577 of its full scale in shares of it, shape (K,)
    cross: Floats
    """Departure of each axis where two others are at their full scales, in shares of its own, shape (K, K,
    K); zero but for j < k."""


def cross_slope(cubic: float, cross: float, axes: int) -> float:
    """Return the most by which a row of the slopes of :func:`cross_nonlinearity` misses the identity.

    Below one no two loads have one reading.
    """
    return 2.0 * CUBIC_PEAK * cubic + axes * (axes - 1) * cross


def cross_nonlinearity(cubic: float, cross: float, full_scale: ArrayLike) -> Corruption[CoupledState]:
    """Add cubic errors and products of two axes, which each axis draws for itself at power-up.

    Largest departures of the cubic terms, drawn uniformly to either side, and of what two axes at their full
    scales, shape (K,), add to each, in shares of the full scale. Loads beyond the full scale keep the error
    that they have there. ValueError says that two loads could have one reading.
    """
    check_not_negative(cubic=cubic, cross=cross)
    scale = np.asarray(full_scale, dtype=np.float64)
    axes = len(scale)
    if cross_slope(cubic, cross, axes) >= 1.0:
        raise ValueError(
            f"'cubic' and 'cross' must keep {2.0 * CUBIC_PEAK:.3g} cubic + {axes * (axes - 1)} cross below "
            f"1, or two loads could have one reading, got {cubic!r} and {cross!r}."
        )
    pairs = np.triu(np.ones((axes, axes)), 1)

    def init(shape: tuple[int, ...], rng: Rng) -> CoupledState:
        terms = uniform(rng, -cubic, cubic, shape)
        products = uniform(rng, -cross, cross, (*shape, axes, axes))
        return CoupledState(terms, products * pairs)

    def apply(reading: Floats, state: CoupledState, rng: Rng, dt: float) -> tuple[Floats, CoupledState]:
        u = limit(reading / scale, -1.0, 1.0)
        off = CUBIC_PEAK * state.cubic * (u - u * u * u) + state.cross @ u @ u
        return reading + scale * off, state

    return Corruption(init, apply)
