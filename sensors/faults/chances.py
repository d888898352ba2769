"""Faults by chance: ``{"dies": 0.02, "within 20 s drops 30 %": 0.05}``.

A key names a fault of a channel, in the words of :mod:`surefoot.sensors.faults.words` without the
cell, and when: from the first reading on unless it begins with a time. Its value is the probability that this
happens to a channel in an episode::

    dies                                    from the first reading on
    at t=5 s sticks
    within 20 s flips                       at any moment of the first 20 s, all alike
    from t=3 s to t=5 s spikes 2 /s by 20 N
    swaps                                   with any other channel
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from surefoot.sensors.corruption import Rng
from surefoot.sensors.faults.channels import Fault
from surefoot.sensors.faults.words import parse_fault
from surefoot.sensors.randomness import uniform

_WITHIN = re.compile(r"within (\d+(?:\.\d*)?) s (.+)")
_TIMED = re.compile(r"(at t=\S+ s|from t=\S+ s to t=\S+ s) (.+)")


class FaultChance(NamedTuple):
    """A fault that may happen to each channel of a robot."""

    fault: Fault  # the fault, of channel 0
    within: float  # it begins at any moment of so many seconds after the fault's own start
    probability: float  # that it happens to a channel in an episode


def parse_chances(chances: Mapping[str, float]) -> tuple[FaultChance, ...]:
    """Return the faults that may happen, of words and probabilities, or ValueError.

    >>> parse_chances({"within 20 s dies": 0.02})[0].within
    20.0
    """
    return tuple(_parse(words, probability) for words, probability in chances.items())


def draw_faults(chances: tuple[FaultChance, ...], channels: int, rng: Rng) -> tuple[Fault, ...]:
    """Draw the faults of K channels in one episode, at most one each: 3 numbers a chance and a channel."""
    drawn = uniform(rng, 0.0, 1.0, (len(chances), channels, 3))
    found: dict[int, Fault] = {}
    for (fault, within, probability), rows in zip(chances, drawn.tolist(), strict=True):
        for channel, (chance, moment, partner) in enumerate(rows):
            if chance >= probability or channel in found:
                continue
            start = fault.start + moment * within
            other = None
            if fault.kind == "swapped":
                other = (channel + 1 + int(partner * (channels - 1))) % channels
            found[channel] = replace(fault, channel=channel, start=start, other=other)
    return tuple(found.values())


def _parse(words: Any, probability: Any) -> FaultChance:
    if not isinstance(words, str):
        raise ValueError(f"A fault by chance is named by words such as 'dies', got {words!r}.")
    if not isinstance(probability, int | float | np.number) or not 0.0 <= float(probability) <= 1.0:
        raise ValueError(
            f"The value of {words!r} must be the probability that it happens to a channel in an episode, "
            f"from 0 to 1; got {probability!r}."
        )
    text, within = " ".join(words.split()), 0.0
    if moment := _WITHIN.fullmatch(text):
        within, text = float(moment[1]), moment[2]
    timed = None if within else _TIMED.fullmatch(text)
    when, what = timed.groups() if timed else ("at t=0 s", text)
    what = "swaps with left/2" if what == "swaps" else what
    try:
        fault = parse_fault(f"{when} cell left/1 {what}")
    except ValueError as error:
        raise ValueError(
            f"A fault by chance reads 'dies', 'at t=5 s sticks' or 'within 20 s drops 30 %', without a cell; "
            f"got {words!r}. {str(error).partition(', got')[0]}."
        ) from None
    return FaultChance(fault, within, float(probability))
