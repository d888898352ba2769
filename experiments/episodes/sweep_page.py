"""A sweep's page: what fell where, in one file."""

import base64
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from surefoot.experiments.episodes import figures, tables
from surefoot.experiments.episodes.episode import Episode, episode_moments
from surefoot.experiments.episodes.run import EpisodeResults
from surefoot.experiments.policy.controllers import short_name
from surefoot.experiments.study.figures import look_of
from surefoot.experiments.study.page import ReportFigure, Section, Words, save_tables, write_page
from surefoot.experiments.study.tables import Frame, Table, plural, sentence
from surefoot.experiments.walks.video import HEIGHT, WIDTH, headed, mark_cop, pictures, write_film
from surefoot.experiments.walks.walkers import Moment

_say = Words("episodes")

LAST_SECONDS = 12.0  # what is kept of a long episode, in s: its end, where the fall is


def film_episode(path: Path, episode: Episode, *, until: float | None = None) -> Path:
    """Film the last 12 s of an episode, or all, with true (black) and fed CoP, as .mp4; OSError as drawn."""
    who = f"{short_name(episode.controller)}, {look_of(episode.feed).label}, {episode.scenario}"

    def draw(moment: Moment) -> NDArray[np.uint8]:
        mark_cop(episode.feed, moment)
        picture = Image.fromarray(moment.bare.render())
        headed(picture, f"case {episode.number}: {who}", moment, 24, 14)
        return np.asarray(picture)

    size: Any = {"width": WIDTH, "height": HEIGHT}
    begin = 0.0 if until is None else until - LAST_SECONDS
    drawn = pictures(lambda: episode_moments(episode, render_mode="rgb_array", **size), draw, begin)
    return write_film(path, [frame for frame, _ in drawn], quality=6)


_FILM = f"Its last {LAST_SECONDS:g} s; dots: the true centre of pressure (black) and the one fed back."

_LISTED = 5  # how many of the worst episodes are listed at least


class SweepPage:
    """Tables and figures of a sweep, films of its worst episodes, and the page that holds them."""

    def __init__(self, results: EpisodeResults, *, films: int = 0) -> None:
        self.results, self.folder, self.films = results, results.folder, films
        self.rows = rows = results.finished
        ran = set(rows["scenario"])
        self.titles = {name: results.plan.title_of(name) for name in results.plan.scenarios if name in ran}
        self.outcomes = {
            name: tables.outcome_table(rows, name, sentence(title)) for name, title in self.titles.items()
        }
        self.half = tables.half_table(rows, self.titles)
        self.failed = tables.failure_table(results.failed)
        self.worst = _worst(rows, max(films, _LISTED))

    @property
    def tables(self) -> tuple[Table, ...]:
        """All tables, in the order of the page."""
        optional = (self.half, *self.outcomes.values(), self.failed)
        return tuple(table for table in optional if table is not None)

    def write(self) -> Path:
        """Draw the figures, save the tables as CSV, film, and write ``index.html``."""
        save_tables(self.folder / "tables", self.tables)
        plan, failed = self.results.plan, len(self.results.failed)
        amount = _say(
            "sweep_amount",
            cases=plural(len(self.results.rows), "case"),
            duration=plan.duration,
            settle=plan.settle,
            failed=plural(failed, "case"),
        )
        sections = [self._summary(), *map(self._scenario, self.titles)] if self.titles else []
        if self.failed is not None:
            sections.append(Section("failed", "Cases that failed", tables=(self.failed,)))
        if self.titles:
            note = () if self.films else ("Films of them come with --films.",)
            listed = (tables.worst_table(self.worst),)
            sections.append(Section("worst", "The worst episodes", note, tables=listed))
            sections += [self._film(row) for row in self.worst.head(self.films).to_dict("records")]
        shown = self.worst if self.titles else self.results.rows
        command = f"surefoot replay {self.folder} --case {int(shown['case'].iloc[0])}"
        sections.append(Section("repeat", "Repeat any part", (_say("sweep_repeat"),), commands=(command,)))
        introduction = (_say("sweep", cells=plan.cells), amount)
        return write_page(self.folder / "index.html", "surefoot sweep", introduction, sections)

    def _summary(self) -> Section:
        path = figures.heat_maps(self.folder / "figures" / "heat.svg", self.rows, self.titles)
        shown = () if self.half is None else (self.half,)
        drawn = (ReportFigure(path, "Falls", _say("heat")),)
        return Section("summary", "In short", tables=shown, figures=drawn)

    def _scenario(self, name: str) -> Section:
        part, table = self.rows[self.rows["scenario"] == name], self.outcomes[name]
        drawn = figures.outcome_figures(self.folder / "figures", part, f"_{name}")
        return Section(name, table.title, tables=(table,), figures=drawn)

    def _film(self, row: dict[str, Any]) -> Section:
        episode = Episode.from_json(row["spec"])
        anchor, title = f"film-{episode.number}", f"Case {episode.number} on film"
        path = self.folder / "films" / f"case{episode.number}.mp4"
        try:
            film_episode(path, episode, until=row["time"])
        except OSError as error:
            return Section(anchor, title, (f"There is no film: {error}",))
        film = "data:video/mp4;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
        return Section(anchor, title, video=film, video_caption=_FILM)


def _worst(rows: Frame, count: int) -> Frame:
    """Return the earliest falls, and then the lowest returns: those of different tasks cannot be compared."""
    order = ["fell", "time", "return", "case"]
    return rows.sort_values(order, ascending=[False, True, True, True]).head(count)
