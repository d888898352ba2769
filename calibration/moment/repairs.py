"""Repair of readings that the robot's motion speaks against.

A channel that is dead is taken out, flipped and exchanged ones are put right, and a leap that zeros make
together is taken off the readings. The last seconds' learning came from wrong readings: the
filter goes back before it.
"""

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.moment.blocks import Block
from surefoot.calibration.moment.columns import Columns
from surefoot.calibration.moment.faults import ChannelFaults
from surefoot.calibration.moment.model import Rows
from surefoot.calibration.moment.modes import HELD, MODES
from surefoot.calibration.moment.state import Belief, MomentState
from surefoot.calibration.moment.suspects import Leap, Suspects
from surefoot.calibration.moment.versus_start import VersusStart


class Repairs:
    """Finds and repairs wrong readings of one setup.

    Args:
        layout: The feet.
        weight: W in N.
        faults: Faults of channels.
        columns: The unknowns.

    Attributes:
        suspects: Who may be guilty.
        versus_start: Compares the learnt map with the starting map.
    """

    def __init__(
        self,
        layout: FeetLayout,
        weight: float,
        faults: ChannelFaults,
        columns: Columns,
        versus_start: VersusStart,
    ) -> None:
        self._weight, self._faults, self._columns = weight, faults, columns
        self.versus_start = versus_start
        self.suspects = Suspects(layout, faults.stand_in.cells, columns)

    def weigh(
        self, state: MomentState, block: Block, rows: Rows, published: Array, belief: Belief, moved: Array,
        added: Array,
    ) -> tuple[MomentState, int | Leap | None]:  # fmt: skip
        """Hold all suspects against a block.

        Args:
            state: The filter's state.
            block: The samples.
            rows: Theirs.
            published: The published map, shape (M,).
            belief: The modes' posteriors before the block, about its point o.
            moved: Transition of the unknowns to that point, shape (N, N).
            added: Constant that it adds, shape (N,).

        Returns:
            The state, and what is wrong: a suspect of
            :class:`~surefoot.calibration.moment.suspects.Suspects`, or zeros that have leapt.
        """
        columns, stand_in, suspects = self._columns, self._faults.stand_in, state.suspects
        momentum, likeliest = columns.momentum, belief.chance.argmax()
        robot = slice(columns.map.stop, momentum.start)
        known = np.concatenate([published, belief.mean[likeliest, robot]])
        covariance = np.zeros((momentum.start, momentum.start))
        covariance[columns.map, columns.map] = state.published.covariance
        covariance[robot, robot] = belief.covariance[likeliest, robot, robot]
        moved, added = moved[momentum, momentum], added[momentum]
        suspects = self.suspects.read(suspects, block.force)
        suspects = suspects._replace(before=moved @ suspects.before + added, error=moved @ suspects.error)
        held = MODES[likeliest] is HELD
        compared = self.versus_start.take(
            state.versus_start, rows, suspects.before, state.published.mean, block.duration, held,
            belief.com_shift,
        )  # fmt: skip
        state = state._replace(versus_start=compared)
        as_stated = known.copy()
        as_stated[columns.scale], as_stated[columns.drift] = 1.0, 0.0
        as_stated[columns.offset] = -state.tare.reading
        faults = self._faults.miss(
            state.faults, *self.suspects.miss(suspects, rows, as_stated, self._faults.by_others)
        )
        lost = state.faults.lost
        others, std = stand_in.others(state.faults.moments, lost)
        broken = stand_in.count_lost(lost) > 0.5
        suspects, wrong = self.suspects.weigh(
            suspects, rows, known, covariance, others, std / self._weight, lost, broken, block.duration
        )
        return state._replace(faults=faults, suspects=suspects._replace(before=rows.at_end)), wrong

    def repair(self, state: MomentState, wrong: int | Leap) -> MomentState:
        """Repair a fault, and let suspicions start again.

        Args:
            state: The filter's state before the fault.
            wrong: As :meth:`weigh` returns it.
        """
        cleared = state.suspects._replace(score=np.zeros(self.suspects.count))
        state = state._replace(suspects=cleared, faults=self._faults.restart(state.faults))
        if isinstance(wrong, Leap):
            return self._shift(state, wrong)
        if wrong < self.suspects.out.stop:
            return state._replace(faults=self._faults.lose(state.faults, wrong))
        turned, kind = self.suspects.rewire(wrong)
        return state._replace(
            faults=self._faults.rewire(state.faults, turned, kind), shift=turned @ state.shift
        )

    def _shift(self, state: MomentState, leap: Leap) -> MomentState:
        """Take a leap off the readings, as far as it was seen."""
        columns = self._columns
        by, open_to = leap.reading * self._weight, (state.published.mean[columns.scale] * leap.std) ** 2
        history, covariance = state.front.history.copy(), state.belief.covariance.copy()
        history[:, : len(by)] -= by
        at = np.arange(columns.drift.start, columns.drift.stop)
        covariance[:, at, at] += open_to
        return state._replace(
            front=state.front._replace(history=history),
            shift=state.shift + by,
            belief=state.belief._replace(covariance=covariance),
        )
