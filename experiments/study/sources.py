"""Which files of surefoot a piece of work depends on, by the imports in their text, and one hash of them.

A name that a package only passes on is followed to the module that defines it; a string that names a module
counts as an import, and so does the id of an environment.
"""

import inspect
import re
import sys
from collections.abc import Iterator
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import surefoot
from surefoot.calibration import METHODS, online
from surefoot.names import plain_name
from surefoot.sensors import presets

_DATA = (".xml", ".h", ".c")  # files beside modules that decide results as well
_ROOT = Path(surefoot.__file__).parent
_IMPORT = re.compile(r"^[ \t]*from (surefoot[\w.]*) import (?:\(([^)]*)\)|([^\n(]*))", re.MULTILINE)
_WHOLE = re.compile(r"^[ \t]*import (surefoot\.[\w.]+)", re.MULTILINE)
_STRING = re.compile(r"[\"'](surefoot(?:\.\w+)+)(?::\w+)?[\"']")
_ENVIRONMENT = re.compile(r"[\"']surefoot/\w+-v\d+[\"']")


@cache
def source_hash(*entries: str) -> str:
    """Return 16 hex digits that change with the code behind some modules or packages."""
    modules, digest = source_modules(*entries), sha256()
    folders = {_file(module).parent for module in modules if module.startswith("surefoot.")}
    data = {file for folder in folders for file in folder.iterdir() if file.suffix in _DATA}
    files = data.union(map(_file, modules))
    # Several are alike in their names and their folders' names: the text decides on the order as well.
    for text in sorted(f"{file.parent.name}/{file.name}".encode() + file.read_bytes() for file in files):
        digest.update(text)
    return digest.hexdigest()[:16]


@cache
def code_of(module: str) -> str:
    """Hash of a module's sources, and versions of the packages they use: both decide its results."""
    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "mujoco"))
    return f"code {source_hash(module)}, {versions}"


def own_code(*names: str) -> tuple[str, ...]:
    """Hashes that decide the results of methods and presets that a user registered; none of others.

    Of a method it is a hash of its file, of a preset its values.
    """
    found: list[str] = []
    for name in map(plain_name, names):
        if name in METHODS and name not in online.SHIPPED:
            file = Path(inspect.getsourcefile(inspect.unwrap(METHODS[name].build)) or "")
            found.append(sha256(file.read_bytes()).hexdigest()[:16] if file.is_file() else name)
        if name not in presets.SHIPPED:
            found += [repr(own[name]) for own in presets.PRESETS.values() if name in own]
    return tuple(found)


@cache
def source_modules(*entries: str) -> frozenset[str]:
    """Return the modules of surefoot that some modules need, directly or not, and these themselves."""
    found: set[str] = set()
    waiting = list(entries)
    while waiting:
        module = waiting.pop()
        if module not in found:
            found.add(module)
            waiting += _needs(module)
    return frozenset(found)


def _file(module: str) -> Path:
    if module.partition(".")[0] != "surefoot":
        return Path(str(getattr(sys.modules.get(module), "__file__", module)))
    if file := _find_source(module):
        return file
    raise ModuleNotFoundError(f"There is no module '{module}' whose source could be hashed.", name=module)


def _find_source(module: str) -> Path | None:
    path = _place(module)
    return next((file for file in (path / "__init__.py", path.with_suffix(".py")) if file.is_file()), None)


@cache
def _place(module: str) -> Path:
    """Return a module's folder, or its file without an ending; an sdist has its packages side by side."""
    head, *names = module.split(".")[1:] or [""]
    spec = find_spec(f"surefoot.{head}") if head else None
    homes = spec.submodule_search_locations if spec is not None else None
    return (Path(homes[0]) if homes else _ROOT / head).joinpath(*names)


@cache
def _needs(module: str) -> frozenset[str]:
    text = _file(module).read_text(encoding="utf-8")
    needed = {_find_home(home, name) for home, name, _ in _imports(text)}
    needed.update(name for name in (*_WHOLE.findall(text), *_STRING.findall(text)) if _find_source(name))
    if _ENVIRONMENT.search(text):
        needed.add("surefoot.registration")
    return frozenset(needed - {module})


def _imports(text: str) -> Iterator[tuple[str, str, str]]:
    """Yield the names that a source imports from surefoot: of which module, which, and their names there."""
    for home, several, one in _IMPORT.findall(text):
        for part in re.sub(r"#[^\n]*", "", several or one).split(","):
            if words := part.split():
                yield home, words[0], words[-1]


def _find_home(module: str, name: str) -> str:
    """Return the module in which ``from module import name`` ends."""
    if _find_source(f"{module}.{name}"):
        return f"{module}.{name}"
    if _file(module).name == "__init__.py":
        return _exports(module).get(name, module)
    return module


@cache
def _exports(package: str) -> dict[str, str]:
    text = _file(package).read_text(encoding="utf-8")
    return {own: _find_home(home, name) for home, name, own in _imports(text)}
