"""How figures look: one colour, line and marker for each way to read the feet, one sheet, one way to save.

Lines are saved as SVG, clouds of many points as PNG. The colours are those of Okabe and Ito (2008) and two of
Tol's, which people with any kind of colour vision tell apart; lines and markers say the same once more.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from surefoot.experiments.study.tables import Frame
from surefoot.files import atomic_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 130
STYLE: Any = {
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 10,
    "axes.labelsize": 9.5,
    "font.size": 9.5,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "svg.hashsalt": "surefoot",
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
}
"""Settings of Matplotlib for all figures."""


class Look(NamedTuple):
    """How a way to read the feet appears: in legends and tables, in figures, and where space is short."""

    label: str
    colour: str
    line: str
    marker: str
    short: str = ""


_BEFORE = Look("calibrated before, kept", "#56B4E9", "--", "d", "calibrated before")
_LOOKS = {
    "truth": Look("truth (MuJoCo)", "#000000", "-", "o", "truth"),
    "true": Look("true CoP", "#000000", "-", "o", "true"),
    "baseline": _BEFORE,
    "true-map": Look("true map", "#7f7f7f", ":", ".", "true map"),
    "reference": Look("reference", "#882255", ":", "*", "reference"),
    "none": Look("raw (none)", "#D55E00", "-", "X", "raw"),
    "raw": Look("raw", "#D55E00", "-", "X", "raw"),
    "weights": _BEFORE._replace(label="weights just before", short="weights"),
    "tare": Look("swing tare", "#999933", "--", "^", "tare"),
    "quasi-static": Look("quasi-static (Han)", "#CC79A7", "-", "s", "quasi-static"),
    "window": Look("window (CoP paper)", "#009E73", "-", "o", "window"),
    "moment": Look("moment", "#0072B2", "-", "P", "moment"),
}


def in_order(names: Iterable[str]) -> list[str]:
    """Return each way to read the feet once, in the order of all figures; unknown ones come last."""
    known = list(_LOOKS)
    return sorted(dict.fromkeys(names), key=lambda name: known.index(name) if name in known else len(known))


def by_way(frame: Frame, column: str = "method") -> dict[str, Frame]:
    """Return the rows of each way to read the feet, in the order of all figures."""
    return {name: frame[frame[column] == name] for name in in_order(frame[column])}


def look_of(name: str) -> Look:
    """Return how a way to read the feet appears; an unknown one is grey and has its own name."""
    return _LOOKS.get(name, Look(name, "#7f7f7f", "-.", "v", name))


def short_label(name: str) -> str:
    """Return its name where space is short."""
    return look_of(name).short or name


@contextmanager
def figure_at(path: Path, width: float, height: float) -> Iterator["Figure"]:
    """Lend a figure of some size in inches and save it: drawn without pyplot, so that nothing is global."""
    # Imported late: who wants to know a colour alone draws no figure.
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        # Without a date the same figure is the same file; without paper of its own it lies on any page.
        drawn: Any = {"metadata": {"Date": None}, "transparent": True} if path.suffix == ".svg" else {}
        with atomic_path(path) as part:
            figure.savefig(part, dpi=DPI, **drawn)


def grid_of(figure: "Figure", rows: int, columns: int, **kwargs: Any) -> Any:
    """Return rows x columns axes of a figure, always as a two-dimensional array."""
    return figure.subplots(rows, columns, squeeze=False, **kwargs)


def name_axes(panels: Any, below: str, *left: str) -> None:
    """Label the lowest row of panels, and the first column: all of it alike, or each of its panels."""
    for axes in panels[-1]:
        axes.set_xlabel(below)
    for row, axes in enumerate(panels[:, 0] if left else ()):
        axes.set_ylabel(left[row % len(left)])


def legend_below(figure: "Figure", axes: "Axes | Iterable[Axes]", columns: int = 6, **options: Any) -> None:
    """Write one legend for one or all panels under them, with as many columns as there is room."""
    entries: dict[str, Any] = {}
    for panel in axes if isinstance(axes, Iterable) else [axes]:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    for count in range(min(columns, len(entries)), 0, -1):
        legend = figure.legend(entries.values(), entries, loc="outside lower center", ncols=count, **options)
        if count == 1 or legend.get_window_extent().width <= 0.98 * figure.bbox.width:
            return
        legend.remove()


def draw_curve(
    axes: "Axes", x: Any, y: Any, look: Look, low: Any = None, high: Any = None, **options: Any
) -> None:
    """Draw a curve in a look, with its markers where it has few points; perhaps a band from low to high."""
    marker = look.marker if len(x) <= 8 else ""
    style: Any = {"linestyle": look.line, "marker": marker, "markersize": 4.5, "label": look.label} | options
    axes.plot(x, y, color=look.colour, **style)
    if low is not None:
        axes.fill_between(x, low, high, color=look.colour, alpha=0.14, linewidth=0)


def limit_to(axes: "Axes", values: Any, least: float) -> None:
    """Show finite values and room around them, of a least range: what runs away must not flatten all else."""
    if np.isfinite(values).any():
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        margin = 0.6 * max(high - low, least)
        bottom, top = axes.get_ylim()
        axes.set_ylim(max(bottom, low - margin), min(top, high + margin))


def show_values(axes: "Axes", values: Sequence[float]) -> None:
    """Make ticks at a few values of the horizontal axis, with room around a value that is alone."""
    axes.set_xticks(list(values), [f"{value:g}" for value in values])
    axes.minorticks_off()
    if len(values) == 1:
        reach = 0.5 * (abs(values[0]) or 1.0)
        axes.set_xlim(values[0] - reach, values[0] + reach)


def logarithmic(axes: "Axes", label: str = "") -> None:
    """Make the vertical axis logarithmic with plain numbers; or the horizontal one, which has a label."""
    from matplotlib.ticker import FuncFormatter

    axis, scale = (axes.xaxis, axes.set_xscale) if label else (axes.yaxis, axes.set_yscale)
    scale("log")

    def minor(value: float, _: float) -> str:
        low, high = axis.get_view_interval()
        narrow = high < 100.0 * low or not label  # in which there is room for them
        return f"{value:g}" if narrow and np.isfinite(value) and f"{value:e}"[0] in "25" else ""

    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(FuncFormatter(minor))
    axis.set_tick_params(which="minor", labelsize=8)
    if label:
        axes.set_xlabel(label)
