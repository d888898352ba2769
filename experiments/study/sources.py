"""The code that decides results: one hash of its sources, and those of what a user adds."""

import inspect
import sys
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from surefoot.calibration import METHODS, online
from surefoot.names import plain_name
from surefoot.sensors import presets

_PACKAGES = ("calibration", "controllers", "envs", "experiments", "native", "robot", "sensors", "wrappers")
_SOURCES = (".py", ".xml", ".h", ".c")
_SHOWING = {"cli", "view", "page.py", "figures.py", "tables.py"}
"""Folders and files of ``surefoot.experiments`` that show results and decide none."""


@cache
def source_hash(*modules: str) -> str:
    """Return 16 hex digits of the files of modules and packages, by default of all that decide results."""
    digest = sha256()
    for module in modules or tuple(f"surefoot.{name}" for name in _PACKAGES):
        home = _find_home(module)
        files = {file.relative_to(home).as_posix(): file for file in (home, *home.rglob("*"))}
        showing = _SHOWING if module.startswith("surefoot.experiments") else set()
        for name in sorted(files):
            if files[name].suffix in _SOURCES and not showing.intersection(name.split("/")):
                digest.update(f"{module} {name} ".encode() + files[name].read_bytes())
    return digest.hexdigest()[:16]


@cache
def code_of(module: str) -> str:
    """Hash of the code behind a function of a module, and versions of packages: both decide its results."""
    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "mujoco"))
    own = "" if module.startswith("surefoot.") else f" and {source_hash(module)}"
    return f"code {source_hash()}{own}, {versions}"


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


def _find_home(module: str) -> Path:
    if module in sys.modules:
        there = sys.modules[module]
        path, folders = getattr(there, "__file__", None), getattr(there, "__path__", ())
    else:
        spec = find_spec(module)
        path, folders = (spec.origin, spec.submodule_search_locations or ()) if spec else (None, ())
    home = next(iter(folders), path)
    if home is None:
        raise ModuleNotFoundError(f"There is no module '{module}' whose source could be hashed.", name=module)
    return Path(home)
