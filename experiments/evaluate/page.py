"""The page of an evaluation: first the answer, then curves, tables and the worst episodes."""

from collections.abc import Iterator
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING

from surefoot.experiments.evaluate import figures, tables
from surefoot.experiments.evaluate.episode import VERSIONS
from surefoot.experiments.evaluate.statistics import (
    NOBODY,
    RAW,
    TRUE,
    Run,
    difference,
    half_fall,
    mean_over,
    severities_of,
    share_won_back,
)
from surefoot.experiments.study.figures import in_order
from surefoot.experiments.study.page import Report, Section, command_line, failure_section, publish
from surefoot.experiments.study.tables import Frame, number, plural

if TYPE_CHECKING:
    from surefoot.experiments.evaluate.grid import Evaluation

PAGE = "index.html"

_DEVICE = 1.0  # severity of sensors as their makers and measurements describe them


def write_page(results: "Evaluation", folder: Path) -> Report:
    """Draw the figures, save the tables as CSV, and write the page; ValueError if no episode has finished."""
    frame = results.finished
    if not len(frame):
        last = [error.splitlines()[-1] for error in results.failed["error"]][:1]
        raise ValueError(
            f"There are no episodes to make a page of: all {len(results.rows)} failed, the first with {last}."
        )
    setup = results.plan.setup
    introduction = (
        f"Policies in {setup.env_id} on feet of different kinds. The same seed is the same start, the same "
        "disturbances and the same sensors on every feed; feeds differ by what the policy reads for its feet "
        "and by nothing else. Severity scales all errors of the feet's sensors: 1 is the device as it is; "
        "true feet have none and were run once per seed.",
        f"{plural(len(results.rows), 'episode')}, {len(results.failed)} failed. Instruments: "
        f"{setup.cells or 'load cells of the size of the robot'}; faults: {setup.faults or 'none'}.",
    )
    sections = [*_sections(frame, folder / "figures"), *_failures(results)]
    sections.append(Section("worst", "The worst episodes", tables=(tables.worst_table(frame),)))
    sections.append(_repeat(results, folder))
    lead = Section("lead", "What was done", (answer(frame),), findings=tuple(_falls(frame)))
    report = publish(
        folder,
        f"Does sensor drift hurt this policy? {setup.env_id}",
        introduction,
        sections,
        lead=lead,
        name=PAGE,
    )
    return report._replace(tables=tuple(table for table in report.tables if table.name != "worst"))


def answer(frame: Frame) -> str:
    """Return the cost of drift for each policy, and the share that calibration wins back, with intervals.

    Severity 1, or else the least one that was run, is that of the device as it is.
    """
    return " ".join(_cost(frame, policy) for policy in tables.policies_of(frame) if policy != NOBODY)


def _cost(frame: Frame, policy: str) -> str:
    own = frame[frame["policy"] == policy]
    feeds, severities = in_order(own["feed"]), [severity for severity in severities_of(own) if severity > 0.0]
    if RAW not in feeds or TRUE not in feeds or not severities:
        found = mean_over(own.set_index(["training", "seed"])["return"])
        said = f"{policy} returns {number(found.mean, 4)} (± {number(found.half)})"
        return f"{said}; to see what drift costs, run the feeds 'true' and 'raw'."
    severity = _DEVICE if _DEVICE in severities else severities[0]
    loss = difference(own, Run(policy, TRUE, 0.0), Run(policy, RAW, severity))
    if loss is None:
        return f"{policy} has no seed on both true and raw feet."
    mean = number(own[own["feed"] == TRUE]["return"].mean(), 4)
    if own.groupby(["training", "seed"])["return"].nunique().max() == 1:
        return (
            f"{policy} does not use its feet: each seed has the same return on all feeds, so that drift "
            f"costs it 0 (± 0) of {mean}. If it should, say with 'observe' how they enter its observation."
        )
    ends = f"95 % interval {number(loss.mean - loss.half)} to {number(loss.mean + loss.half)}"
    if not (loss.apart and loss.mean > 0.0):
        return (
            f"At severity {severity:g} drift costs {policy} nothing that these episodes can tell: "
            f"{number(loss.mean)} of {mean} in return ({ends})."
        )
    won = [(feed, share_won_back(own, Run(policy, feed, severity))) for feed in feeds]
    parts = [
        f"'{feed}' wins back {tables.estimate_text(share, 100.0, 2, ' %')}"
        for feed, share in won[::-1]
        if share is not None and not isnan(share.value)
    ]
    said = f"At severity {severity:g} drift costs {policy} {number(loss.mean)} of {mean} in return ({ends})"
    return f"{'; '.join([said, ', '.join(parts)]) if parts else said}."


