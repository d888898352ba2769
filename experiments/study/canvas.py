"""The sheet that every figure of the report is drawn on; private to :mod:`surefoot.experiments`."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from surefoot.experiments.study.files import atomic_path

__all__ = ["figure_at", "grid_of", "legend_below", "logarithmic"]

DPI = 130
_RC: Any = {
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
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
}


@contextmanager
def figure_at(path: Path, width: float, height: float) -> Iterator[Figure]:
    """Lend a figure in the house style and save it: drawn without pyplot, so that nothing is global."""
    with mpl.rc_context(_RC):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        with atomic_path(path) as part:
            figure.savefig(part, dpi=DPI)


def grid_of(figure: Figure, rows: int, columns: int, **kwargs: Any) -> Any:
    """Divide a figure into rows x columns axes, always as a two-dimensional array."""
    return figure.subplots(rows, columns, squeeze=False, **kwargs)


def legend_below(figure: Figure, axes: Axes | Iterable[Axes], columns: int = 6) -> None:
    """Write one legend for all panels under them, of what is labelled in one of them or in several."""
    entries: dict[str, Any] = {}
    for panel in [axes] if isinstance(axes, Axes) else axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=min(columns, len(entries)))


def logarithmic(axes: Axes) -> None:
    """Make the vertical axis logarithmic with plain numbers at 1, 2 and 5."""
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))

    def minor(value: float, _: float) -> str:
        return f"{value:g}" if f"{value:e}"[0] in "25" else ""

    axes.yaxis.set_minor_formatter(FuncFormatter(minor))
    axes.tick_params(axis="y", which="minor", labelsize=8)
