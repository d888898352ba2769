"""``surefoot bench``: virtual benches and comparisons."""

from pathlib import Path
from typing import Annotated

import typer

from surefoot.experiments.cli.console import console, fail

__all__ = ["app"]

app = typer.Typer(help="Calibrate on virtual benches, or hold the calibrators against each other.")


@app.callback(invoke_without_command=True)
def bench_cells(
    context: typer.Context,
    seed: Annotated[int, typer.Option(help="Of everything random on the bench.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Folder for the tables as CSV.")] = None,
) -> None:
    """Calibrate the load cells on a virtual bench, as the CoP paper's Tables 2 and 3."""
    if context.invoked_subcommand is not None:
        return
    from surefoot.experiments.demo.tables import paper_table_2, table_2, table_3
    from surefoot.experiments.study.files import atomic_path
    from surefoot.experiments.weights.weighing import run_weighing

    report = run_weighing(seed=seed)
    tables = (paper_table_2()[0], table_2(report), table_3(report))
    for table in tables:
        console.print(table.to_rich())
        if out is not None:
            with atomic_path(out / f"{table.name}.csv") as part:
                table.to_frame().to_csv(part, index=False)


@app.command("calibration")
def bench_calibration(
    out: Annotated[Path, typer.Option(help="Folder for everything that is made.")] = Path("out/arena"),
    seeds: Annotated[int, typer.Option(help="Walks of each scenario.", min=1)] = 20,
    scenario: Annotated[
        list[str] | None, typer.Option(help="A scenario to run; give it again for more. All by default.")
    ] = None,
    method: Annotated[
        list[str] | None, typer.Option(help="A method to run; give it again for more. All by default.")
    ] = None,
    jobs: Annotated[int, typer.Option(help="Processes that work at the same time.", min=1)] = 2,
    quick: Annotated[
        bool, typer.Option("--quick", help="Two seeds, short walks, no scenario that takes minutes.")
    ] = False,
) -> None:
    """Hold the calibrators against each other on the same walks, in every scenario, and report."""
    from surefoot.experiments.arena.bound import bound_of
    from surefoot.experiments.arena.options import ArenaOptions
    from surefoot.experiments.arena.page import ArenaPage
    from surefoot.experiments.arena.run import run_arena

    try:
        options = ArenaOptions(
            out=out, seeds=seeds, scenarios=tuple(scenario or ()), methods=tuple(method or ()), jobs=jobs
        )
        out.mkdir(parents=True, exist_ok=True)
        results = run_arena(options.quickly() if quick else options, bound=bound_of)
    except ValueError as error:
        fail(str(error))
    except OSError as error:
        fail(f"cannot write to '{out}': {error.strerror}; give another folder with --out.")
    page = ArenaPage(results)
    report = page.write()
    for table in (page.targets, page.overview, page.timing, page.alarms, page.faults):
        if table is not None:
            console.print(table.to_rich())
    typer.echo(f"Report: {report}")


@app.command("in-situ")
def bench_in_situ(
    out: Annotated[Path, typer.Option(help="Folder for everything that is made.")] = Path(
        "out/in-situ-study"
    ),
    seeds: Annotated[int, typer.Option(help="Sensors and IMUs, each with errors of its own.", min=1)] = 50,
    jobs: Annotated[int, typer.Option(help="Processes that work at the same time.", min=1)] = 2,
    quick: Annotated[bool, typer.Option("--quick", help="Two seeds at 10 samples a second.")] = False,
) -> None:
    """Calibrate six-axis sensors on a simulated leg with known masses, as the in-situ paper, and report."""
    from surefoot.experiments.in_situ.study import InSituStudyOptions, run_in_situ_study
    from surefoot.experiments.in_situ.study_page import InSituStudyPage

    try:
        options = InSituStudyOptions(out=out, seeds=seeds, jobs=jobs)
        out.mkdir(parents=True, exist_ok=True)
        results = run_in_situ_study(options.quickly() if quick else options)
    except ValueError as error:
        fail(str(error))
    except OSError as error:
        fail(f"cannot write to '{out}': {error.strerror}; give another folder with --out.")
    page = InSituStudyPage(results)
    report = page.write()
    for table in page.tables:
        console.print(table.to_rich())
    typer.echo(f"Report: {report}")
