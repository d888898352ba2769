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

_NORMAL, _RIGHT = slice(0, 3), slice(3, 4)
"""Columns of a load's normal equations: their matrix, for (centre of mass (2), mass), and right-hand side."""


class Contradiction(NamedTuple):
    """What one block shows; any leading batch dimensions ``...``; m rows of Newton and Euler.

    Attributes:
        residuals: What the rows leave unexplained.
        places: What a newton on each channel does to them, shape (..., m, K).
        reading: Forces by the starting map of each row in N, shape (..., m, K).
        scale: Scales a, shape (..., K).
        force: Calibrated forces of each row in N, shape (..., m, K).
        load: Columns of what a load changes, (centre of mass (2), mass), shape (..., m, 3).
        mass: Believed mass over the estimated one, less 1, shape (...).
    """

    residuals: Residuals
    places: Array
    reading: Array
    scale: Array
    force: Array
    load: Array
    mass: Array


class Evidence(NamedTuple):
    """What supports each explanation since something seemed wrong; H hypotheses about channels.

    Attributes:
        doubt: Blocks since then, 0 while nothing seems wrong, shape (...).
        scores: Mean squared residuals of the whole blocks among them without a fault, by each hypothesis, and
            with a load, shape (..., 1 + H + 1).
        size: Largest error of a force in N over these blocks, by each hypothesis, shape (..., H).
        latest: The same in the last block alone, shape (..., H).
        load: Normal equations of a load over these blocks, the right-hand side last, shape (..., 3, 4).
        load_possible: Whether that load is one that the robot can have been given (bool), shape (...).
    """

    doubt: Array
    scores: Array
    size: Array
    latest: Array
    load: Array
    load_possible: Array


