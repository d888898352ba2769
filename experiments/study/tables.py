"""Tables of a study: one content for the terminal, the page and the files.

A cell is a text that knows its value, all digits of it: files for machines hold values.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any, Self

from rich import box
from rich.markup import escape
from rich.table import Table as RichTable
from rich.text import Text

from surefoot.experiments.study.statistics import Interval, mean_interval

if TYPE_CHECKING:
    import pandas as pd

Frame = Any  # a pandas data frame: type checkers do not follow what indexing one gives
Column = Any  # a pandas series, likewise
Cell = Callable[[Any], str]  # makes a cell of what its row is about

NOTHING = "–"


class Valued(str):
    """A cell that knows its value: a number, a list, or a mapping of some."""

    value: Any

    @classmethod
    def of(cls, text: str, value: Any) -> Self:
        """Return the text with its value."""
        cell = cls(text)
        cell.value = value
        return cell


class Verdict(Valued):
    """A cell that is good or bad, whatever its word; a page colours it by that."""

    good: bool

    @classmethod
    def of(cls, good: bool, word: str = "") -> "Verdict":  # type: ignore[override]
        """Return a verdict; its word is "yes" or "no" unless another is given."""
        word = word or ("yes" if good else "no")
        verdict = cls(word)
        verdict.good = bool(good)
        verdict.value = getattr(word, "value", {"yes": True, "no": False}.get(word, word))
        return verdict


@dataclass(frozen=True)
class Table:
    """A table of cells; its name is for files, its note says how to read it."""

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

    def to_plain(self) -> dict[str, Any]:
        """Return its values for JSON, a mapping a row; a heading that is there twice is numbered."""
        keys = [
            name if name not in self.columns[:i] else f"{name} ({self.columns[:i].count(name) + 1})"
            for i, name in enumerate(self.columns)
        ]
        rows = [dict(zip(keys, map(value_of, row), strict=True)) for row in self.rows]
        return {"title": self.title, "note": self.note, "rows": rows}

    def to_frame(self) -> "pd.DataFrame":
        """Return it as a data frame of text."""
        import pandas as pd  # takes half a second, which a log's page does without

        return pd.DataFrame(list(self.rows), columns=list(self.columns))


def value_of(cell: str) -> Any:
    """Value of a cell as JSON has it, nothing, or its text.

    >>> [value_of(cell) for cell in (decimal(1 / 3, ".2f"), share(3, 5), number(float("nan")), "–", "> 8")]
    [0.3333333333333333, {'count': 3, 'of': 5}, None, None, '> 8']
    """
    if not isinstance(cell, Valued):
        return None if cell in ("", NOTHING) else cell
    value = cell.value
    if isinstance(value, Mapping):
        return {key: _finite(part) for key, part in value.items()}
    return [_finite(part) for part in value] if isinstance(value, list | tuple) else _finite(value)


def _finite(value: Any) -> Any:
    """Return a number as JSON has it: nothing in the place of NaN and infinities."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not isfinite(value) else value


def table_of(
    name: str, title: str, columns: Mapping[str, Cell], items: Iterable[Any], note: str = ""
) -> Table:
    """Return a table of a row an item; each column has a function that makes its cells of one."""
    rows = tuple(tuple(cell(item) for cell in columns.values()) for item in items)
    return Table(name, title, tuple(columns), rows, note)


def mean_of(column: str, factor: float = 1.0, digits: int = 3) -> Cell:
    """Make cells of frames: the mean of a column with its interval."""
    return lambda runs: with_interval(runs[column], factor, digits)


def count_of(column: str) -> Cell:
    """Make cells of frames: in how many rows a column is true."""
    return lambda runs: share(int(runs[column].sum()), len(runs))


def decimal(value: float, form: str = "g") -> str:
    """Return a number in a form of Python's; a dash for none.

    >>> decimal(0.25, ".1f"), decimal(12, "d"), decimal(float("nan"))
    ('0.2', '12', '–')
    """
    return Valued.of(NOTHING if value != value else format(value, form), value)


def share(count: int, of: int) -> str:
    """Return a count of some.

    >>> share(3, 5)
    '3 of 5'
    """
    return Valued.of(f"{count} of {of}", {"count": count, "of": of})


def span(low: float, high: float, form: str = "g") -> str:
    """Return an interval.

    >>> span(0.1, 0.25, ".1f")
    '0.1 to 0.2'
    """
    return Valued.of(f"{low:{form}} to {high:{form}}", {"from": low, "to": high})


def percent(part: float, form: str = ".0f") -> str:
    """Return a share of one in percent.

    >>> percent(0.64)
    '64 %'
    """
    return Valued.of(f"{100 * part:{form}} %", {"percent": 100 * part})


def number(value: float, digits: int = 3) -> str:
    """Return a number with some significant digits and no exponent; a dash for none.

    >>> [number(value) for value in (0.012345, 123.4, 1234.5, 9.999, 1e-12, float("nan"))]
    ['0.0123', '123', '1234', '10.00', '0', '–']
    """
    return Valued.of(_digits(value, digits), value)


def _digits(value: float, digits: int) -> str:
    if value != value:
        return NOTHING
    if abs(value) < 5e-7:
        return "0"
    magnitude = abs(value)
    decimals = digits - 1
    while magnitude >= 10 and decimals > 0:
        magnitude, decimals = magnitude / 10, decimals - 1
    while magnitude < 1 and decimals < 8:
        magnitude, decimals = magnitude * 10, decimals + 1
    return f"{value:.{decimals}f}"


def round_to(value: float, deviation: float) -> tuple[str, str]:
    """Return a value and its deviation to the decimal at which the deviation has two significant digits.

    >>> round_to(4.75804, 0.1912), round_to(-0.00002, 0.000157), round_to(5231.6, 99.97)
    (('4.76', '0.19'), ('-0.00002', '0.00016'), ('5232', '100'))
    """
    if not 0.0 < deviation < float("inf"):
        return number(value), Valued.of(NOTHING if deviation != 0.0 else "0", deviation)
    form = f".{max(1 - int(f'{deviation:.1e}'.partition('e')[2]), 0)}f"
    return decimal(value, form), decimal(deviation, form)


def with_deviation(value: float, deviation: float) -> str:
    """Return a value with its deviation, as :func:`round_to`.

    >>> with_deviation(20.91, 0.0312)
    '20.910 ± 0.031'
    """
    both = {"value": value, "plus_minus": deviation}
    return Valued.of(" ± ".join(round_to(value, deviation)), both)


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
        return NOTHING
    both = {"value": factor * interval.mean, "plus_minus": factor * interval.half}
    mean = _digits(both["value"], digits)
    if interval.n == 1:
        return Valued.of(mean, both)
    decimals = len(mean.partition(".")[2])
    return Valued.of(f"{mean} ± {both['plus_minus']:.{decimals}f}", both)


def plural(count: int, word: str) -> str:
    """Return a count with its word.

    >>> plural(1, "walk"), plural(2, "walk")
    ('1 walk', '2 walks')
    """
    return f"{count} {word if count == 1 else word + 's'}"


def sentence(title: str) -> str:
    """Return a title with a capital at its beginning."""
    return title[:1].upper() + title[1:]


def flat(text: str) -> str:
    """Return a text that the source wraps and indents as one line."""
    return " ".join(text.split())
