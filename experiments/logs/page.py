"""The page about one calibrated log: the log itself comes first, and figures are inside."""

import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

import surefoot
from surefoot.experiments.study.page import Section, write_page
from surefoot.experiments.study.tables import Table


def write_log_page(
    path: Path,
    title: str,
    made_of: str,
    introduction: str,
    log: Table,
    notices: tuple[str, ...],
    sections: Callable[[Path], Iterable[Section]],
) -> Path:
    """Write the page of a log that was made of, or by, something; sections draw into a folder."""
    quiet = () if notices else ("Nothing in the log calls for a warning.",)
    first = Section("log", "The log", paragraphs=quiet, findings=notices, tables=(log,))
    with tempfile.TemporaryDirectory() as folder:
        made = f"Made with surefoot {surefoot.__version__} {made_of}."
        return write_page(path, title, (introduction,), (first, *sections(Path(folder))), made=made)
