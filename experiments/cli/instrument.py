"""``surefoot check`` and ``surefoot twin``: the instrument behind a log."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from surefoot.experiments.cli.calibrate import Topics
from surefoot.experiments.cli.console import REFUSED, Json, fail, one_line_errors, show

AnyLog = Annotated[Path, Argument(help="A walk, sets of a six-axis sensor, weighings, channels, or a bag.")]
Page = Annotated[Path | None, Option(help="Where the page goes; by default beside the log.")]


def check(log: AnyLog, out: Page = None, topics: Topics = None, as_json: Json = False) -> None:
    """Name the flaws of a log, since when, how surely, and the measurement that would settle each."""
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


def twin(
    log: AnyLog,
    capacity: Annotated[
        float | None, Option(help="Rated load of a cell in N; else the largest load.")
    ] = None,
    out: Annotated[Path | None, Option(help="Where the preset goes; by default beside the log.")] = None,
    topics: Topics = None,
    as_json: Json = False,
) -> None:
    """Read the preset of load cells off a recording: noise, drift, clock, hysteresis, creep, delay."""
    from surefoot.experiments.instrument.page import write_twin_page
    from surefoot.experiments.instrument.recording import read_recording
    from surefoot.experiments.instrument.twin import identify, write_preset
    from surefoot.experiments.study.progress import working

    if capacity is not None and not 0.0 < capacity < float("inf"):
        fail(f"--capacity must be positive, in N, got {capacity}.")
    with one_line_errors(), working("reading the recording") as then:
        recording = read_recording(log, topics)
        then("looking for the instrument")
        found = identify(recording, capacity)
        then("drawing the page")
        path = log.with_suffix(".twin.json") if out is None else out
        files = {"preset": write_preset(path, found)}
        files["page"] = write_twin_page(path.with_suffix(".html"), found)
    notices = (*recording.notices, *found.notes)
    show(found.tables, files, notices=notices, as_json=as_json, alike=found.alike)
