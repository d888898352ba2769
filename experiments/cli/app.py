"""The ``surefoot`` command.

Commands import their packages when they run, so that ``surefoot --help`` starts fast.
"""

from typing import Annotated, Any

import typer
from typer import Option
from typer.core import TyperGroup

import surefoot
from surefoot.experiments.cli import calibrate, controllers, demo, view
from surefoot.experiments.cli.console import INTERRUPTED
from surefoot.names import page

ORDER = ["demo", "view", "check", "calibrate", "train", "evaluate"]


class _InOrder(TyperGroup):
    """Lists commands in this order, and reports an interruption of any command in one line."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in order."""
        return ORDER

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except (KeyboardInterrupt, ImportError) as error:
            # C modules that are interrupted during their import raise "initialization failed".
            causes = error, error.__cause__, error.__context__
            if not any(isinstance(cause, KeyboardInterrupt) for cause in causes):
                raise
            typer.echo("Stopped.", err=True)
            raise typer.Exit(INTERRUPTED) from None


app = typer.Typer(
    name="surefoot",
    cls=_InOrder,
    help="Realistic models of the foot sensors of legged robots, and calibrators that correct their errors.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.add_typer(calibrate.app, name="calibrate")
app.command(epilog=f"Kinds of logs: {page('check')}")(calibrate.check)
app.command()(demo.demo)
app.command()(view.view)
for command in (controllers.train, controllers.evaluate):
    app.command()(command)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"surefoot {surefoot.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, Option("--version", help="Show the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    pass
