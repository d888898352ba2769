r"""Plans of a robot's motions to calibrate its feet: the motions that lower the bound most per second.

The posterior bound (:mod:`surefoot.calibration.excitation.bound`) of a motion needs no estimate and no drawn
error: the covariance after it follows from the covariance before it, the motion, and the model that the
moment filter assumes. A plan is made from motions that all start and end in one posture, so that any can
follow any. It is found forward in time: whatever ends within the same half second competes, the ten orders
with the least standard deviation of the goal stay, and each goes on with every motion. Scales and offsets
drift while the robot moves, which is part of the covariance; a motion can therefore bring less than nothing.
This is not the optimum; ``benchmarks/calibration_motion.py`` holds it against other orders.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.excitation.bound import LogPassages, Passage
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import Reference
from surefoot.calibration.setup import OnlineSetup, setup_from_options
from surefoot.checks import check_value

PIECE = 0.5  # pieces in s that time is cut into: of what ends within the same one, the best is kept
KEPT = 10  # how many are kept of each

GOALS = ("cop", "channel")
"""What a plan lowers: the error of the centre of pressure, or that of the worst channel's force."""


class FootMotion(NamedTuple):
    """One motion that a robot can do, n samples long.

    Attributes:
        force: Readings of the feet's channels without errors in N (or the channel's unit), shape (n, K).
        reference: The robot's beliefs at those samples, less the lag.
    """

    force: Floats
    reference: Reference


@dataclass(frozen=True, eq=False, kw_only=True)
class MovingRobot:
    """A robot as a planner sees it."""

    mass: float
    """In kg."""

    motions: Mapping[str, FootMotion]
    """What it can do, by name; each starts and ends in one and the same posture."""

    dt: float = 1.0 / 80.0
    """Time between samples in s."""

    lag: int = 2
    """How many samples ago the foot sample was taken that a reference describes."""


@dataclass(frozen=True, eq=False)
class FootExcitation:
    """Motions to do, and their gain."""

    goal: str  # the quantity to lower
    motions: tuple[str, ...]  # their names, in order
    time: Floats  # time after each in s, shape (S,)
    before: float  # the goal's standard deviation before, in m for the centre of pressure and N for a channel
    std: Floats  # that after each motion, shape (S,)
    rates: Mapping[str, float]
    """Information per second that each possible motion would bring first, in nats: the logarithm of standard
    deviation before by after, over its duration."""
    covariance_before: Floats  # of (a, b) of all channels before, shape (2K, 2K)
    covariance: Floats  # that after the last


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
    """Choose motions, one after the other.

    Args:
        layout: How the channels make up the feet's wrenches.
        robot: The robot and its motions.
        budget: Most time in s.
        goal: ``"cop"``: the root mean square of the centre of pressure's standard deviation over all samples
            of all motions, in m; ``"channel"``: that of the worst channel's force in N.
        enough: The standard deviation of the goal at which the plan ends early.
        motions: Motions to do in this order in place of a choice, to learn their gain.
        **options: Fields of :class:`~surefoot.calibration.OnlineSetup` and of the moment filter.

    Raises:
        ValueError: If an argument has no meaning, there is no such motion, or none fits into the budget.
    """
    _check_plan(robot, budget, goal, motions)
    setup, rest = setup_from_options(
        layout, mass=robot.mass, initial=None, dt=robot.dt, lag=robot.lag, options=options
    )
    config = Moment(**rest)
    logs = {name: _passages_of(setup, motion, config) for name, motion in robot.motions.items()}
    first = next(iter(logs.values()))
    choice = _Choice(
        _Aim(goal, logs),
        {name: log.whole() for name, log in logs.items()},
        {name: robot.dt * len(motion.force) for name, motion in robot.motions.items()},
        first.start,
    )
    chosen = choice.best(budget, enough) if motions is None else list(motions)
    if not chosen:
        shortest = min(choice.length.values())
        raise ValueError(
            f"No motion is chosen: the goal's {choice.std([]):.3g} are no more than 'enough', {enough:g}, or "
            f"nothing fits into a budget of {budget:g} s; the shortest motion takes {shortest:g} s."
        )
    std = [choice.std(chosen[: k + 1]) for k in range(len(chosen))]
    before = choice.std([])
    rates = {name: float(np.log(before / choice.std([name])) / choice.length[name]) for name in logs}
    return FootExcitation(
        goal=goal,
        motions=tuple(chosen),
        time=np.cumsum([choice.length[name] for name in chosen]),
        before=before,
        std=np.array(std),
        rates=MappingProxyType(rates),
        covariance_before=first.of_parameters(first.start, 0),
        covariance=first.of_parameters(choice.covariance(chosen), 0),
    )


