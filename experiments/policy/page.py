"""An evaluation's page: what was compared, what came of it, and how to repeat it, in one file."""

import shlex
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from surefoot.experiments.policy import figures
from surefoot.experiments.policy.comparison import (
    difference_table,
    differences,
    input_differences,
    nobody_differences,
)
from surefoot.experiments.policy.controllers import BUILT_IN, labels
from surefoot.experiments.policy.findings import controller_findings, target_table
from surefoot.experiments.policy.origin import Origin
from surefoot.experiments.policy.randomisation import answers, gap_table, trainings, two_by_two
from surefoot.experiments.policy.scores import (
    controllers_of,
    in_order,
    same_seeds,
    score_table,
    seed_ranges,
    seeds_text,
)
from surefoot.experiments.policy.tasks import task_named
from surefoot.experiments.study.files import atomic_path
from surefoot.experiments.study.page import ReportFigure, Section, flat, write_page
from surefoot.experiments.study.runner import machine
from surefoot.experiments.study.tables import Frame, Table

__all__ = ["EvaluationPage"]

_INTRODUCTION = """
    Controllers on {env_id}. What they are given for the centre of pressure (CoP) differs, and nothing else:
    the same seed is the same command, load, pushes, ground and sensors for all of them. Severity is a factor
    of all errors of the feet's load cells; true feet have none, and are run once. Scores begin when the quiet
    stand is over."""

_FEEDS = """
    What is fed back: 'true', the simulator's own; 'none', readings of drifting feet as they are; 'bench', by
    coefficients from a bench just before the episode; 'quasi-static', Han's method; 'window', that of the CoP
    paper; and 'moment'. What was not run is left out."""

_AMOUNT = """
    {episodes} episodes of {count} seeds ({seeds}). {paired} Intervals are 95 %: of means Student's t, of the
    loss won back a bootstrap over seeds, of survival Greenwood's."""

_PAIRED = "Every row is of the same seeds."

_UNPAIRED = """
    Not all rows are of the same seeds: differences are taken over those that both sides have, and say how
    many there are; means beside each other are not of the same episodes."""

_KINDS = {"true": ": trained on true feet", "randomised": ": trained on randomised feet"}

_BUILT_IN = {"stabiliser": ": feedback of the CoP, no learning", "zero": ": nobody acts"}

_CAPTIONS = {
    "returns": "Mean return with 95 % intervals (Student t), and share of falls (Wilson), over severity.",
    "survival": "Share on its feet over time since the quiet stand (Kaplan and Meier) with 95 % bands "
    "(Greenwood, log-log).",
    "forest": "Differences of returns between episodes of the same seed, with 95 % intervals. What crosses "
    "the line at zero may be nothing.",
}

_RANDOMISATION = """
    A policy that was trained on randomised sensors has learnt what to make of feet that lie; a calibration
    makes them lie less. Either can be had without the other. All intervals are over the episodes of these two
    trained policies: how far another training of the same kind, by another seed, would come out from them is
    in none."""

_INPUTS = """
    True feet, but the controller is given a CoP that is held (frozen), that of another episode (swapped), or
    that of another episode in random order (shuffled). Who uses the CoP loses by it."""

_NOBODY = """
    Returns less those of the zero action, which leaves the robot to its pattern: who acts on feet that lie
    may do worse than nobody."""


