"""The figure of walks: the error of the centre of pressure over time."""

from collections.abc import Mapping
from pathlib import Path

from surefoot.experiments.study.figures import (
    by_way,
    draw_curve,
    figure_at,
    grid_of,
    legend_below,
    logarithmic,
    look_of,
    name_axes,
)
from surefoot.experiments.study.tables import Frame


def error_curves(path: Path, panels: Mapping[str, Frame], columns: int = 3) -> Path:
    """Draw the running CoP error (m) over time (s): median and quartiles over runs, one panel per title."""
    across = min(columns, len(panels))
    down = -(-len(panels) // across)
    with figure_at(path, max(3.7 * across + 0.4, 6.4), 2.5 * down + 1.2) as figure:
        drawn = grid_of(figure, down, across, sharey=True)
        for axes, (title, part) in zip(drawn.flat, panels.items(), strict=False):
            for method, runs in by_way(part).items():
                errors = runs.groupby("time")["cop"]
                low, middle, high = (1e3 * errors.quantile(q).clip(lower=1e-5) for q in (0.25, 0.5, 0.75))
                draw_curve(axes, middle.index, middle, look_of(method), low, high)
            axes.set_title(title)
            logarithmic(axes)
        drawn[0, 0].set_ylim(bottom=0.3)
        for axes in drawn.flat[len(panels) :]:
            axes.set_visible(False)
        name_axes(drawn, "time (s)", "CoP rmse of 2 s (mm)")
        legend_below(figure, drawn[0, 0])
    return path
