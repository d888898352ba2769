"""The gait cycle of each foot, from heel contact to heel contact (0 to 100 %): means and standard deviations.

Cycles begin and end by the true contacts, so that all ways to read the feet are averaged over the same ones.
The duty factor and the cycle's time are those of a method's own forces: a foot whose zero is off by more than
the threshold of contact never swings.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from surefoot.calibration import GRAVITY
from surefoot.calibration.cop import FORCE_THRESHOLD, cop_of_wrench, sole_wrenches
from surefoot.experiments.arrays import Floats
from surefoot.experiments.study.figures import (
    by_way,
    draw_curve,
    figure_at,
    grid_of,
    legend_below,
    look_of,
    name_axes,
)
from surefoot.experiments.study.page import Words
from surefoot.experiments.study.tables import NOTHING, Cell, Frame, Table, Valued, decimal, number, table_of
from surefoot.experiments.walks.play import Stream
from surefoot.experiments.walks.score import rms, vertical_forces

CURVES = {"vgrf": "vertical force (weights)", "cop_x": "CoP x, forward (mm)", "cop_y": "CoP y, left (mm)"}
FEET = ("left", "right")

_PERCENT = np.linspace(0.0, 100.0, 101)
_SHORTEST = 0.1  # s of contact or swing that is one: a knock at landing is none
_FEWEST = 0.5  # share of the cycles in which a foot must have a CoP at a percent, to have a spread there


def find_contacts(vgrf: Floats, time: Floats) -> Floats:
    """Return when a foot is set down in s, of its vertical force in N at times in s, (N,)."""
    samples = 2 * round(0.5 * _SHORTEST / float(np.median(np.diff(time)))) + 1
    loaded = median_filter((vgrf > FORCE_THRESHOLD).astype(np.int8), samples, mode="nearest")
    found: Floats = time[1:][np.diff(loaded) > 0]
    return found


def cycle_rows(stream: Stream, force: Floats) -> list[dict[str, Any]]:
    """Return a row a foot of what forces in N, (N, K), say of its cycles; none of a foot with less than two.

    ``cycles`` is their number; ``peak`` the largest vertical force in body weights, ``duty`` the share of the
    cycle with contact and ``period`` the cycle's time in s, means and (``_std``) standard deviations over
    cycles; ``repeat`` the standard deviation of the CoP in m, rms over the stance. And :data:`CURVES` with
    their standard deviations, at each percent.
    """
    log, truth = stream.log, stream.truth
    load, true_load = (vertical_forces(f, log.layout, truth.R_world_sole) for f in (force, truth.force))
    cop, rows = cop_of_wrench(sole_wrenches(force, log.layout)), []
    walks = stream.judged
    for i, foot in enumerate(FEET):
        starts = find_contacts(true_load[walks, i], log.time[walks])
        if len(starts) < 3:
            continue
        at = starts[:-1, None] + 0.01 * _PERCENT * np.diff(starts)[:, None]
        own, true = (np.interp(at, log.time, one[:, i]) for one in (load, true_load))
        place = np.stack([np.interp(at, log.time, cop[:, i, axis]) for axis in (0, 1)])
        seen = np.ma.masked_invalid(np.where(true > FORCE_THRESHOLD, place, np.nan))
        spread = seen.std(axis=1, ddof=1).filled(np.nan)
        spread[seen.count(axis=1) < _FEWEST * len(at)] = np.nan
        period = np.diff(find_contacts(load[walks, i], log.time[walks]))
        each = {
            "peak": own.max(axis=1) / (log.mass * GRAVITY),
            "duty": (own[:, :-1] > FORCE_THRESHOLD).mean(axis=1),
            "period": period if len(period) > 1 else np.full(2, np.nan),
        }
        vgrf = own / (log.mass * GRAVITY)
        rows.append(
            {
                "foot": foot,
                "cycles": len(at),
                **{name: float(values.mean()) for name, values in each.items()},
                **{f"{name}_std": float(values.std(ddof=1)) for name, values in each.items()},
                # Of both axes together, over the percents that have any.
                "repeat": rms(np.linalg.norm(spread, axis=0)),
                "vgrf": vgrf.mean(axis=0),
                "vgrf_std": vgrf.std(axis=0, ddof=1),
                **dict(zip(("cop_x", "cop_y"), 1e3 * seen.mean(axis=1).filled(np.nan), strict=True)),
                **dict(zip(("cop_x_std", "cop_y_std"), 1e3 * spread, strict=True)),
            }
        )
    return rows


def cycle_table(cycles: Frame, conditions: Mapping[str, str]) -> Table:
    """Return the statistics of one speed's cycles, a row a method and foot in each condition."""

    def pool(name: str, form: str, factor: float = 1.0) -> Cell:
        def cell(part: Frame) -> str:
            means, spreads = part[name], part[f"{name}_std"]
            if not means.notna().any():
                return NOTHING
            mean, spread = factor * float(means.mean()), factor * float(np.sqrt((spreads**2).mean()))
            return Valued.of(f"{mean:{form}} ± {spread:{form}}", {"value": mean, "plus_minus": spread})

        return cell

    columns: dict[str, Cell] = {
        "condition": lambda part: conditions[part["condition"].iloc[0]],
        "method": lambda part: look_of(part["method"].iloc[0]).label,
        "foot": lambda part: str(part["foot"].iloc[0]),
        "cycles": lambda part: decimal(part["cycles"].sum()),
        "peak vGRF (weights)": pool("peak", ".3f"),
        "duty factor (%)": pool("duty", ".1f", 100.0),
        "cycle (s)": pool("period", ".3f"),
        "CoP repeats within (mm)": lambda part: number(1e3 * float(np.sqrt((part["repeat"] ** 2).mean()))),
    }
    parts = [
        part
        for name in conditions
        for own in by_way(cycles[cycles["condition"] == name]).values()
        for _, part in own.groupby("foot")
    ]
    title = f"Gait cycles at {cycles['speed'].iloc[0]:g} m/s"
    return table_of("gait_cycle", title, columns, parts, Words("walks", "paper")("gait_cycle"))


def cycle_figure(path: Path, cycles: Frame, conditions: Mapping[str, str], methods: Sequence[str]) -> Path:
    """Draw one walk's cycles by some methods: a row a quantity, a column a condition and foot."""
    columns = [(name, title, foot) for name, title in conditions.items() for foot in FEET]
    with figure_at(path, 2.9 * len(columns), 6.6) as figure:
        panels = grid_of(figure, len(CURVES), len(columns), sharex=True, sharey="row")
        for column, (name, title, foot) in zip(panels.T, columns, strict=True):
            part = cycles[(cycles["condition"] == name) & (cycles["foot"] == foot)].set_index("method")
            for method in (one for one in methods if one in part.index):
                for axes, curve in zip(column, CURVES, strict=True):
                    mean, spread = (np.asarray(part.loc[method, key]) for key in (curve, f"{curve}_std"))
                    draw_curve(axes, _PERCENT, mean, look_of(method), mean - spread, mean + spread)
            column[0].set_title(f"{title}, {foot} foot")
        for row, curve in enumerate(CURVES):
            true = np.concatenate([np.asarray(one) for one in cycles[cycles["method"] == "truth"][curve]])
            low, high = np.nanmin(true), np.nanmax(true)
            panels[row, 0].set_ylim(low - 0.4 * (high - low), high + 0.4 * (high - low))
        name_axes(panels, "gait cycle (%)", *CURVES.values())
        legend_below(figure, panels[0, 0])
    return path
