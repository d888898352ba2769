"""Compile all libraries of this package, for who installed without a compiler."""

import sys
from pathlib import Path

from surefoot.native.build import sources_below


def main() -> str | None:
    """Compile them and say where they are; return what went wrong."""
    package, checkout = Path(__file__).parents[1:3]
    # An unpacked sdist has no links: its packages lie side by side.
    linked = any(sources_below(package)) or not (checkout / "setup.py").is_file()
    for sources in sources_below(package if linked else checkout):
        problem = sources.compile()
        if problem:
            return f"Not compiled, {sources.name}: {problem}."
        print(f"Compiled {sources.library}.")
    return None


if __name__ == "__main__":
    sys.exit(main())
