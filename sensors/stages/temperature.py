r"""The effect of temperature on a strain-gauge bridge: its offset and its scale change.

A device warms up after it was switched on, along a ramp :math:`T = r t` or, as one with a heat loss does,
levelling off, :math:`T = T_\infty (1 - e^{-r t / T_\infty})`. Its errors, besides drifting at random, follow
:math:`\alpha T` with a coefficient :math:`\alpha` for each channel. All changes are added up in one state,
the error at this moment.
"""

from math import exp
from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors.configuration import check_not_negative
from surefoot.sensors.corruption import Corruption, Rng
from surefoot.sensors.randomness import normal


class ThermalState(NamedTuple):
    """A channel that drifts and warms up."""

    error: Floats  # its error now, shape (K,)
    tempco: Floats  # its change by a kelvin, shape (K,); constant from power-up
    temperature: Floats  # rise since power-up in K, shape (K,)


def temperature_rise(temperature: Floats, ramp: float, rise: float, dt: float) -> Floats:
    """Return the rise of a device's temperature since power-up in K, ``dt`` s after it was ``temperature``.

    It rises by ``ramp`` in K/s at power-up and levels off at ``rise`` in K, or at 0 never.
    """
    if rise == 0.0:
        return temperature + ramp * dt
    return rise + (temperature - rise) * exp(-ramp * dt / rise)


def thermal_drift(
    initial_std: float,
    density: float,
    tempco_std: float,
    *,
    ramp: float,
    rise: float = 0.0,
    relative: bool = False,
) -> Corruption[ThermalState]:
    """Add an offset, or multiply by a scale, that starts anywhere, drifts, and follows the temperature.

    Args:
        initial_std: Standard deviation of the error at power-up, in the unit of the readings (relative: 1).
        density: Random walk of it per sqrt(s).
        tempco_std: Standard deviation of its temperature coefficient, in that unit per K.
        ramp: Rate at which the device warms up at first, in K/s.
        rise: Where the rise levels off in K; 0 for a ramp that goes on.
        relative: Whether the error is one of the scale rather than an offset.
    """
    check_not_negative(initial_std=initial_std, density=density, tempco_std=tempco_std, ramp=ramp, rise=rise)

    def init(shape: tuple[int, ...], rng: Rng) -> ThermalState:
        error = initial_std * normal(rng, shape)
        return ThermalState(error, tempco_std * normal(rng, shape), np.zeros(shape))

    def apply(reading: Floats, state: ThermalState, rng: Rng, dt: float) -> tuple[Floats, ThermalState]:
        error, tempco, before = state
        if density:
            error = error + density * dt**0.5 * normal(rng, error.shape)
        temperature = temperature_rise(before, ramp, rise, dt)
        error = error + tempco * (temperature - before)
        read = reading * (1.0 + error) if relative else reading + error
        return read, ThermalState(error, tempco, temperature)

    return Corruption(init, apply)
