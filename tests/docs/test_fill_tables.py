"""Pages take the tables that studies wrote, and keep what stands there where a study has written none."""

import importlib.util
import json
from pathlib import Path

import pytest

from surefoot.experiments.study.page import MADE, save_tables
from surefoot.experiments.study.tables import Table

SCRIPT = Path(__file__).parents[2] / "docs" / "fill_tables.py"

PAGE = """# Results

<!-- table out/a/methods.csv -->

old

<!-- end -->

<!-- table out/b/methods.csv -->
kept
<!-- end -->
"""


def test_a_page_takes_a_table_and_says_what_made_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["/somewhere/surefoot", "compare", "walking", "--out", "out/a b"])
    table = Table("methods", "Methods", ("method", "CoP"), (("a|b", "NaN"), ("tare", "5.1 ± 1.3")))
    save_tables(tmp_path / "out" / "a", [table])
    if not SCRIPT.is_file():
        pytest.skip("the pages are not part of the wheel")
    spec = importlib.util.spec_from_file_location("fill_tables", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    made = json.loads((tmp_path / "out" / "a" / MADE).read_text())
    page = tmp_path / "results.md"
    page.write_text(PAGE)
    monkeypatch.chdir(tmp_path)
    script.main(["results.md"])
    text = page.read_text()
    assert "| method | CoP |\n|---|---|\n| a\\|b | NaN |\n| tare | 5.1 ± 1.3 |\n" in text
    assert f"`surefoot compare walking --out 'out/a b'`, {made['software']}, {made['date']}." in text
    assert "old" not in text
    assert "kept" in text
    said = capsys.readouterr().out
    assert said == "results.md: 1 tables put in.\n  kept as it is: out/b/methods.csv is not there\n"
    script.main(["results.md"])
    assert page.read_text() == text
