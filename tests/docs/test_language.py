"""Names and docstrings speak plainly: functions are verbs, values are nouns, one word for one thing."""

import ast
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = (
    "benchmarks", "calibration", "controllers", "envs", "examples", "experiments", "native", "robot",
    "sensors", "surefoot", "wrappers",
)  # fmt: skip
GLOSSARY = ROOT / "docs" / "glossary.md"

IRREGULAR = frozenset(
    re.findall(
        r"\w+",
        "begun bought brought built done drawn driven felt found given grown heard held joined kept known "
        "laid led left lent lost made met paid seen sent shown sold spent stood taken taught thought thrown "
        "told understood walked won worn written",
    )
)
"""Participles that do not end in -ed."""

VERBS_IN_ED = ["bed", "embed", "exceed", "feed", "need", "proceed", "reseed", "seed", "speed"]
"""Words in -ed that are no participles."""

EXCEPTIONS = {
    "added_mass",  # a value: the mass that is added
    "combined",  # FootLayout.combined(...) makes a foot, as dict.fromkeys makes a dict
    "installed",  # the library that is installed
    "scaled",  # sensors.scaled(...) and sized(...) give a copy, as sorted(...) does
    "shipped_policy",
    "sized",
}
"""Functions that may be named by a participle."""

LONGEST = 60
"""Lines of a function."""

pytestmark = pytest.mark.skipif(not GLOSSARY.exists(), reason="the pages are not part of the wheel")


class Named(NamedTuple):
    """A function, class or module with its docstring."""

    place: str
    name: str
    is_value: bool
    docstring: str


class Spoken(NamedTuple):
    """Everything that the code says, read once.

    Attributes:
        named: Functions, classes and modules.
        words: Words of names and docstrings, and a place of each.
    """

    named: list[Named]
    words: dict[str, str]


@cache
def spoken() -> Spoken:
    found, texts = Spoken([], {}), set[str]()
    for file in sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        path = str(file.relative_to(ROOT))
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            place = f"{path}:{getattr(node, 'lineno', 1)}"
            said = [getattr(node, key) for key in ("name", "id", "arg", "attr") if hasattr(node, key)]
            if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef):
                docstring, name = ast.get_docstring(node) or "", getattr(node, "name", "")
                marks = {ast.unparse(mark).split("(")[0] for mark in getattr(node, "decorator_list", [])}
                is_value = not isinstance(node, ast.FunctionDef) or any(
                    mark.endswith(("property", "setter")) for mark in marks
                )
                found.named.append(Named(place, name, is_value, docstring))
                said.append(docstring)
            for text in said:
                if text in texts or not isinstance(text, str):
                    continue
                texts.add(text)
                for word in re.findall(r"[a-z]+", re.sub(r"([a-z])([A-Z])", r"\1_\2", text).lower()):
                    found.words.setdefault(word, place)
    return found


def participles() -> list[str]:
    """Functions that a participle names."""
    found = []
    for one in spoken().named:
        first = one.name.strip("_").split("_")[0]
        regular = re.fullmatch(r"[a-z]{2,}ed", first) and first not in VERBS_IN_ED
        if (regular or first in IRREGULAR) and not (one.is_value or one.name in EXCEPTIONS):
            found.append(f"{one.place} {one.name}")
    return found


def whats() -> tuple[list[str], int]:
    """Places of "what" in docstrings, and the number of all words."""
    found, words = [], 0
    for one in spoken().named:
        own = re.findall(r"[A-Za-z']+", one.docstring)
        found += [f"{one.place} {one.name}"] * sum(word.lower() == "what" for word in own)
        words += len(own)
    return found, words


def returns_what() -> list[str]:
    """Places of docstrings that begin with "Return what"."""
    found = [one for one in spoken().named if one.docstring.startswith("Return what")]
    return [f"{one.place} {one.name}" for one in found]


def forbidden() -> list[str]:
    """Words in bold in the last column of the glossary."""
    rows = [line for line in GLOSSARY.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    return [word for row in rows for word in re.findall(r"\*\*(\w+)\*\*", row.split("|")[-2])]


def test_functions_are_verbs() -> None:
    assert not participles()


def test_docstrings_open_with_the_verb_or_the_thing() -> None:
    assert not returns_what()
    found, words = whats()
    assert 1000 * len(found) < 2 * words, f"{len(found)} in {words} words: {found}"


def test_pages_use_few_whats() -> None:
    texts = [
        page.read_text(encoding="utf-8") for page in [*ROOT.glob("docs/**/*.md"), ROOT / "CONTRIBUTING.md"]
    ]
    words = re.findall(r"[A-Za-z']+", " ".join(texts))
    assert 1000 * sum(word.lower() == "what" for word in words) < 2 * len(words)


def test_words_in_bold_in_the_glossary_are_in_no_name_and_no_docstring() -> None:
    assert len(forbidden()) > 5
    assert not {word: spoken().words[word] for word in forbidden() if word in spoken().words}


def test_a_file_of_tests_is_about_one_thing() -> None:
    lengths = {
        path.name: path.read_text(encoding="utf-8").count("\n") for path in (ROOT / "tests").rglob("*.py")
    }
    assert not {name: length for name, length in lengths.items() if length >= 450}


def test_functions_are_short() -> None:
    lengths = {
        f"{path.relative_to(ROOT)} {node.name}": node.end_lineno - node.lineno + 1
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
    }
    assert not {name: length for name, length in lengths.items() if length > LONGEST}
