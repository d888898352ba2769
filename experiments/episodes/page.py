"""Pages of episodes, one file each: of an evaluation, the comparison; of a sweep, who fell where."""

import base64
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from PIL import Image

from surefoot.experiments.episodes import figures, tables
from surefoot.experiments.episodes.comparisons import COMPARISONS, trainings
from surefoot.experiments.episodes.episode import Episode, episode_moments
from surefoot.experiments.episodes.findings import controller_findings, target_table
from surefoot.experiments.episodes.run import EpisodeResults, Origin, in_order, origins_of
from surefoot.experiments.episodes.scores import (
    controllers_of,
    same_seeds,
    seed_ranges,
    seeds_text,
    severities_of,
)
from surefoot.experiments.policy.card import SCORES, WHOSE
from surefoot.experiments.policy.controllers import labels, short_name
from surefoot.experiments.policy.tasks import Task, task_named
from surefoot.experiments.study.figures import look_of
from surefoot.experiments.study.page import Report, ReportFigure, Section, Words, publish
from surefoot.experiments.study.tables import Frame, Table, plural, sentence
from surefoot.experiments.walks.video import HEIGHT, WIDTH, mark_cop, pictures, write_film, write_heading
from surefoot.experiments.walks.walkers import Moment
from surefoot.files import atomic_path

_say = Words("episodes")

_KINDS = {"true": ": trained on true feet", "randomised": ": trained on randomised feet"}

_LEARNT_NOTHING = {"stabiliser": ": feedback of the CoP, no learning", "zero": ": nobody acts"}

PAGE = "index.html"
LAST_SECONDS = 12.0  # what is kept of a long episode, in s: its end, where the fall is

_FILM = f"Its last {LAST_SECONDS:g} s; dots: the true centre of pressure (black) and the one fed back."

_LISTED = 5  # how many of the worst episodes are listed at least


def check_episodes(frame: Frame) -> tuple[Frame, Frame]:
    """Return the rows of one task that can be scored, in order, and of failures; ValueError for no page."""
    failed = frame["error"] != "" if "error" in frame else frame["feed"] == ""
    if failed.any() and failed.all():
        raise ValueError(
            f"There are no episodes to make a page of: all {len(frame)} failed, the first with "
            f"'{frame['error'].iloc[0].splitlines()[-1]}'."
        )
    finished = frame[~failed]
    if not len(finished):
        raise ValueError("There are no episodes to make a page of.")
    if len(tasks := sorted(set(finished["scenario"]))) > 1:
        raise ValueError(f"Episodes of the tasks {', '.join(tasks)} cannot share a page; give those of one.")
    twice = finished[finished.duplicated(["controller", "feed", "cop_input", "severity", "seed"])]
    if len(twice):
        row = twice.iloc[0]
        raise ValueError(
            f"Controller '{row['controller']}', feed '{row['feed']}', severity {row['severity']:g}, seed "
            f"{row['seed']} is there twice; give controllers of different files different names, NAME=FILE."
        )
    return in_order(finished), frame[failed]


def write_evaluation(frame: Frame, failed: Frame, folder: Path) -> Report:
    """Draw the figures, save tables and scores as CSV, and write the page of checked episodes."""
    task, origins = task_named(str(frame["scenario"].iloc[0])), origins_of(frame)
    scores = _score_tables(frame, origins)
    with atomic_path(folder / SCORES) as part:
        of_each = (_name_scores(frame, name, scores[name], origins[name], task) for name in scores)
        pd.concat(of_each).to_csv(part, index=False)
    amount = _say(
        "amount",
        episodes=len(frame),
        count=frame["seed"].nunique(),
        seeds=seeds_text(frame["seed"]),
        paired=_say("paired" if same_seeds(frame) else "unpaired"),
    )
    introduction = _say("introduction", env_id=task.env_id), _say("feeds"), amount
    sections = [*_evaluation_sections(frame, scores, folder / "figures"), *_failures(failed)]
    sections.append(_repeat_evaluation(frame, origins, task))
    return publish(folder, f"surefoot evaluate: {task.name}", introduction, sections, name=PAGE)


