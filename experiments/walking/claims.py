r"""How well a log fits itself: one batch fit of a map from counts to the forces that the motion requires.

A log *claims* that counts, layout, mass, beliefs and contacts belong together. If they do, one linear map a
channel, F = a F0 + b near the starting map F0, gives at all times the force and the moments that Newton and
Euler ask for (CoP paper, Eqs. 6, 7), and nothing on a foot in the air. The fit is independent of all methods.

Rows are means over :data:`BLOCK` s. Their residuals count as drawn from Student's t distribution, whose scale
is found for each kind of row and is never below that of a sound log; errors of a robot's beliefs last for
:data:`LASTING` s, so that a row counts for less than one. With the prior of the map, log evidence in
Laplace's approximation is

    ln Z = sum_k w ln t(r_k / s) - 1/2 theta' P theta - 1/2 ln det(P + H' W H) + 1/2 ln det P,

and two readings of the same log, as it is and with the feet exchanged, say, compare by it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma

from surefoot.arrays import Floats, take_rows
from surefoot.calibration import GRAVITY, OnlineSetup, Parameters, Reference
from surefoot.experiments.logs.format import Log

BLOCK = 0.1  # time in s that a row is the mean of: shorter than a step, longer than a ripple of servos
LASTING = 0.25  # time in s for which errors of beliefs last: half a step
WINDOW, WINDOWS = 20.0, 3  # longest stretch in s that one map must fit, as maps drift; how many of them
HELD = 0.25  # longest time in s over which a line is drawn between two readings of a channel
TAIL = 4.0  # degrees of freedom of Student's t
NORMAL = 0.6745  # median of |z| for z ~ N(0, 1)
ABSURD = np.log(1e-6)  # of the probability that legs are crossed, or that a cell pulls where it is pushed
FEWEST = 8  # rows below which nothing is said
ITERATIONS, SETTLED = 12, 1e-2  # of the fit; change of a scale of residuals at which it ends

FORCE, COP, AIR = 0.016, 2.5e-3, 0.005
"""Least scale of residuals: vertical force in weights, centre of pressure in m (both as the moment filter
assumes its rows), and a channel's reading in the air in weights, which moves with the sole."""

SCALE, OFFSET = 0.12, 0.03  # prior of a map: cells that were never calibrated; offsets in weights
WIDTHS = (1.0, 3.0)  # times that prior, of which the likelier counts
COM, MASS = 0.003, 0.01  # prior of the belief's own errors: centre of mass in m, mass relative


@dataclass(frozen=True, eq=False)
class Claims:
    """The claims of a log of N samples at the moments of its references; hypotheses change it."""

    raw: Floats  # readings in counts, shape (N, K); NaN where not read
    initial: Parameters  # the starting map
    reference: Reference
    wrench_map: Floats  # shape (F, 6, K)
    weight: float  # in N
    length: float  # of a foot in m, which makes torques of one size with forces
    dt: float
    air: Floats  # least scale of residuals of channels in the air, in N or N m, shape (K,)
    com_std: float = COM

    @property
    def force(self) -> Floats:
        """Forces by the starting map in N, shape (N, K)."""
        force: Floats = np.asarray(self.initial.force(self.raw))
        return force


class Fit(NamedTuple):
    """How well claims hold."""

    evidence: float  # natural logarithm
    scales: Floats  # of residuals in those of a sound log: force, centre of pressure, in the air; shape (3,)
    map: Parameters  # a and b of F = a F0 + b, b in weights; the median over windows
    rows: int  # blocks that were used
    counted: float = 0.0  # number of independent rows

    @property
    def size(self) -> float:
        """Geometric mean of the residuals in those assumed, with the costs of changing the map."""
        return float(np.exp(-self.evidence / max(self.counted, 1.0)))

    @property
    def worst(self) -> float:
        """The largest scale of residuals, in that of a sound log."""
        return float(self.scales.max())


