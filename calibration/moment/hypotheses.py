r"""What can explain that the robot's motion contradicts its feet, and what of it is believed.

Newton and Euler about the whole robot leave residuals e. Four steps lead from them to a repair:

1. **Hypotheses.** Each changes the forces, and so the residuals: a channel's force is what the others of its
   foot make of it (it is *out*), the channel is the other way round (*flipped*), or two are exchanged
   (*straight*, or *crossed* between bridges that are wired the other way round). The robot may also have been
   given a *load*: another mass and another centre of mass from then on, which no channel is to blame for.
2. **Evidence.** The mean squared residual that each leaves, over all whole blocks since all began to seem
   wrong.
3. **Decision.** A channel is accepted that explains what is otherwise unexplained, and much better than any
   hypothesis about other channels and than a load; a load that does so against every channel. While a robot
   stands quite still, a load and a broken cell look alike, and neither is accepted.
4. **Repair.** Flipped and exchanged channels are put right, as if the cable were plugged in again.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array, in_a_row
from surefoot.calibration.estimate import Flag
from surefoot.calibration.moment.rows import Residuals
from surefoot.calibration.setup import OnlineSetup

SUSPICION = 4.0
"""Mean squared normalised residual of a block above which something is thought to be wrong."""

TRUST = 10.0
"""Blocks without doubt that must have passed before the robot's motion counts against a channel."""

_CALM = 0.4 * SUSPICION
"""Mean of all blocks since something seemed wrong below which nothing seems wrong any more."""

_PATIENCE = 10
"""Blocks after which a suspicion that nothing explains is dropped."""

_RELIEF = 0.4
"""Share of the mean that may be left by a hypothesis that is accepted."""

_CONTRAST = 0.6
"""The same against the best hypothesis about other channels, and against a load."""

_LOAD_CONTRAST = 0.4
"""The same of a load against the best hypothesis about any channel."""

_NOISE = 1.0
"""Mean square that noise leaves, added before a load is compared: two that explain all are equally good."""

_LOAD_BLOCKS = 3.0
"""Blocks after which a load is believed: while it is put on it is none that stays the same."""

_LEAST_ERROR = 0.1
"""Error of a force in body weights that a fault amounts to at least, for the motion to show it."""

_LOSS = 1.15
"""Factor on what is left where a channel is out: to put a channel right is preferred to losing it."""

_LOOSE = 3.0
"""How many times the standard deviation of a change a load may make."""

_LEAST_CHANGE = 1e-3
"""Least change that a load may make, in foot lengths and as a share of the mass, so that a fit exists."""

_LIGHTER = 0.02
"""Share of its mass that a robot may seem to lack under a load: what it never carried it cannot put down."""

_NOTHING, _CHANNELS, _LOAD = 0, slice(1, -1), -1
"""Places of the scores with nothing wrong, with each hypothesis about channels, and with a load."""

_NORMAL, _RIGHT = slice(0, 3), 3
"""Columns of a load's normal equations: their matrix, for (centre of mass (2), mass), and right-hand side."""


class Contradiction(NamedTuple):
    """What one block shows; m rows of Newton and Euler.

    Attributes:
        residuals: What the rows leave unexplained.
        places: What a newton on each channel does to them, shape (m, K).
        reading: Forces by the starting map of each row in N, shape (m, K).
        scale: Scales a, shape (K,).
        force: Calibrated forces of each row in N, shape (m, K).
        load: Columns of what a load changes, (centre of mass (2), mass), shape (m, 3).
        mass: Believed mass over the estimated one, less 1.
    """

    residuals: Residuals
    places: Array
    reading: Array
    scale: Array
    force: Array
    load: Array
    mass: float


class Evidence(NamedTuple):
    """What supports each explanation since something seemed wrong; H hypotheses about channels.

    Attributes:
        doubt: Blocks since then, 0 while nothing seems wrong.
        scores: Mean squared residuals of the whole blocks among them without a fault, by each hypothesis, and
            with a load, shape (1 + H + 1,).
        size: Largest error of a force in N over these blocks, by each hypothesis, shape (H,).
        latest: The same in the last block alone, shape (H,).
        load: Normal equations of a load over these blocks, the right-hand side last, shape (3, 4).
        load_possible: Whether that load is one that the robot can have been given.
    """

    doubt: float
    scores: Array
    size: Array
    latest: Array
    load: Array
    load_possible: bool


