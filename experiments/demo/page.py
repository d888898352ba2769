"""The demo's page: what was done, tables, figures that say what to see, and how to repeat any of it."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from surefoot.calibration import METHODS
from surefoot.experiments.demo import figures, figures_summary, findings, tables
from surefoot.experiments.demo.figures import Trace
from surefoot.experiments.demo.paper_tables import WALKING_TABLES
from surefoot.experiments.demo.run import DemoResults
from surefoot.experiments.demo.text import CAPTIONS, TEXTS, say
from surefoot.experiments.study.files import atomic_path
from surefoot.experiments.study.page import ReportFigure, Section, write_page
from surefoot.experiments.study.tables import Frame, Table
from surefoot.experiments.walks.record import CONDITIONS
from surefoot.experiments.walks.walkers import STAND_TIME

__all__ = ["DemoPage"]

PAPER, BAD = CONDITIONS
PAPER_FIGURES = {0.02: (10, 11), 0.04: (12, 13), 0.1: (14, 15)}
DRAWN = ("truth", "none", "quasi-static", "window", "moment")
YARDSTICKS = (
    (PAPER, "baseline", f"{PAPER.title}, against the baseline"),
    (PAPER, "truth", f"{PAPER.title}, against the truth"),
    (BAD, "truth", f"{BAD.title}, against the truth"),
)


class DemoPage:
    """Tables and figures of one demo, and the page that holds them.

    Args:
        results: What the demo found.
        recordings: The section on real recordings.
    """

    def __init__(self, results: DemoResults, recordings: Section) -> None:
        self.results = results
        self.folder = results.options.out
        options, bench = results.options, results.bench
        conditions = [(PAPER.name, "the paper's"), (BAD.name, BAD.title)]
        paper_2, coefficient = tables.paper_table_2()
        self.targets = findings.target_table(
            results.scores,
            results.loop,
            paper_condition=PAPER.name,
            coefficient=coefficient,
            bench=(bench.calibrated.cop, bench.calibrated.vgrf),
            update_ms=results.update_ms,
        )
        self.bench = (paper_2, tables.table_2(bench), tables.table_3(bench))
        self.walking = tuple(tables.walking_table(results.scores, v, conditions) for v in options.speeds)
        self.loop = tables.loop_table(results.loop, options.loop_duration)
        self.sensitivity = tuple(
            tables.sensitivity_table(part, title) for title, part in self._sensitivity_parts()
        )
        self.recordings = recordings

    @property
    def tables(self) -> tuple[Table, ...]:
        """All tables, in the order of the page."""
        walked = (*self.walking, self.loop, *self.sensitivity, *self.recordings.tables)
        return (self.targets, *self.bench, *walked)

    def write(self) -> Path:
        """Draw the figures, save the tables as CSV, and write ``report.html``."""
        for table in self.tables:
            with atomic_path(self.folder / "tables" / f"{table.name}.csv") as part:
                table.to_frame().to_csv(part, index=False)
        options = self.results.options
        made = f"Made {datetime.now(UTC):%Y-%m-%d %H:%M} UTC by {self.results.machine}."
        amount = say(
            TEXTS["amount"],
            seeds=options.seeds,
            speeds=len(options.speeds),
            duration=options.duration,
            stand=STAND_TIME,
            settle=options.settle,
        )
        sections = (
            Section("summary", "In short", (say(TEXTS["summary"]),), tables=(self.targets,)),
            self._bench_section(),
            self._walking_section(),
            self._loop_section(),
            self._sensitivity_section(),
            self.recordings,
            self._repeat_section(),
        )
        title = "surefoot demo: walking on load cells that lie"
        introduction = (say(TEXTS["introduction"]), amount)
        return write_page(self.folder / "report.html", title, introduction, sections, made=made)

    def _path(self, name: str) -> Path:
        return self.folder / "figures" / f"{name}.png"

    def _figure(self, path: Path, name: str, caption: str, **values: Any) -> ReportFigure:
        return ReportFigure(path, name, say(CAPTIONS[caption], **values))

    def _bench_section(self) -> Section:
        left, right = self.results.bench.held_out
        pressed = np.isfinite(left.cop_initial).all(axis=1)
        cop = figures.bench_cop(
            self._path("figure07_bench_cop"),
            left.hole[pressed],
            left.cop_initial[pressed],
            left.cop_calibrated[pressed],
        )
        vgrf = figures.bench_vgrf(
            self._path("figure08_bench_vgrf"),
            *(
                np.concatenate([getattr(left, name), getattr(right, name)])
                for name in ("load", "vgrf_initial", "vgrf_calibrated")
            ),
        )
        return Section(
            "bench",
            "On the bench",
            (say(TEXTS["bench"]),),
            tables=self.bench,
            figures=(
                self._figure(cop, "Figure 7", "bench_cop"),
                self._figure(vgrf, "Figure 8", "bench_vgrf"),
            ),
        )

    def _walking_section(self) -> Section:
        results = self.results
        said = list(findings.baseline_findings(results.scores, PAPER.name))
        for condition in CONDITIONS:
            said += findings.truth_findings(results.scores, condition.name, condition.title)
        published = {
            (method, speed): (errors.cop, errors.vgrf)
            for speed, methods in WALKING_TABLES.items()
            for method, errors in methods.items()
        }
        overview = figures_summary.rmse_overview(self._path("overview"), self._overview_rows(), published)
        titles = {c.name: c.title for c in CONDITIONS}
        panels = results.errors.assign(panel=[titles[name] for name in results.errors["condition"]])
        walked = (panels["time"] > STAND_TIME) & panels["method"].isin(["floor", *METHODS])
        shown = panels[walked]
        over_time = figures_summary.error_over_time(self._path("errors_over_time"), shown)
        drawn = [self._figure(overview, "All speeds at once", "overview")]
        for speed in results.options.speeds:
            drawn += self._speed_figures(speed)
        drawn.append(self._figure(over_time, "Errors over time", "errors_over_time"))
        return Section(
            "walking",
            "Calibrating while walking",
            (
                say(TEXTS["conditions"], paper=PAPER.title.capitalize(), bad=BAD.title.capitalize()),
                say(TEXTS["yardsticks"]),
                say(TEXTS["definitions"]),
            ),
            findings=tuple(said),
            tables=self.walking,
            figures=tuple(drawn),
        )

    def _overview_rows(self) -> Frame:
        scores = self.results.scores
        scores = scores[scores["method"].isin(["floor", *METHODS])]
        return pd.concat(
            scores[(scores["condition"] == condition.name) & (scores["against"] == against)].assign(
                panel=title, paper=against == "baseline"
            )
            for condition, against, title in YARDSTICKS
        )

    def _speed_figures(self, speed: float) -> list[ReportFigure]:
        traces = []
        for condition in CONDITIONS:
            outcomes = {o.name: o for o in self.results.outcomes[condition.name, speed]}
            cop = {n: o.cop for n, o in outcomes.items() if o.cop is not None}
            vgrf = {n: o.vgrf for n, o in outcomes.items() if o.vgrf is not None}
            time = outcomes["truth"].time
            assert time is not None
            traces.append(Trace(condition.title, time, cop, vgrf))
        # The last steps before the robot stops: whatever converges has converged.
        end = float(traces[0].time[-1]) - 2.0
        span = (max(end - 6.0, 0.0), end)
        first, second = (f"Figure {number}" for number in PAPER_FIGURES.get(speed, ("CoP", "vGRF")))
        tag = f"{speed:g}".replace(".", "_")
        cop_figure = figures.cop_over_time(self._path(f"cop_{tag}"), traces, DRAWN, span)
        vgrf_figure = figures.vgrf_over_time(self._path(f"vgrf_{tag}"), traces, DRAWN, span)
        return [
            self._figure(cop_figure, first, "cop", speed=speed),
            self._figure(vgrf_figure, second, "vgrf", speed=speed),
        ]

    def _loop_section(self) -> Section:
        results, film = self.results, self.results.film
        horizon = results.options.loop_duration
        drawn = []
        for severity, runs in results.loop.groupby("severity", sort=False):
            path = self._path(f"closed_loop_severity{severity:g}")
            figures_summary.closed_loop_survival(path, runs, horizon)
            drawn.append(self._figure(path, f"Who falls when, severity {severity:g}", "closed_loop"))
        paragraphs = [say(TEXTS["loop"], stand=STAND_TIME)]
        caption = ""
        if film.path is None or results.filmed is None:
            paragraphs.append(f"There is no film in this report: {film.problem.rstrip('.')}.")
        else:
            severity, speed, seed = results.filmed
            caption = say(CAPTIONS["film"], severity=severity, speed=speed, seed=seed)
        return Section(
            "closed-loop",
            "Closing the loop",
            tuple(paragraphs),
            findings=findings.loop_findings(results.loop, horizon),
            tables=(self.loop,),
            video="" if film.path is None else film.path.name,
            poster="" if film.still is None else film.still.name,
            video_caption=caption,
            figures=tuple(drawn),
        )

    def _sensitivity_parts(self) -> list[tuple[str, Frame]]:
        rows = self.results.sensitivity
        return [
            (title, rows[(rows["condition"] == condition.name) & (rows["against"] == against)])
            for condition, against, title in (YARDSTICKS[0], YARDSTICKS[2])
        ]

    def _sensitivity_section(self) -> Section:
        parts = self._sensitivity_parts()
        curves = figures_summary.sensitivity_curves(
            self._path("sensitivity"), pd.concat(part.assign(panel=title) for title, part in parts)
        )
        said = [
            f"{title.capitalize()}: {sentence}"
            for title, part in parts
            for sentence in findings.sensitivity_findings(part)
        ]
        return Section(
            "sensitivity",
            "How much hangs on the weights",
            (say(TEXTS["sensitivity"]),),
            findings=tuple(said),
            tables=self.sensitivity,
            figures=(self._figure(curves, "Sensitivity", "weights"),),
        )

    def _repeat_section(self) -> Section:
        options = self.results.options
        took = ", ".join(f"{what} {seconds:.0f} s" for what, seconds in self.results.seconds.items())
        speed, seed, severity = options.speeds[-1], options.seeds - 1, max(options.loops)
        log = options.out / "logs" / f"{BAD.name}_{speed:g}_seed{seed}.parquet"
        return Section(
            "repeat",
            "Repeat any single cell",
            (say(TEXTS["repeat"]), f"This run took: {took}."),
            commands=(
                f"surefoot calibrate walk {log} --method window --settle {options.settle:g}",
                f"surefoot view --feed none --severity {severity:g} --speed {speed:g} --seed {seed} "
                f"--duration {options.loop_duration:g} --video walk.mp4",
                f"surefoot demo --seeds {options.seeds} --jobs {options.jobs} --out {options.out}",
            ),
        )
