"""The list of tests that take long names what there is."""

from ast import ClassDef, FunctionDef, parse
from pathlib import Path

TESTS = Path(__file__).parents[1]


def test_all_that_is_listed_as_long_exists() -> None:
    for line in (TESTS / "long.txt").read_text(encoding="utf-8").splitlines():
        file, *names = line.partition("[")[0].split("::")
        inside = parse((TESTS / file).read_text(encoding="utf-8")).body
        for name in names:
            there = {node.name: node for node in inside if isinstance(node, ClassDef | FunctionDef)}
            assert name in there, f"tests/long.txt lists '{line}', which is not there: take the line out"
            inside = there[name].body
