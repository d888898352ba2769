r"""Six-axis sensors down to their gauges: wrenches in, raw counts out.

Each of :math:`k \ge 6` gauges feels all six components of a wrench (in-situ paper: Traversaro, Pucci and
Nori, 2015, Eq. 2, turned round),

.. math:: r = \mathrm{round}(A w + o + n), \qquad w = C (r - o), \quad C A = I.

The maker measured :math:`A_0` once and supplies :math:`C_0 = A_0^+`. Since then every axis has changed a
little, many times, and each change acted on the result of the ones before:

.. math:: A = A_0 (I + D X D^{-1} / N)^N, \qquad N = 64,

with the full scales :math:`D` of the axes and a normal :math:`X`, errors of the scales on its diagonal and
cross-talk beside it. To first order this is :math:`A_0 (I + D X D^{-1})`, but no scale changes its sign and
no sensor loses an axis, however large the errors. Offsets, their drift and the noise are those of the gauges,
and are given as forces by :math:`C_0`. More than six gauges have offsets and noise of the same size
that no wrench could cause: that is the redundancy of such gauges.

The element bends out of proportion, creeps and lags (see :mod:`surefoot.sensors.stages.nonlinearity`,
:mod:`surefoot.sensors.stages.creep` and :mod:`surefoot.sensors.stages.hysteresis`), heat changes offsets and
scales (:mod:`surefoot.sensors.stages.temperature`), and the converter rounds and clips.
"""

from typing import Any, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors.configuration import check_not_negative
from surefoot.sensors.corruption import Corruption, Rng, check_channels, device, limit
from surefoot.sensors.devices.force_torque import AXES, per_axis
from surefoot.sensors.devices.strain_gauge_config import StrainGauges
from surefoot.sensors.randomness import normal, uniform
from surefoot.sensors.stages.creep import CreepState, creep
from surefoot.sensors.stages.hysteresis import HysteresisState, hysteresis
from surefoot.sensors.stages.nonlinearity import cross_nonlinearity
from surefoot.sensors.stages.temperature import temperature_rise

STEPS = 64  # the matrix has changed in so many small steps

SCALE, OFFSET = 0, 1
"""Rows of :attr:`StrainGaugeState.tempco`."""

SMALLEST_LOOP = 1e-3
"""Share of the full scales down to which loops of hysteresis are resolved: 1.5 N and 0.035 N m."""


class StrainGaugeState(NamedTuple):
    """A sensor in use."""

    response: Floats  # A without the heat in counts per N and N m, shape (k, 6); constant from power-up
    tempco: Floats
    """The change of a gauge by a kelvin, shape (2, k): to its scale, relative, in 1/K (row :data:`SCALE`),
    and to its offset in counts/K (row :data:`OFFSET`); constant from power-up."""
    offset: Floats  # o in counts, with drift and heat, shape (k,)
    temperature: Floats  # rise since power-up in K, shape ()
    creep: CreepState  # the creep of the loads so far
    hysteresis: HysteresisState  # the slacks under the loads so far
    bend: Any = ()  # a ``CoupledState``; ``()`` where the element is linear


