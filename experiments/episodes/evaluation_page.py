"""An evaluation's page: what was compared, what came of it, and how to repeat it, in one file."""

import shlex
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.experiments.episodes import figures
from surefoot.experiments.episodes.comparisons import COMPARISONS
from surefoot.experiments.episodes.findings import controller_findings, target_table
from surefoot.experiments.episodes.randomisation import answers, gap_table, trainings, two_by_two
from surefoot.experiments.episodes.rows import in_order, origins_of
from surefoot.experiments.episodes.scores import (
    controllers_of,
    same_seeds,
    seed_ranges,
    seeds_text,
    severities_of,
)
from surefoot.experiments.episodes.tables import difference_table, failure_table, score_table
from surefoot.experiments.policy.card import SCORES, WHOSE
from surefoot.experiments.policy.controllers import BUILT_IN, labels
from surefoot.experiments.policy.tasks import task_named
from surefoot.experiments.study.page import ReportFigure, Section, Words, save_tables, write_page
from surefoot.experiments.study.tables import Frame, Table
from surefoot.files import atomic_path

_say = Words("episodes")

_KINDS = {"true": ": trained on true feet", "randomised": ": trained on randomised feet"}

_LEARNT_NOTHING = {"stabiliser": ": feedback of the CoP, no learning", "zero": ": nobody acts"}


