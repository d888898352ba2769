"""The common part of all commands: output, one-line errors, common options."""

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from typer import Option

console = Console()
if not console.is_terminal:
    console = Console(width=160)

CONTROLLERS = (
    "shipped, shipped-randomised, stabiliser, zero, a policy file .npz, or module:function, which is "
    "imported and run"
)
REFUSED = 3
"""Exit code if the data contradict each other or do not determine the result. Unreadable files give 2."""

INTERRUPTED = 130  # the exit code of shells after Ctrl-C

Names = list[str] | None
Numbers = list[float] | None
Paths = list[Path] | None
Out = Annotated[Path, Option(help="Folder of the results.")]
Json = Annotated[bool, Option("--json", help="Print only tables and paths, as JSON.")]
Jobs = Annotated[int, Option(help="Number of processes.", min=1)]


def fail(message: str, code: int = 2) -> NoReturn:
    """Exit with a one-line message, which names the error and the remedy, and an exit code."""
    typer.echo(f"surefoot: {message}", err=True)
    raise typer.Exit(code)


@contextmanager
def one_line_errors(out: Path | None = None, cure: str = "give another folder with --out.") -> Iterator[None]:
    """Turn an interruption or a user's error into one line, with the output folder and the remedy."""
    try:
        yield
    except KeyboardInterrupt:
        kept = "" if out is None else f" Finished parts are kept in '{out}'; the same command continues."
        typer.echo(f"Stopped.{kept}", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except (ValueError, FileNotFoundError) as error:
        from surefoot.calibration.results import CalibrationRefused

        fail(str(error), REFUSED if isinstance(error, CalibrationRefused) else 2)
    except OSError as error:
        if out is None:
            fail(f"'{error.filename}': {error.strerror}." if error.filename else str(error))
        fail(f"cannot write to '{out}': {error.strerror or error}; {cure}")


def show(
    tables: Iterable[Any],
    files: Mapping[str, Path],
    *,
    as_json: bool,
    notices: Iterable[str] = (),
    said: str = "",
    **facts: Any,
) -> None:
    """Print the results of a command: notices, tables, text, and the kind and path of each file.

    The JSON output is one object with ``notices``, ``tables`` by name, ``files``, and the facts instead of
    the text.
    """
    if as_json:
        plain = {table.name: table.to_plain() for table in tables}
        whole = {"notices": list(notices), "tables": plain, **facts}
        whole["files"] = {what: str(path) for what, path in files.items()}
        typer.echo(json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False))
        return
    for notice in notices:
        typer.echo(f"Note: {notice}")
    for table in tables:
        console.print(table.to_rich())
    if said:
        typer.echo(said)
    width = max(map(len, files), default=0) + 2
    for what, path in files.items():
        typer.echo(f"{what[:1].upper()}{what[1:] + ':':<{width}}{path}")
