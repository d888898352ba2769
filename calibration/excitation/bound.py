r"""Posterior Cramér-Rao bound of the calibration of a log.

Scales and zeros that are random walks, measured by linear rows with independent normal errors, cannot be
estimated with a smaller covariance than that of the recursion (Tichavský, Muravchik and Nehorai, 1998, in the
linear case). The recursion is that of the filter without its estimates: its rows are evaluated at the *true*
scales and offsets, which are known for a simulated log, no external wrench acts, and the severity of the
sensors and the noise of the rows are the configured ones. The bound therefore holds for the assumed model
(:class:`~surefoot.calibration.moment.config.Moment`) and for the motion of the log; it is high for a robot
that stands still. A mass that the filter only considers (Schmidt) is estimated here.
"""

from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats, take_rows
from surefoot.calibration.cop import cop_of_moments
from surefoot.calibration.moment.blocks import Block
from surefoot.calibration.moment.columns import Spread, first_variance
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.filter import MomentFilter
from surefoot.calibration.moment.health import map_covariance, to_cop
from surefoot.calibration.moment.model import Rows
from surefoot.calibration.moment.modes import FREE, wrench_variance
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import MomentumReference, Reference
from surefoot.calibration.setup import OnlineSetup


class Bound(NamedTuple):
    """Lower bounds of standard deviations at N samples of K channels."""

    force: Floats  # of single channels in N, shape (N, K)
    vgrf: Floats  # of the vertical force on all feet in N, shape (N,)
    cop: Floats
    """Of the centre of pressure along x and y in the level frame in m, shape (N, 2); NaN without load."""
    covariance: Floats  # of (a, b) against the starting map at the end, shape (2K, 2K)


def posterior_bound(
    setup: OnlineSetup,
    raw: Floats,
    reference: Reference | MomentumReference,
    truth: Parameters,
    config: Moment | None = None,
) -> Bound:
    """Compute the bound of a log.

    Args:
        setup: The estimator's setup: layout, mass, starting map, time between samples, lag.
        raw: Readings, shape (N, K), without gaps.
        reference: The robot's reference, with N rows in each field.
        truth: The true scales and offsets at each sample, shape (N, K) each.
        config: The model; by default the estimator's default options.

    Raises:
        ValueError: If a shape does not fit, or a reading is missing.
    """
    log = LogPassages(setup, raw, reference, truth, config)
    covariance, begin = log.start, 0
    parts = []
    for end, passage in log.blocks:
        parts.append(log.deviations(covariance, slice(begin, end)))
        covariance, begin = passage.after(covariance), end
    if begin < len(log.raw):
        parts.append(log.deviations(covariance, slice(begin, len(log.raw))))
    force, vgrf, cop = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Bound(force, vgrf, cop, log.of_parameters(covariance))


class Passage(NamedTuple):
    r"""Map of the covariance over a part of a log: :math:`\Phi S (1 + \Psi S)^{-1} \Phi' + \Gamma`.

    A random walk has :math:`\Gamma = Q`, rows have :math:`\Psi = H' R^{-1} H`, and the composition of two
    maps is such a map again (Redheffer's star product), so that a motion of many blocks costs one solution.
    """

    carried: Floats  # :math:`\Phi`, shape (N, N)
    information: Floats  # :math:`\Psi`, shape (N, N)
    added: Floats  # :math:`\Gamma`, shape (N, N)

    @classmethod
    def move(cls, carried: Floats, added: Floats) -> "Passage":
        """Return the map of a transition that adds a variance."""
        return cls(carried, np.zeros_like(added), added)

    @classmethod
    def learn(cls, H: Floats, variance: Floats) -> "Passage":
        """Return the map of measurement rows, shapes (m, N) and (m, m)."""
        N = H.shape[1]
        return cls(np.eye(N), H.T @ np.linalg.solve(variance, H), np.zeros((N, N)))

    def after(self, covariance: Floats) -> Floats:
        """Return the covariance after this part, shape (N, N), for the one before it."""
        inner = np.eye(len(covariance)) + covariance @ self.information
        found: Floats = self.carried @ np.linalg.solve(inner, covariance) @ self.carried.T + self.added
        return 0.5 * (found + found.T)

    def then(self, other: "Passage") -> "Passage":
        """Return the map of this part followed by another one."""
        inner = np.eye(len(self.added)) + self.added @ other.information
        carried, added = np.linalg.solve(inner, np.stack([self.carried, self.added]))
        return Passage(
            other.carried @ carried,
            self.information + self.carried.T @ other.information @ carried,
            other.added + other.carried @ added @ other.carried.T,
        )


