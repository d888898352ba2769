"""Faults in words: ``"at t=12 s cell left/2 dies"``.

A line names moment, cell and fault, in this order::

    at t=12 s cell left/2 dies
    from t=3 s to t=5 s cell right/front-left sticks
    at t=0 s cell left/1 saturates beyond 20 N          (without a load: at the rail)
    at t=4 s cell left/rear-right spikes 2 /s by 20 N
    at t=4 s cell left/3 drops 30 % in gaps of 0.2 s    (without gaps: each reading on its own)
    at t=9 s cell left/3 flips
    at t=9 s cell left/3 swaps with right/1

Cells of a foot have numbers from 1 and names, (front-left, front-right, rear-left, rear-right).
"""

import re
from collections.abc import Sequence

from surefoot.sensors.faults.channels import Fault

FEET = ("left", "right")  # feet in the order of the channels

CELLS = ("front-left", "front-right", "rear-left", "rear-right")
"""Cells of a foot in the order of the channels."""

_NUMBER = r"(\d+(?:\.\d*)?(?:e-?\d+)?)"
_CELL = r"(\S+)"
_WHEN = re.compile(rf"(?:at t={_NUMBER} s|from t={_NUMBER} s to t={_NUMBER} s) cell {_CELL} (.+)")
_WHAT: dict[str, re.Pattern[str]] = {
    "dead": re.compile("dies"),
    "stuck": re.compile("sticks"),
    "saturated": re.compile(rf"saturates(?: beyond {_NUMBER} N)?"),
    "spiking": re.compile(rf"spikes(?: {_NUMBER} /s by {_NUMBER} N)?"),
    "dropped": re.compile(rf"drops(?: {_NUMBER} %)?(?: in gaps of {_NUMBER} s)?"),
    "flipped": re.compile("flips"),
    "swapped": re.compile(rf"swaps with {_CELL}"),
}
_FIELDS = {"saturated": ("level",), "spiking": ("rate", "size"), "dropped": ("probability", "burst")}


def cell_names(feet: Sequence[str] = FEET, cells: Sequence[str] = CELLS) -> list[str]:
    """Return the names of the channels in their order: left/front-left and so on."""
    return [f"{foot}/{cell}" for foot in feet for cell in cells]


def parse_fault(text: str, feet: Sequence[str] = FEET, cells: Sequence[str] = CELLS) -> Fault:
    """Return the fault that a line of words describes.

    Args:
        text: A line as in :mod:`surefoot.sensors.faults.words`.
        feet: Names of the feet, in the order of the channels.
        cells: Names of the cells of a foot, in the order of the channels.

    Raises:
        ValueError: If the line is not of that form, or names a cell that is not there; the message lists
            what is.

    >>> parse_fault("at t=12 s cell left/2 dies")  # doctest: +ELLIPSIS
    Fault(kind='dead', channel=1, start=12.0, stop=None, ...)
    """
    words = " ".join(text.split())
    found = _WHEN.fullmatch(words)
    if not found:
        raise ValueError(
            "A fault reads 'at t=12 s cell left/2 dies' or 'from t=3 s to t=5 s cell left/2 sticks', "
            f"got {text!r}."
        )
    at, start, stop, name, what = found.groups()
    channel = _channel(name, feet, cells)
    matches = ((kind, pattern.fullmatch(what)) for kind, pattern in _WHAT.items())
    kind, match = next(((kind, match) for kind, match in matches if match), ("", None))
    if match is None:
        raise ValueError(
            f"A cell dies, sticks, saturates [beyond 20 N], spikes [2 /s by 20 N], drops [30 %] [in gaps of "
            f"0.2 s], flips or swaps with another, got {what!r} in {text!r}."
        )
    times = {"start": float(start or at), "stop": float(stop) if stop else None}
    if kind == "swapped":
        return Fault(kind, channel, **times, other=_channel(match[1], feet, cells))  # type: ignore[arg-type]
    values = {
        field: float(value)
        for field, value in zip(_FIELDS.get(kind, ()), match.groups(), strict=True)
        if value is not None
    }
    if "probability" in values:
        values["probability"] /= 100.0
    return Fault(kind, channel, **times, **values)  # type: ignore[arg-type]


def _channel(name: str, feet: Sequence[str], cells: Sequence[str]) -> int:
    foot, _, cell = name.partition("/")
    numbers = [str(number) for number in range(1, len(cells) + 1)]
    for known in (numbers, list(cells)):
        if foot in feet and cell in known:
            return list(feet).index(foot) * len(cells) + known.index(cell)
    raise ValueError(
        f"There is no cell {name!r}; there are {cell_names(feet, cells)}, or by number "
        f"{feet[0]}/1 to {feet[-1]}/{len(cells)}."
    )
