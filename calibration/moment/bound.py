r"""How well a log can be calibrated at all: the posterior Cramér-Rao bound.

Scales and offsets that are random walks, seen through rows that are linear in them with independent
normal errors, can be known no better than with the covariance of the recursion (Tichavský, Muravchik and
Nehorai, 1998, in the linear case)

.. math:: S_k^{-1} = (S_{k-1} + Q)^{-1} + H_k' R_k^{-1} H_k,

in which nothing is estimated: H is made with the *true* scales and offsets, which a simulated log knows. It
holds for the model as it is assumed (priors, drift and noise of
:class:`~surefoot.calibration.moment.config.MomentFilterConfig`), on the motion that the log holds: where a
robot stands still, the bound is high. A mass and a vertical bias that the filter only considers are free
here, as nothing forbids to estimate them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.cop import cop_of_moments
from surefoot.calibration.front_end.readings import FrontEnd
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.kalman import kalman_step
from surefoot.calibration.moment.newton_euler import NewtonEuler
from surefoot.calibration.moment.parity import Parity
from surefoot.calibration.moment.rows import Block, Rows
from surefoot.calibration.moment.tare import Tare
from surefoot.calibration.moment.uncertainty import Uncertainty, to_cop, variances
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import Reference
from surefoot.calibration.setup import OnlineSetup

Floats = NDArray[np.float64]


class Bound(NamedTuple):
    """Standard deviations that no estimate can be below on average, at N samples of K channels.

    Attributes:
        force: Of single channels in N, shape (N, K).
        vgrf: Of the vertical force on both feet in N, shape (N,).
        cop: Of the centre of pressure along x and y in the level frame in m, shape (N, 2); NaN without load.
        covariance: Of (a, b) against the starting map at the end, shape (2K, 2K).
    """

    force: Floats
    vgrf: Floats
    cop: Floats
    covariance: Floats


def posterior_bound(
    setup: OnlineSetup,
    raw: Floats,
    reference: Reference,
    truth: Parameters,
    config: MomentFilterConfig | None = None,
) -> Bound:
    """Compute the bound of a log.

    Args:
        setup: What an estimator knows: layout, mass, starting map, time between samples, lag.
        raw: Readings, shape (N, K), all of them there.
        reference: The robot's beliefs, every field with N rows.
        truth: The true scales and offsets at each sample, shape (N, K) each.
        config: The model; the default options of the estimator when not given.

    Raises:
        ValueError: If a shape does not fit, or a reading is missing.
    """
    log = BoundRows(setup, raw, reference, truth, config)
    covariance, spread = log.start, _Spread(log)
    for end, rows in log.blocks:
        spread.add(covariance, slice(end - log.every, end))
        if rows is not None:
            covariance = log.step(covariance, rows)
    spread.add(covariance, slice(len(raw) // log.every * log.every, len(raw)))
    return Bound(*spread.result(), log.of_parameters(covariance))


class BoundRows:
    """The rows of a log, made of the truth; arguments and errors are those of :func:`posterior_bound`.

    Attributes:
        every: Samples of a block.
        start: Covariance to start from, shape (N, N).
        blocks: Where each block ends, and its rows: ``None`` for the first, which lack samples before them.
        unknowns: The unknowns.
        path: The unknowns as they truly were, shape (samples, N).
    """

    def __init__(
        self,
        setup: OnlineSetup,
        raw: Floats,
        reference: Reference,
        truth: Parameters,
        config: MomentFilterConfig | None = None,
    ) -> None:
        config = config or MomentFilterConfig()
        raw = self._checked(setup, np.asarray(raw, dtype=np.float64), reference, truth)
        self.unknowns = unknowns = Unknowns(setup, config)
        self._uncertainty = Uncertainty(unknowns)
        newton_euler = NewtonEuler(setup, config, unknowns)
        tare, parity = Tare(setup, config, unknowns), Parity(setup, config, unknowns)
        start = Parameters(*(np.asarray(part, dtype=np.float64) for part in setup.initial))
        learnt = Parameters(*(np.asarray(part, dtype=np.float64) for part in truth)).relative_to(start)
        samples = _Samples(setup, raw, reference)
        self.every = every = config.every
        self.start: Floats = np.diag(unknowns.std**2)
        self._walk = np.diag(unknowns.walk * every * setup.dt)
        self._free = np.ones(unknowns.size)
        self._setup, self._samples = setup, samples
        self.path: Floats = np.tile(unknowns.start, (len(raw), 1))
        self.path[:, : unknowns.channels] = learnt.scale
        self.path[:, unknowns.offset] = learnt.offset / (learnt.scale * unknowns.unit)
        self.blocks: list[tuple[int, Rows | None]] = []
        for end in range(every, len(raw) + 1, every):
            if end < config.span:
                self.blocks.append((end, None))
                continue
            mean = self.path[end - 1]
            block = samples.block(end - config.span, end)
            rows, _ = newton_euler.rows(mean, block, np.ones(newton_euler.kinds))
            rows = rows.beside(tare.rows(mean, block, *tare.hanging(mean, block)))
            if parity.matters:
                rows = rows.beside(parity.rows(mean, block))
            used = (rows.H != 0.0).any(axis=1)
            self.blocks.append((end, Rows(*(part[used] for part in rows))))

    def passage(self) -> "Passage":
        """Return what all of it makes of any covariance."""
        identity, none = np.eye(len(self._walk)), np.zeros_like(self._walk)
        whole = Passage(identity, none, none)
        for _, rows in self.blocks:
            if rows is not None:
                information = rows.H.T @ (rows.H / rows.variance[:, None])
                whole = whole.then(Passage(identity, none, self._walk))
                whole = whole.then(Passage(identity, information, none))
        return whole

    def aged(self, covariance: Floats) -> Floats:
        """Return the covariance of scales and offsets, shape (P + K, P + K), which drift on after a block."""
        of_map = self.unknowns.map
        aged: Floats = (covariance + np.diag(self.unknowns.age * self.unknowns.walk))[of_map, of_map]
        return aged

    def of_parameters(self, covariance: Floats, sample: int = -1) -> Floats:
        """Return the covariance of (a, b) of each channel, shape (2K, 2K), for that of the unknowns then."""
        of_channels: Floats = self._uncertainty.of_parameters(self.path[sample], self.aged(covariance))
        return of_channels

    def step(self, covariance: Floats, rows: Rows) -> Floats:
        """Return the covariance after one more block."""
        nothing = np.zeros(len(covariance))
        covariance = covariance + self._walk
        step = kalman_step(nothing, covariance, *rows, self._free, np.inf)
        return step.covariance  # type: ignore[no-any-return]

    def spread_rows(self, part: slice) -> tuple[Floats, Floats, Floats]:
        """Return what errors of the map do to forces, the vertical force and the CoP of some samples.

        Returns:
            Rows that take what ``unknowns.map`` names to forces in N, shape (n, K, P), to the vertical force
            on all feet in N, shape (n, 1, P), and to the centre of pressure in m, shape (n, 2, P).
        """
        found = [self._spread_rows(k) for k in range(*part.indices(len(self.path)))]
        force, vgrf, cop = (np.array(rows) for rows in zip(*found, strict=True))
        return force, vgrf, cop

    def _spread_rows(self, k: int) -> tuple[Floats, Floats, Floats]:
        """Return the same of one sample."""
        force, rows, mean = self._samples.force[k], self._samples.rows[k], self.path[k]
        to_force = self._uncertainty.to_force(mean, force)
        moments = rows @ self.unknowns.force(mean, force)
        cop = cop_of_moments(moments[0], moments[1:], self._setup.force_threshold)
        row = rows @ to_force
        return to_force, row[:1], to_cop(row, cop, moments[0])

    @staticmethod
    def _checked(setup: OnlineSetup, raw: Floats, reference: Reference, truth: Parameters) -> Floats:
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
        for name, part in zip(Reference._fields, reference, strict=True):
            if np.shape(part)[:1] != raw.shape[:1]:
                raise ValueError(
                    f"'reference.{name}' must have one row for each of the {len(raw)} rows of 'raw', "
                    f"got shape {np.shape(part)}."
                )
        return raw


class Passage(NamedTuple):
    r"""What a piece of a log makes of a covariance: :math:`\Phi S (1 + \Psi S)^{-1} \Phi' + \Gamma`.

    A random walk has :math:`\Gamma = Q`, rows have :math:`\Psi = H' R^{-1} H`, and pieces one after the
    other are a piece again (Redheffer's star product), so that a motion of many blocks costs one solution.

    Attributes:
        carried: :math:`\Phi`, shape (N, N).
        information: :math:`\Psi`, shape (N, N).
        added: :math:`\Gamma`, shape (N, N).
    """

    carried: Floats
    information: Floats
    added: Floats

    def after(self, covariance: Floats) -> Floats:
        """Return the covariance after it, shape (N, N), for that before."""
        inner = np.eye(len(covariance)) + covariance @ self.information
        found: Floats = self.carried @ np.linalg.solve(inner, covariance) @ self.carried.T + self.added
        return 0.5 * (found + found.T)

    def then(self, other: "Passage") -> "Passage":
        """Return this piece with another one behind it."""
        inner = np.eye(len(self.added)) + self.added @ other.information
        carried, added = np.linalg.solve(inner, np.stack([self.carried, self.added]))
        return Passage(
            other.carried @ carried,
            self.information + self.carried.T @ other.information @ carried,
            other.added + other.carried @ added @ other.carried.T,
        )


class _Samples:
    """A log, checked and aligned as the estimator does it."""

    def __init__(self, setup: OnlineSetup, raw: Floats, reference: Reference) -> None:
        front = FrontEnd(setup, imu=False)
        state, kept = front.init(raw[0]), []
        for k, reading in enumerate(raw):
            row = Reference(*(np.asarray(part)[k] for part in reference))
            state, sample = front.observe(state, reading, row, setup.dt)
            kept.append(sample)
        self.force: Floats = np.array([sample.force for sample in kept])
        self.rows: Floats = np.array([sample.rows for sample in kept]).sum(axis=1)
        self._past: Floats = np.array([sample.past for sample in kept])
        self._motion: Floats = np.array([sample.motion for sample in kept])
        self._swing: Floats = np.array([sample.swing for sample in kept], dtype=np.float64)
        self._stand: Floats = np.array([sample.stance.any() for sample in kept], dtype=np.float64)
        physical = [front.motions.ground(motion)[2] for motion in self._motion]
        self._use: Floats = np.array([sample.good for sample in kept]) & np.array(physical)

    def block(self, start: int, end: int) -> Block:
        part = slice(start, end)
        use = self._use[part].astype(np.float64)
        return Block(self._past[part], self._motion[part], self._swing[part], use, self._stand[part])


class _Spread:
    """What a covariance means for forces and centres of pressure."""

    def __init__(self, log: BoundRows) -> None:
        self._log = log
        self._parts: list[tuple[Floats, Floats, Floats]] = []

    def add(self, covariance: Floats, part: slice) -> None:
        covariance = self._log.aged(covariance)
        if part.start >= part.stop:
            return
        parts = self._log.spread_rows(part)
        force_std, vgrf_std, cop_std = (
            np.sqrt([variances(rows, covariance) for rows in one]) for one in parts
        )
        self._parts.append((force_std, vgrf_std[:, 0], cop_std))

    def result(self) -> tuple[Floats, Floats, Floats]:
        force, vgrf, cop = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        return force, vgrf, cop
