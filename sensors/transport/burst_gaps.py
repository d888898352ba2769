r"""Gaps: packets get lost, and seldom one alone.

A link is good or bad (Gilbert, 1960; Elliott, 1963), and a bad one loses everything. Left alone it turns
bad at the rate :math:`\mu` and good again at the rate :math:`\lambda`, in continuous time, so that with the
mean length of a gap :math:`1 / \lambda` the share of the time that is lost and the correlation over a time
:math:`t` are

.. math:: p = \frac{\mu}{\lambda + \mu}, \qquad \rho(t) = e^{-(\lambda + \mu) t}, \qquad
          \lambda + \mu = \frac{\lambda}{1 - p},

however finely time is stepped. In a fault of the kind ``"dropped"`` (:mod:`surefoot.sensors.faults.channels`)
one
channel of an instrument fails on a schedule; here the link to all of them does at random, for ever, from a
state drawn at power-up. A log of an iCub's has a gap of 0.17 s, one of a balance board's radio a gap of
22.6 s.
"""

from math import expm1
from typing import Any, NamedTuple

from surefoot.sensors._arrays import cast_like, namespace
from surefoot.sensors.corruption import Array, Corruption, Rng
from surefoot.sensors.randomness import uniform


class GapState(NamedTuple):
    """Whether links are up.

    Attributes:
        lost: 1 within a gap and 0 elsewhere, shape (..., 1); (..., K) for channels with a link each.
    """

    lost: Array


def burst_gaps(share: float, mean_length: float, *, each: bool = False) -> Corruption[GapState]:
    """Lose readings in bursts: they are NaN.

    Args:
        share: Share of the time that is lost in the long run; 0 loses nothing.
        mean_length: Mean length of a gap in s. Where it is not long against the time between
            readings, gaps that fall between two of them are not seen, and those that are seem longer.
        each: Whether each channel has a link of its own; otherwise the channels of a robot, which travel in
            one packet, are lost together.

    Raises:
        ValueError: If the share does not lie in [0, 1) or the length is not positive.
    """
    if not 0.0 <= share < 1.0:
        raise ValueError(f"'share' must lie in [0, 1), got {share}.")
    if not 0.0 < mean_length < float("inf"):
        raise ValueError(f"'mean_length' must be finite and positive, got {mean_length}.")

    def init(shape: tuple[int, ...], rng: Rng, dtype: Any = None) -> GapState:
        drawn = uniform(rng, 0.0, 1.0, shape if each else (*shape[:-1], 1), dtype)
        return GapState(cast_like(drawn < share, drawn))

    def apply(reading: Array, state: GapState, rng: Rng, dt: float) -> tuple[Array, GapState]:
        before = cast_like(state.lost, reading)
        drawn = uniform(rng, 0.0, 1.0, tuple(before.shape), reading.dtype)
        forgotten = -expm1(-dt / (mean_length * (1.0 - share)))
        lost = drawn < before * (1.0 - forgotten) + forgotten * share
        gone = namespace(reading).where(lost, 0.0 * drawn + float("nan"), 0.0 * drawn)
        return reading + gone, GapState(cast_like(lost, reading))

    return Corruption(init, apply)
