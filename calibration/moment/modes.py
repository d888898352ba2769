r"""Forces on the robot besides those of its feet: almost none, a hand that moves, or a steady one.

An external wrench w has a time constant and a standard deviation, which differ between modes. The modes form
an interacting multiple model (Blom and Bar-Shalom, 1988): each is a Kalman filter of its own. Before each
block they are mixed by their transition probabilities, and after it they are weighed by their innovations. A
newly entered mode starts from a fresh prior on w.

* **free**: errors of the model, and small pushes.
* **held**: a hand, a gantry or a chair. It absorbs the innovations, and the cells learn nothing from them.
* **steady**: a hand on a wall or a rail, a crutch, or something that was picked up. Its wrench is estimated
  together with the map. What both can explain stays undetermined.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.columns import Columns
from surefoot.calibration.moment.model import Rows, force_and_wrench
from surefoot.calibration.moment.state import Belief


class Mode(NamedTuple):
    """How an external wrench behaves."""

    time: float  # time constant in s
    force: float  # standard deviation of a force in W
    torque: float
    """Standard deviation of a torque about the feet's centre of pressure, in W times the height of the centre
    of mass."""


FREE = Mode(2.0, 0.002, 0.004)
"""A robot that nobody touches: air, cables and an imperfect model, 0.2 % of its weight, and an attitude error
of 4 mrad, which is 3 mm under a robot as tall as a man."""

HELD = Mode(2.0, 0.2, 0.08)
"""A robot that somebody holds, with a fifth of its weight and a twelfth of its height."""

STEADY = Mode(15.0, 0.03, 0.025)
"""A hand that bears some percent of the weight and changes within a quarter of a minute. Chosen on robots
that walk along a rail, stand at a wall and sway there. Hands twice as large fit as well, but a filter that
expects them recognises a hand of 5 % only on every second robot, and with half the torque it mistakes
payloads for hands."""

MODES = FREE, HELD, STEADY

RATES = np.array([(0.0, 1 / 60, 1 / 60), (1 / 20, 0.0, 1 / 300), (1 / 60, 1 / 60, 0.0)])
"""Rates at which modes (rows) change into others (columns), in 1/s: in a minute of work somebody takes hold
of a robot once and lets it go after 20 s, and a robot puts a hand on something for a minute."""

FIRST_CHANCE = np.array([0.96, 0.02, 0.02])  # probabilities of the modes at the start

LEAST_CHANCE = 1e-6
"""Smallest probability of a mode, so that a robot that was free for an hour is recognised as held within two
blocks."""


def wrench_variance(mode: Mode, rows: Rows) -> Array:
    """Return the variances of an external wrench, and of errors that act like one, shape (C,)."""
    force = force_and_wrench(len(rows.measured))
    outside: Array = force * mode.force**2 + (1.0 - force) * (mode.torque * rows.height) ** 2
    return outside + rows.lasting


def mix(belief: Belief, rows: Rows, columns: Columns, duration: float) -> Belief:
    """Mix the modes by their transition probabilities.

    Args:
        belief: Posteriors of the modes.
        rows: The following block.
        columns: The unknowns.
        duration: Time in s since the last mixing.
    """
    turning = RATES * duration
    turning = turning + np.diag(1.0 - turning.sum(axis=1))
    chance = belief.chance @ turning
    share = turning * belief.chance[:, None] / chance
    means, covariances = [], []
    for j, mode in enumerate(MODES):
        mean, covariance = belief.mean.copy(), belief.covariance.copy()
        for i in range(len(MODES)):
            if i != j:
                begin(mean[i], covariance[i], columns.wrench, wrench_variance(mode, rows))
        mean, covariance = combine(share[:, j], mean, covariance)
        means.append(mean)
        covariances.append(covariance)
    return belief._replace(mean=np.stack(means), covariance=np.stack(covariances), chance=chance)


def begin(mean: Array, covariance: Array, part: slice, variance: Array) -> None:
    """Restart unknowns in place, with a mean of 0."""
    mean[part] = 0.0
    covariance[part], covariance[:, part] = 0.0, 0.0
    covariance[part, part] = np.diag(variance)


def begin_momentum(belief: Belief, rows: Rows, columns: Columns) -> Belief:
    """Restart the momentum from the measurement at a block's end, and the wrench from its prior."""
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

    belief: Belief  # posteriors of the modes at its end, with unchanged probabilities
    likelihood: Array  # logarithm of the block's likelihood in each mode, under the wide prior, shape (J,)
    nis: float  # normalised squared innovation of the mode that was likeliest before


def learn(belief: Belief, rows: Rows, columns: Columns, duration: float) -> Step:
    """Predict a block's mean momentum in each mode, take in its measurement, and predict its end.

    Args:
        belief: Posteriors of the modes about the block's point o.
        rows: The block.
        columns: The unknowns.
        duration: Duration of the block in s.
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
        # The mass is considered and not estimated (Schmidt, 1966). While somebody holds the robot, that holds
        # for everything but its momentum.
        considered = slice(0, columns.momentum.start) if mode is HELD else columns.mass
        mean, covariance = update(mean, covariance, rows.mean, innovation, variance, considered)
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


def support_probability(belief: Belief, columns: Columns) -> float:
    """Return the probability that something other than the feet bears a part of the weight.

    In the steady mode that is the probability that the vertical force is directed upwards.
    """
    steady, vertical = MODES.index(STEADY), columns.wrench.start
    mean, variance = belief.mean[steady, vertical], belief.covariance[steady, vertical, vertical]
    upwards = ndtr(mean / np.sqrt(variance))
    return float(belief.chance[MODES.index(HELD)] + belief.chance[steady] * upwards)


def weigh_modes(chance: Array, evidence: Array) -> Array:
    """Return the probabilities of the modes after a block with this logarithmic evidence, shapes (J,)."""
    weight = chance * np.exp(evidence - evidence.max())
    weight = np.maximum(weight / weight.sum(), LEAST_CHANCE)
    found: Array = weight / weight.sum()
    return found


def update(
    mean: Array, covariance: Array, H: Array, innovation: Array, variance: Array, considered: slice
) -> tuple[Array, Array]:
    """Update a mean and a covariance with rows, by Joseph's form.

    Args:
        mean: Shape (N,).
        covariance: Shape (N, N).
        H: Rows, shape (m, N).
        innovation: Shape (m,).
        variance: Of the rows, shape (m, m).
        considered: Unknowns that are considered and not estimated.
    """
    predicted = H @ covariance
    gain = np.linalg.solve(predicted @ H.T + variance, predicted).T
    gain[considered] = 0.0
    keep = np.eye(len(mean)) - gain @ H
    joseph = keep @ covariance @ keep.T + gain @ variance @ gain.T
    return mean + gain @ innovation, 0.5 * (joseph + joseph.T)
