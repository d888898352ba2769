r"""Forces on the robot besides those of its feet: hardly any, a hand, or a load.

An outside wrench w comes and goes with a time constant, and modes differ in how large it may be. They
are an interacting multiple model (Blom and Bar-Shalom, 1988): each mode is a Kalman filter of its own, they
are mixed before each block by how likely one turns into the other, and weighed by their innovations
afterwards. Who changes mode begins with a w of its own.

* **free**: errors of the model, and small pushes.
* **held**: a hand, a gantry, a chair. It takes the innovations, and the cells learn nothing of them.
* **loaded**: free, but heavier by something that was picked up or put on, and stays.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.columns import Columns
from surefoot.calibration.moment.model import Rows, force_and_wrench
from surefoot.calibration.moment.state import Belief


class Mode(NamedTuple):
    """How an outside wrench behaves, and the load on the robot."""

    time: float  # the wrench's time constant in s
    force: float  # its standard deviation in W
    torque: float  # the same about the feet's centre of pressure, in W times the height of the centre of mass
    load: float = 0.0  # standard deviation of the robot's load, as a share of its weight
    shift: float = 0.0  # by how much a load moves the centre of mass along each axis, in m


FREE = Mode(2.0, 0.002, 0.004)
"""A robot that nobody touches: air, cables and a model that is a little wrong, 0.2 % of its weight, and
an attitude that is off by 4 mrad: 3 mm under a robot that is as tall as a man."""

HELD = Mode(2.0, 0.2, 0.08)
"""A robot that somebody holds: a fifth of its weight, and a twelfth of its height off."""

LOADED = FREE._replace(load=0.1, shift=0.01)
"""A robot that carries a tenth of its weight, ten centimetres from its centre of mass."""

MODES = FREE, HELD, LOADED

RATES = np.array([(0.0, 1 / 60, 1 / 300), (1 / 20, 0.0, 1 / 300), (1 / 300, 1 / 60, 0.0)])
"""How often modes (in rows) turn into others (in columns), in 1/s: somebody takes hold of a robot once in a
minute of work with it and lets it go after 20 s, and it picks something up in five minutes."""

FIRST_CHANCE = np.array([0.977, 0.02, 0.003])  # how likely modes are at the start

LEAST_CHANCE = 1e-6
"""Chance that a mode keeps, and that of a load in its likelihood: who was free for an hour is believed to be
held within two blocks."""


def wrench_variance(mode: Mode, rows: Rows) -> Array:
    """Return the variances of an outside wrench, and of errors that act like one, shape (C,)."""
    force = force_and_wrench(len(rows.measured))
    outside: Array = force * mode.force**2 + (1.0 - force) * (mode.torque * rows.height) ** 2
    return outside + rows.lasting


def mix(belief: Belief, rows: Rows, columns: Columns, duration: float, mass_std: float) -> Belief:
    """Let modes turn into each other.

    Args:
        belief: The modes' posteriors.
        rows: The block that follows.
        columns: The unknowns.
        duration: For how long, in s.
        mass_std: How far the mass is thought to be off without a load, relative.
    """
    turning = RATES * duration
    turning = turning + np.diag(1.0 - turning.sum(axis=1))
    chance = belief.chance @ turning
    share = turning * belief.chance[:, None] / chance
    means, covariances = [], []
    for j in range(len(MODES)):
        parts = [
            _turn_into(j, belief, i, rows, columns, mass_std)
            if i != j
            else (belief.mean[i], belief.covariance[i])
            for i in range(len(MODES))
        ]
        mean, covariance = combine(share[:, j], *(np.stack(part) for part in zip(*parts, strict=True)))
        means.append(mean)
        covariances.append(covariance)
    return Belief(np.stack(means), np.stack(covariances), chance)


def _turn_into(
    j: int, belief: Belief, i: int, rows: Rows, columns: Columns, mass_std: float
) -> tuple[Array, Array]:
    """Turn mode i into mode j: the wrench starts again, and so does a load."""
    before, mode = MODES[i], MODES[j]
    mean, covariance = belief.mean[i].copy(), belief.covariance[i].copy()
    begin(mean, covariance, columns.wrench, wrench_variance(mode, rows))
    if mode.load != before.load:
        begin(mean, covariance, columns.mass, np.array([mass_std**2 + mode.load**2]))
        at = np.arange(columns.com.start, columns.com.stop)
        covariance[at, at] += (mode.shift - before.shift) ** 2
    return mean, covariance


def begin(mean: Array, covariance: Array, part: slice, variance: Array) -> None:
    """Let unknowns start again in place, at 0."""
    mean[part] = 0.0
    covariance[part], covariance[:, part] = 0.0, 0.0
    covariance[part, part] = np.diag(variance)


def begin_momentum(belief: Belief, rows: Rows, columns: Columns) -> Belief:
    """Let the momentum begin with the measurement at a block's end, and the wrench too."""
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    for i, mode in enumerate(MODES):
        begin(mean[i], covariance[i], columns.wrench, wrench_variance(mode, rows))
        begin(mean[i], covariance[i], columns.momentum, np.zeros(columns.components))
        mean[i, columns.momentum] = rows.at_end
        covariance[i, columns.momentum, columns.momentum] = rows.variance
    return belief._replace(mean=mean, covariance=covariance)


