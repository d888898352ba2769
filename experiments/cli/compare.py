"""``surefoot compare``: studies that hold calibrators against each other; ``surefoot demo``, a first one."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from surefoot.experiments.cli.console import Jobs, Json, Names, Out, fail, one_line_errors, show

app = typer.Typer(help="Compare calibrators in simulation, and report.", no_args_is_help=True)


@app.command()
def walking(
    out: Out = Path("out/compare-walking"),
    seeds: Annotated[int | None, Option(help="Walks of each; 20 by default, 10 with --full.", min=1)] = None,
    scenario: Annotated[Names, Option(help="A scenario to run; again for more. All by default.")] = None,
    method: Annotated[Names, Option(help="A method, or module:name; again for more. All by default.")] = None,
    jobs: Jobs = 2,
    quick: Annotated[bool, Option("--quick", help="Two seeds, short walks, only fast scenarios.")] = False,
    full: Annotated[bool, Option("--full", help="The CoP paper's study instead, with closed loops.")] = False,
    as_json: Json = False,
) -> None:
    """Compare the online calibrators on the same walks, in every scenario."""
    from surefoot.experiments.walks.options import WalkStudyOptions, full_options
    from surefoot.experiments.walks.page import report_walks

    if full and (scenario or method):
        fail("--full has scenarios and methods of its own; leave out --scenario and --method.")
    with one_line_errors(out):
        if full:
            options = full_options(out, 10 if seeds is None else seeds, jobs)
        else:
            chosen: Any = {"scenarios": tuple(scenario or ()), "methods": tuple(method or ())}
            options = WalkStudyOptions(out=out, seeds=20 if seeds is None else seeds, jobs=jobs, **chosen)
        report = report_walks(options.quickly() if quick else options)
    show(report.tables, {"report": report.page}, as_json=as_json)


@app.command()
def robots(
    out: Out = Path("out/compare-robots"),
    seeds: Annotated[int, Option(help="Of each robot, motion and kind of sensors.", min=1)] = 5,
    jobs: Jobs = 2,
    quick: Annotated[bool, Option("--quick", help="Two seeds, short runs.")] = False,
    as_json: Json = False,
) -> None:
    """Compare calibrators on robots that others made: standing, moving, falling."""
    from surefoot.experiments.walks.robots import compare_robots

    amount: Any = {"seeds": min(seeds, 2), "duration": 3.0} if quick else {"seeds": seeds}
    with one_line_errors(out):
        report = compare_robots(out, jobs=jobs, **amount)
    show(report.tables, {"report": report.page}, as_json=as_json)


def demo(
    out: Out = Path("out/demo"),
    seeds: Annotated[int, Option(help="Walks, of which up to four are walked in closed loops.", min=1)] = 8,
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
