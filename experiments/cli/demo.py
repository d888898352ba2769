"""``surefoot demo``: a first picture."""

from pathlib import Path
from typing import Annotated

from typer import Option

from surefoot.experiments.cli.console import Jobs, Json, Out, one_line_errors, show


def demo(
    out: Out = Path("out/demo"),
    seeds: Annotated[int, Option(help="Walks, and walks of each closed loop.", min=1)] = 4,
    jobs: Jobs = 2,
    quick: Annotated[bool, Option("--quick", help="Two seeds and short walks.")] = False,
    as_json: Json = False,
) -> None:
    """Walk on bad feet and on calibrated ones; write a page with a film, a figure and tables."""
    from surefoot.experiments.walks.options import demo_options
    from surefoot.experiments.walks.page import report_walks

    with one_line_errors(out):
        options = demo_options(out, seeds, jobs)
        report = report_walks(options.quickly() if quick else options)
    show(report.tables, {"report": report.page}, as_json=as_json)
