r"""Choose calibration motions that lower the posterior bound of a robot's feet the most per second.

The posterior bound (:mod:`surefoot.calibration.excitation.bound`) after a motion follows from the covariance
before it, the motion, and the model that the moment filter assumes. It needs neither an estimate nor drawn
errors. All motions start and end in the same posture, so that they can be played in any order.

A plan is a beam search forward in time. Sequences that end within the same half second compete, and the ten
with the lowest standard deviation of the goal are continued with each motion. Scales and offsets drift while
the robot moves, so that a motion can also increase the bound. The result is not the optimum;
``benchmarks/calibration_motion.py`` compares it with other sequences.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.excitation.bound import LogPassages
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import Reference
from surefoot.calibration.setup import OnlineSetup, setup_from_options
from surefoot.checks import check_value

PIECE = 0.5  # duration in s within which sequences of motions compete; chosen
KEPT = 10  # number of sequences that are continued from each piece; chosen

GOALS = ("cop", "channel")
"""Goals: the standard deviation of the centre of pressure, or that of the worst channel's force."""


class FootMotion(NamedTuple):
    """One motion that a robot can do, n samples long.

    Attributes:
        force: Ideal readings of the channels in N (or the channel's unit), shape (n, K).
        reference: The robot's reference at those samples, shifted by the lag.
    """

    force: Floats
    reference: Reference


@dataclass(frozen=True, eq=False, kw_only=True)
class MovingRobot:
    """A robot for the planner."""

    mass: float
    """In kg."""

    motions: Mapping[str, FootMotion]
    """Possible motions by name. All start and end in the same posture."""

    dt: float = 1.0 / 80.0
    """Time between samples in s."""

    lag: int = 2
    """Delay of the reference in samples."""


@dataclass(frozen=True, eq=False)
class FootExcitation:
    """Chosen motions, and their gain."""

    goal: str  # one of :data:`GOALS`
    motions: tuple[str, ...]  # their names, in order
    time: Floats  # time after each in s, shape (S,)
    before: float  # initial standard deviation of the goal, in m (centre of pressure) or N (channel)
    std: Floats  # standard deviation after each motion, shape (S,)
    rates: Mapping[str, float]
    """Information per second of each possible motion when it is played first, in nats: the logarithm of the
    ratio of standard deviations before and after, divided by its duration."""
    covariance_before: Floats  # initial covariance of (a, b) of all channels, shape (2K, 2K)
    covariance: Floats  # covariance after the last motion


def plan_foot_excitation(
    layout: FeetLayout,
    robot: MovingRobot,
    budget: float,
    *,
    goal: str = "cop",
    enough: float = 0.0,
    motions: Sequence[str] | None = None,
    **options: Any,
) -> FootExcitation:
    """Choose a sequence of motions.

    Args:
        layout: The map from channels to wrenches of the feet.
        robot: The robot and its motions.
        budget: Maximum duration in s.
        goal: ``"cop"``: the root mean square of the centre of pressure's standard deviation over all samples
            of all motions, in m; ``"channel"``: that of the worst channel's force in N.
        enough: Standard deviation of the goal at which the plan ends early.
        motions: A fixed sequence to evaluate instead of a search.
        **options: Fields of :class:`~surefoot.calibration.OnlineSetup` and of the moment filter.

    Raises:
        ValueError: If an argument is out of its range, a motion does not exist, or none fits into the budget.
    """
    check_value("budget", budget, positive=True)
    if goal not in GOALS:
        raise ValueError(f"'goal' must be one of {GOALS}, got '{goal}'.")
    if unknown := [name for name in motions or () if name not in robot.motions]:
        raise ValueError(f"The robot cannot do '{unknown[0]}'. It can do: {', '.join(robot.motions)}.")
    setup, rest = setup_from_options(
        layout, mass=robot.mass, initial=None, dt=robot.dt, lag=robot.lag, options=options
    )
    planner = _Planner(setup, robot, goal, Moment(**rest))
    start = planner.after([])
    chosen = planner.search(budget, enough) if motions is None else list(motions)
    if not chosen:
        shortest = min(planner.length.values())
        raise ValueError(
            f"No motion is chosen: the goal's {start.std:.3g} are no more than 'enough', {enough:g}, or "
            f"nothing fits into a budget of {budget:g} s; the shortest motion takes {shortest:g} s."
        )
    done = [planner.after(chosen[: k + 1]) for k in range(len(chosen))]
    single = {name: planner.after([name]) for name in robot.motions}
    rates = {name: float(np.log(start.std / after.std) / after.time) for name, after in single.items()}
    return FootExcitation(
        goal=goal,
        motions=tuple(chosen),
        time=np.array([after.time for after in done]),
        before=start.std,
        std=np.array([after.std for after in done]),
        rates=MappingProxyType(rates),
        covariance_before=planner.log.of_parameters(start.covariance, 0),
        covariance=planner.log.of_parameters(done[-1].covariance, 0),
    )


