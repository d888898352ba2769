"""Tables of a study: one content for the terminal, the page and the files."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
from rich import box
from rich.markup import escape
from rich.table import Table as RichTable
from rich.text import Text

from surefoot.experiments.study.statistics import Interval, mean_interval

__all__ = ["Column", "Frame", "Table", "Verdict", "interval_text", "number", "plural", "with_interval"]

Frame = Any
"""A pandas data frame: type checkers do not follow what indexing one gives."""

Column = Any
"""A pandas series, likewise."""


class Verdict(str):
    """A cell that is good or bad, whatever its word; a page colours it by that.

    Attributes:
        good: Whether it is good.
    """

    good: bool

    @classmethod
    def of(cls, good: bool, word: str = "") -> "Verdict":
        """Return a verdict; its word is "yes" or "no" unless another is given."""
        verdict = cls(word or ("yes" if good else "no"))
        verdict.good = bool(good)
        return verdict


@dataclass(frozen=True)
class Table:
    """A table whose cells are already text.

    Attributes:
        name: Short name for files, such as ``"table4"``.
        title: What it shows.
        columns: Headings.
        rows: Cells, one tuple a row.
        note: How to read it.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def to_rich(self) -> RichTable:
        """Return it for a terminal; brackets and colons in it are text and mean nothing to rich."""
        table = RichTable(
            title=escape(self.title),
            caption=escape(self.note) or None,
            box=box.SIMPLE_HEAD,
            title_justify="left",
        )
        for i, column in enumerate(self.columns):
            table.add_column(Text(column), justify="left" if i == 0 else "right")
        for row in self.rows:
            table.add_row(*map(Text, row))
        return table

    def to_frame(self) -> pd.DataFrame:
        """Return it as a data frame of text."""
        return pd.DataFrame(list(self.rows), columns=list(self.columns))


def number(value: float, digits: int = 3) -> str:
    """Return a number with some significant digits and no exponent; a dash for none.

    >>> number(0.012345), number(123.4), number(float("nan"))
    ('0.0123', '123', '–')
    """
    if value != value:
        return "–"
    if abs(value) < 5e-7:
        return "0"
    magnitude = abs(value)
    decimals = digits - 1
    while magnitude >= 10 and decimals > 0:
        magnitude, decimals = magnitude / 10, decimals - 1
    while magnitude < 1 and decimals < 8:
        magnitude, decimals = magnitude * 10, decimals + 1
    return f"{value:.{decimals}f}"


def with_interval(values: Sequence[float] | Any, factor: float = 1.0, digits: int = 3) -> str:
    """Return the mean of one number a seed with its 95 % interval, as text.

    >>> with_interval([1.0, 2.0, 3.0])
    '2.00 ± 2.48'
    """
    return interval_text(mean_interval(values), factor, digits)


def interval_text(interval: Interval, factor: float = 1.0, digits: int = 3) -> str:
    """Return a mean with its interval, as text.

    >>> interval_text(Interval(0.0123, 0.0004, 9), 1e3)
    '12.3 ± 0.4'
    """
    if interval.n == 0:
        return "–"
    mean = number(factor * interval.mean, digits)
    if interval.n == 1:
        return mean
    decimals = len(mean.partition(".")[2])
    return f"{mean} ± {factor * interval.half:.{decimals}f}"


def plural(count: int, word: str, words: str = "") -> str:
    """Return a count with its word.

    >>> plural(1, "walk"), plural(2, "walk"), plural(2, "study", "studies")
    ('1 walk', '2 walks', '2 studies')
    """
    return f"{count} {word if count == 1 else words or word + 's'}"