def claims_of(log: Log, initial: Parameters, length: float) -> Claims:
    """Claims of a log, readings moved to the moments of the references."""
    weight, count = log.mass * GRAVITY, len(log) - log.lag
    plausible = np.abs(initial.force(log.raw)) <= OnlineSetup.plausible_weights * weight
    # Rows that repeat all channels are those of a chip slower than them: old readings, and no new ones.
    held = np.concatenate([[False], (np.diff(log.raw, axis=0) == 0.0).all(axis=1)])[:, None]
    read = _fill(np.where(plausible & ~held, log.raw, np.nan)[:count], round(HELD / log.dt))
    late = take_rows(log.reference, slice(log.lag, None))
    wrench_map = log.layout.wrench_map
    air = AIR * weight * np.where(_torques(wrench_map), length, 1.0)
    return Claims(read, initial, late, wrench_map, weight, length, log.dt, air)


def _torques(wrench_map: Floats) -> NDArray[np.bool_]:
    """Return which channels are torques, shape (K,)."""
    found: NDArray[np.bool_] = ~(wrench_map[:, :3] != 0.0).any(axis=(0, 1))
    return found


def _fill(raw: Floats, most: int) -> Floats:
    """Draw lines over gaps of up to ``most`` samples; a channel that is rarely read counts as unread."""
    filled = raw.copy()
    rows = np.arange(len(raw))
    for i, column in enumerate(raw.T):
        there = np.flatnonzero(np.isfinite(column))
        if len(there) < 2:
            continue
        after = np.minimum(np.searchsorted(there, rows), len(there) - 1)
        before = np.maximum(after - 1, 0)
        near = (there[after] - there[before] <= most) & (rows <= there[-1]) & (rows >= there[0])
        filled[:, i] = np.where(near, np.interp(rows, there, column[there]), column)
    return filled


class _Rows(NamedTuple):
    """Linear rows in units of their least scale: residual = H theta - y."""

    H: Floats
    y: Floats
    kind: NDArray[np.intp]  # 0 force, 1 moments, 2 in the air
    blocks: int


def fit_claims(claims: Claims) -> Fit:
    """Fit claims as :func:`fit_parts` does."""
    return fit_parts(condense(claims))


def fit_parts(parts: Sequence[Claims], without: int | None = None, widths: Sequence[float] = WIDTHS) -> Fit:
    """Fit condensed claims, each part by a map of its own, and add up the evidence.

    ``without`` is a channel that is left out: its load is open at every moment. Of the ``widths`` of the
    map's prior the likeliest counts.
    """
    found = []
    for one in parts:
        if len(one.raw) >= FEWEST:
            written = _rows(one, without)
            fits = [_fit_with(written, one, width) for width in widths]
            found.append(max(fits, key=lambda fit: fit.evidence))
    if not found:
        ones = np.ones(parts[0].raw.shape[1])
        return Fit(0.0, np.zeros(3), Parameters(ones, 0.0 * ones), 0)
    middle = [np.median(values, axis=0) for values in zip(*((p.scales, *p.map) for p in found), strict=True)]
    evidence, rows = float(sum(part.evidence for part in found)), sum(part.rows for part in found)
    evidence += ABSURD * _legs_cross(parts[0].reference)
    counted = sum(part.counted for part in found)
    return Fit(evidence, middle[0], Parameters(*middle[1:]), rows, counted)


def condense(claims: Claims) -> list[Claims]:
    """Return claims of blocks, in up to :data:`WINDOWS` parts: means over samples that hold everything.

    A foot stands, or swings, in all of a block or not.
    """
    return [_condense(one) for one in _windows(claims)]


def _legs_cross(reference: Reference) -> bool:
    """Return whether the left sole is to the right of the right one, most of the time."""
    if reference.position_sole.shape[1] != 2 or len(reference.com) == 0:
        return False
    left = reference.R_level_sole[..., 1].sum(axis=1)
    apart = reference.position_sole[:, 0] - reference.position_sole[:, 1]
    return bool(np.nanmedian(np.einsum("ni,ni->n", left, apart)) < 0.0)


def parts_of(claims: Claims, count: int = 3) -> list[Claims]:
    """Return a log in so many parts of one length, in order."""
    edges = np.linspace(0, len(claims.raw), count + 1).astype(int)
    return [_cut(claims, slice(first, end)) for first, end in pairwise(edges)]