class Decision(NamedTuple):
    """What is believed.

    Attributes:
        fault: Whether a channel is broken (bool), shape (...).
        load: Whether the robot was given a load (bool), shape (...).
        accepted: 1 for the hypothesis that is, shape (..., H).
    """

    fault: Array
    load: Array
    accepted: Array


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
        self._possible = possible
        self._about = about.astype(float)
        self._pair = pair.astype(float)
        self._related = (about.astype(float) @ about.T > 0.5).astype(float)
        self._handicap = np.where(np.arange(self.count) < self.out.stop, _LOSS, 1.0)
        self._order = np.arange(self.count)
        self._identity = np.eye(K)
        self._loose = np.diag(1.0 / np.maximum(largest, _LEAST_CHANGE) ** 2)
        self._largest = largest

    def changes(self, seen: Contradiction, others: Array) -> tuple[Array, Array]:
        """Return what each hypothesis changes.

        Args:
            seen: The block.
            others: How each force follows from the others of its foot, shape (..., K, K).

        Returns:
            Errors of forces in N, and what they do to the residuals, shape (..., m, H) each.
        """
        first, second = self._first, self._second
        scaled = seen.places * seen.scale[..., None, :]
        reading = seen.reading
        errors = [
            seen.force - seen.force @ others.mT,
            2.0 * reading,
            reading[..., first] - reading[..., second],
            reading[..., first] + reading[..., second],
        ]
        per_newton = [
            seen.places,
            scaled,
            scaled[..., first] - scaled[..., second],
            scaled[..., first] + scaled[..., second],
        ]
        error = np.concatenate(errors, axis=-1)
        return error, np.concatenate(per_newton, axis=-1) * error

    def evidence(
        self,
        seen: Contradiction,
        error: Array,
        change: Array,
        doubt: Array,
        scores: Array,
        size: Array,
        load: Array,
    ) -> Evidence:
        """Return the evidence of all blocks with this one.

        Args:
            seen: The block.
            error: Errors of forces by each hypothesis in N, shape (..., m, H).
            change: What they do to the residuals, shape (..., m, H).
            doubt: As in :class:`Evidence`, of the blocks before, like the three that follow.
            scores: As there.
            size: As there.
            load: As there.
        """
        residuals = seen.residuals
        latest = (np.abs(error) * residuals.there[..., None]).max(axis=-2)
        # The block in which a fault begins is half right: what counts are those behind it.
        doubt = doubt + (doubt > 0.5)
        goes_on, sums_go_on = doubt > 1.5, doubt > 2.5
        load = load * sums_go_on[..., None, None]
        load, change_by_load, load_possible = self._with_load(load, seen)
        size = np.maximum(size * goes_on[..., None], latest)
        changes = np.concatenate([change, change_by_load[..., None]], axis=-1)
        mean = np.concatenate([residuals.mean[..., None], residuals.mean_with(changes)], axis=-1)

        whole = np.where(goes_on, doubt - 1.0, 1.0)[..., None]
        scores = np.where(goes_on[..., None], scores + (mean - scores) / whole, 0.0)
        begins = (doubt < 0.5) & (mean[..., _NOTHING] > SUSPICION)
        doubt = np.where(begins, 1.0, doubt)
        ends = (doubt > _PATIENCE) | ((doubt > 1.5) & (scores[..., _NOTHING] < _CALM))
        return Evidence(np.where(ends, 0.0, doubt), scores, size, latest, load, load_possible)

    def decide(self, evidence: Evidence, trust: Array, lost: Array) -> Decision:
        """Return what of it is believed.

        Args:
            evidence: What supports each explanation.
            trust: Blocks without doubt before, shape (...).
            lost: Channels that are out already (0 or 1), shape (..., K).
        """
        doubt, nothing = evidence.doubt, evidence.scores[..., _NOTHING]
        open_to = self._possible & ~(lost @ self._about.mT > 0.5)
        left = np.where(open_to, evidence.scores[..., _CHANNELS] * self._handicap, np.inf)
        # Between its turns a broken cell carries little, and still explains what was wrong in them.
        any_channel = np.where(evidence.size > self._least_error, left, np.inf).min(axis=-1)
        # What small errors of the reference could be as well is not put down to a channel.
        left = np.where(evidence.latest > self._least_error, left, np.inf)
        by_load = np.where(evidence.load_possible, evidence.scores[..., _LOAD], np.inf)
        chosen = (np.argmin(left, axis=-1)[..., None] == self._order).astype(np.float64)
        least = left.min(axis=-1)
        rival = np.where(chosen @ self._related > 0.5, np.inf, left).min(axis=-1)

        ready = (doubt > 1.5) & (trust >= TRUST) & (nothing > SUSPICION)
        fault = ready & (least < _RELIEF * nothing) & (least < _CONTRAST * rival)
        fault = fault & (least + _NOISE < _CONTRAST * (by_load + _NOISE))
        load = ready & ~fault & (doubt >= _LOAD_BLOCKS) & (by_load < _RELIEF * nothing)
        load = load & (by_load + _NOISE < _LOAD_CONTRAST * (any_channel + _NOISE))
        return Decision(fault, load, chosen * fault[..., None])

    def promising(self, scores: Array) -> Array:
        """Return whether any explanation leaves much less than none does (bool), shape (...)."""
        return scores[..., 1:].min(axis=-1) < _CONTRAST * scores[..., _NOTHING]

    def repair(self, accepted: Array, wiring: Array, kind: Array) -> tuple[Array, Array]:
        """Put flipped and exchanged channels right.

        Args:
            accepted: 1 for the hypothesis that is accepted, shape (..., H).
            wiring: Signed permutation that puts channels right so far, shape (..., K, K).
            kind: Flags of what is wrong with each channel, shape (..., K).

        Returns:
            The new wiring and flags.
        """
        flipped, straight = accepted[..., self.flipped], accepted[..., self.straight]
        crossed = accepted[..., self.crossed]
        turn = self._identity * (1.0 - 2.0 * flipped)[..., None]
        exchange = self._identity
        for swapped, sign in ((straight, 1.0), (crossed, -1.0)):
            one = swapped @ self._pair
            cross = one[..., None] * one[..., None, :] * (1.0 - self._identity)
            exchange = (self._identity * (1.0 - one)[..., None] + sign * cross) @ exchange
        exchanged = (straight + crossed) @ self._pair > 0.5
        kind = kind ^ (int(Flag.FLIPPED) * (flipped > 0.5))
        return turn @ exchange @ wiring, kind ^ (int(Flag.SWAPPED) * exchanged)

    def _with_load(self, sums: Array, seen: Contradiction) -> tuple[Array, Array, Array]:
        """Fit a load to all blocks since something seemed wrong.

        Returns:
            The normal equations with this block, what the load does to its residuals, shape (..., m), and
            whether there can be such a load (bool), shape (...).
        """
        loads, residuals = seen.load, seen.residuals
        both = np.concatenate([loads, residuals.residual[..., None]], axis=-1)
        sums = sums + (loads * (residuals.there / residuals.variance)[..., None]).mT @ both
        fit = np.linalg.solve(sums[..., _NORMAL] + self._loose, sums[..., _RIGHT])
        found, mass_change = fit[..., 0], fit[..., -1, 0]
        possible = (np.abs(found) <= self._largest).all(axis=-1) & (seen.mass + mass_change < _LIGHTER)
        return sums, -(loads @ fit)[..., 0], possible
