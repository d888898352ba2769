"""One page that a person reads from top to bottom: no server, no network, figures inside."""

import base64
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from surefoot.experiments.study.files import write_text
from surefoot.experiments.study.tables import Table

__all__ = ["ReportFigure", "Section", "flat", "render_report"]


@dataclass(frozen=True)
class ReportFigure:
    """A figure of the page.

    Attributes:
        path: Its PNG file, which is embedded.
        name: What the text calls it, such as ``"Figure 10"``.
        caption: What to see in it.
    """

    path: Path
    name: str
    caption: str

    @property
    def anchor(self) -> str:
        """What links point at."""
        return self.path.stem

    @property
    def alt(self) -> str:
        """What is read where nothing is shown."""
        return f"{self.name}: {self.caption}"

    @property
    def source(self) -> str:
        """The picture itself as a data address."""
        return "data:image/png;base64," + base64.b64encode(self.path.read_bytes()).decode("ascii")


@dataclass(frozen=True)
class Section:
    """A section of the page; parts appear in the order of the fields.

    Attributes:
        anchor: What links point at.
        title: Its heading.
        paragraphs: Plain text.
        findings: Statements computed from the figures, set apart.
        tables: Tables.
        video: Address of a film beside the page, or nothing.
        poster: Address of its still picture.
        video_caption: What to see in it.
        figures: Figures.
        commands: Lines for a shell.
    """

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


def render_report(
    path: Path, title: str, made: str, introduction: tuple[str, ...], sections: tuple[Section, ...]
) -> Path:
    """Write the page.

    Args:
        path: Where; films must lie beside it.
        title: Its heading.
        made: When and with what it was made.
        introduction: What was done, in plain text.
        sections: What follows.

    Returns:
        The path.
    """
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    template = files("surefoot.experiments.study").joinpath("page.html").read_text(encoding="utf-8")
    page = environment.from_string(template).render(
        title=title, made=made, introduction=introduction, sections=sections
    )
    write_text(path, page)
    return path


def flat(text: str) -> str:
    """Make one line of a text that the source wraps and indents."""
    return " ".join(text.split())
