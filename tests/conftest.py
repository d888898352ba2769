"""What holds for all tests, and environments that several of them wrap; planning a walk is done once."""

import gc
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

TESTS = Path(__file__).parent
LONG = frozenset((TESTS / "long.txt").read_text(encoding="utf-8").splitlines())
"""Files, functions and rows of them that take 0.2 s or more: CI runs them, `make test` does not."""

# Modules that tests of a folder share begin with an underscore.
sys.path[:0] = [str(TESTS), *(str(folder) for folder in TESTS.iterdir() if folder.is_dir())]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what takes long, before pytest selects by marks."""
    for item in items:
        if item.path.is_relative_to(TESTS):
            file = item.path.relative_to(TESTS).as_posix()
            name = f"{file}::{item.nodeid.partition('::')[2]}"
            if LONG & {file, name, name.partition("[")[0]}:
                item.add_marker("long")


def pytest_collection_finish() -> None:
    """Keep what was imported (torch, pandas, matplotlib) out of garbage collections, which come seldom."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


@pytest.fixture(scope="session")
def load_script() -> Callable[[str], ModuleType]:
    """Give a function that imports a script by its path, or skips where there is none: in the wheel."""

    def load(name: str) -> ModuleType:
        path = TESTS.parent / name
        if not path.is_file():
            pytest.skip(f"{path.parent.name} are not part of the wheel")
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None
        assert spec.loader is not None
        module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Give the library of calibrators and beliefs, compiled if there is none."""
    from _native import library_of

    from surefoot.native import CALIBRATION

    return library_of(CALIBRATION, tmp_path_factory.mktemp("native"))


@pytest.fixture
def make_bare() -> Callable[..., Any]:
    """Make a bare environment; by default a walk of 12 s."""
    import gymnasium as gym

    import surefoot  # noqa: F401

    def make(name: str = "surefoot/NaoWalk-v0", **options: Any) -> gym.Env[Any, Any]:
        if "Walk" in name:
            options = {"speed": 0.04, "duration": 12.0, **options}
        return gym.make(name, **options)

    return make
