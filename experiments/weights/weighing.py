"""Known weights on simulated load cells, one cell after the other (CoP paper, section 3.1)."""

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.layout import nao_shoe_layout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.weights.channels import fit_channels
from surefoot.sensors import LoadCells
from surefoot.sensors.devices.load_cells import LoadCellState, static_counts

STREAM = 7001  # keeps this randomness apart from every other stream with the same seed
CHANNEL_LOADS = np.array([0.0, 0.001, 0.01, 0.05, 0.2, 0.5, 1.0, 2.0, 4.0, 6.0])  # kg on each cell
READINGS = 80  # conversions averaged for each weighing: one second at 80 per second
NONLINEARITY = 5e-4  # largest bow of a cell's curve, drawn with either sign, as a share of its capacity


class WeighedCells:
    """The cells of a NAO on which weights stand; their curves are bowed."""

    def __init__(self, config: LoadCells, state: LoadCellState, rng: np.random.Generator) -> None:
        self._config, self._state, self._rng = config, state, rng
        self._bow = NONLINEARITY * config.capacity * rng.uniform(-1.0, 1.0, config.channels)

    def read(self, load: Floats) -> Floats:
        """Return mean counts under true loads in N, shape (n, K), weighed one after another."""
        share = load / self._config.capacity
        bowed = (load + self._bow * 4.0 * share * (1.0 - share))[:, None].repeat(READINGS, axis=1)
        return np.array(
            [static_counts(self._config, self._state, one, self._rng).mean(axis=0) for one in bowed]
        )

    def fit(self) -> Parameters:
        """Weigh the cells one by one; return the lines through their mean counts, in N."""
        weight = CHANNEL_LOADS * GRAVITY
        code = self.read(np.repeat(weight[:, None], self._config.channels, axis=1))
        return fit_channels(code, weight, nao_shoe_layout().channel_names).value


def weigh_cells(cells: LoadCells, state: LoadCellState, seed: int) -> Parameters:
    """Return the map of a NAO's cells that known weights on each of them give."""
    return WeighedCells(cells, state, np.random.default_rng([STREAM, seed])).fit()
