"""Compile all libraries of this package, for who installed without a compiler; or say where headers are."""

import sys
from argparse import ArgumentParser
from collections.abc import Sequence

from surefoot.native.build import FOLDER, sources_below


def main(arguments: Sequence[str] = ()) -> str | None:
    """Run a command line, by default compile the libraries; return the failures."""
    parser = ArgumentParser(prog="python -m surefoot.native", description=__doc__)
    parser.add_argument("--include", action="store_true", help="print the folder of headers as a -I option")
    parser.add_argument("--cmakedir", action="store_true", help="print the folder of surefoot-config.cmake")
    wanted = parser.parse_args(arguments)
    if wanted.include:
        print(f"-I{FOLDER}")
    if wanted.cmakedir:
        print(FOLDER)
    if wanted.include or wanted.cmakedir:
        return None
    for sources in sources_below():
        problem = sources.compile()
        if problem:
            return f"Not compiled, {sources.name}: {problem}."
        print(f"Compiled {sources.library}.")
    return None


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
