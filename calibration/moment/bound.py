r"""How well a log can be calibrated at all: the posterior Cramér-Rao bound.

Scales and offsets that are random walks, seen through rows that are linear in them with independent
normal errors, can be known no better than with the covariance of the recursion (Tichavský, Muravchik and
Nehorai, 1998, in the linear case)

.. math:: S_k^{-1} = (S_{k-1} + Q)^{-1} + H_k' R_k^{-1} H_k,

in which nothing is estimated: H is made with the *true* scales and offsets, which a simulated log knows. It
holds for the model as it is assumed (priors, drift and noise of
:class:`~surefoot.calibration.moment.config.MomentFilterConfig`), on the motion that the log holds: where a
robot stands still, the bound is high. A mass that the filter only considers is free here, as nothing forbids
to estimate it.
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
from surefoot.calibration.moment.rows import Block
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
    layout, config = setup.layout, config or MomentFilterConfig()
    raw = np.asarray(raw, dtype=np.float64)
    layout.check_raw(raw)
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
    unknowns = Unknowns(setup, config)
    newton_euler = NewtonEuler(setup, config, unknowns)
    tare, parity = Tare(setup, config, unknowns), Parity(setup, config, unknowns)
    start = Parameters(*(np.asarray(part, dtype=np.float64) for part in setup.initial))
    learnt = Parameters(*(np.asarray(part, dtype=np.float64) for part in truth)).relative_to(start)
    samples = _Samples(setup, raw, reference)

    every, span = config.every, config.span
    covariance = np.diag(unknowns.std**2)
    walk = np.diag(unknowns.walk * every * setup.dt)
    identity, free = np.eye(unknowns.size), np.ones(unknowns.size)
    uncertainty = Uncertainty(setup, unknowns)
    spread = _Spread(setup, uncertainty)
    for end in range(every, len(raw) + 1, every):
        part = slice(end - every, end)
        spread.add(covariance, samples, learnt, part)
        if end < span:
            continue
        mean = unknowns.start.copy()
        mean[unknowns.own] = learnt.scale[end - 1]
        mean[unknowns.offset] = learnt.offset[end - 1] / unknowns.unit
        block = samples.block(end - span, end)
        rows, _ = newton_euler.rows(mean, block, np.ones(newton_euler.kinds))
        rows = rows.beside(tare.rows(block, *tare.hanging(block)))
        if parity.matters:
            rows = rows.beside(parity.rows(block))
        step = kalman_step(mean, covariance + walk, *rows, free, identity, np.inf)
        covariance = step.covariance
    rest = slice(len(raw) // every * every, len(raw))
    spread.add(covariance, samples, learnt, rest)
    return Bound(*spread.result(), uncertainty.of_parameters(covariance))


class _Samples:
    """A log, checked and aligned as the estimator does it."""

    def __init__(self, setup: OnlineSetup, raw: Floats, reference: Reference) -> None:
        front = FrontEnd(setup)
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
        _, _, physical = front.motions.ground(self._motion)
        self._use: Floats = np.array([sample.good for sample in kept]) & physical

    def block(self, start: int, end: int) -> Block:
        part = slice(start, end)
        use = self._use[part].astype(np.float64)
        return Block(self._past[part], self._motion[part], self._swing[part], use, self._stand[part])


class _Spread:
    """What a covariance means for forces and centres of pressure."""

    def __init__(self, setup: OnlineSetup, uncertainty: Uncertainty) -> None:
        self._setup, self._uncertainty = setup, uncertainty
        self._parts: list[tuple[Floats, Floats, Floats]] = []

    def add(self, covariance: Floats, samples: _Samples, learnt: Parameters, part: slice) -> None:
        unknowns = self._uncertainty.unknowns
        force, rows = samples.force[part], samples.rows[part]
        # What has drifted since a block is part of what cannot be known.
        covariance = (covariance + np.diag(unknowns.aged))[unknowns.map, unknowns.map]
        to_force = self._uncertainty.to_force(force)
        true = learnt.scale[part] * force + learnt.offset[part]
        moments = (rows @ true[..., None])[..., 0]
        cop = cop_of_moments(moments[..., 0], moments[..., 1:], self._setup.force_threshold)
        row = rows @ to_force
        parts = (to_force, row[:, :1], to_cop(row, cop, moments[..., 0]))
        force_std, vgrf_std, cop_std = (np.sqrt(variances(one, covariance)) for one in parts)
        self._parts.append((force_std, vgrf_std[:, 0], cop_std))

    def result(self) -> tuple[Floats, Floats, Floats]:
        force, vgrf, cop = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        return force, vgrf, cop
