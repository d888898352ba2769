"""What an evaluation says in words and against its targets: nothing is written beforehand but the grammar."""

from collections.abc import Sequence

from surefoot.experiments.policy.comparison import CALIBRATED, difference, severities_of
from surefoot.experiments.policy.controllers import labels
from surefoot.experiments.policy.randomisation import Answer
from surefoot.experiments.policy.scores import Run, controllers_of, survival, won_back
from surefoot.experiments.study.page import flat
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import Frame, Table, interval_text

__all__ = ["controller_findings", "target_table"]

_NOTE = """
    Survival and the share of the loss that is won back are judged by the number itself, wherever its interval
    ends; all else by 95 % intervals. An interval leaves out what is true in one of twenty cases: among many
    differences, some are clear, and some targets met or missed, by chance. Of what both together are held
    against, the one is shown that decides."""


def target_table(frame: Frame, controller: str, randomisation: Sequence[Answer] = ()) -> Table:
    """Hold a policy against what was set out to be reached.

    Args:
        frame: Of :func:`~surefoot.experiments.policy.scores.episodes_frame`.
        controller: The policy.
        randomisation: What randomisation is worth, which is a target as well.
    """
    own = frame[frame["controller"] == controller]
    rows: list[tuple[str, str, str, str]] = []

    def row(what: str, target: str, measured: str, reached: bool) -> None:
        rows.append((what, target, measured, "yes" if reached else "no"))

    felt = own[own["cop_input"] == "felt"]
    if len(felt[felt["feed"] == "true"]):
        share = survival(own)
        row("survives on true CoP", "≥ 95 %", f"{100 * share:.3g} %", share >= 0.95)
    for severity in severities_of(own):
        at = f"severity {severity:g}: "
        part = felt[(felt["feed"] == "true") | (felt["severity"] == severity)]
        of = {str(feed): mean_interval(runs["total"]) for feed, runs in part.groupby("feed")}
        if {"true", "none"} <= of.keys():
            true, none = of["true"], of["none"]
            measured = f"{interval_text(none, digits=4)} and {interval_text(true, digits=4)}"
            apart = none.mean + none.half < true.mean - true.half
            row(f"{at}return on drifting CoP below that on true CoP", "intervals apart", measured, apart)
        won = won_back(own, CALIBRATED, severity)
        if won is not None:
            measured = "{:.1f} % ({:.1f} to {:.1f})".format(*(100 * part for part in won))
            row(f"{at}of the loss won back by moment", "≥ 90 %", measured, won[0] >= 0.9)
        for other, name in (("window", "window"), ("quasi-static", "Han")):
            gap = difference(own, Run(CALIBRATED), Run(other), severity)
            if gap is not None:
                measured = interval_text(gap)
                row(f"{at}moment less {name}", "> 0, clearly", measured, gap.apart and gap.mean > 0.0)
    for answer in randomisation:
        alone, gap = answer.deciding
        row(
            f"severity {answer.severity:g}: randomised and calibrated, less either alone",
            "not clearly below 0",
            f"{interval_text(gap)} (less {alone})",
            not answer.worse,
        )
    gap = difference(own, Run("true"), Run("true", "shuffled"), None)
    if gap is not None:
        reached = gap.apart and gap.mean > 0.0
        row("true CoP felt less shuffled", "> 0, clearly", interval_text(gap), reached)
    columns = ("what", "target", "measured", "reached")
    title = f"Set out to reach, by {labels(controllers_of(frame))[controller]}"
    return Table("targets", title, columns, tuple(rows), flat(_NOTE))


def controller_findings(frame: Frame, controller: str) -> tuple[str, ...]:
    """Say what a controller loses on drifting feet and gets back on calibrated ones.

    Args:
        frame: Of :func:`~surefoot.experiments.policy.scores.episodes_frame`.
        controller: Whose.
    """
    name = labels(controllers_of(frame))[controller]
    own = frame[(frame["controller"] == controller) & (frame["cop_input"] == "felt")]
    said = []
    true = own[own["feed"] == "true"]
    if len(true):
        fallen = int(true["fell"].sum())
        said.append(
            f"{name}, true CoP: return {interval_text(mean_interval(true['total']), digits=4)}, "
            f"{fallen} of {len(true)} fall."
        )
    for severity in severities_of(own):
        loss = difference(own, Run("true"), Run("none"), severity)
        if loss is None:
            continue
        text = f"{name}, severity {severity:g}: drifting feet cost {interval_text(loss)}"
        if not (loss.apart and loss.mean > 0.0):
            said.append(f"{text}, which is no clear loss, so that there is nothing to win back.")
            continue
        won = []
        for feed in dict.fromkeys(own["feed"]):
            share = won_back(own, feed, severity)
            if share is not None:
                won.append(
                    "{} wins {:.1f} % of it back ({:.0f} to {:.0f})".format(feed, *(100 * x for x in share))
                )
        falls = own[(own["feed"] == "none") & (own["severity"] == severity)]["fell"]
        text += f" and {int(falls.sum())} of {len(falls)} fall"
        said.append("; ".join([text, *won]) + ".")
    return tuple(said)
