"""The page about one calibrated log: the log itself comes first, and figures are inside."""

import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

import surefoot
from surefoot.experiments.study.page import Section, write_page
from surefoot.experiments.study.tables import Table

__all__ = ["write_log_page"]


def write_log_page(
    path: Path,
    title: str,
    made_of: str,
    introduction: str,
    log: Table,
    notices: tuple[str, ...],
    sections: Callable[[Path], Iterable[Section]],
) -> Path:
    """Write the page, and return its path.

    Args:
        path: Where.
        title: Its heading.
        made_of: The log or the method that it was made of, or by.
        introduction: What was done.
        log: What was calibrated.
        notices: What the log lacks, and warnings.
        sections: Returns what follows, with figures drawn into a folder that it is given.
    """
    quiet = () if notices else ("Nothing in the log calls for a warning.",)
    first = Section("log", "The log", paragraphs=quiet, findings=notices, tables=(log,))
    with tempfile.TemporaryDirectory() as folder:
        made = f"Made with surefoot {surefoot.__version__} {made_of}."
        return write_page(path, title, (introduction,), (first, *sections(Path(folder))), made=made)
