"""Pages of episodes, one file each: of an evaluation, the comparison; of a sweep, who fell where."""

from collections.abc import Iterator
from pathlib import Path

from surefoot.experiments.episodes import figures, tables
from surefoot.experiments.episodes.episode import VERSIONS
from surefoot.experiments.episodes.plan import find_scenario
from surefoot.experiments.episodes.run import EpisodeResults, sort_episodes
from surefoot.experiments.episodes.scores import (
    CALIBRATED,
    COMPARISONS,
    controllers_of,
    same_seeds,
    seeds_text,
    severities_of,
    trainings,
)
from surefoot.experiments.policy.controllers import labels
from surefoot.experiments.policy.tasks import find_task
from surefoot.experiments.study.figures import by_way
from surefoot.experiments.study.page import Report, Section, Words, command_line, failure_section, publish
from surefoot.experiments.study.tables import Frame, Table, plural, sentence

_say = Words("episodes")

_KINDS = {"true": ": trained on true feet", "randomised": ": trained on randomised feet"}

_LEARNT_NOTHING = {"stabiliser": ": feedback of the CoP, no learning", "zero": ": nobody acts"}

_READ = {"true": "on true feet", "none": "on raw readings", CALIBRATED: f"by {CALIBRATED!r}"}

PAGE = "index.html"

_LISTED = 5  # how many of the worst episodes are listed


def check_episodes(frame: Frame) -> tuple[Frame, Frame]:
    """Return the rows of one task that can be scored, in order, and of failures; ValueError for no page."""
    said = ("error", "controller_hash", "trained", *VERSIONS)  # by files of today; others lack some
    frame = frame.assign(**{name: frame[name].fillna("") if name in frame else "" for name in said})
    failed = frame["error"] != ""
    finished = frame[~failed]
    if not len(finished):
        errors = [error.splitlines()[-1] for error in frame["error"]]
        why = f": all {len(errors)} failed, the first with '{errors[0]}'" if errors else ""
        raise ValueError(f"There are no episodes to make a page of{why}.")
    if len(tasks := sorted(set(finished["scenario"]))) > 1:
        raise ValueError(f"Episodes of the tasks {', '.join(tasks)} cannot share a page; give those of one.")
    cure = "give controllers of different files different names, NAME=FILE."
    twice = finished[finished.duplicated(["controller", "feed", "severity", "seed"])]
    if len(twice):
        row = twice.iloc[0]
        raise ValueError(
            f"Controller '{row['controller']}', feed '{row['feed']}', severity {row['severity']:g}, seed "
            f"{row['seed']} is there twice; {cure}"
        )
    files = finished[finished["controller_hash"] != ""].groupby("controller")["controller_hash"].nunique()
    if len(changed := files[files > 1]):
        raise ValueError(
            f"'{changed.index[0]}' is not the same file everywhere: it was changed between one evaluation "
            f"and the next; {cure}"
        )
    return sort_episodes(finished), frame[failed]


def write_evaluation(frame: Frame, failed: Frame, folder: Path) -> Report:
    """Draw the figures, save tables and scores as CSV, and write the page of checked episodes."""
    task, brief = find_task(str(frame["scenario"].iloc[0])), labels(controllers_of(frame))
    own = {name: frame[frame["controller"] == name] for name in brief}
    scores = {
        name: tables.score_table(
            runs,
            f"scores_{number}",
            brief[name] + _LEARNT_NOTHING.get(name, _KINDS.get(runs["trained"].iloc[0], "")),
        )
        for number, (name, runs) in enumerate(own.items())
    }
    amount = _say(
        "amount",
        episodes=len(frame),
        count=frame["seed"].nunique(),
        seeds=seeds_text(frame["seed"]),
        paired=_say("paired" if same_seeds(frame) else "unpaired"),
    )
    introduction = _say("introduction", env_id=task.env_id), _say("feeds"), amount
    sections = [*_evaluation_sections(frame, scores, folder / "figures"), *_failures(failed)]
    made = [f"{brief[name]}: {_versions_of(runs)}." for name, runs in own.items()]
    repeat = "The episodes were made with these versions. " + " ".join([*made, _say("again")])
    sections.append(Section("repeat", "Repeat it", (repeat,), commands=(command_line(),)))
    title, lead = f"surefoot evaluate: {task.name}", _lead({"": frame})
    return publish(folder, title, introduction, sections, lead=lead, name=PAGE)