def _falls(frame: Frame) -> Iterator[str]:
    """Say how many fall on each feed, at each severity."""
    for policy in tables.policies_of(frame):
        own = frame[frame["policy"] == policy]
        for severity in severities_of(own) or [0.0]:
            shown = own[(own["feed"] == TRUE) | (own["severity"] == severity)]
            counts = [
                f"{int(runs['fell'].sum())} of {len(runs)} on {feed}"
                for feed in in_order(shown["feed"])
                for runs in [shown[shown["feed"] == feed]]
            ]
            yield f"{policy}, severity {severity:g}, falls: {', '.join(counts)}."
        raw = own[own["feed"] == RAW]
        if raw["fell"].any() and (half := half_fall(raw)) is not None:
            yield f"{policy}: severity at which half fall on raw readings: {half.words()}."


def _sections(frame: Frame, drawn: Path) -> Iterator[Section]:
    policies = tables.policies_of(frame)
    scores = tuple(
        tables.score_table(frame[frame["policy"] == policy], f"scores_{i}", policy)
        for i, policy in enumerate(policies)
    )
    beside = (tables.returns_table(frame),) if len(policies) > 1 else ()
    half = tables.half_table(frame)
    yield Section(
        "scores",
        "Scores",
        tables=(*beside, *scores, *(() if half is None else (half,))),
        figures=figures.outcome_figures(drawn, frame),
    )
    if found := list(tables.between_feeds(frame)):
        shown = tables.difference_table(found, "differences", "Paired differences of returns between feeds")
        yield Section("differences", "Feet against feet", tables=(shown,))
    if found := list(tables.between_policies(frame)):
        title = f"Return above that of {found[0].second.policy}, on the same feet"
        yield Section(
            "policies", "Policy against policy", tables=(tables.difference_table(found, "policies", title),)
        )


def _failures(results: "Evaluation") -> tuple[Section, ...]:
    names = ("case", "policy", "feed", "severity", "seed")
    rows = results.failed.to_dict("records")
    return failure_section({", ".join(f"{name} {row[name]}" for name in names): row["error"] for row in rows})


def _repeat(results: "Evaluation", folder: Path) -> Section:
    """Return the section with the command, or the call, that repeats the study or one episode."""
    made = results.finished[list(VERSIONS)].drop_duplicates().to_dict("records")
    versions = "; ".join(", ".join(f"{name} {one[name]}" for name in VERSIONS) for one in made)
    case = int(tables.worst_of(results.finished)["case"].iloc[0])
    text = (
        f"Made with {versions}. An episode that is run again comes out the same to the last digit with the "
        "same versions on the same kind of machine; episodes.parquet and episodes.csv have one row per "
        "episode. The same command goes on where it was stopped. The second one repeats the worst episode, "
        "and --video films it."
    )
    command = command_line()
    if not command.startswith("surefoot evaluate"):
        return Section(
            "repeat", "Repeat it", (text, f"From Python: evaluate(...).again({case})."), commands=(command,)
        )
    base = command.partition(" --case")[0]
    return Section("repeat", "Repeat it", (text,), commands=(base, f"{base} --case {case} --video worst.mp4"))
