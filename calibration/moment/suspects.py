r"""Faults of the readings themselves, held against each other by evidence.

Channels may be out, turned, or exchanged. Each of these suspects changes the forces of a block by what is
known, so each has a likelihood of its own. It is compared with the best of four innocent causes (nothing is
wrong, what acted in the last block still acts, a hand changes what it does, something unknown acts) and
summed up from where it began to be better (Page's test, 1954),

    S <- max(0, S + log p(block | suspect) - log p(block | innocent))

Exchanged channels spoil all that is learnt and tared of them, so suspects are judged by the unknowns from
before. The momentum at a block's start is as measured there: a filter's, from wrong readings, is not used.

All zeros of a foot or of the robot may also **leap** together: somebody tares it as it stands, and all read
nothing; or its supply steps, and all step alike. As soon as a block is not explained by what was known, each
step of the readings is tried as such a leap. The momentum contradicts a load that steps so, and loads do not
step alike: both kinds of evidence add up.
"""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array, in_a_row
from surefoot.calibration.estimate import Flag
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.moment.columns import Columns, first_mean
from surefoot.calibration.moment.model import Rows, force_and_wrench
from surefoot.calibration.moment.modes import FREE, HELD, MODES, RATES, wrench_variance
from surefoot.calibration.moment.state import SuspectState
from surefoot.calibration.moment.tare import LARGEST_LOAD

SURE = 21.0
"""Logarithmic evidence from which on a suspect is guilty: one of eighty in a thousand hours of blocks."""

CONTRAST = 4.6
"""The same against the next suspect of other channels, from which on something seems wrong, and of a leap,
which was seen: a hundred to one."""

ALIKE = 0.05
"""Least share of a leap by which channels leap unlike: within two samples loads change by a twentieth."""

SMALLEST_STEP = 1e-4
"""Change of readings in W within two samples that says nothing: a converter's noise."""

LARGEST_TARED = 1.0
"""Load of a channel in W with which a robot may be tared: whoever does so sees it stand. One that falls has
more."""

LEAST_ERROR = 0.02
"""Mean force in W, or torque in W times the height, that a fault changes in a block that may speak for it:
ten times the errors of the model of a robot that nobody touches."""

SUSPECT_SHARE, SUSPECT_NOISE, SUSPECT_SURPRISE = 0.02, (0.04, 100.0), 9.0
"""How much of the rows' noise one block decides, five seconds of it; between which factors on its variance it
is believed; and the squared surprise of which more counts no more (three standard deviations)."""


class Leap(NamedTuple):
    """Zeros that have leapt together."""

    reading: Array  # by how much, as readings show it, in W, shape (K,)
    std: Array  # how far that may be off in W, shape (K,)


