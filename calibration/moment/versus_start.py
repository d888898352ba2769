"""The learnt map against the starting map, block by block, before the filter has learnt from a block.

While the filter takes the robot to be held by something, a block counts only if the starting map explains it
without a hold: then the learnt map may be all that is wrong.

Both maps predict the change of momentum from the end of one block to the mean over the next. Their residuals,
as a mean force in W and a mean torque in W m, are compared by :mod:`surefoot.calibration.comparison`.
"""

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.comparison import INDEPENDENT, Residuals, evidence_for_start
from surefoot.calibration.moment.columns import Columns, first_mean
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.model import Rows
from surefoot.calibration.moment.state import VersusStartState

MEMORY = 20.0
"""Time in s over which residuals are averaged, some thirty steps. A map that has become better again is
cleared within that time."""

EXPLAINED = 3.0  # standard deviations of its noise within which a row is explained
SLACK = 2.0  # standard deviations of the believed centre of mass and mass that no map is to blame for


class VersusStart:
    """The comparison for one setup.

    Attributes:
        slack: Constant residual in W and W m that an error of the robot's own model may explain, shape (C,).
    """

    def __init__(self, columns: Columns, config: Moment) -> None:
        self._columns, self._start = columns, first_mean(columns)[columns.map]
        self.slack = np.zeros(columns.components)
        self.slack[:3] = SLACK * np.array([config.mass_std, config.com_std, config.com_std])

    def take(
        self, state: VersusStartState, rows: Rows, before: Array, learnt: Array, duration: float, held: bool
    ) -> VersusStartState:
        """Take in a block.

        Args:
            state: Residuals so far.
            rows: The block's rows.
            before: Momentum measured at the end of the block before, about this block's point, shape (C,).
            learnt: The map that was published before the block, shape (M,).
            duration: Of the block in s.
            held: Whether something most likely holds the robot.
        """
        time = min(state.time + duration, MEMORY)
        share = duration / time
        span = rows.mean[:, self._columns.wrench].max(axis=0)
        floor = np.diagonal(2.0 * rows.variance + rows.walk) / span**2
        of_row, of_start_row = (self._residual(rows, before, known) / span for known in (learnt, self._start))
        if held and (np.abs(of_start_row) > self.slack + EXPLAINED * np.sqrt(floor)).any():
            return state
        # Rows count by how exact they are: a step that is read late says little.
        precision = state.precision + share * (1.0 / floor - state.precision)
        counts = share / (floor * precision)
        of_learnt = Residuals(state.learnt_mean, state.learnt_square).include(of_row, counts)
        of_start = Residuals(state.start_mean, state.start_square).include(of_start_row, counts)
        evidence = evidence_for_start(of_learnt, of_start, self.slack, 1.0 / precision, time / INDEPENDENT)
        return VersusStartState(time, *of_learnt, *of_start, precision, evidence)

    def _residual(self, rows: Rows, before: Array, known: Array) -> Array:
        """Return the measured less the predicted mean momentum of a block by a map, shape (C,)."""
        columns = self._columns
        scale, zero = known[columns.scale], known[columns.offset] + known[columns.drift]
        force = np.einsum("ckk,k->c", rows.crossed, scale) + rows.mean[:, columns.offset] @ zero
        residual: Array = rows.measured - before - rows.mean_rest - force
        return residual
