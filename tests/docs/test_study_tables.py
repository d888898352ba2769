"""Pages show tables of docs/data: what they name is there, and what is missing is an error that names it."""

import importlib.util
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from surefoot.experiments.study.page import MADE, save_tables
from surefoot.experiments.study.tables import Table

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "docs" / "study_tables.py"

pytestmark = pytest.mark.skipif(not SCRIPT.is_file(), reason="the pages are not part of the wheel")
pytest.importorskip("docutils")

PAGE = """# Page

```{study-table} a/methods
:columns: method | paper | CoP
:rows: t*
The caption.
```
"""


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, with a page, a README and a study of its own."""
    spec = importlib.util.spec_from_file_location("study_tables", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr("sys.argv", ["/somewhere/surefoot", "evaluate", "a", "--out", "out/a b"])
    rows = (("a|b", "NaN", "1", "x"), ("tare", "> 5.1 ± *1.3", "2", "y"))
    save_tables(
        tmp_path / "out/a/tables", [Table("methods", "Methods", ("method", "CoP", "paper", "paper"), rows)]
    )
    (tmp_path / "out/a/figures").mkdir()
    (tmp_path / "out/a/figures/curves_0.1.svg").write_text("<svg/>")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/page.md").write_text(PAGE)
    (tmp_path / "README.md").write_text("before\n<!-- results -->\nold\n<!-- end -->\nafter\n")
    monkeypatch.setattr(module, "DOCS", tmp_path / "docs")
    monkeypatch.setattr(module, "DATA", tmp_path / "docs/data")
    return module


def test_the_script_takes_what_pages_name_and_keeps_what_no_study_wrote(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(script, "readme_table", lambda data: "| new |\n")
    (tmp_path / "docs/page.md").write_text(
        PAGE + "\n![x](data/a/curves_0.1.svg)\n```{study-table} b/other\nOther.\n```\n"
    )
    script.main(tmp_path / "out")
    table = script.read_table(tmp_path / "docs/data", "a/methods")
    assert table.lines[1:] == [["a|b", "NaN", "1", "x"], ["tare", "> 5.1 ± *1.3", "2", "y"]]
    assert table.command == "surefoot evaluate a --out 'out/a b'"
    made = json.loads((tmp_path / "out/a/tables" / MADE).read_text())
    assert table.version == f"{made['software']}, {made['date']}"
    said = capsys.readouterr().out
    assert said == "a: 2 taken\nb: kept, no results\n"
    assert (tmp_path / "docs/data/a/curves_0.1.svg").read_text() == "<svg/>"
    assert (tmp_path / "README.md").read_text() == (
        "before\n<!-- results -->\n\n| new |\n\n<!-- end -->\nafter\n"
    )


def test_a_study_that_lacks_a_table_is_refused(script: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "docs/page.md").write_text(PAGE + "\n```{study-table} a/other\nOther.\n```\n")
    with pytest.raises(ValueError, match=r"out/a lacks tables/other\.csv, which pages name"):
        script.main(tmp_path / "out")
    assert not (tmp_path / "docs/data").exists()


def render(page: str, script: ModuleType) -> Any:
    """A page as docutils reads it."""
    parser = pytest.importorskip("myst_parser.docutils_").Parser()
    from docutils.core import publish_doctree
    from docutils.parsers.rst.directives import register_directive

    register_directive("study-table", script.StudyTableDirective)
    return publish_doctree(page, parser=parser, settings_overrides={"report_level": 5})


@pytest.mark.filterwarnings("ignore")
def test_a_table_has_the_columns_and_rows_that_the_page_names(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script, "readme_table", lambda data: "")
    script.main(tmp_path / "out")
    shown = " ".join(render(PAGE, script).astext().split())
    assert shown.startswith("Page The caption. method paper CoP tare 2 > 5.1 ± *1.3 surefoot evaluate a")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("a/methods", "a/nothing", "a/nothing.csv is not there; python docs/study_tables.py takes it"),
        ("| CoP", "| NEES", "methods.csv has no column 'NEES'; it has method, CoP, paper, paper."),
        ("paper |", "paper | paper | paper |", "has no column 'paper'; it has"),
        ("t*", "t* | window", "methods.csv has no row 'window'; its first cells are a|b, tare."),
    ],
)
def test_what_is_missing_is_an_error_that_names_it(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, message: str
) -> None:
    monkeypatch.setattr(script, "readme_table", lambda data: "")
    script.main(tmp_path / "out")
    assert message in render(PAGE.replace(old, new), script).astext()


def test_all_that_pages_name_is_there_and_nothing_else(script: ModuleType) -> None:
    data = ROOT / "docs" / "data"
    named = {data / folder / name for folder, name in script.figures_on_pages(ROOT / "docs")}
    for page, name, options in script.tables_on_pages(ROOT / "docs"):
        table = script.read_table(data, name, **options)
        assert len({len(line) for line in table.lines}) == 1, page
        named |= {data / f"{name}.csv", (data / name).parent / MADE}
    assert {path for path in data.rglob("*") if path.is_file()} == named


def test_the_readme_fits_on_a_screen_and_its_results_are_those_of_the_data(script: ModuleType) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 700
    assert script.readme_table(ROOT / "docs" / "data") in text
