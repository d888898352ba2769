"""The ``surefoot`` command, also as ``python -m surefoot``."""

import sys
from importlib.util import find_spec

NEEDED = (
    "typer",
    "rich",
    "pandas",
    "pyarrow",
    "pydantic",
    "matplotlib",
    "jinja2",
    "joblib",
    "gymnasium",
    "mujoco",
    "mink",
)


def main() -> None:
    """Run the command, or name the missing package."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        print(
            f"surefoot: the command needs {', '.join(missing)}; install it with "
            '`pip install "surefoot[experiments]"`.\n'
            "The calibrators themselves need no more: import surefoot.calibration.",
            file=sys.stderr,
        )
        raise SystemExit(2)
    try:
        from surefoot.experiments.cli.app import app

        app()
    except KeyboardInterrupt:  # while modules are imported, or a second one
        print("Stopped.", file=sys.stderr)
        raise SystemExit(130) from None


if __name__ == "__main__":
    main()
