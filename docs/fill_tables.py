"""Put the tables that studies wrote into the pages of docs/.

    python docs/fill_tables.py docs/results.md

A page marks where a table goes: ``<!-- table out/results/walking/tables/overview.csv -->``, later
``<!-- end -->``. The text between them is replaced by that table and a line that says how and with which
code it was made. Where there is no such file, the text stays.
"""

import csv
import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from surefoot.experiments.study.page import MADE
from surefoot.files import write_text

_MARK = re.compile(r"(<!-- table (\S+\.csv) -->\n).*?(<!-- end -->)", re.DOTALL)


def markdown(lines: Sequence[Sequence[str]]) -> str:
    """Return a table, headings first, for a page."""
    first, *others = ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]
    return "\n".join([first, "|" + "---|" * len(lines[0]), *others])


def refresh(text: str, root: Path) -> tuple[str, list[str]]:
    """Return a page's text with new tables, and the files that were not there, looked for under ``root``."""
    missing: list[str] = []

    def replace(mark: re.Match[str]) -> str:
        path = root / mark[2]
        if not path.is_file():
            missing.append(mark[2])
            return mark[0]
        made = json.loads((path.parent / MADE).read_text(encoding="utf-8"))
        with path.open(newline="", encoding="utf-8") as file:
            lines = list(csv.reader(file))
        source = f"`{made['command']}`, {made['software']}, {made['date']}."
        return f"{mark[1]}\n{markdown(lines)}\n\n{source}\n\n{mark[3]}"

    return _MARK.sub(replace, text), missing


def main(pages: list[str]) -> None:
    """Refresh pages in place, and say which tables are not there."""
    for page in map(Path, pages):
        text, missing = refresh(page.read_text(encoding="utf-8"), Path())
        write_text(page, text)
        print(f"{page}: {text.count('<!-- table ') - len(missing)} tables put in.")
        for path in missing:
            print(f"  kept as it is: {path} is not there")


if __name__ == "__main__":
    main(sys.argv[1:])
