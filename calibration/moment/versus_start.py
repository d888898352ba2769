"""Compare the learnt map with the starting map on each block, before the filter learns from that block.

Both maps predict the change of momentum from the end of one block to the mean over the next. Their residuals
are a mean force in W and a mean torque in W m. :mod:`surefoot.calibration.comparison` compares them.

While the filter assumes external support, a block is used only if the starting map explains it without
support. In that case an error of the learnt map alone may explain the apparent support.
"""

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.comparison import INDEPENDENT, Residuals, evidence_for_start
from surefoot.calibration.moment.columns import Columns, first_mean
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.model import Rows
from surefoot.calibration.moment.state import VersusStartState

MEMORY = 20.0
"""Time in s over which residuals are averaged, about thirty steps. If a map becomes better again, its poor
residuals are forgotten within this time."""

EXPLAINED = 3.0  # residual in standard deviations of its noise up to which a map explains a row
SLACK = 2.0  # standard deviations of the nominal mass and centre of mass not attributed to a map


class VersusStart:
    """Compares the learnt map with the starting map for one setup.

    Attributes:
        slack: Constant residual in W and W m that an error of the nominal model may cause, shape (C,).
    """

    def __init__(self, columns: Columns, config: Moment) -> None:
        self._columns, self._start = columns, first_mean(columns)[columns.map]
        self.slack = np.zeros(columns.components)
        self.slack[:3] = SLACK * np.array([config.mass_std, config.com_std, config.com_std])

    def take(
        self,
        state: VersusStartState,
        rows: Rows,
        before: Array,
        learnt: Array,
        duration: float,
        held: bool,
        com_shift: Array,
    ) -> VersusStartState:
        """Update the comparison with one block.

        Args:
            state: Residuals so far.
            rows: The block's rows.
            before: Momentum measured at the end of the previous block, about the point of this block, shape
                (C,).
            learnt: The map that was published before the block, shape (M,).
            duration: Duration of the block in s.
            held: Whether the robot most likely has external support.
            com_shift: Error in m of the centre of mass that tilted soles have made possible, shape (2,).
        """
        slack = self.slack.copy()
        slack[1:3] = np.sqrt(slack[1:3] ** 2 + SLACK**2 * np.square(com_shift).max())
        time = min(state.time + duration, MEMORY)
        share = duration / time
        span = rows.mean[:, self._columns.wrench].max(axis=0)
        floor = np.diagonal(2.0 * rows.variance + rows.walk) / span**2
        of_row, of_start_row = (self._residual(rows, before, known) / span for known in (learnt, self._start))
        if held and (np.abs(of_start_row) > slack + EXPLAINED * np.sqrt(floor)).any():
            return state
        # Rows are weighted by their precision, because a step that is read late contains little information.
        precision = state.precision + share * (1.0 / floor - state.precision)
        counts = share / (floor * precision)
        of_learnt = Residuals(state.learnt_mean, state.learnt_square).include(of_row, counts)
        of_start = Residuals(state.start_mean, state.start_square).include(of_start_row, counts)
        evidence = evidence_for_start(of_learnt, of_start, slack, 1.0 / precision, time / INDEPENDENT)
        return VersusStartState(time, *of_learnt, *of_start, precision, evidence)

    def _residual(self, rows: Rows, before: Array, known: Array) -> Array:
        """Return the measured minus the predicted mean momentum of a block for one map, shape (C,)."""
        columns = self._columns
        scale, zero = known[columns.scale], known[columns.offset] + known[columns.drift]
        force = np.einsum("ckk,k->c", rows.crossed, scale) + rows.mean[:, columns.offset] @ zero
        residual: Array = rows.measured - before - rows.mean_rest - force
        return residual
