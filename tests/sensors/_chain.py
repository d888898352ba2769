"""Load cells put together of single stages: an independent formula for the device."""

from functools import partial
from typing import Any

from surefoot.sensors import Corruption, LoadCells, chain
from surefoot.sensors.stages.affine import drift, offset, scale, scale_drift
from surefoot.sensors.stages.clock import sample_and_hold
from surefoot.sensors.stages.converter import quantize, saturate, white_noise
from surefoot.sensors.stages.mechanics import mechanics
from surefoot.sensors.stages.moving_average import moving_average
from surefoot.sensors.stages.shear import shear
from surefoot.sensors.stages.temperature import thermal_drift
from surefoot.sensors.transport.wire import wire


def load_cell_chain(config: LoadCells) -> Corruption[Any]:
    """Build load cells; without a clock a reading is the load of the instant, or the mean."""
    rated = config.counts_per_newton * config.capacity
    sideways = [shear(config.shear_std)] if config.shear_std else []
    element = [mechanics(config.mechanics, config.capacity)] if config.mechanics.acts else []
    bridge: list[Corruption[Any]] = [
        scale_drift(config.initial_scale_std, config.scale_drift),
        drift(config.initial_offset_std, config.offset_drift),
    ]
    if config.warms:
        warming = partial(thermal_drift, ramp=config.temperature_ramp, rise=config.temperature_rise)
        bridge = [
            warming(config.initial_scale_std, config.scale_drift, config.scale_tempco, relative=True),
            warming(config.initial_offset_std, config.offset_drift, config.offset_tempco),
        ]
    converter: list[Corruption[Any]] = [scale(config.slope), offset(config.zero_code)]
    converter.append(white_noise(config.noise_counts))
    if config.adc_bits:
        converter += [saturate(*config.code_range), quantize(1.0)]
    brought = wire(config.wire, rated, config.code_range, config.adc_bits, config.coding)
    way = [brought] if config.wire.acts else []
    if config.rate is None:
        return chain(*sideways, *element, *bridge, moving_average(config.settling), *converter, *way)
    measured = chain(*element, *bridge)
    held = sample_and_hold(measured, config.rate, settling=config.settling, converter=chain(*converter))
    return chain(*sideways, held, *way)
