"""Severity and faults of one robot's sensors: as configured, or drawn from the robot's random stream."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.checks import as_number
from surefoot.sensors import Fault, parse_fault
from surefoot.sensors.corruption import Rng
from surefoot.sensors.faults.chances import FaultChance, draw_faults, parse_chances
from surefoot.sensors.faults.channels import KINDS
from surefoot.sensors.presets import resolve
from surefoot.sensors.randomness import uniform

Severity = float | tuple[float, float]  # a factor of all errors, or its lowest and highest value

Faults = Sequence[str | Fault | Mapping[str, Any]] | Mapping[str, float]
"""Scheduled faults, or probabilities of faults of a channel in an episode."""


class Condition(NamedTuple):
    """Severity and faults of one robot's sensors."""

    severity: float  # factor of all errors of the feet's sensors
    faults: tuple[Fault, ...]  # the scheduled faults


AS_STATED = Condition(1.0, ())  # sensors as bad as their configuration states, without faults


class Conditions(NamedTuple):
    """The distribution of a robot's condition."""

    lowest: float  # lowest severity
    highest: float  # highest severity; the distribution is uniform
    faults: tuple[Fault, ...] = ()  # scheduled faults, on the clock of the power-up
    chances: tuple[FaultChance, ...] = ()  # random faults of an episode, on the clock of the episode

    @property
    def by_chance(self) -> bool:
        """Whether a condition is random."""
        return bool(self.chances) or self.lowest < self.highest

    @property
    def usual(self) -> Condition:
        """The condition of a robot before anything is drawn."""
        return Condition(min(max(1.0, self.lowest), self.highest), self.faults)

    def draw(self, before: Condition, fresh: bool, channels: int, rng: Rng) -> Condition:
        """Draw the condition of an episode for K channels. The severity changes with fresh sensors only."""
        severity, faults = before.severity, self.faults
        if fresh:
            severity = self.lowest
            if self.lowest < self.highest:
                severity = float(uniform(rng, self.lowest, self.highest, (1,))[0])
        if self.chances:
            faults = draw_faults(self.chances, channels, rng)
        return Condition(severity, faults)


def severity_range(severity: Any) -> tuple[float, float]:
    """Return the lowest and the highest severity.

    Raises:
        TypeError: If it is neither a number nor a pair of them.
        ValueError: If one is negative or not finite, or the pair is in the wrong order.
    """
    pair = severity if isinstance(severity, tuple | list | np.ndarray) else (severity, severity)
    if len(pair) != 2:
        raise ValueError(f"'severity' must be a number or (lowest, highest), got {severity!r}.")
    low, high = (as_number("severity", end) for end in pair)
    if not 0.0 <= low <= high < float("inf"):
        if low == high:
            raise ValueError(f"'severity' must be finite and not negative, got {low}.")
        raise ValueError(
            "'severity' must be a number or (lowest, highest), finite, not negative and in this order; "
            f"got {severity!r}."
        )
    return low, high


def severity_of_each(severity: Any, robots: int) -> list[Any]:
    """Return one severity per robot.

    ``severity`` is a number or a tuple (lowest, highest) for all, or a list or an array of one per robot.

    Raises:
        ValueError: If there are more or fewer values than robots.
    """
    if isinstance(severity, np.ndarray) and not severity.ndim:
        severity = severity.item()
    if not isinstance(severity, list | np.ndarray):
        return [severity] * robots
    if len(severity) != robots:
        raise ValueError(
            f"'severity' must be one number, or one a robot: got {len(severity)} for {robots} robots."
        )
    return list(severity)


def faults_of(
    faults: Any, feet: Sequence[str], cells: Sequence[str]
) -> tuple[tuple[Fault, ...], tuple[FaultChance, ...]]:
    """Return scheduled and random faults.

    Args:
        faults: As passed by the user.
        feet: Names of the feet, in the order of the channels.
        cells: Names of the channels of a foot.

    Raises:
        TypeError: If they are neither a sequence of faults nor a mapping of probabilities.
        ValueError: If a fault or a probability is refused.
    """
    if isinstance(faults, Mapping) and "kind" not in faults:
        return (), parse_chances(faults)
    if isinstance(faults, str | Mapping) or not isinstance(faults, Iterable):
        alone = isinstance(faults, str | Mapping)
        got = f"; got one alone, give [{faults!r}]" if alone else f", got {faults!r}"
        raise TypeError(f"'faults' must be a sequence of faults or a mapping of their probabilities{got}.")
    found = (
        parse_fault(fault, feet, cells) if isinstance(fault, str) else resolve(fault, Fault, "faults")
        for fault in faults
    )
    return tuple(found), ()


def channel_states(faults: Sequence[Fault], channels: int) -> NDArray[np.int8]:
    """Return the fault of each channel, shape (K,): 0 without a fault, or 1 plus its index in ``KINDS``."""
    states = np.zeros(channels, dtype=np.int8)
    for fault in faults:
        for channel in (fault.channel, fault.other):
            if channel is not None:
                states[channel] = 1 + KINDS.index(fault.kind)
    return states
