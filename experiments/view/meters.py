"""Numbers and a chart beside the scene: forces on the feet, errors of the centre of pressure, flags."""

from collections import deque
from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np
import viser
from viser import uplot

from surefoot.calibration.estimate import Flag
from surefoot.experiments.view.board import words
from surefoot.experiments.view.server import FRAMES_PER_SECOND
from surefoot.experiments.view.shown import WAYS, Shown

SPAN = 10.0  # time in s that the chart shows
_EVERY = 3  # samples are drawn for one that the chart takes in


class Meters:
    """A table and a chart of the last seconds, for feet and channels of these names."""

    def __init__(self, server: viser.ViserServer, feet: tuple[str, ...], channels: tuple[str, ...]) -> None:
        self._gui, self._feet, self._channels = server.gui, feet, channels
        self._rows: deque[list[float]] = deque(maxlen=round(SPAN * FRAMES_PER_SECOND / _EVERY))
        self._count = 0
        self._table = server.gui.add_html("")
        self._place = server.gui.add_folder("Vertical force: left solid, right dashed")
        self._colours: Mapping[str, str] = {}
        self._chart: Any = None

    def paint(self, chosen: Mapping[str, str]) -> None:
        """Draw a fresh chart, in a colour for each way to read the feet, ``"#rrggbb"``."""
        self._colours = chosen
        series: list[Any] = [uplot.Series(label="time in s")]
        for i, foot in enumerate(self._feet):
            for way, colour in self._colours.items():
                dash = [5.0, 4.0] if i else []
                series.append(uplot.Series(label=f"{foot} {way}", stroke=colour, width=1.5, dash=dash))
        if self._chart is not None:
            self._chart.remove()
        with self._place:
            self._chart = self._gui.add_uplot(
                self._columns(),
                tuple(series),
                scales={"x": uplot.Scale(time=False), "y": uplot.Scale(auto=True)},
                axes=tuple(
                    uplot.Axis(label=label, size=30, labelSize=18) for label in ("time in s", "force in N")
                ),
                legend=uplot.Legend(show=False),
                aspect=1.5,
            )

    def forget(self) -> None:
        """Empty the chart, at an episode start."""
        self._rows.clear()

    def draw(self, now: Shown, *lines: str) -> None:
        """Take in one sample, and show it under lines of plain text."""
        self._count += 1
        if self._count % _EVERY:
            return
        unknown = np.full(len(self._feet), np.nan)
        forces = [now.readings[way].vgrf if way in now.readings else unknown for way in WAYS]
        self._rows.append([now.time, *np.array(forces).T.ravel().tolist()])
        self._chart.data = self._columns()
        self._table.content = self._html(now, lines)

    def _columns(self) -> tuple[Any, ...]:
        rows = np.array(self._rows) if len(self._rows) > 1 else np.zeros((2, 1 + len(WAYS) * len(self._feet)))
        return tuple(np.ascontiguousarray(column) for column in rows.T)

    def _html(self, now: Shown, lines: tuple[str, ...]) -> str:
        heads = "".join(f'<th style="color:{colour}">■ {way}</th>' for way, colour in self._colours.items())
        rows = []
        for i, foot in enumerate(self._feet):
            forces = [f"{now.readings[way].vgrf[i]:.1f}" if way in now.readings else "" for way in WAYS]
            rows.append([f"{foot}, N", *forces])
        errors = [_millimetres(now.cop_error(way)) for way in WAYS[1:]]
        rows.append(["CoP off by, mm", "", *errors])
        covariance = now.readings["calibrated"].cop_covariance
        spread = float("nan") if covariance is None else float(np.sqrt(max(np.trace(covariance), 0.0)))
        rows.append(["it claims, mm", "", "", _millimetres(spread)])
        cells = "".join(
            "<tr>" + "".join(f"<td>{escape(part)}</td>" for part in row) + "</tr>" for row in rows
        )
        wrong = [
            f"{name} {words(Flag(int(flag)))}"
            for name, flag in zip(self._channels, now.flags, strict=True)
            if flag
        ]
        flagged = f'<b style="color:#c92a2a">{escape("; ".join(wrong))}</b>' if wrong else "nothing"
        told = "".join(f"<div>{escape(line)}</div>" for line in lines if line)
        table = (
            f'<table style="width:100%;font-size:13px"><tr align="left"><th></th>{heads}</tr>{cells}</table>'
        )
        style = "padding:0.4em 1em;font-size:13px;line-height:1.5"
        return f'<div style="{style}">{told}{table}<div>flagged: {flagged}</div></div>'


def _millimetres(distance: float) -> str:
    return f"{1e3 * distance:.1f}" if np.isfinite(distance) else "–"