def _lead(parts: dict[str, Frame]) -> Section:
    """Begin the page with who falls at the largest severity, and what is returned; ``parts`` by title."""
    said = [f"{title}{text}" for title, frame in parts.items() for text in _say_outcomes(frame)]
    return Section("lead", "What was done", findings=tuple(said))


def _say_outcomes(frame: Frame) -> Iterator[str]:
    for name, brief in labels(controllers_of(frame)).items():
        own = frame[frame["controller"] == name]
        severity = max(severities_of(own), default=0.0)
        feeds = by_way(own[(own["feed"] == "true") | (own["severity"] == severity)], "feed")
        shown = {feed: feeds[feed] for feed in ("true", "none", CALIBRATED) if feed in feeds}
        fell = {feed: f"{int(runs['fell'].sum())} of {len(runs)} fall" for feed, runs in shown.items()}
        said = [f"{_READ[feed]} {fell[feed]} (return {shown[feed]['return'].mean():.0f})" for feed in shown]
        if said:
            yield f"{brief}, severity {severity:g}: {'; '.join(said)}."


def _versions_of(runs: Frame) -> str:
    found = runs[list(VERSIONS)].drop_duplicates().to_dict("records")
    return "; ".join(", ".join(f"{name} {one[name] or 'unknown'}" for name in VERSIONS) for one in found)


def _evaluation_sections(frame: Frame, scores: dict[str, Table], drawn: Path) -> Iterator[Section]:
    pair = trainings(frame)
    outcomes = figures.outcome_figures(drawn, frame, since=" since the quiet stand")
    yield Section("scores", "Scores", tables=tuple(scores.values()), figures=outcomes)
    for comparison in COMPARISONS:
        if found := comparison.find(frame):
            table = tables.difference_table(found, comparison.name, comparison.table)
            extra = (tables.two_by_two(frame, *pair),) if pair and comparison is COMPARISONS[-1] else ()
            yield Section(table.name, comparison.title, comparison.text, tables=(*extra, table))


def _failures(rows: Frame) -> tuple[Section, ...]:
    return failure_section(
        {
            f"case {row['case']}: {row['controller']}, {row['feed']}, {row['scenario']}, severity "
            f"{row['severity']:g}, seed {row['seed']}": row["error"]
            for row in rows.to_dict("records")
        }
    )


def write_sweep(results: EpisodeResults) -> Report:
    """Draw the figures, save the tables as CSV, and write the page of a sweep."""
    plan, rows, folder = results.plan, results.finished, results.folder
    ran = set(rows["scenario"])
    titles = {name: find_scenario(name, plan.own).title for name in plan.scenarios if name in ran}
    # The earliest falls, and then the lowest returns: those of different tasks cannot be compared.
    order = {"fell": False, "time": True, "return": True, "case": True}
    worst = rows.sort_values([*order], ascending=[*order.values()]).head(_LISTED)
    sections = [*_sweep_sections(rows, titles, folder / "figures")] if titles else []
    sections += _failures(results.failed)
    if titles:
        sections.append(Section("worst", "The worst episodes", tables=(tables.worst_table(worst),)))
    shown = worst if titles else results.rows
    command = f"surefoot replay {folder} --case {int(shown['case'].iloc[0])}"
    commands = (command, f"{command} --video worst.mp4")
    sections.append(Section("repeat", "Repeat any part", (_say("sweep_repeat"),), commands=commands))
    amount = _say(
        "sweep_amount",
        cases=plural(len(results.rows), "case"),
        duration=plan.duration,
        settle=plan.settle,
        failed=plural(len(results.failed), "case"),
    )
    introduction = (_say("sweep", cells=plan.cells), amount)
    lead = _lead({f"{sentence(title)}: ": rows[rows["scenario"] == name] for name, title in titles.items()})
    report = publish(folder, "surefoot sweep", introduction, sections, lead=lead, name=PAGE)
    return report._replace(tables=tuple(table for table in report.tables if table.name != "worst"))


def _sweep_sections(rows: Frame, titles: dict[str, str], drawn: Path) -> Iterator[Section]:
    if (half := tables.half_table(rows, titles)) is not None:
        yield Section("half", "Where half fall", tables=(half,))
    for name, title in titles.items():
        part = sort_episodes(rows[rows["scenario"] == name])
        table = tables.score_table(part, f"outcome_{name}", sentence(title))
        outcomes = figures.outcome_figures(drawn, part, f"_{name}")
        yield Section(name, table.title, tables=(table,), figures=outcomes)