class EvaluationPage:
    """Tables and figures of an evaluation, and the page that holds them.

    Args:
        frame: Episodes with the columns ``controller`` and ``task``, see
            :func:`~surefoot.experiments.policy.scores.episodes_frame`.
        origins: What is known of the controllers; those of which nothing is may be left out.

    Raises:
        ValueError: If there are no episodes, or of several tasks, or one of them twice.
    """

    def __init__(self, frame: Frame, origins: Mapping[str, Origin] | None = None) -> None:
        _check(frame)
        self.frame = in_order(frame)
        self.task = task_named(str(frame["task"].iloc[0]))
        self.controllers = controllers_of(self.frame)
        self.labels = labels(self.controllers)
        self.origins = {name: (origins or {}).get(name, Origin()) for name in self.controllers}
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
                self.labels[name] + _BUILT_IN.get(name, _KINDS.get(trained[name], "")),
            )
            for number, name in enumerate(self.controllers)
        )
        self.differences = differences(self.frame)
        self.nobody = nobody_differences(self.frame)
        self.inputs = input_differences(self.frame)

    @property
    def tables(self) -> tuple[Table, ...]:
        """All tables, in the order of the page."""
        found = [self.targets] if self.targets is not None and self.targets.rows else []
        found += self.scores
        if self.differences:
            found.append(difference_table(self.differences, "differences", "Paired differences of returns"))
        if self.nobody:
            found.append(difference_table(self.nobody, "nobody", "What acting is worth"))
        if self.inputs:
            found.append(difference_table(self.inputs, "inputs", "What another CoP costs"))
        return (*found, *self.randomisation)

    def write(self, folder: Path) -> Path:
        """Draw the figures, save the tables as CSV, and write ``index.html``.

        Args:
            folder: Where; it is made.
        """
        tables = {table.name: table for table in self.tables}
        for table in tables.values():
            with atomic_path(folder / "tables" / f"{table.name}.csv") as part:
                table.to_frame().to_csv(part, index=False)
        drawn = folder / "figures"
        drawn.mkdir(parents=True, exist_ok=True)
        said = [sentence for name in self.controllers for sentence in controller_findings(self.frame, name)]
        shown = (tables["targets"],) if "targets" in tables else ()
        sections = [Section("summary", "In short", findings=(*said, *self.answers), tables=shown)]
        sections.append(self._scores(drawn))
        for name, title, text, found in (
            ("differences", "Feet against feet", "", self.differences),
            ("nobody", "Is acting worth it?", _NOBODY, self.nobody),
            ("inputs", "Is the CoP used?", _INPUTS, self.inputs),
        ):
            if found:
                path = figures.forest(drawn / f"{name}.png", found)
                figure = ReportFigure(path, tables[name].title, _CAPTIONS["forest"])
                said_before = (flat(text),) * bool(text)
                sections.append(Section(name, title, said_before, tables=(tables[name],), figures=(figure,)))
        if self.randomisation:
            sections.append(
                Section(
                    "randomisation",
                    "Is domain randomisation enough?",
                    (flat(_RANDOMISATION),),
                    findings=self.answers,
                    tables=self.randomisation,
                )
            )
        sections.append(self._repeat())
        made = f"Made {datetime.now(UTC):%Y-%m-%d %H:%M} UTC by {machine()}."
        title = f"surefoot evaluate: {self.task.name}"
        return write_page(folder / "index.html", title, self._introduction(), sections, made=made)

    def _introduction(self) -> tuple[str, ...]:
        seeds = self.frame["seed"]
        amount = _AMOUNT.format(
            episodes=len(self.frame),
            count=seeds.nunique(),
            seeds=seeds_text(seeds),
            paired=_PAIRED if same_seeds(self.frame) else _UNPAIRED,
        )
        return flat(_INTRODUCTION.format(env_id=self.task.env_id)), flat(_FEEDS), flat(amount)

    def _scores(self, drawn: Path) -> Section:
        felt = self.frame[self.frame["cop_input"] == "felt"]
        shown: tuple[ReportFigure, ...] = ()
        if len(felt):
            shown = (
                ReportFigure(
                    figures.returns(drawn / "returns.png", felt), "Return and falls", _CAPTIONS["returns"]
                ),
                ReportFigure(
                    figures.survival_curves(drawn / "survival.png", felt), "Survival", _CAPTIONS["survival"]
                ),
            )
        return Section("scores", "Scores", tables=self.scores, figures=shown)

    def _repeat(self) -> Section:
        said = [
            *self._versions(),
            "An episode that is run again comes out the same to the last digit with the same versions on the "
            "same kind of machine.",
        ]
        if given := [self.labels[name] for name, origin in self.origins.items() if not origin.runs]:
            said.append(f"No command runs {', '.join(given)}: the episodes were given as files.")
        return Section("repeat", "Repeat it", (" ".join(said),), commands=tuple(self.commands()))

    def _versions(self) -> list[str]:
        """Say with what the episodes were made: once if all alike, else of each controller."""
        versions = {name: origin.versions for name, origin in self.origins.items()}
        if len(set(versions.values())) == 1:
            return [f"The episodes were made with {each}." for each in set(versions.values()) if each]
        return [
            f"Those of {self.labels[name]} were made with {each or 'versions that nobody wrote down'}."
            for name, each in versions.items()
        ]

    def commands(self) -> list[str]:
        """Write the commands that run these episodes again: controllers that were run alike share one.

        Who was given as a file of episodes, under a name of its own, cannot be run by it and is left out.
        """
        alike: dict[str, list[str]] = {}
        for name in (name for name, origin in self.origins.items() if origin.runs):
            own = self.frame[self.frame["controller"] == name]
            severities = sorted(own[own["feed"] != "true"]["severity"].unique()) or [1.0]
            options = [f"--task {self.task.name}"]
            options += [f"--feed {feed}" for feed in dict.fromkeys(own["feed"])]
            options += [f"--severity {severity:g}" for severity in severities]
            for first, last in seed_ranges(own["seed"]):
                each = [*options, f"--seeds {last - first + 1} --first-seed {first}"]
                each += ["--uses-cop"] * bool((own["cop_input"] != "felt").any())
                alike.setdefault(" ".join(each), []).append(shlex.quote(name))
        return [f"surefoot evaluate {' '.join(names)} {options}" for options, names in alike.items()]


def _check(frame: Frame) -> None:
    if not len(frame):
        raise ValueError("There are no episodes to make a page of.")
    if len(tasks := sorted(set(frame["task"]))) > 1:
        raise ValueError(f"Episodes of the tasks {', '.join(tasks)} cannot share a page; give those of one.")
    # True feet know no severity: an episode on them at another one is the same episode again.
    same = frame.assign(severity=frame["severity"].where(frame["feed"] != "true", 0.0))
    twice = same[same.duplicated(["controller", "feed", "cop_input", "severity", "seed"])]
    if len(twice):
        row = twice.iloc[0]
        raise ValueError(
            f"Controller '{row['controller']}', feed '{row['feed']}', severity {row['severity']:g}, seed "
            f"{row['seed']} is there twice; give controllers of different files different names, NAME=FILE."
        )
