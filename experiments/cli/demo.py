"""``surefoot demo``: a walk on bad feet and on calibrated ones."""

from pathlib import Path
from typing import Annotated

from typer import Option

from surefoot.experiments.cli.console import Jobs, Json, Out, one_line_errors, show


def demo(
    out: Out = Path("out/demo"),
    seeds: Annotated[int, Option(help="Recorded walks, and walks in closed loop on each feed.", min=1)] = 4,
    jobs: Jobs = 2,
    quick: Annotated[bool, Option("--quick", help="Two seeds and short walks.")] = False,
    as_json: Json = False,
) -> None:
    """Walk on bad feet and on calibrated ones; write a page with a film, figures and tables."""
    from surefoot.experiments.demo import run_demo

    with one_line_errors(out):
        report = run_demo(out, seeds, jobs, quick=quick)
    show(report.tables, {"report": report.page}, as_json=as_json)