@device
def strain_gauges(config: StrainGauges) -> Corruption[StrainGaugeState]:
    """Build a six-axis sensor of strain gauges.

    ``init(shape, rng)`` takes the shape of the readings, (k,). ``apply(wrench, state, rng, dt)`` takes
    true wrenches at the instant of reading in N and N m, at and in the sensor's frame, shape (6,), and
    returns counts, shape (k,).

    >>> from surefoot.sensors import preset
    >>> sensor, rng = strain_gauges(preset("icub-ftsens-leg", StrainGauges)), np.random.default_rng(0)
    >>> counts, state = sensor.apply(np.zeros(6), sensor.init((6,), rng), rng, 0.01)
    >>> float(abs(counts - np.round(counts)).max()), bool(abs(counts).max() > 100.0)
    (0.0, True)
    """
    k, (low, high) = config.channels, config.code_range
    eye, full_scale, response = np.eye(AXES), config.full_scale, config.nominal_response
    talk = config.scale_error_std * eye + config.cross_talk_std * (1.0 - eye)
    change = talk * full_scale[:, None] / full_scale / STEPS
    offset_map = gauge_map(config, config.offset_force, config.offset_torque).T
    tempco_map = gauge_map(config, config.offset_tempco_force, config.offset_tempco_torque).T
    # One matrix for each draw of a step: noise and, where offsets drift, their drift.
    noisy, walks = config.noisy, config.walks
    noise_map = gauge_map(config, config.noise_force, config.noise_torque).T
    walk_map = gauge_map(config, config.offset_drift_force, config.offset_drift_torque).T
    bends, creeping = config.bends, creep(config.creep_shares, config.creep_time_constants)
    bending = cross_nonlinearity(config.nonlinearity, config.cross_nonlinearity, full_scale)
    true_at = config.hysteresis_true
    lagging = hysteresis(config.hysteresis, full_scale, smallest=SMALLEST_LOOP, true_at=true_at)

    def init(shape: tuple[int, ...], rng: Rng) -> StrainGaugeState:
        check_channels(shape, k)
        grown = np.linalg.matrix_power(eye + change * normal(rng, (AXES, AXES)), STEPS)
        offset = uniform(rng, -1.0, 1.0, shape) @ offset_map
        heat = normal(rng, (2, k))
        tempco = np.stack([config.scale_tempco * heat[0], heat[1] @ tempco_map])
        crept, lagged = creeping.init((AXES,), rng), lagging.init((AXES,), rng)
        bend = bending.init((AXES,), rng) if bends else ()
        return StrainGaugeState(response @ grown, tempco, offset, np.zeros(()), crept, lagged, bend)

    def apply(
        wrench: Floats, state: StrainGaugeState, rng: Rng, dt: float
    ) -> tuple[Floats, StrainGaugeState]:
        if wrench.shape != (AXES,):
            raise ValueError(f"A wrench must have the shape ({AXES},), got {wrench.shape}.")
        matrix, tempco, offset, before, crept, lagged, bend = state
        load, bend = bending.apply(wrench, bend, rng, dt) if bends else (wrench, ())
        load, crept = creeping.apply(load, crept, rng, dt)
        load, lagged = lagging.apply(load, lagged, rng, dt)
        counts = matrix @ load
        if walks:
            drawn = normal(rng, offset.shape)
            offset = offset + dt**0.5 * (drawn @ walk_map)
        counts, offset, temperature = _warm(config, counts, offset, tempco, before, dt)
        counts = counts + offset
        if noisy:
            counts = counts + normal(rng, counts.shape) @ noise_map
        if config.adc_bits:
            counts = np.rint(limit(counts, low, high))
        return counts, StrainGaugeState(matrix, tempco, offset, temperature, crept, lagged, bend)

    return Corruption(init, apply)


def _warm(
    config: StrainGauges, counts: Floats, offset: Floats, tempco: Floats, before: Floats, dt: float
) -> tuple[Floats, Floats, Floats]:
    """Warm a sensor up for dt; return counts by scales of now, offsets and the rise of temperature."""
    if not config.temperature_ramp:
        return counts, offset, before
    temperature = temperature_rise(before, config.temperature_ramp, config.temperature_rise, dt)
    offset = offset + tempco[OFFSET] * (temperature - before)
    return counts * (1.0 + tempco[SCALE] * temperature), offset, temperature


def true_response(config: StrainGauges, state: StrainGaugeState) -> tuple[Floats, Floats]:
    """Return the map from wrenches to counts at this moment, of a linear element, noise and converter apart.

    The reading of w is A w + o, and the map that undoes it w = A^+ (r - o), with A in counts per N and N m,
    shape (k, 6), and o in counts, shape (k,). Creep and hysteresis are left out as well; with hysteresis it
    holds at the ends of cycles of the amplitudes ``config.hysteresis_true_force`` and
    ``config.hysteresis_true_torque``.
    """
    heated = 1.0 + state.tempco[SCALE] * state.temperature
    return state.response * heated[:, None], state.offset + 0.0


def shift_offset(
    config: StrainGauges, state: StrainGaugeState, rng: Rng, force_std: float, torque_std: float
) -> StrainGaugeState:
    """Return the sensor after its offsets have jumped, as they do from one recording to the next.

    The standard deviations of the jump are in N and N m on each axis, as the maker's matrix shows it.
    """
    check_not_negative(force_std=force_std, torque_std=torque_std)
    drawn = normal(rng, state.offset.shape)
    jump = drawn @ gauge_map(config, force_std, torque_std).T
    return state._replace(offset=state.offset + jump)


def gauge_map(config: StrainGauges, force: float, torque: float) -> Floats:
    """Return the map from k unit errors to counts that C_0 shows as that force and torque, shape (k, k)."""
    response = config.nominal_response
    image: Floats = response * per_axis(force, torque)
    if config.channels == AXES:
        return image
    # Beyond what a wrench can cause: as much as there is on average within it.
    beyond = np.linalg.svd(response, full_matrices=True)[0][:, AXES:]
    whole: Floats = np.concatenate([image, np.sqrt(np.square(image).sum() / AXES) * beyond], axis=1)
    return whole
