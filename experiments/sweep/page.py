"""A sweep's page: what fell where, in one file."""

import base64
from datetime import UTC, datetime
from pathlib import Path

from surefoot.experiments.study.files import atomic_path
from surefoot.experiments.study.page import ReportFigure, Section, flat, write_page
from surefoot.experiments.study.runner import machine
from surefoot.experiments.study.tables import Frame, Table
from surefoot.experiments.sweep import figures, tables
from surefoot.experiments.sweep.episode import Cell
from surefoot.experiments.sweep.film import film_cell
from surefoot.experiments.sweep.run import SweepResults

__all__ = ["SweepPage"]

_INTRODUCTION = """
    Every episode is one cell: a controller, what it is fed for the centre of pressure, a scenario, a severity
    and a seed. Severity is a factor of all errors of the load cells "{cells}": 0 leaves none of them, 1 is
    the device as it is. Seeds are paired: the same seed is the same ground, pushes, starting state and
    sensors, scaled, for every controller and feed. True feet have no errors and so no severity."""

_AMOUNT = """
    {cells} cells of at most {duration:g} s; the controller is asked from {settle:g} s on, and before that the
    robot stands by its pattern alone, which calibrators need. {failed} cells failed and are left out of
    everything below but their own table."""

_CAPTIONS = {
    "survival": "Share on its feet over time (Kaplan and Meier) with 95 % bands (Greenwood, log-log).",
    "severity": "Mean return with 95 % intervals (Student t), and share of falls (Wilson), over severity.",
    "heat": "Share of episodes that end in a fall; what was not run is blank.",
}


class SweepPage:
    """Tables and figures of a sweep, and the page that holds them.

    Args:
        results: What the sweep found.
        films: How many of the worst episodes are filmed; each takes about as long as the episode.
    """

    def __init__(self, results: SweepResults, *, films: int = 0) -> None:
        self.results = results
        self.folder = results.folder
        self.films = films
        rows = results.finished
        self.titles = {
            name: results.plan.title_of(name)
            for name in results.plan.scenarios
            if (rows["scenario"] == name).any()
        }
        self.outcomes = {
            name: tables.outcome_table(rows, name, f"{title[:1].upper()}{title[1:]}")
            for name, title in self.titles.items()
        }
        self.half = tables.half_table(rows, self.titles)
        self.failed = tables.failure_table(results.failed)
        self.worst = _worst(rows, max(films, 5))

    @property
    def tables(self) -> tuple[Table, ...]:
        """All tables, in the order of the page."""
        optional = (self.half, *self.outcomes.values(), self.failed)
        return tuple(table for table in optional if table is not None)

    def write(self) -> Path:
        """Draw the figures, save the tables as CSV, film, and write ``report.html``."""
        for table in self.tables:
            with atomic_path(self.folder / "tables" / f"{table.name}.csv") as part:
                table.to_frame().to_csv(part, index=False)
        plan, rows = self.results.plan, self.results.rows
        introduction = (
            flat(_INTRODUCTION.format(cells=plan.cells)),
            flat(
                _AMOUNT.format(
                    cells=len(rows),
                    duration=plan.duration,
                    settle=plan.settle,
                    failed=len(self.results.failed),
                )
            ),
        )
        sections = [self._summary(), *map(self._scenario, self.titles)] if self.titles else []
        if self.failed is not None:
            sections.append(Section("failed", "Cells that failed", tables=(self.failed,)))
        if self.titles:
            sections.append(self._worst_section())
            sections += [self._film(row) for row in self.worst.head(self.films).to_dict("records")]
        sections.append(self._repeat())
        made = f"Made {datetime.now(UTC):%Y-%m-%d %H:%M} UTC by {machine()}."
        path = self.folder / "report.html"
        return write_page(path, "surefoot sweep", introduction, sections, made=made)

    def _summary(self) -> Section:
        path = figures.heat_maps(self._path("heat"), self.results.finished, self.titles)
        return Section(
            "summary",
            "In short",
            tables=() if self.half is None else (self.half,),
            figures=(ReportFigure(path, "Falls", _CAPTIONS["heat"]),),
        )

    def _scenario(self, name: str) -> Section:
        rows = self.results.finished
        part = rows[rows["scenario"] == name]
        severity = figures.against_severity(self._path(f"severity_{name}"), part)
        standing = figures.survival_curves(self._path(f"survival_{name}"), part)
        return Section(
            name,
            self.outcomes[name].title,
            tables=(self.outcomes[name],),
            figures=(
                ReportFigure(severity, "Return and falls", _CAPTIONS["severity"]),
                ReportFigure(standing, "Survival", _CAPTIONS["survival"]),
            ),
        )

    def _worst_section(self) -> Section:
        note = "" if self.films else "Films of them come with --films."
        return Section(
            "worst", "The worst episodes", (note,) * bool(note), tables=(tables.worst_table(self.worst),)
        )

    def _film(self, row: dict[str, object]) -> Section:
        cell = Cell.from_json(str(row["spec"]))
        anchor, title = f"film-{cell.number}", f"Cell {cell.number} on film"
        path = self.folder / "films" / f"cell{cell.number}.mp4"
        try:
            film_cell(path, cell, until=float(str(row["time"])))
        except OSError as error:
            return Section(anchor, title, (f"There is no film: {error}",))
        film = "data:video/mp4;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
        caption = (
            "Its last 12 s; dots on the ground: the true centre of pressure (black) and the one fed back."
        )
        return Section(anchor, title, video=film, video_caption=caption)

    def _repeat(self) -> Section:
        number = (
            int(self.results.rows["cell"].iloc[0]) if not self.titles else int(self.worst["cell"].iloc[0])
        )
        return Section(
            "repeat",
            "Repeat any part",
            (
                "results.parquet has one row a cell, with all that makes it in the column 'spec' and the "
                "versions that made it beside it. A cell that is run again comes out the same to the last "
                "digit with the same versions on the same kind of machine.",
            ),
            commands=(f"surefoot replay {self.folder} --cell {number}",),
        )

    def _path(self, name: str) -> Path:
        return self.folder / "figures" / f"{name}.png"


def _worst(rows: Frame, count: int) -> Frame:
    """Pick the earliest falls, and then the lowest returns: those of different tasks cannot be compared."""
    order = ["fell", "time", "return", "cell"]
    return rows.sort_values(order, ascending=[False, True, True, True]).head(count)
