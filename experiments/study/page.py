"""One page that a person reads from top to bottom: no server, no network, figures inside."""

import base64
import json
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, StrictUndefined

import surefoot
from surefoot.experiments.study.sources import source_hash
from surefoot.experiments.study.tables import Frame, Table, Verdict, plural
from surefoot.files import atomic_path, write_text

MADE = "made.json"  # beside a study's tables: its command, code and date

_TYPES = {".png": "image/png", ".svg": "image/svg+xml"}

_WORDS = 28  # a cell that is longer than so many letters is text: it stands on the left and is wrapped


@dataclass(frozen=True)
class ReportFigure:
    """A figure of the page: its SVG or PNG file, which is embedded, its name, and its caption."""

    path: Path
    name: str
    caption: str

    @property
    def source(self) -> str:
        """The picture itself as a data address."""
        data = base64.b64encode(self.path.read_bytes()).decode("ascii")
        return f"data:{_TYPES[self.path.suffix]};base64,{data}"


@dataclass(frozen=True)
class Section:
    """A section of the page in the order of its fields; video and poster are addresses beside the page."""

    anchor: str
    title: str
    paragraphs: tuple[str, ...] = ()
    findings: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    video: str = ""
    poster: str = ""
    video_caption: str = ""
    figures: tuple[ReportFigure, ...] = ()
    commands: tuple[str, ...] = ()


class Report(NamedTuple):
    """The results that a study hands to a command: its page, and the tables that the terminal shows."""

    page: Path
    tables: tuple[Table, ...]


def write_page(
    path: Path,
    title: str,
    introduction: tuple[str, ...],
    sections: Iterable[Section],
    *,
    lead: Section | None = None,
    made: str = "",
) -> Path:
    """Write the page: its lead, the method, and the sections; return its path."""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"kind": _kind, "kinds": _kinds}
    if not made:
        from surefoot.experiments.study.runner import machine  # a log's page needs no workers

        made = f"Made {datetime.now(UTC):%Y-%m-%d %H:%M} UTC by {machine()}."
    template = files("surefoot.experiments.study").joinpath("page.html").read_text(encoding="utf-8")
    page = environment.from_string(template).render(
        title=title, made=made, introduction=introduction, sections=tuple(sections), lead=lead
    )
    write_text(path, page)
    return path


def write_log_page(
    path: Path,
    title: str,
    made_of: str,
    introduction: str,
    log: Table,
    notices: tuple[str, ...],
    sections: Callable[[Path], Iterable[Section]],
    verdict: Section | None = None,
) -> Path:
    """Write the page of a log that was made of, or by, something; sections draw into a folder.

    A ``verdict`` comes first; without one, missing notices are said.
    """
    quiet = () if notices or verdict else ("Nothing in the log calls for a warning.",)
    own = Section("log", "The log", paragraphs=quiet, findings=notices, tables=(log,))
    first = (own,) if verdict is None else (verdict, own)
    with tempfile.TemporaryDirectory() as folder:
        made = f"Made with surefoot {surefoot.__version__} {made_of}."
        return write_page(path, title, (introduction,), (*first, *sections(Path(folder))), made=made)


def publish(
    out: Path,
    title: str,
    introduction: tuple[str, ...],
    sections: Sequence[Section],
    *,
    lead: Section | None = None,
    prefix: str = "",
    name: str = "report.html",
) -> Report:
    """Save the tables of all sections as CSV, write a page of a name, and return both."""
    shown = sections if lead is None else (lead, *sections)
    tables = tuple(table for section in shown for table in section.tables)
    save_tables(out / "tables", tables, prefix)
    return Report(write_page(out / name, title, introduction, sections, lead=lead), tables)


def save_tables(folder: Path, tables: Iterable[Table], prefix: str = "", by: str = "") -> None:
    """Save tables as CSV files of their names, and beside them how, by what and when they were made.

    ``by`` is the machine of a measurement of speed, else the code.
    """
    for table in tables:
        with atomic_path(folder / f"{prefix}{table.name}.csv") as part:
            table.to_frame().to_csv(part, index=False)
    made = {
        "command": command_line(),
        "software": f"surefoot {surefoot.__version__} ({by or f'code {source_hash()}'})",
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
    }
    write_text(folder / MADE, json.dumps(made, indent=1) + "\n")


def command_line() -> str:
    """Command that runs now."""
    script = Path(sys.argv[0])
    program = ["python", script.as_posix()] if script.suffix == ".py" else ["surefoot"]
    return shlex.join([*program, *sys.argv[1:]])


def failure_section(failures: Mapping[str, str]) -> tuple[Section, ...]:
    """Return the section about cases that failed, from errors by name of case; none if none did."""
    if not failures:
        return ()
    rows = tuple((name, error.splitlines()[-1]) for name, error in failures.items())
    table = Table("failed", f"{plural(len(rows), 'case')} failed", ("case", "raised"), rows)
    return (Section("failed", "Cases that failed", tables=(table,)),)


def save_frames(
    folder: Path, frames: Mapping[str, Frame], endings: Sequence[str] = (".csv", ".parquet")
) -> None:
    """Save data frames under their names, as CSV and Parquet; those that are empty are left out."""
    for name, ending in ((name, ending) for name in frames if len(frames[name]) for ending in endings):
        with atomic_path(folder / f"{name}{ending}") as part:
            write = frames[name].to_csv if ending == ".csv" else frames[name].to_parquet
            write(part, index=False)


def _kinds(table: Table) -> list[str]:
    """Return the class of each column: text stands on the left."""
    columns = list(zip(*table.rows, strict=True)) or [()] * len(table.columns)
    return ["text" if column and all(cell[:1].isalpha() for cell in column) else "" for column in columns]


def _kind(cell: str) -> str:
    """Return the classes of a cell: the verdict of a claim, and whether it is text."""
    if isinstance(cell, Verdict):
        return "good" if cell.good else "bad"
    return "words" if len(cell) > _WORDS else ""