def combine(chance: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the mean and the covariance of a mixture, shapes (J,), (J, N), (J, N, N) to (N,), (N, N)."""
    mixed = chance @ mean
    apart = mean - mixed
    return mixed, np.tensordot(chance, covariance, 1) + (chance * apart.T) @ apart


class Step(NamedTuple):
    """Result of a block; J modes."""

    belief: Belief  # the modes' posteriors at its end; how likely they are is as before
    likelihood: Array  # logarithm of the block's likelihood in each mode, under the wide prior, shape (J,)
    nis: float  # innovation squared of the mode that was likeliest before, normalised


def learn(belief: Belief, rows: Rows, columns: Columns, duration: float) -> Step:
    """Predict the block's mean momentum in each mode, measure it, and go on to the block's end.

    Args:
        belief: The modes' posteriors about the block's point o.
        rows: The block.
        columns: The unknowns.
        duration: Of the block in s.
    """
    # The mean over a block of a random walk within it has a third of its variance at the end.
    variance = rows.variance + rows.walk / 3.0
    means, covariances, likelihoods, nis = [], [], [], []
    wrench = np.arange(columns.wrench.start, columns.wrench.stop)
    momentum = columns.momentum
    for i, mode in enumerate(MODES):
        mean, covariance = belief.mean[i].copy(), belief.covariance[i].copy()
        decay = np.exp(-duration / mode.time)
        mean[wrench] *= decay
        covariance[wrench] *= decay
        covariance[:, wrench] *= decay
        covariance[wrench, wrench] += wrench_variance(mode, rows) * (1.0 - decay**2)
        innovation = rows.measured - rows.mean @ mean - rows.mean_rest
        expected = rows.mean @ covariance @ rows.mean.T + variance
        nis.append(float(innovation @ np.linalg.solve(expected, innovation)))
        likelihoods.append(-0.5 * (nis[i] + np.linalg.slogdet(expected)[1]))
        # A load's weight is estimated; the robot's own is only considered (Schmidt, 1966),
        # and so is all but the momentum while somebody holds it.
        considered = columns.mass if mode.load == 0.0 else slice(0)
        if mode is HELD:
            considered = slice(0, columns.momentum.start)
        mass = columns.mass.start
        before = chance_of_load(mean, covariance, mass) if mode.load > 0.0 else 1.0
        mean, covariance = update(mean, covariance, rows.mean, innovation, variance, considered)
        if mode.load > 0.0:
            likelihoods[i] += np.log(chance_of_load(mean, covariance, mass) / before)
            mean = keep_heavier(mean, covariance, mass)
        forward = np.eye(len(mean))
        forward[momentum] = rows.end
        mean = forward @ mean
        mean[momentum] += rows.end_rest
        covariance = forward @ covariance @ forward.T
        covariance[momentum, momentum] += rows.walk
        means.append(mean)
        covariances.append(0.5 * (covariance + covariance.T))
    learnt = belief._replace(mean=np.stack(means), covariance=np.stack(covariances))
    return Step(learnt, np.array(likelihoods), nis[int(belief.chance.argmax())])


def chance_of_load(mean: Array, covariance: Array, mass: int) -> float:
    """Return the chance that a load is not negative: likelihoods are those of such loads alone."""
    variance = float(covariance[mass, mass])
    return max(float(ndtr(-mean[mass] / np.sqrt(variance))), LEAST_CHANCE) if variance > 0.0 else 1.0


def keep_heavier(mean: Array, covariance: Array, mass: int) -> Array:
    """Return the likeliest mean of which a load is not negative (Simon and Simon, 2006).

    Forces and weight together may shrink to nothing otherwise, which explains errors of any reading.
    """
    lighter = float(mean[mass])
    if not (lighter > 0.0 and covariance[mass, mass] > 0.0):
        return mean
    kept = mean - lighter / covariance[mass, mass] * covariance[mass]
    kept[mass] = 0.0
    return kept


def weigh_modes(chance: Array, evidence: Array) -> Array:
    """Return how likely modes are after a block, by its logarithmic evidence, shapes (J,)."""
    weight = chance * np.exp(evidence - evidence.max())
    weight = np.maximum(weight / weight.sum(), LEAST_CHANCE)
    found: Array = weight / weight.sum()
    return found


def update(
    mean: Array, covariance: Array, H: Array, innovation: Array, variance: Array, considered: slice
) -> tuple[Array, Array]:
    """Take in rows by Joseph's form.

    Args:
        mean: Shape (N,).
        covariance: Shape (N, N).
        H: Rows, shape (m, N).
        innovation: Shape (m,).
        variance: Of the rows, shape (m, m).
        considered: Unknowns that are considered and not estimated (Schmidt, 1966).
    """
    predicted = H @ covariance
    gain = np.linalg.solve(predicted @ H.T + variance, predicted).T
    gain[considered] = 0.0
    keep = np.eye(len(mean)) - gain @ H
    joseph = keep @ covariance @ keep.T + gain @ variance @ gain.T
    return mean + gain @ innovation, 0.5 * (joseph + joseph.T)
