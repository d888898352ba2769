"""Tables of studies, which are stored in docs/data and shown on pages of the site.

    python docs/study_tables.py out/results

copies the tables that pages use from the folder of the results, and updates the table in the README. A page
gives the name of a table, and optionally columns and patterns of the first cell of rows, separated by bars:

    ```{study-table} walking/overview
    :columns: scenario | moment
    :rows: 0.04 m/s | *payload*
    The caption.
    ```

Figures are links such as ``data/walking/NAME.svg``.
``made.json`` in the folder of the data contains the command, the version and the date of the results.
"""

import csv
import json
import re
import string
import sys
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from shutil import copyfile
from typing import Any, NamedTuple

from docutils import nodes
from docutils.parsers.rst.directives import unchanged_required
from docutils.parsers.rst.directives.tables import CSVTable

DOCS = Path(__file__).parent
DATA = DOCS / "data"
MADE = "made.json"

_BLOCK = re.compile(r"^```\{study-table\} *(\S+)\n((?::\w+:.*\n)*)", re.MULTILINE)
_FIGURE = re.compile(r"\]\(data/([\w-]+)/([^)]+\.svg)\)")
_README = re.compile(r"(<!-- results -->\n).*?(<!-- end -->)", re.DOTALL)

README_COLUMNS = {
    "raw": "raw (none)",
    "tare": "swing tare",
    "window": "window (CoP paper)",
    "moment": "moment",
}
README_ROWS = (
    "0.04 m/s",
    "half an hour",
    "soft ground",
    "a payload of 0.3 kg picked up",
    "a cell goes dead",
    "a cell spikes five times a second",
    "six-axis sensors in the ankles",
)
README_ROBOT = "g1/walk"


class StudyTable(NamedTuple):
    """Cells of a table, headings first, and what made it.

    Attributes:
        lines: Its cells. The first line contains the headings.
        command: The command that repeats it.
        version: The software, and the date.
    """

    lines: list[list[str]]
    command: str
    version: str


def read_table(data: Path, name: str, columns: str = "", rows: str = "") -> StudyTable:
    """Read a table, or some of its columns and rows, separated by bars.

    A heading that occurs twice in the file may be given twice.

    Raises:
        ValueError: If the file, a column or a row does not exist.
    """
    path = data / f"{name}.csv"
    for file in (path, path.with_name(MADE)):
        if not file.is_file():
            raise ValueError(
                f"{file} is not there; python docs/study_tables.py takes it from a study's results."
            )
    with path.open(newline="", encoding="utf-8") as opened:
        head, *body = csv.reader(opened)
    if patterns := _parts(rows):
        for pattern in patterns:
            if not any(fnmatchcase(row[0], pattern) for row in body):
                raise ValueError(f"{path} has no row '{pattern}'; its first cells are {_firsts(body)}.")
        body = [row for row in body if any(fnmatchcase(row[0], pattern) for pattern in patterns)]
    places: list[int] = []
    for column in _parts(columns) or head:
        free = [i for i, heading in enumerate(head) if heading == column and i not in places]
        if not free:
            raise ValueError(f"{path} has no column '{column}'; it has {', '.join(head)}.")
        places.append(free[0])
    made = json.loads(path.with_name(MADE).read_text(encoding="utf-8"))
    lines = [[line[i] for i in places] for line in (head, *body)]
    return StudyTable(lines, made["command"], f"{made['software']}, {made['date']}")


def _parts(text: str) -> list[str]:
    return [part.strip() for part in text.split("|") if part.strip()]


def _firsts(rows: Sequence[Sequence[str]]) -> str:
    return ", ".join(dict.fromkeys(row[0] for row in rows))


class StudyTableDirective(CSVTable):  # type: ignore[misc]
    """A table of docs/data with its caption, and below it what made it."""

    required_arguments = 1
    option_spec = {"columns": unchanged_required, "rows": unchanged_required}  # noqa: RUF012

    def run(self) -> list[Any]:
        """Make the table, or an error of the build that names what is missing."""
        options = dict(self.options)
        try:
            self.study_table = read_table(DATA, self.arguments[0], **options)
        except ValueError as error:
            raise self.error(str(error)) from error
        self.arguments = [" ".join(self.content)]
        self.options = {"header-rows": 1, "class": ["study-table"]}
        made = nodes.paragraph(classes=["made-by"])
        made += [nodes.literal(text=self.study_table.command), nodes.Text(f", {self.study_table.version}")]
        return [*super().run(), made]

    def get_csv_data(self) -> tuple[list[str], str]:
        """Return the cells as CSV with Markdown's special characters escaped."""
        lines = ([_escape(cell) for cell in line] for line in self.study_table.lines)
        return [",".join(f'"{cell}"' for cell in line) for line in lines], self.arguments[0]


