"""Cells for robots of other weights."""

from dataclasses import replace

import numpy as np
import pytest

from surefoot.sensors import load_cells, preset, sized
from surefoot.sensors.presets import HX711_LOAD_CELLS, NAO_FSR, REFERENCE_WEIGHT


def test_cells_of_the_reference_robot_stay_as_they_are():
    for name in ("hx711-load-cells", "hx711-bar-cells", "nao-fsr"):
        assert sized(preset(name), REFERENCE_WEIGHT) == preset(name)


@pytest.mark.parametrize("config", [HX711_LOAD_CELLS, NAO_FSR, preset("hx711-bar-cells")])
def test_larger_cells_read_larger_loads_alike(config):
    """In shares of the weight everything but the drawn spikes is the same, sample by sample."""
    config, factor = replace(config, wire=replace(config.wire, spike_rate=0.0, wrong_words=0.0)), 8.0
    shares = []
    for weight in (REFERENCE_WEIGHT, factor * REFERENCE_WEIGHT):
        larger = sized(config, weight)
        rng, cells = np.random.default_rng(4), load_cells(larger)
        state, rows = cells.init((8,), rng), []
        for k in range(60):
            load = weight / 8.0 * (1.0 + np.sin(0.4 * k))
            counts, state = cells.apply(np.full((4, 8), load), state, rng, 0.02)
            rows.append((larger.nominal_scale * counts + larger.nominal_offset) / weight)
        shares.append(np.stack(rows))
    np.testing.assert_allclose(shares[1], shares[0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("weight", [0.0, -1.0, float("nan"), float("inf")])
def test_a_weight_that_is_none_is_refused(weight):
    with pytest.raises(ValueError, match=f"'weight' must be finite and positive, in N, got {weight}"):
        sized(HX711_LOAD_CELLS, weight)