def _windows(claims: Claims) -> list[Claims]:
    size, n = round(WINDOW / claims.dt), len(claims.raw)
    if n <= size:
        return [claims]
    count = min(WINDOWS, -(-n // size))
    starts = np.linspace(0, n - size, count).astype(int)
    return [_cut(claims, slice(start, start + size)) for start in starts]


def _cut(claims: Claims, where: slice) -> Claims:
    return replace(claims, raw=claims.raw[where], reference=take_rows(claims.reference, where))


def _condense(claims: Claims) -> Claims:
    size = max(1, round(BLOCK / claims.dt))
    blocks = len(claims.raw) // size
    end, reference = blocks * size, claims.reference
    named = ("com", "com_acceleration", "angular_momentum_rate", "position_sole", "R_level_sole")
    parts = [claims.raw, *(np.asarray(getattr(reference, name)) for name in named)]
    flat = np.concatenate([part[:end].reshape(end, -1) for part in parts], axis=1)
    whole = np.isfinite(flat).all(axis=1).astype(float).reshape(blocks, size)
    kept = whole.sum(axis=1) > 0.0
    share = whole[kept] / whole[kept].sum(axis=1, keepdims=True)
    means = np.einsum("bs,bsc->bc", share, np.nan_to_num(flat).reshape(blocks, size, -1)[kept])
    edges = np.cumsum([part[0].size for part in parts])[:-1]
    raw, *found = (
        values.reshape(-1, *part.shape[1:])
        for values, part in zip(np.split(means, edges, axis=1), parts, strict=True)
    )
    stance, swing = (
        np.asarray(part)[:end].reshape(blocks, size, -1)[kept].all(axis=1)
        for part in (reference.stance, reference.swing)
    )
    beliefs = reference._replace(**dict(zip(named, found, strict=True)), stance=stance, swing=swing)
    return replace(claims, raw=raw, reference=beliefs)


def _rows(claims: Claims, without: int | None = None) -> _Rows:
    """Write the rows of blocks; unknowns are a and b of K channels, the centre of mass and the mass."""
    columns, asked = ground_rows(claims)
    force, swing = claims.force, claims.reference.swing
    # Where all feet are in the air nobody knows what else bears the robot.
    stands = ~swing.all(axis=1)
    y, by_offset = asked[stands], columns[stands]
    by_scale = by_offset * force[stands][:, None, :]
    own = np.zeros((len(y), y.shape[1], 3))  # of the centre of mass (2) and the mass
    own[:, 1, 1], own[:, 2, 0], own[:, :, 2] = -y[:, 0], y[:, 0], -y
    H = np.concatenate([by_scale / claims.weight, by_offset, own], axis=2)
    floor = np.array([FORCE, COP, COP, FORCE, FORCE])[: y.shape[1], None]
    H, y, kind = H / floor, y / floor[:, 0], np.array([0, 1, 1, 0, 0])[: y.shape[1]]
    if without is not None:
        # Two directions of three (or more) that the channel does not act along.
        Q = np.linalg.svd((by_offset[:, :, without] / floor[:, 0])[:, :, None])[0][:, :, 1:]
        H, y, kind = np.einsum("nij,nik->njk", Q, H), np.einsum("nij,ni->nj", Q, y), kind[1:]
    air, y_air = _write_air_rows(claims, swing, force, without)
    H = np.concatenate([H.reshape(-1, H.shape[2]), air])
    kinds = np.concatenate([np.tile(kind, len(y)), np.full(len(air), 2)])
    return _Rows(H, np.concatenate([y.ravel(), y_air]), kinds, len(force))


def ground_rows(claims: Claims) -> tuple[Floats, Floats]:
    """Return rows by a newton on each channel, and their values that the motion requires.

    Rows are the vertical force in weights, both moments below the centre of mass in weights times m, and, if
    every foot sees them, the horizontal forces: (N, rows, K) and (N, rows).
    """
    reference, wrench_map = claims.reference, claims.wrench_map
    position, R = reference.position_sole, reference.R_level_sole
    ground = position[..., 2].min(axis=1)
    f = np.einsum("nfij,fjk->nfik", R, wrench_map[:, :3])
    arm = position - np.column_stack([reference.com[:, :2], ground])[:, None]
    t = np.einsum("nfij,fjk->nfik", R, wrench_map[:, 3:]) + np.cross(arm[..., None], f, axis=2)
    (x, y, z), spin = (
        reference.com_acceleration.T / GRAVITY,
        reference.angular_momentum_rate.T / claims.weight,
    )
    height = reference.com[:, 2] - ground
    asked = np.column_stack([z + 1.0, spin[0] - height * y, spin[1] + height * x, x, y])
    seen = 5 if (wrench_map != 0.0).any(axis=2).all() else 3
    columns = np.concatenate([f[:, :, 2:], t[:, :, :2], f[:, :, :2]], axis=2).sum(axis=1)
    return columns[:, :seen], asked[:, :seen]


def _write_air_rows(
    claims: Claims, swing: NDArray[np.bool_], force: Floats, without: int | None
) -> tuple[Floats, Floats]:
    """Write the rows of channels whose foot swings through a whole block: they carry nothing."""
    K = force.shape[1]
    air = swing[:, (claims.wrench_map != 0.0).any(axis=1).argmax(axis=0)]
    if without is not None:
        air[:, without] = False
    block, channel = np.nonzero(air)
    # By its mean in the air: a scale that shrank would make the noise of each reading smaller.
    mean = np.where(air, force, 0.0).sum(axis=0) / np.maximum(air.sum(axis=0), 1)
    unit = claims.air
    H = np.zeros((len(block), 2 * K + 3))
    row = np.arange(len(block))
    H[row, channel] = mean[channel] / unit[channel]
    H[row, K + channel] = claims.weight / unit[channel]
    return H, (mean[channel] - force[block, channel]) / unit[channel]


def _fit_with(rows: _Rows, claims: Claims, width: float) -> Fit:
    K = claims.raw.shape[1]
    offset = width * OFFSET * np.where(_torques(claims.wrench_map), claims.length, 1.0)
    std = np.concatenate([np.full(K, width * SCALE), offset, [claims.com_std] * 2, [MASS]])
    # theta = start + std u, so that the prior of u is the identity.
    start = np.concatenate([np.ones(K), np.zeros(K + 3)])
    H, y = rows.H * std, rows.y - rows.H @ start
    number = np.bincount(rows.kind, minlength=3)
    share = min(1.0, BLOCK / LASTING)
    u, information, r = np.zeros(len(std)), np.eye(len(std)), -y
    s = np.array([np.median(np.abs(r[rows.kind == k])) if number[k] else 0.0 for k in range(3)])
    s = np.maximum(1.0, s / NORMAL)
    for _ in range(ITERATIONS):
        scale = s[rows.kind]
        weight = (TAIL + 1.0) / (TAIL + (r / scale) ** 2)
        WH = H * (share * weight / scale**2)[:, None]
        information = H.T @ WH + np.eye(len(std))
        u = np.linalg.solve(information, WH.T @ y)
        r = H @ u - y
        power = np.bincount(rows.kind, weight * r**2, minlength=3) / np.maximum(number, 1)
        before, s = s, np.maximum(1.0, np.sqrt(power))
        if np.abs(s / before - 1.0).max() < SETTLED:
            break
    # A row that is as noisy as assumed counts 0 on average: predictions that come true are worth something.
    usual = (TAIL + 1.0) / 2.0 * (digamma((TAIL + 1.0) / 2.0) - digamma(TAIL / 2.0))
    z = r / s[rows.kind]
    likelihood = usual - np.log(s[rows.kind]) - (TAIL + 1.0) / 2.0 * np.log1p(z**2 / TAIL)
    evidence = float(share * likelihood.sum() - 0.5 * u @ u - 0.5 * np.linalg.slogdet(information)[1])
    theta = start + std * u
    evidence += ABSURD * float((theta[:K] < 0.0).sum())
    found = Parameters(theta[:K], theta[K : 2 * K])
    return Fit(evidence, s * (number > 0), found, rows.blocks, share * len(r))