def _passages_of(setup: OnlineSetup, motion: FootMotion, config: Moment) -> LogPassages:
    shape = motion.force.shape
    return LogPassages(setup, *motion, Parameters(np.ones(shape), np.zeros(shape)), config)


class _Sequence(NamedTuple):
    """Motions one after the other, and the result."""

    std: float  # the goal's standard deviation after them
    time: float  # their duration in s
    names: tuple[str, ...]
    covariance: Floats  # of the filter's unknowns after them, shape (N, N)


class _Planner:
    """Evaluates sequences of a robot's motions.

    The goal's variance is the largest of some traces :math:`tr(W S)`, with :math:`S` the covariance of the
    scales and offsets. ``length`` is the duration of each motion in s, ``log`` the passages of the first one.
    """

    def __init__(self, setup: OnlineSetup, robot: MovingRobot, goal: str, config: Moment) -> None:
        logs = {name: _passages_of(setup, motion, config) for name, motion in robot.motions.items()}
        self.length = {name: robot.dt * len(motion.force) for name, motion in robot.motions.items()}
        self.log = next(iter(logs.values()))
        self._passages = {name: log.whole() for name, log in logs.items()}
        weights = []
        for log in logs.values():
            to_force, _, to_cop = log.error_rows(slice(None))
            if goal == "cop":
                rows = to_cop[np.isfinite(to_cop).all(axis=(1, 2))]
                weights.append(np.einsum("nip,niq->pq", rows, rows)[None] / max(len(rows), 1))
            else:
                weights.append(np.einsum("nip,niq->ipq", to_force, to_force) / len(to_force))
        self._weights = np.mean(weights, axis=0)

    def after(self, names: Sequence[str]) -> _Sequence:
        """Return the result of motions in an order."""
        result = _Sequence(self._std(self.log.start), 0.0, (), self.log.start)
        for name in names:
            result = self._then(result, name)
        return result

    def search(self, budget: float, enough: float) -> list[str]:
        """Return the best motions within a time in s, or the first whose deviation is ``enough``."""
        pieces = int(budget / PIECE + 1e-9)
        waiting: list[list[_Sequence]] = [[] for _ in range(pieces + 1)]
        waiting[0] = [best := self.after([])]
        for ends in waiting:
            for sequence in sorted(ends, key=lambda one: one.std)[:KEPT]:
                if best.std <= enough:
                    return list(best.names)
                for name in self._passages:
                    if sequence.time + self.length[name] <= budget + 1e-9:
                        longer = self._then(sequence, name)
                        waiting[min(int(longer.time / PIECE), pieces)].append(longer)
                        best = min(best, longer, key=lambda one: one.std)
        return list(best.names)

    def _then(self, sequence: _Sequence, name: str) -> _Sequence:
        covariance = self._passages[name].after(sequence.covariance)
        time, names = sequence.time + self.length[name], (*sequence.names, name)
        return _Sequence(self._std(covariance), time, names, covariance)

    def _std(self, covariance: Floats) -> float:
        traces = np.einsum("kpq,qp->k", self._weights, self.log.of_parameters(covariance, 0))
        return float(np.sqrt(traces.max()))
