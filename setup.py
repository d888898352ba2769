"""Compile the libraries in C where there is a C compiler, and tag the wheel by its contents."""

import os
import re
import runpy
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

ROOT = Path(__file__).parent
BUILD = runpy.run_path(str(ROOT / "native" / "build.py"))
LIBRARIES = list(BUILD["sources_below"](ROOT))
# `make wheels` sets the platform of each wheel. The default is the platform of this machine.
PLATFORM = os.environ.get("SUREFOOT_PLATFORM")
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT, HOMES = SETTINGS["project"], SETTINGS["tool"]["setuptools"]["package-dir"]


def packages() -> list[str]:
    """Return the names of all packages: folders with an ``__init__.py`` below those of ``package-dir``."""
    found = set()
    for name, home in HOMES.items():
        # The links in surefoot/ lead to folders that have an entry of their own.
        for folder, _, files in os.walk(ROOT / home):
            if "__init__.py" in files:
                found.add(".".join([name, *Path(folder).relative_to(ROOT / home).parts]))
    return sorted(found)


def place(sources: Any) -> Path:
    """Return the path of a library in a wheel."""
    return Path("surefoot", "native", sources.name + BUILD["ending"](PLATFORM))


def is_current(sources: Any) -> bool:
    """Return whether the library in the folder of the sources was compiled from them."""
    library = sources.library
    return library.is_file() and sources.fingerprint().encode() in library.read_bytes()


def readme() -> str:
    """Return README.md for package indexes, with its relative links replaced by links to this version."""
    home, tag = PROJECT["urls"]["Repository"], f"v{PROJECT['version']}"
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    text = text.replace("](docs/images/", f"]({home}/raw/{tag}/docs/images/")
    return re.sub(r"\]\((?!https?:|#)", f"]({home}/blob/{tag}/", text)


class BuildWithLibraries(build_py):
    """Copies the package and compiles its libraries. Those of an editable install go into the checkout."""

    def run(self) -> None:
        """Build the package, and the libraries if there is a C compiler."""
        super().run()
        with ThreadPoolExecutor() as pool:  # compilers are processes of their own, one per library
            for said in pool.map(self.compile_library, LIBRARIES):
                print(said)

    def compile_library(self, sources: Any) -> str:
        """Compile a library unless another environment of this checkout has, and return a message."""
        if self.editable_mode and is_current(sources):
            return f"{sources.name} is current"
        target = sources.library if self.editable_mode else Path(self.build_lib, place(sources))
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)
        problem = sources.compile(target, platform=PLATFORM)
        if problem and PLATFORM:
            raise SystemExit(f"No wheel for {PLATFORM}: {problem}.")
        return f"{sources.name} runs in Python alone: {problem}." if problem else f"compiled {target}"


class WheelOfOnePlatform(bdist_wheel):
    """Tags a wheel with libraries for Python 3 on one platform, and a wheel without for all platforms."""

    def get_tag(self) -> tuple[str, str, str]:
        """Return Python, ABI and platform of the wheel."""
        if not any(Path(self.bdist_dir, place(sources)).exists() for sources in LIBRARIES):
            return super().get_tag()
        self.root_is_pure = False
        return "py3", "none", PLATFORM or super().get_tag()[2]


setup(
    packages=packages(),
    # pip installs these for the build. A compiler cannot be required conditionally in pyproject.toml.
    setup_requires=BUILD["requirements"](),
    cmdclass={"build_py": BuildWithLibraries, "bdist_wheel": WheelOfOnePlatform},
    long_description=readme(),
    long_description_content_type="text/markdown",
)
