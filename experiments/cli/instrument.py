"""``surefoot check``: what a log shows of the instrument behind it."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from surefoot.experiments.cli.calibrate import Topics
from surefoot.experiments.cli.console import REFUSED, Json, one_line_errors, show

AnyLog = Annotated[Path, Argument(help="A walk, sets of a six-axis sensor, weighings, channels, or a bag.")]
Page = Annotated[Path | None, Option(help="Where the page goes; by default beside the log.")]


def check(log: AnyLog, out: Page = None, topics: Topics = None, as_json: Json = False) -> None:
    """Say what is wrong with a log, since when, how surely, and what would settle it: no calibration."""
    from surefoot.experiments.instrument.check import check_log, words_of
    from surefoot.experiments.instrument.page import write_check_page
    from surefoot.experiments.study.progress import working

    with one_line_errors():
        checked = check_log(log, topics)
        path = log.with_suffix(".check.html") if out is None else out
        with working("drawing the page"):
            write_check_page(path, checked)
    facts = {"sound": checked.sound, "kind": checked.recording.kind}
    tables = checked.tables if as_json else checked.tables[1:]
    notices, said = checked.recording.notices, words_of(checked)
    show(tables, {"page": path}, notices=notices, said=said, as_json=as_json, **facts)
    if not checked.sound:
        raise typer.Exit(REFUSED)
