"""Compile all libraries of this package, for who installed without a compiler; or say where headers are."""

import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path

from surefoot.native.build import SHARED, Sources, sources_below


def main(arguments: Sequence[str] = ()) -> str | None:
    """Run a command line, by default compile the libraries; return the failures."""
    parser = ArgumentParser(prog="python -m surefoot.native", description=__doc__)
    parser.add_argument("--include", action="store_true", help="print the folders of headers as -I options")
    parser.add_argument("--cmakedir", action="store_true", help="print the folder of surefoot-config.cmake")
    wanted = parser.parse_args(arguments)
    if wanted.include:
        print(
            " ".join(f"-I{folder}" for folder in (*dict.fromkeys(one.folder for one in _sources()), SHARED))
        )
    if wanted.cmakedir:
        print(SHARED)
    if wanted.include or wanted.cmakedir:
        return None
    for sources in _sources():
        problem = sources.compile()
        if problem:
            return f"Not compiled, {sources.name}: {problem}."
        print(f"Compiled {sources.library}.")
    return None


def _sources() -> list[Sources]:
    """Return the sources of all libraries."""
    package, checkout = Path(__file__).parents[1:3]
    # An unpacked sdist has no links: its packages lie side by side.
    linked = any(sources_below(package)) or not (checkout / "setup.py").is_file()
    return list(sources_below(package if linked else checkout))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
