"""Compile all libraries of this package after an installation without a compiler, or print include paths."""

import sys
from argparse import ArgumentParser
from collections.abc import Sequence

from surefoot.native.build import FOLDER, sources_below


def main(arguments: Sequence[str] = ()) -> str | None:
    """Run the command, which compiles the libraries by default, and return an error message or ``None``."""
    parser = ArgumentParser(prog="python -m surefoot.native", description=__doc__)
    parser.add_argument("--include", action="store_true", help="print the folder of headers as a -I option")
    parser.add_argument("--cmakedir", action="store_true", help="print the folder of surefoot-config.cmake")
    options = parser.parse_args(arguments)
    if options.include:
        print(f"-I{FOLDER}")
    if options.cmakedir:
        print(FOLDER)
    if options.include or options.cmakedir:
        return None
    for sources in sources_below():
        problem = sources.compile()
        if problem:
            return f"Not compiled, {sources.name}: {problem}."
        print(f"Compiled {sources.library}.")
    return None


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