class EvaluationPage:
    """Tables, figures and page of episodes of one task; ValueError if none, twice or of several."""

    def __init__(self, frame: Frame) -> None:
        failed = frame["error"] != "" if "error" in frame else frame["feed"] == ""
        self.failed = failure_table(frame[failed])
        if failed.any() and failed.all():
            raise ValueError(
                f"There are no episodes to make a page of: all {len(frame)} failed, the first with "
                f"'{frame['error'].iloc[0].splitlines()[-1]}'."
            )
        frame = frame[~failed]
        _check(frame)
        self.frame = in_order(frame)
        self.task = task_named(str(frame["scenario"].iloc[0]))
        self.controllers = controllers_of(self.frame)
        self.labels = labels(self.controllers)
        self.origins = origins_of(self.frame)
        trained = {name: origin.trained for name, origin in self.origins.items()}
        both = trainings(self.frame, trained)
        found = [] if both is None else answers(self.frame, *both)
        self.answers = tuple(answer.words() for answer in found)
        self.randomisation: tuple[Table, ...] = ()
        if both is not None and found:
            self.randomisation = tuple(make(self.frame, *both, found) for make in (two_by_two, gap_table))
        # What learnt nothing was set no target: of the policies, the one that was trained on true feet.
        learnt = [name for name in self.controllers if name not in BUILT_IN]
        clean = [name for name in learnt if trained[name] == "true"]
        self.targets = target_table(self.frame, (clean or learnt)[0], found) if learnt else None
        self.scores = tuple(
            score_table(
                self.frame[self.frame["controller"] == name],
                f"scores_{number}",
                self.labels[name] + _LEARNT_NOTHING.get(name, _KINDS.get(trained[name], "")),
            )
            for number, name in enumerate(self.controllers)
        )
        compared = [(comparison, comparison.find(self.frame)) for comparison in COMPARISONS]
        self.compared = [(comparison, found) for comparison, found in compared if found]
        self.differences = tuple(difference_table(of, c.name, c.table) for c, of in self.compared)

    @property
    def tables(self) -> tuple[Table, ...]:
        """All tables, in the order of the page."""
        targets = (self.targets,) if self.targets is not None and self.targets.rows else ()
        failed = () if self.failed is None else (self.failed,)
        return (*targets, *self.scores, *self.differences, *self.randomisation, *failed)

    def write(self, folder: Path) -> Path:
        """Draw the figures, save tables and scores as CSV, and write ``index.html`` in a folder."""
        save_tables(folder / "tables", self.tables)
        with atomic_path(folder / SCORES) as part:
            pd.concat(map(self._scores_of, self.controllers, self.scores)).to_csv(part, index=False)
        title, sections = f"surefoot evaluate: {self.task.name}", self._sections(folder / "figures")
        return write_page(folder / "index.html", title, self._introduction(), sections)

    def _scores_of(self, controller: str, scores: Table) -> Frame:
        """Return a table of scores with whose they are, for the card of a policy."""
        own = self.frame[self.frame["controller"] == controller]
        runs = own.groupby(["feed", "cop_input", "severity"], sort=False)["seed"]
        seeds = [seeds_text(of) for _, of in runs]
        said = (controller, self.origins[controller].file, self.task.name, seeds)
        return pd.concat([pd.DataFrame(dict(zip(WHOSE, said, strict=True))), scores.to_frame()], axis=1)

    def _introduction(self) -> tuple[str, ...]:
        seeds = self.frame["seed"]
        amount = _say(
            "amount",
            episodes=len(self.frame),
            count=seeds.nunique(),
            seeds=seeds_text(seeds),
            paired=_say("paired" if same_seeds(self.frame) else "unpaired"),
        )
        return _say("introduction", env_id=self.task.env_id), _say("feeds"), amount

    def _sections(self, drawn: Path) -> list[Section]:
        findings = [text for name in self.controllers for text in controller_findings(self.frame, name)]
        targets = tuple(table for table in self.tables if table.name == "targets")
        sections = [Section("summary", "In short", findings=(*findings, *self.answers), tables=targets)]
        if self.failed is not None:
            sections.append(Section("failed", "Episodes that failed", tables=(self.failed,)))
        given = self.frame[self.frame["cop_input"] == "given"]
        since = " since the quiet stand"
        outcomes = figures.outcome_figures(drawn, given, since=since) if len(given) else ()
        sections.append(Section("scores", "Scores", tables=self.scores, figures=outcomes))
        for (comparison, found), table in zip(self.compared, self.differences, strict=True):
            path = figures.forest(drawn / f"{table.name}.svg", found)
            shown: Any = {"tables": (table,), "figures": (ReportFigure(path, table.title, _say("forest")),)}
            sections.append(Section(table.name, comparison.title, comparison.text, **shown))
        if self.randomisation:
            title, shown = "Is domain randomisation enough?", {"tables": self.randomisation}
            text = (_say("randomisation"),)
            sections.append(Section("randomisation", title, text, self.answers, **shown))
        sections.append(self._repeat())
        return sections

    def _repeat(self) -> Section:
        text = [*self._versions(), _say("again")]
        if given := [self.labels[name] for name, origin in self.origins.items() if not origin.runs]:
            text.append(f"No command runs {', '.join(given)}: the episodes were given as files.")
        return Section("repeat", "Repeat it", (" ".join(text),), commands=tuple(self.commands()))

    def _versions(self) -> list[str]:
        """Return with what the episodes were made: once if all alike, else of each controller."""
        versions = {name: origin.versions for name, origin in self.origins.items()}
        if len(set(versions.values())) == 1:
            return [f"The episodes were made with {each}." for each in set(versions.values()) if each]
        return [
            f"Those of {self.labels[name]} were made with {each or 'versions that nobody wrote down'}."
            for name, each in versions.items()
        ]

    def commands(self) -> list[str]:
        """Return the commands that run these episodes again, but for controllers given as files."""
        alike: dict[str, list[str]] = {}
        for name in (name for name, origin in self.origins.items() if origin.runs):
            own = self.frame[self.frame["controller"] == name]
            options = [f"--task {self.task.name}"]
            options += [f"--feed {feed}" for feed in dict.fromkeys(own["feed"])]
            options += [f"--severity {severity:g}" for severity in severities_of(own) or [1.0]]
            for first, last in seed_ranges(own["seed"]):
                each = [*options, f"--seeds {last - first + 1} --first-seed {first}"]
                each += ["--uses-cop"] * bool((own["cop_input"] != "given").any())
                alike.setdefault(" ".join(each), []).append(shlex.quote(name))
        return [f"surefoot evaluate {' '.join(names)} {options}" for options, names in alike.items()]


def _check(frame: Frame) -> None:
    if not len(frame):
        raise ValueError("There are no episodes to make a page of.")
    if len(tasks := sorted(set(frame["scenario"]))) > 1:
        raise ValueError(f"Episodes of the tasks {', '.join(tasks)} cannot share a page; give those of one.")
    twice = frame[frame.duplicated(["controller", "feed", "cop_input", "severity", "seed"])]
    if len(twice):
        row = twice.iloc[0]
        raise ValueError(
            f"Controller '{row['controller']}', feed '{row['feed']}', severity {row['severity']:g}, seed "
            f"{row['seed']} is there twice; give controllers of different files different names, NAME=FILE."
        )
