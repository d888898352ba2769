"""One name and one colour for each way to read the feet, in every figure and table.

The colours are those of Okabe and Ito (2008), which people with any kind of colour vision tell apart; line
styles and markers say the same once more.
"""

from collections.abc import Iterable
from typing import NamedTuple

__all__ = ["Look", "in_order", "look_of", "short_label"]


class Look(NamedTuple):
    """How a way to read the feet appears.

    Attributes:
        label: Its name in legends and tables.
        colour: As hexadecimal RGB.
        line: A line style of matplotlib.
        marker: A marker of matplotlib.
    """

    label: str
    colour: str
    line: str
    marker: str


_LOOKS = {
    "truth": Look("truth (MuJoCo)", "#000000", "-", "o"),
    "true": Look("true CoP", "#000000", "-", "o"),
    "baseline": Look("bench map, kept", "#56B4E9", "--", "d"),
    "floor": Look("floor (true map)", "#7f7f7f", ":", "."),
    "reference": Look("reference", "#999933", ":", "*"),
    "none": Look("raw (none)", "#D55E00", "-", "X"),
    "bench": Look("bench, just before", "#56B4E9", "--", "d"),
    "tare": Look("swing tare", "#009E73", "-", "^"),
    "quasi-static": Look("Han (quasi-static)", "#CC79A7", "-", "s"),
    "window": Look("window (CoP paper)", "#0072B2", "-", "o"),
    "moment": Look("moment", "#E69F00", "-", "P"),
}
_SHORT = {
    "truth": "truth",
    "true": "true",
    "baseline": "bench",
    "floor": "floor",
    "reference": "reference",
    "none": "raw",
    "tare": "tare",
    "quasi-static": "Han",
    "window": "window",
    "moment": "moment",
}


def in_order(names: Iterable[str]) -> list[str]:
    """Name each way to read the feet once, in the order of all figures and tables; unknown ones come last."""
    known = list(_LOOKS)
    return sorted(dict.fromkeys(names), key=lambda name: known.index(name) if name in known else len(known))


def look_of(name: str) -> Look:
    """Look a way to read the feet up; an unknown one appears in grey under its own name."""
    return _LOOKS.get(name, Look(name, "#7f7f7f", "-.", "v"))


def short_label(name: str) -> str:
    """Its name where space is short."""
    return _SHORT.get(name, name)