def _escape(cell: str) -> str:
    text = re.sub(f"([{re.escape(string.punctuation)}])", r"\\\1", cell)
    return text.replace('"', '""').replace(" ± ", "\u00a0±\u00a0")


def tables_on_pages(folder: Path) -> Iterator[tuple[Path, str, dict[str, str]]]:
    """Return page, name, and options of each table on the pages in a folder."""
    for page in sorted(folder.rglob("*.md")):
        for block in _BLOCK.finditer(page.read_text(encoding="utf-8")):
            yield page, block[1], dict(re.findall(r"^:(\w+): *(.*)$", block[2], re.MULTILINE))


def figures_on_pages(folder: Path) -> set[tuple[str, str]]:
    """Return folder and name of each figure in docs/data that pages in a folder link."""
    texts = (page.read_text(encoding="utf-8") for page in folder.rglob("*.md"))
    return {figure for text in texts for figure in _FIGURE.findall(text)}


def readme_table(data: Path) -> str:
    """Make README's table: errors of the CoP, in brackets of a single foot, the best in bold."""
    columns = "scenario | " + " | ".join(README_COLUMNS.values())
    totals, feet = (
        {line[0]: line[1:] for line in read_table(data, f"walking/{name}", columns).lines}
        for name in ("overview", "overview_foot")
    )
    lines = [["", *README_COLUMNS], ["---"] * (1 + len(README_COLUMNS))]
    for row in README_ROWS:
        cells = zip(_bold(totals[row]), _bold(feet[row]), strict=True)
        lines.append([row, *(f"{total} ({foot})" for total, foot in cells)])
    table = "\n".join("| " + " | ".join(line) + " |" for line in lines).replace("| --- ", "|---")
    (_, robot) = read_table(data, "momentum/feet", "moment: foot (mm) | none: foot (mm)", README_ROBOT).lines
    foot, raw = (f"{float(cell):.1f}" for cell in robot)
    walker = "On a Unitree G1 that walks by a policy ([try it](docs/tutorials/4-humanoid.md))"
    change = f"reduces the error of a foot's CoP from {raw} mm to {foot} mm, without noise and latency"
    return f"{table}\n\n{walker}, calibration {change}.\n"


def _bold(cells: Sequence[str]) -> list[str]:
    values = [f"{float(cell.partition(' ')[0]):.1f}" for cell in cells]
    least = min(values, key=float)
    return [f"**{value}**" if value == least else value for value in values]


def main(results: Path) -> None:
    """Copy the tables and figures that pages use from the results, whole studies only, and update the README.

    Raises:
        ValueError: If a study wrote some of its tables and figures and not the others.
    """
    wanted: dict[str, set[str]] = {}
    for _, name, _ in tables_on_pages(DOCS):
        folder, _, file = name.partition("/")
        wanted.setdefault(folder, {f"tables/{MADE}"}).add(f"tables/{file}.csv")
    for folder, file in figures_on_pages(DOCS):
        wanted.setdefault(folder, {f"tables/{MADE}"}).add(f"figures/{file}")
    there = sorted(folder for folder in wanted if (results / folder / "tables" / MADE).is_file())
    for folder in there:
        if lacking := sorted(file for file in wanted[folder] if not (results / folder / file).is_file()):
            raise ValueError(f"{results / folder} lacks {', '.join(lacking)}, which pages name.")
    for folder in there:
        (DATA / folder).mkdir(parents=True, exist_ok=True)
        for file in wanted[folder]:
            copyfile(results / folder / file, DATA / folder / Path(file).name)
    for folder in sorted(wanted):
        print(f"{folder}: {f'{len(wanted[folder]) - 1} taken' if folder in there else 'kept, no results'}")
    readme = DOCS.parent / "README.md"
    text = _README.sub(
        lambda mark: mark[1] + "\n" + readme_table(DATA) + "\n" + mark[2], readme.read_text(encoding="utf-8")
    )
    readme.write_text(text, encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Register the directive with Sphinx."""
    app.add_directive("study-table", StudyTableDirective)
    return {"parallel_read_safe": True}


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/results"))