class Suspects:
    """The suspects of one setup.

    Args:
        layout: The feet.
        cells: Channels that are cells under one plate (bool), shape (K,): others are not suspected.
        columns: The unknowns.

    Attributes:
        count: Number of suspects, H.
        out, flipped, straight, crossed: Their places among these.
    """

    def __init__(self, layout: FeetLayout, cells: Array, columns: Columns) -> None:
        K, index = layout.channels, np.flatnonzero(cells)
        self._columns = columns
        self._first, self._second = (index[part] for part in np.triu_indices(len(index), 1))
        pairs = len(self._first)
        self.out, self.flipped, self.straight, self.crossed = in_a_row(K, K, pairs, pairs)
        self.count = self.crossed.stop
        self._together = np.vstack(
            [np.ones(K), layout.foot_of_channel == np.arange(len(layout.feet))[:, None]]
        )
        pair = np.zeros((pairs, K))
        pair[np.arange(pairs), self._first] = pair[np.arange(pairs), self._second] = 1.0
        self._about = about = np.vstack([np.eye(K), np.eye(K), pair, pair])
        self._related = about @ about.T > 0.0
        # To put a channel right is preferred to losing it.
        self._handicap = np.where(np.arange(self.count) < self.out.stop, CONTRAST, 0.0)
        self._possible = np.concatenate([cells, cells, np.ones(2 * pairs, dtype=bool)])

    def init(self, capacity: int) -> SuspectState:
        """Return the state of readings that nothing speaks against, for blocks of so many samples."""
        columns = self._columns
        C, K = columns.components, self.out.stop
        known = first_mean(columns)[: columns.momentum.start]
        zero = np.zeros(C)
        return SuspectState(
            np.zeros(self.count), zero, zero, np.ones(C), known, np.zeros((2 * capacity + 2, K))
        )

    def weigh(
        self,
        state: SuspectState,
        rows: Rows,
        known: Array,
        covariance: Array,
        others: Array,
        others_std: Array,
        lost: Array,
        broken: Array,
        duration: float,
    ) -> tuple[SuspectState, int | Leap | None]:
        """Hold all suspects against a block.

        Args:
            state: Evidence so far.
            rows: The block.
            known: The unknowns before the momentum, shape (M,).
            covariance: Theirs, shape (M, M).
            others: How each force follows from the others of its foot, shape (K, K).
            others_std: How far that is off in W, shape (K,).
            lost: Channels that are out (0 or 1), shape (K,).
            broken: Channels of plates of which one is out (bool), shape (K,): they are not suspected.
            duration: Of the block in s.

        Returns:
            The state, and the leap, or else the guilty suspect.
        """
        columns = self._columns
        H, reach = rows.mean[:, : len(known)], rows.mean[:, columns.offset]
        e, e_before = (self._error(state, rows, one) for one in (known, state.known))
        larger = np.sqrt(state.noise)
        S = (2.0 * rows.variance + rows.walk + H @ covariance @ H.T) * np.outer(larger, larger)
        span = rows.mean[:, columns.wrench].max(axis=0)
        S = S + np.diag(span**2 * wrench_variance(FREE, rows))
        changes = self._changes(rows.crossed, reach, state.known, others)
        off = e_before[:, None] - changes
        possible = self._possible & (self._about @ broken < 0.5)
        each = np.where(possible, _evidence(S, off), -np.inf)
        for k in np.flatnonzero(possible[self.out]):
            extra = np.outer(reach[:, k], reach[:, k]) * others_std[k] ** 2
            each[k] = _evidence(S + extra, off[:, [k]])[0]
        # A force in W, or a torque in W times the height, seen in the mean momentum.
        arm = span * np.where(force_and_wrench(len(e)) > 0.0, 1.0, rows.height)
        shown = (np.abs(changes) > LEAST_ERROR * arm[:, None]).any(axis=0)
        rare = float(np.log(RATES[MODES.index(FREE), MODES.index(HELD)] * duration))
        nothing, lasting, innocent = self._excuse(state, rows, S, e, span, arm, rare, duration)
        gain = np.where(shown, each - innocent, np.minimum(each - innocent, 0.0))
        score = np.maximum(state.score + gain, 0.0)
        noise, before = state.noise, state.known
        if score.max() < CONTRAST:
            before = known
            lasted = state.error * span if lasting > nothing + CONTRAST else None
            noise = _learn_noise(noise, np.diagonal(S), e, lasted)
        least = max(innocent + SURE, each.max())
        there = 1.0 - lost
        leap = self._find_leap(state, S, reach, e_before, there, least, rare) if innocent > nothing else None
        state = state._replace(score=score, noise=noise, error=e / span, known=before)
        return state, leap or self._find_guilty(score)

    def _excuse(
        self,
        state: SuspectState,
        rows: Rows,
        S: Array,
        e: Array,
        span: Array,
        arm: Array,
        rare: float,
        duration: float,
    ) -> tuple[float, float, float]:
        """Return the evidence that nothing is wrong, that an error lasts, and of the best innocent cause.

        Nothing is wrong; what acted in the last block still acts, or changes as a hand's force does, as
        rarely as somebody takes hold; a force as large as the weight acts on the robot's body, up to its
        height away from its centre of mass.
        """
        nothing = _evidence(S, e[:, None])[0]
        lasting = _evidence(2.0 * S, (e - state.error * span)[:, None])[0]
        decay = np.exp(-duration / HELD.time)
        hand = np.diag(span**2 * wrench_variance(HELD, rows) * (1.0 - decay**2))
        changing = rare + _evidence(2.0 * S + hand, (e - decay * state.error * span)[:, None])[0]
        body = np.outer(rows.mean_rest, rows.mean_rest) + np.diag(np.concatenate([[0.0], arm[1:]]) ** 2)
        unknown = _evidence(S + body, e[:, None])[0]
        return nothing, lasting, max(nothing, lasting, changing, unknown)

    def miss(self, state: SuspectState, rows: Rows, known: Array, others: Array) -> tuple[Array, Array]:
        """Return the error of a block, and its changes by channels that are out; torques over the height.

        Args:
            state: Evidence so far.
            rows: The block.
            known: The unknowns before the momentum to judge by, shape (M,).
            others: How each force follows from the others of its foot, shape (K, K).
        """
        reach = rows.mean[:, self._columns.offset]
        arm = np.where(force_and_wrench(len(reach)) > 0.0, 1.0, rows.height)
        changes = self._changes(rows.crossed, reach, known, others)[:, self.out]
        return self._error(state, rows, known) / arm, changes / arm[:, None]

    def read(self, state: SuspectState, force: Array) -> SuspectState:
        """Note the readings F0 of a block in W, shape (n, K)."""
        return state._replace(force=np.vstack([state.force, force])[len(force) :])

    def rewire(self, guilty: int) -> tuple[Array, Array]:
        """Return the signed permutation that puts channels right (K, K), and flags that turn (K,)."""
        K = self.out.stop
        turned, kind = np.eye(K), np.zeros(K, dtype=np.int64)
        if guilty < self.straight.start:
            channel = guilty - self.flipped.start
            turned[channel, channel] = -1.0
            kind[channel] = int(Flag.FLIPPED)
        else:
            crossed = guilty >= self.crossed.start
            pair = guilty - (self.crossed if crossed else self.straight).start
            both = [self._first[pair], self._second[pair]]
            turned[both] = (-1.0 if crossed else 1.0) * turned[both[::-1]]
            kind[both] = int(Flag.SWAPPED)
        return turned, kind

    def _find_guilty(self, score: Array) -> int | None:
        score = score - self._handicap
        best = int(score.argmax())
        rival = float(np.where(self._related[best], 0.0, score).max())
        return best if score[best] > max(SURE, rival + CONTRAST) else None

    def _find_leap(
        self, state: SuspectState, S: Array, reach: Array, e: Array, there: Array, least: float, rare: float
    ) -> Leap | None:
        """Find the step of readings that explains an error best, and better than ``least``.

        ``there`` are the channels that are not out, and ``rare`` is the logarithm of how rarely a hand pushes
        in a block.
        """
        a, found, most = state.known[self._columns.scale], None, least
        # Readings are brought to one moment, between two of each channel's.
        steps = state.force[2:] - state.force[:-2]
        for before, step in zip(state.force[:-2], steps, strict=True):
            for together in self._together * there:
                count, force = max(together.sum(), 1.0), together * a
                size = together @ step**2 / count
                alike = np.full(len(step), together @ step / count)
                for leap, largest in ((alike, LARGEST_LOAD), (-before, LARGEST_TARED)):
                    unlike = together @ (step - leap) ** 2 / count
                    variance = max(unlike, ALIKE**2 * size, SMALLEST_STEP**2)
                    # Loads that step do so each by its own, and by any size.
                    seen = 0.5 * count * np.log(max(size, SMALLEST_STEP**2) / variance)
                    # A push on a robot that stands evenly comes on all of its cells alike.
                    seen += rare * (together.sum() == there.sum())
                    if seen > CONTRAST and np.abs(together * leap).max() <= largest:
                        S_leap = S + variance * (reach * force**2) @ reach.T
                        seen += _evidence(S_leap, (e + reach @ (force * leap))[:, None])[0]
                        if seen > most:
                            found, most = Leap(together * leap, together * np.sqrt(variance)), seen
        return found

    def _error(self, state: SuspectState, rows: Rows, known: Array) -> Array:
        """Return the innovation of rows, shape (C,)."""
        columns = self._columns
        robot = slice(columns.map.stop, columns.momentum.start)
        a, reach = known[columns.scale], rows.mean[:, columns.offset]
        force = np.einsum("ckk->ck", rows.crossed) @ a + reach @ _zero(known, columns)
        error: Array = (
            rows.measured - state.before - rows.mean_rest - force - rows.mean[:, robot] @ known[robot]
        )
        return error

    def _changes(self, crossed: Array, reach: Array, known: Array, others: Array) -> Array:
        """Return the change of the mean momentum by each suspect, shape (C, H)."""
        columns, i, j = self._columns, self._first, self._second
        a, zero = known[columns.scale], _zero(known, columns)
        own = a * np.einsum("ckk->ck", crossed)
        by_others = np.einsum("ckl,l,kl->ck", crossed, a, others) + reach * (others @ zero)
        to_i, to_j = a[i] * crossed[:, i, j], a[j] * crossed[:, j, i]
        both = own[:, i] + own[:, j]
        lost = by_others - own - reach * zero
        return np.hstack([lost, -2.0 * own, to_i + to_j - both, -to_i - to_j - both])


def _learn_noise(noise: Array, variance: Array, e: Array, lasted: Array | None) -> Array:
    """Learn how much larger variances are than stated from a block's innovation, shapes (C,).

    An error that surely lasts is no noise, as the whole weight of a robot that hangs on a crane: noise is its
    change since the last block, of which ``lasted`` is the error.
    """
    square = e**2 if lasted is None else 0.5 * (e - lasted) ** 2
    surprise = np.minimum(square / variance, SUSPECT_SURPRISE)
    learnt: Array = np.clip(noise * (1.0 + SUSPECT_SHARE * (surprise - 1.0)), *SUSPECT_NOISE)
    return learnt


def _zero(known: Array, columns: Columns) -> Array:
    """Return b + u in W, shape (K,)."""
    zero: Array = known[columns.offset] + known[columns.drift]
    return zero


def _evidence(S: Array, e: Array) -> Array:
    """Return the logarithms of likelihoods of innovations, shapes (C, C) and (C, H) to (H,)."""
    chi2 = (e * np.linalg.solve(S, e)).sum(axis=0)
    logarithm: Array = -0.5 * (chi2 + np.linalg.slogdet(S)[1])
    return logarithm