def _score_tables(frame: Frame, origins: dict[str, Origin]) -> dict[str, Table]:
    """Return a table of scores for each controller."""
    brief = labels(controllers_of(frame))
    return {
        name: tables.score_table(
            frame[frame["controller"] == name],
            f"scores_{number}",
            brief[name] + _LEARNT_NOTHING.get(name, _KINDS.get(origins[name].trained, "")),
        )
        for number, name in enumerate(brief)
    }


def _name_scores(frame: Frame, controller: str, scores: Table, origin: Origin, task: Task) -> Frame:
    """Add to a table of scores whose they are, for the card of a policy."""
    own = frame[frame["controller"] == controller]
    runs = own.groupby(["feed", "cop_input", "severity"], sort=False)["seed"]
    said = (controller, origin.file, task.name, [seeds_text(of) for _, of in runs])
    return pd.concat([pd.DataFrame(dict(zip(WHOSE, said, strict=True))), scores.to_frame()], axis=1)


def _evaluation_sections(frame: Frame, scores: dict[str, Table], drawn: Path) -> Iterator[Section]:
    said = tuple(text for name in scores for text in controller_findings(frame, name))
    pair, targets = trainings(frame), target_table(frame)
    shown = () if targets is None or not targets.rows else (targets,)
    yield Section("summary", "In short", findings=said, tables=shown)
    given = frame[frame["cop_input"] == "given"]
    outcomes = figures.outcome_figures(drawn, given, since=" since the quiet stand") if len(given) else ()
    yield Section("scores", "Scores", tables=tuple(scores.values()), figures=outcomes)
    for comparison in COMPARISONS:
        if found := comparison.find(frame):
            table = tables.difference_table(found, comparison.name, comparison.table)
            path = figures.forest(drawn / f"{table.name}.svg", found)
            extra = (tables.two_by_two(frame, *pair),) if pair and comparison is COMPARISONS[-1] else ()
            more: Any = {"figures": (ReportFigure(path, table.title, _say("forest")),)}
            yield Section(table.name, comparison.title, comparison.text, tables=(*extra, table), **more)


def _failures(rows: Frame) -> tuple[Section, ...]:
    table = tables.failure_table(rows)
    return () if table is None else (Section("failed", "Episodes that failed", tables=(table,)),)


def _repeat_evaluation(frame: Frame, origins: dict[str, Origin], task: Task) -> Section:
    brief = labels(list(origins))
    text = [*_say_versions({brief[name]: origin.versions for name, origin in origins.items()}), _say("again")]
    if given := [brief[name] for name, origin in origins.items() if not origin.runs]:
        text.append(f"No command runs {', '.join(given)}: the episodes were given as files.")
    return Section("repeat", "Repeat it", (" ".join(text),), commands=tuple(commands_of(frame, task)))


def _say_versions(versions: dict[str, str]) -> list[str]:
    """Name the versions that made the episodes: once if all alike, else of each controller."""
    if len(set(versions.values())) == 1:
        return [f"The episodes were made with {each}." for each in set(versions.values()) if each]
    return [
        f"Those of {name} were made with {each or 'versions that nobody wrote down'}."
        for name, each in versions.items()
    ]


def commands_of(frame: Frame, task: Task) -> list[str]:
    """Return the commands that run episodes again, but for controllers given as files."""
    alike: dict[str, list[str]] = {}
    for name in (name for name, origin in origins_of(frame).items() if origin.runs):
        own = frame[frame["controller"] == name]
        options = [f"--task {task.name}"]
        options += [f"--feed {feed}" for feed in dict.fromkeys(own["feed"])]
        options += [f"--severity {severity:g}" for severity in severities_of(own) or [1.0]]
        for first, last in seed_ranges(own["seed"]):
            each = [*options, f"--seeds {last - first + 1} --first-seed {first}"]
            each += ["--uses-cop"] * bool((own["cop_input"] != "given").any())
            alike.setdefault(" ".join(each), []).append(shlex.quote(name))
    return [f"surefoot evaluate {' '.join(names)} {options}" for options, names in alike.items()]