class Decision(NamedTuple):
    """What is believed.

    Attributes:
        fault: The hypothesis about a broken channel that is accepted, or ``None``.
        load: Whether the robot was given a load.
    """

    fault: int | None
    load: bool


class Hypotheses:
    """All that is tried for one setup.

    Args:
        setup: The robot.
        cells: Channels that are cells under one plate (bool), shape (K,): others are not suspected.
        change: Standard deviations of what a load changes, (centre of mass in foot lengths (2), mass), shape
            (3,).

    Attributes:
        count: Number of hypotheses about channels, H.
        out, flipped, straight, crossed: Their places among these.
    """

    def __init__(self, setup: OnlineSetup, cells: NDArray[np.bool_], change: NDArray[np.float64]) -> None:
        K, index = setup.layout.channels, np.nonzero(cells)[0]
        pairs = [(i, j) for i in index for j in index if i < j]
        self._first = np.array([i for i, _ in pairs], dtype=np.intp)
        self._second = np.array([j for _, j in pairs], dtype=np.intp)
        self.out, self.flipped, self.straight, self.crossed = in_a_row(K, K, len(pairs), len(pairs))
        self.count = self.crossed.stop
        pair = np.zeros((len(pairs), K), dtype=bool)
        for row, both in zip(pair, pairs, strict=True):
            row[list(both)] = True
        about = np.concatenate([np.eye(K, dtype=bool), np.eye(K, dtype=bool), pair, pair])
        possible = np.concatenate([np.tile(cells, 2), np.ones(2 * len(pairs), dtype=bool)])
        self._least_error = _LEAST_ERROR * setup.weight
        largest = _LOOSE * change
        self._possible, self._about = possible, about
        self._related = (about[:, None] & about).any(axis=2)
        self._handicap = np.where(np.arange(self.count) < self.out.stop, _LOSS, 1.0)
        self._loose = np.diag(1.0 / np.maximum(largest, _LEAST_CHANGE) ** 2)
        self._largest = largest

    def changes(self, seen: Contradiction, others: Array) -> tuple[Array, Array]:
        """Return what each hypothesis changes.

        Args:
            seen: The block.
            others: How each force follows from the others of its foot, shape (K, K).

        Returns:
            Errors of forces in N, and what they do to the residuals, shape (m, H) each.
        """
        first, second = self._first, self._second
        scaled, reading = seen.places * seen.scale, seen.reading
        errors = [
            seen.force - seen.force @ others.T,
            2.0 * reading,
            reading[:, first] - reading[:, second],
            reading[:, first] + reading[:, second],
        ]
        per_newton = [
            seen.places,
            scaled,
            scaled[:, first] - scaled[:, second],
            scaled[:, first] + scaled[:, second],
        ]
        error = np.hstack(errors)
        return error, np.hstack(per_newton) * error

    def evidence(
        self,
        seen: Contradiction,
        error: Array,
        change: Array,
        doubt: float,
        scores: Array,
        size: Array,
        load: Array,
    ) -> Evidence:
        """Return the evidence of all blocks with this one.

        Args:
            seen: The block.
            error: Errors of forces by each hypothesis in N, shape (m, H).
            change: What they do to the residuals, shape (m, H).
            doubt: As in :class:`Evidence`, of the blocks before, like the three that follow.
            scores: As there.
            size: As there.
            load: As there.
        """
        residuals = seen.residuals
        latest = (np.abs(error) * residuals.there[:, None]).max(axis=0)
        doubt = doubt + 1.0 if doubt > 0.5 else 0.0
        load, change_by_load, load_possible = self._with_load(load if doubt > 2.5 else np.zeros((3, 4)), seen)
        by_each = residuals.mean_with(np.column_stack([change, change_by_load]))
        mean = np.concatenate([[residuals.mean], by_each])
        # The block in which a fault begins is half right: what counts are those behind it.
        if doubt > 1.5:
            scores = scores + (mean - scores) / (doubt - 1.0)
            size = np.maximum(size, latest)
        else:
            scores, size = np.zeros_like(scores), latest
        if doubt < 0.5 and mean[_NOTHING] > SUSPICION:
            doubt = 1.0
        if doubt > _PATIENCE or (doubt > 1.5 and scores[_NOTHING] < _CALM):
            doubt = 0.0
        return Evidence(doubt, scores, size, latest, load, load_possible)

    def decide(self, evidence: Evidence, trust: float, lost: Array) -> Decision:
        """Return what of it is believed.

        Args:
            evidence: What supports each explanation.
            trust: Blocks without doubt before.
            lost: Channels that are out already (0 or 1), shape (K,).
        """
        doubt, nothing = evidence.doubt, evidence.scores[_NOTHING]
        if not (doubt > 1.5 and trust >= TRUST and nothing > SUSPICION):
            return Decision(None, False)
        open_to = self._possible & ~self._about[:, lost > 0.5].any(axis=1)
        left = np.where(open_to, evidence.scores[_CHANNELS] * self._handicap, np.inf)
        # Between its turns a broken cell carries little, and still explains what was wrong in them.
        any_channel = np.where(evidence.size > self._least_error, left, np.inf).min()
        # What small errors of the reference could be as well is not put down to a channel.
        left = np.where(evidence.latest > self._least_error, left, np.inf)
        by_load = evidence.scores[_LOAD] if evidence.load_possible else np.inf

        best = int(left.argmin())
        rival = np.where(self._related[best], np.inf, left).min()
        explains = left[best] < _RELIEF * nothing and left[best] < _CONTRAST * rival
        if explains and left[best] + _NOISE < _CONTRAST * (by_load + _NOISE):
            return Decision(best, False)
        explains = doubt >= _LOAD_BLOCKS and by_load < _RELIEF * nothing
        return Decision(None, bool(explains and by_load + _NOISE < _LOAD_CONTRAST * (any_channel + _NOISE)))

    def promising(self, scores: Array) -> bool:
        """Return whether any explanation leaves much less than none does."""
        return bool(scores[1:].min() < _CONTRAST * scores[_NOTHING])

    def repair(self, fault: int, wiring: Array, kind: Array) -> tuple[Array, Array]:
        """Put a flipped channel, or two exchanged ones, right; nothing for a channel that is out.

        Args:
            fault: The hypothesis that is accepted.
            wiring: Signed permutation that puts channels right so far, shape (K, K).
            kind: Flags of what is wrong with each channel, shape (K,).

        Returns:
            The new wiring and flags.
        """
        repaired, kind = np.eye(len(kind)), kind.copy()
        if fault >= self.straight.start:
            crossed = fault >= self.crossed.start
            pair = fault - (self.crossed if crossed else self.straight).start
            both = [self._first[pair], self._second[pair]]
            repaired[both] = (-1.0 if crossed else 1.0) * repaired[both[::-1]]
            kind[both] ^= int(Flag.SWAPPED)
        elif fault >= self.flipped.start:
            channel = fault - self.flipped.start
            repaired[channel, channel] = -1.0
            kind[channel] ^= int(Flag.FLIPPED)
        return repaired @ wiring, kind

    def _with_load(self, sums: Array, seen: Contradiction) -> tuple[Array, Array, bool]:
        """Fit a load to all blocks since something seemed wrong.

        Returns:
            The normal equations with this block, what the load does to its residuals, shape (m,), and whether
            there can be such a load.
        """
        loads, residuals = seen.load, seen.residuals
        weighted = loads * (residuals.there / residuals.variance)[:, None]
        sums = sums + weighted.T @ np.column_stack([loads, residuals.residual])
        found = np.linalg.solve(sums[:, _NORMAL] + self._loose, sums[:, _RIGHT])
        possible = (np.abs(found) <= self._largest).all() and seen.mass + found[-1] < _LIGHTER
        return sums, -loads @ found, bool(possible)