class LogPassages:
    """The maps of a log's blocks, evaluated at the truth; arguments as in :func:`posterior_bound`.

    ``raw`` are the readings, (samples, K), ``start`` is the initial covariance of the unknowns, (N, N), and
    ``blocks`` are pairs of the last sample of a block and its map.
    """

    def __init__(
        self,
        setup: OnlineSetup,
        raw: Floats,
        reference: Reference | MomentumReference,
        truth: Parameters,
        config: Moment | None = None,
    ) -> None:
        config = config or Moment()
        self.raw = raw = _check(setup, np.asarray(raw, dtype=np.float64), reference, truth)
        self._setup, self._filter = setup, MomentFilter(setup, config)
        self._columns, self._spread = self._filter.columns, Spread.of(setup, config)
        self.start: Floats = np.diag(first_variance(self._columns, self._spread, config, wide=1.0))
        walk = np.zeros(self._columns.size)
        walk[self._columns.scale], walk[self._columns.drift] = self._spread.walk
        self._walk = np.diag(walk)
        self._path = self._follow(truth)
        self._force = np.empty_like(raw)
        self._rows = np.empty((len(raw), 3, raw.shape[1]))
        self.blocks = self._read(reference)

    def whole(self) -> Passage:
        """Return the map of the whole log, with an unknown initial momentum."""
        whole = self._begin(None)
        for _, passage in self.blocks:
            whole = whole.then(passage)
        return whole

    def of_parameters(self, covariance: Floats, sample: int = -1) -> Floats:
        """Return the covariance of (a, b) of all channels, shape (2K, 2K), for that of the unknowns."""
        part, weight = self._columns.map, self._setup.weight
        known, turned = self._as_force(self._path[sample])
        learnt: Floats = map_covariance(
            known,
            (turned @ covariance @ turned.T)[part, part],
            self._columns,
            weight,
            np.zeros_like(self._spread.walk),
        )
        return learnt

    def error_rows(self, part: slice) -> tuple[Floats, Floats, Floats]:
        """Return the derivatives of forces, vertical force and CoP of some samples with respect to (a, b).

        Rows that map (a, b) to forces in N, shape (n, K, 2K), to the vertical force on all feet in N, (n, 1,
        2K), and to the centre of pressure in m, (n, 2, 2K); NaN without load.
        """
        weight, columns = self._setup.weight, self._columns
        found = []
        for force, rows, known in zip(self._force[part], self._rows[part], self._path[part], strict=True):
            to_force = np.hstack([np.diag(force), np.eye(len(force))])
            a, b, z = (known[of] for of in (columns.scale, columns.offset, columns.drift))
            moments = rows @ (a * force + (b + a * z) * weight)
            cop = cop_of_moments(moments[0], moments[1:], self._setup.force_threshold)
            row = rows @ to_force
            found.append((to_force, row[:1], to_cop(row, cop, moments[0])))
        to_force, to_vgrf, to_pressure = (np.array(rows) for rows in zip(*found, strict=True))
        return to_force, to_vgrf, to_pressure

    def deviations(self, covariance: Floats, part: slice) -> tuple[Floats, Floats, Floats]:
        """Return standard deviations of forces, vertical force and CoP of samples, for a covariance."""
        learnt = np.array([self.of_parameters(covariance, k) for k in range(*part.indices(len(self.raw)))])
        force, vgrf, cop = (
            np.sqrt(np.einsum("nij,njk,nik->ni", rows, learnt, rows)) for rows in self.error_rows(part)
        )
        return force, vgrf[:, 0], cop

    def _as_force(self, known: Floats) -> tuple[Floats, Floats]:
        """Return the map with drift as a force u = a z, and the derivatives of the filter's unknowns (N, N).

        Here zeros drift in units of readings, by z, so that drift contains no information on scales.
        """
        scale, drift = self._columns.scale, self._columns.drift
        a, z = known[scale], known[drift]
        turned = np.eye(self._columns.size)
        turned[drift, scale], turned[drift, drift] = np.diag(z), np.diag(a)
        known = known.copy()
        known[drift] = a * z
        return known, turned

    def _follow(self, truth: Parameters) -> Floats:
        """Return the true scales, offsets and drift in readings at each sample, shape (samples, M)."""
        start = Parameters(*(np.asarray(part, dtype=np.float64) for part in self._setup.initial))
        true = Parameters(*(np.asarray(part, dtype=np.float64) for part in truth)).relative_to(start)
        offset = true.offset / self._setup.weight
        return np.hstack(
            [true.scale, np.tile(offset[0], (len(offset), 1)), (offset - offset[0]) / true.scale]
        )

    def _read(self, reference: Reference | MomentumReference) -> list[tuple[int, Passage]]:
        """Process the log as the filter does, and return its blocks."""
        filter_, setup = self._filter, self._setup
        momentum = isinstance(reference, MomentumReference)
        state, last = filter_.init(self.raw[0]), None
        blocks = []
        for k, reading in enumerate(self.raw):
            row = take_rows(reference, k)
            front, sample = filter_.front_end.observe(state.front, reading, row, setup.dt)
            self._force[k], self._rows[k] = sample.force, sample.rows.sum(axis=0)
            state = filter_.blocks.collect(state._replace(front=front), sample, momentum, setup.dt)
            if state.waiting <= 0:
                # A sample was rejected, and the momentum starts again.
                last = None
            if filter_.blocks.full(state):
                block = filter_.blocks.block(state)
                passage, rows = self._pass(block, k, last)
                blocks.append((k, passage))
                state, last = filter_.blocks.begin(state), rows if state.track.valid else None
        return blocks

    def _pass(self, block: Block, k: int, last: Rows | None) -> tuple[Passage, Rows]:
        """Return the map of a block and its rows; ``last`` are the rows of the previous block."""
        columns, T = self._columns, block.duration
        N = columns.size
        known, turned = self._as_force(self._path[k])
        identity, none = np.eye(N), np.zeros((N, N))
        passage = Passage.move(identity, self._walk * T)
        H, variance = self._filter.tare.rows(block, known)
        if len(H):
            passage = passage.then(Passage.learn(H @ turned, variance))
        rows = self._filter.model.rows(block, known, np.zeros(len(known) // 3))
        if last is None:
            return passage.then(self._begin(rows)), rows
        moved, _ = self._filter.model.move(rows.point - last.point, block.velocity.mean(axis=0))
        decay, added = np.eye(N), none.copy()
        share = np.exp(-T / FREE.time)
        decay[columns.wrench, columns.wrench] *= share
        added[columns.wrench, columns.wrench] = np.diag(wrench_variance(FREE, rows) * (1.0 - share**2))
        passage = passage.then(Passage.move(decay @ moved, added))
        passage = passage.then(Passage.learn(rows.mean @ turned, rows.variance + rows.walk / 3.0))
        forward, walk = identity.copy(), none.copy()
        forward[columns.momentum] = rows.end @ turned
        walk[columns.momentum, columns.momentum] = rows.walk
        return passage.then(Passage.move(forward, walk)), rows

    def _begin(self, rows: Rows | None) -> Passage:
        """Return the map that restarts momentum and wrench, from a measurement if there is one."""
        columns, N = self._columns, self._columns.size
        carried, added = np.eye(N), np.zeros((N, N))
        for part in (columns.momentum, columns.wrench):
            carried[part, part] = 0.0
        if rows is not None:
            added[columns.momentum, columns.momentum] = rows.variance
            added[columns.wrench, columns.wrench] = np.diag(wrench_variance(FREE, rows))
        return Passage.move(carried, added)


def _check(
    setup: OnlineSetup, raw: Floats, reference: Reference | MomentumReference, truth: Parameters
) -> Floats:
    setup.layout.check_raw(raw)
    if raw.ndim != 2 or not np.isfinite(raw).all():
        raise ValueError(
            "'raw' must have shape (samples, channels) and hold no gaps: a bound knows of no faults."
        )
    for name, part in zip(Parameters._fields, truth, strict=True):
        if np.shape(part) != raw.shape:
            raise ValueError(
                f"'truth.{name}' must have the shape of 'raw', {raw.shape}, got {np.shape(part)}."
            )
    for name, part in zip(reference._fields, reference, strict=True):
        if np.shape(part)[:1] != raw.shape[:1]:
            raise ValueError(
                f"'reference.{name}' must have one row for each of the {len(raw)} rows of 'raw', "
                f"got shape {np.shape(part)}."
            )
    return raw
