"""Units of the loads in a table of weighings."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from surefoot.calibration import GRAVITY
from surefoot.calibration.reference import look_like_newtons
from surefoot.calibration.results import Finding

if TYPE_CHECKING:
    from surefoot.experiments.weights.judge import Line, Weighings

HEAVIEST = 3000.0  # N, three times what any load cell of a foot is made for
RANGE = 20e3  # N that no 24-bit converter of a foot's cell spans: cells are made for half of it at most
RANGE_COUNTS = 2.0**23  # of a 24-bit converter, from zero to its end
ROUND = 0.5  # loads that are all multiples of it, in newtons, look like kilograms


def check_units(table: "Weighings", lines: "Sequence[Line | None]") -> Iterator[Finding]:
    """Find loads that no cell of a foot bears, and newtons that look like kilograms."""
    known = table.load[np.isfinite(table.load)]
    heaviest = float(np.abs(known).max(initial=0.0))
    spans = [
        RANGE_COUNTS / abs(line.slope)
        for line, code in zip(lines, table.code.T, strict=True)
        if line is not None and line.follows and np.nanmax(np.abs(code)) > 2**16
    ]
    span = float(np.median(spans)) if spans else 0.0
    if heaviest > HEAVIEST or span > RANGE:
        seen = f"up to {heaviest:.4g} N" + (
            f", and a converter that spans {span:.3g} N" if span > RANGE else ""
        )
        near = "grams look so" if table.column == "load_kg" else "millinewtons look so"
        reason = (
            f"Column '{table.column}' means loads of {seen}, and no cell of a foot is made for that: {near}."
        )
        cure = "Give kilograms in 'load_kg', or newtons in 'load_N'."
        yield Finding("units", reason, cure, max(heaviest / HEAVIEST, span / RANGE), 1.0)
    if (known < 0.0).any():
        reason = f"Column '{table.column}' holds loads below zero, such as {table.label(float(known.min()))}."
        yield Finding("units", reason, "Give the weights that press on a cell, without a sign.")
    values = np.unique(known[known != 0.0]) / table.unit
    listed = ", ".join(f"{one:g}" for one in values[:4])
    if table.column == "load_N" and len(values) > 1 and np.allclose(values % ROUND, 0.0, atol=1e-9):
        reason = f"Column 'load_N' holds round numbers ({listed}), as weights in kilograms are."
        cure = "If they are kilograms, name the column 'load_kg': all forces are 9.81 times as large then."
        yield Finding("round newtons", reason, cure, refuses=False)
    if table.column == "load_kg" and look_like_newtons(values):
        reason = f"Column 'load_kg' holds tenths of {GRAVITY:.4g} ({listed}), as weights in newtons are."
        yield Finding("newtons", reason, "Name the column 'load_N', or give kilograms.")