def _check_plan(robot: MovingRobot, budget: float, goal: str, motions: Sequence[str] | None) -> None:
    """Raise ValueError if arguments of :func:`plan_foot_excitation` have no meaning."""
    check_value("budget", budget, positive=True)
    if goal not in GOALS:
        raise ValueError(f"'goal' must be one of {GOALS}, got '{goal}'.")
    if unknown := [name for name in motions or () if name not in robot.motions]:
        raise ValueError(f"The robot cannot do '{unknown[0]}'. It can do: {', '.join(robot.motions)}.")


def _passages_of(setup: OnlineSetup, motion: FootMotion, config: Moment) -> LogPassages:
    shape = motion.force.shape
    return LogPassages(setup, *motion, Parameters(np.ones(shape), np.zeros(shape)), config)


class _Choice:
    """Motions to choose among.

    ``aim`` is the quantity to lower, ``passages`` the effect of each motion on a covariance, ``length`` how
    long each takes in s, ``start`` the covariance before, (N, N).
    """

    def __init__(
        self, aim: "_Aim", passages: Mapping[str, Passage], length: Mapping[str, float], start: Floats
    ) -> None:
        self._aim, self._passages, self._start, self.length = aim, passages, start, length

    def covariance(self, names: Sequence[str]) -> Floats:
        """Return the covariance after motions."""
        covariance = self._start
        for name in names:
            covariance = self._passages[name].after(covariance)
        return covariance

    def std(self, names: Sequence[str]) -> float:
        """Return the goal's standard deviation after motions."""
        return self._aim.std(self.covariance(names))

    def best(self, budget: float, enough: float) -> list[str]:
        """Return the motions with the least deviation within a time, or the first with ``enough``."""
        pieces = int(budget / PIECE + 1e-9)
        waiting: list[list[_Way]] = [[] for _ in range(pieces + 1)]
        waiting[0] = [_Way(self._aim.std(self._start), 0.0, (), self._start)]
        best = waiting[0][0]
        for ways in waiting:
            for way in sorted(ways, key=lambda way: way.std)[:KEPT]:
                if best.std <= enough:
                    return list(best.names)
                for name, passage in self._passages.items():
                    time = way.time + self.length[name]
                    if time <= budget + 1e-9:
                        covariance = passage.after(way.covariance)
                        longer = _Way(self._aim.std(covariance), time, (*way.names, name), covariance)
                        waiting[min(int(time / PIECE), pieces)].append(longer)
                        best = min(best, longer, key=lambda way: way.std)
        return list(best.names)


class _Way(NamedTuple):
    """Some motions one after the other, and the knowledge after them."""

    std: float
    time: float
    names: tuple[str, ...]
    covariance: Floats


class _Aim:
    """The value of a covariance for the goal: the largest of some traces, trace(W S)."""

    def __init__(self, goal: str, logs: Mapping[str, LogPassages]) -> None:
        weights = []
        for log in logs.values():
            to_force, _, to_cop = log.error_rows(slice(None))
            if goal == "cop":
                rows = to_cop[np.isfinite(to_cop).all(axis=(1, 2))]
                weights.append(np.einsum("nip,niq->pq", rows, rows)[None] / max(len(rows), 1))
            else:
                weights.append(np.einsum("nip,niq->ipq", to_force, to_force) / len(to_force))
        self._weights = np.mean(weights, axis=0)
        self._log = next(iter(logs.values()))

    def std(self, covariance: Floats) -> float:
        """Return the goal's standard deviation."""
        traces = np.einsum("kpq,qp->k", self._weights, self._log.of_parameters(covariance, 0))
        return float(np.sqrt(traces.max()))
