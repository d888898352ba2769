"""What all commands share; private to the command line."""

from typing import NoReturn

import typer
from rich.console import Console

__all__ = ["console", "fail"]

console = Console()
if not console.is_terminal:
    console = Console(width=160)


def fail(message: str) -> NoReturn:
    """End with one line that says what is wrong and what to do, and exit code 2."""
    typer.echo(f"surefoot: {message}", err=True)
    raise typer.Exit(2)