def write_sweep(results: EpisodeResults, films: int = 0) -> Report:
    """Draw the figures, save the tables as CSV, film the worst episodes, and write the page of a sweep."""
    plan, rows, folder = results.plan, results.finished, results.folder
    ran = set(rows["scenario"])
    titles = {name: plan.title_of(name) for name in plan.scenarios if name in ran}
    worst = _worst(rows, max(films, _LISTED))
    sections = [*_sweep_sections(rows, titles, folder / "figures")] if titles else []
    sections += _failures(results.failed)
    if titles:
        note = () if films else ("Films of them come with --films.",)
        sections.append(Section("worst", "The worst episodes", note, tables=(tables.worst_table(worst),)))
        sections += [_film_section(folder, row) for row in worst.head(films).to_dict("records")]
    shown = worst if titles else results.rows
    command = f"surefoot replay {folder} --case {int(shown['case'].iloc[0])}"
    sections.append(Section("repeat", "Repeat any part", (_say("sweep_repeat"),), commands=(command,)))
    amount = _say(
        "sweep_amount",
        cases=plural(len(results.rows), "case"),
        duration=plan.duration,
        settle=plan.settle,
        failed=plural(len(results.failed), "case"),
    )
    introduction = (_say("sweep", cells=plan.cells), amount)
    report = publish(folder, "surefoot sweep", introduction, sections, name=PAGE)
    return report._replace(tables=tuple(table for table in report.tables if table.name != "worst"))


def _sweep_sections(rows: Frame, titles: dict[str, str], drawn: Path) -> Iterator[Section]:
    half = tables.half_table(rows, titles)
    heat = (ReportFigure(figures.heat_maps(drawn / "heat.svg", rows, titles), "Falls", _say("heat")),)
    yield Section("summary", "In short", tables=() if half is None else (half,), figures=heat)
    for name, title in titles.items():
        table = tables.outcome_table(rows, name, sentence(title))
        outcomes = figures.outcome_figures(drawn, rows[rows["scenario"] == name], f"_{name}")
        yield Section(name, table.title, tables=(table,), figures=outcomes)


def _film_section(folder: Path, row: dict[str, Any]) -> Section:
    episode = Episode.from_json(row["spec"])
    anchor, title = f"film-{episode.number}", f"Case {episode.number} on film"
    path = folder / "films" / f"case{episode.number}.mp4"
    try:
        film_episode(path, episode, until=row["time"])
    except OSError as error:
        return Section(anchor, title, (f"There is no film: {error}",))
    film = "data:video/mp4;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
    return Section(anchor, title, video=film, video_caption=_FILM)


def film_episode(path: Path, episode: Episode, *, until: float | None = None) -> Path:
    """Film the last 12 s of an episode, or all, with true (black) and fed CoP, as .mp4; OSError as drawn."""
    who = f"{short_name(episode.controller)}, {look_of(episode.feed).label}, {episode.scenario}"

    def draw(moment: Moment) -> NDArray[np.uint8]:
        mark_cop(episode.feed, moment)
        picture = Image.fromarray(moment.bare.render())
        write_heading(picture, f"case {episode.number}: {who}", moment, 24, 14)
        return np.asarray(picture)

    size: Any = {"width": WIDTH, "height": HEIGHT}
    begin = 0.0 if until is None else until - LAST_SECONDS
    drawn = pictures(lambda: episode_moments(episode, render_mode="rgb_array", **size), draw, begin)
    return write_film(path, [frame for frame, _ in drawn], quality=6)


def _worst(rows: Frame, count: int) -> Frame:
    """Return the earliest falls, and then the lowest returns: those of different tasks cannot be compared."""
    order = ["fell", "time", "return", "case"]
    return rows.sort_values(order, ascending=[False, True, True, True]).head(count)
