"""The ``surefoot`` command."""

from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console

import surefoot

__all__ = ["app"]

app = typer.Typer(
    name="surefoot",
    help="Honest models of the sensors that biped robots stand on, and calibrators that undo their errors.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
calibrate = typer.Typer(help="Calibrate from the logs of a robot.", no_args_is_help=True)
app.add_typer(calibrate, name="calibrate")
bench = typer.Typer(
    help="Calibrate the load cells on a virtual bench, or hold the calibrators against each other."
)
app.add_typer(bench, name="bench")

_console = Console()
if not _console.is_terminal:
    _console = Console(width=160)


def _fail(message: str) -> NoReturn:
    """End with one line that says what is wrong and what to do, and exit code 2."""
    typer.echo(f"surefoot: {message}", err=True)
    raise typer.Exit(2)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"surefoot {surefoot.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    pass


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything that is made.")] = Path("out/demo"),
    seeds: Annotated[int, typer.Option(help="Walks at each speed, and in each closed loop.", min=1)] = 10,
    jobs: Annotated[int, typer.Option(help="Processes that work at the same time.", min=1)] = 2,
    quick: Annotated[bool, typer.Option("--quick", help="One speed, two seeds, short walks.")] = False,
) -> None:
    """Walk at three speeds, calibrate the same streams by every method, close the loop, and report."""
    from surefoot.experiments.demo import run_demo
    from surefoot.experiments.demo_options import DemoOptions
    from surefoot.experiments.demo_page import DemoPage
    from surefoot.experiments.recordings_section import recordings_section

    options = DemoOptions(out=out, seeds=seeds, jobs=jobs)
    if quick:
        options = options.quick()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        _fail(f"cannot write to '{out}': {error.strerror}; give another folder with --out.")
    results = run_demo(options)
    page = DemoPage(results, recordings_section(out))
    report = page.write()
    for table in page.tables:
        _console.print(table.to_rich())
    typer.echo(f"Report: {report}")


@bench.callback(invoke_without_command=True)
def bench_cells(
    context: typer.Context,
    seed: Annotated[int, typer.Option(help="Of everything random on the bench.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Folder for the tables as CSV.")] = None,
) -> None:
    """Calibrate the load cells on a virtual bench, as the CoP paper's Tables 2 and 3."""
    if context.invoked_subcommand is not None:
        return
    from surefoot.experiments import demo_tables
    from surefoot.experiments._files import atomic_path
    from surefoot.experiments.bench import run_bench

    report = run_bench(seed=seed)
    tables = (demo_tables.paper_table_2()[0], demo_tables.table_2(report), demo_tables.table_3(report))
    for table in tables:
        _console.print(table.to_rich())
        if out is not None:
            with atomic_path(out / f"{table.name}.csv") as part:
                table.to_frame().to_csv(part, index=False)


@bench.command("calibration")
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
    from surefoot.experiments.arena import run_arena
    from surefoot.experiments.arena_bound import bound_of
    from surefoot.experiments.arena_options import ArenaOptions
    from surefoot.experiments.arena_page import ArenaPage

    try:
        options = ArenaOptions(
            out=out, seeds=seeds, scenarios=tuple(scenario or ()), methods=tuple(method or ()), jobs=jobs
        )
        out.mkdir(parents=True, exist_ok=True)
        results = run_arena(options.quickly() if quick else options, bound=bound_of)
    except ValueError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"cannot write to '{out}': {error.strerror}; give another folder with --out.")
    page = ArenaPage(results)
    report = page.write()
    for table in (page.targets, page.overview, page.timing, page.alarms, page.faults):
        if table is not None:
            _console.print(table.to_rich())
    typer.echo(f"Report: {report}")


@calibrate.command("walking")
def calibrate_walking(
    log: Annotated[Path, typer.Argument(help="A log, .parquet or .csv; see docs/log-format.md.")],
    method: Annotated[
        str | None,
        typer.Option(help="surefoot, window, quasi-static, tare or none; by default as FootCalibrator."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(help="Start from the nominal or bench map; by default as the log says."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the result; by default beside the log.")
    ] = None,
    settle: Annotated[float, typer.Option(help="Errors count from this time in s on.")] = 0.0,
    zero_phase: Annotated[
        bool, typer.Option("--zero-phase", help="Filter with hindsight, as the paper did.")
    ] = False,
    split_gaps: Annotated[
        bool, typer.Option("--split-gaps", help="Go on after gaps in time, with filters begun anew.")
    ] = False,
) -> None:
    """Calibrate a walk: counts and the robot's beliefs in, calibrated forces, CoP and parameters out."""
    from surefoot.experiments.calibrate_log import DEFAULT_METHOD, calibrate_log
    from surefoot.experiments.log_format import MAX_GAP, read_log

    try:
        result = calibrate_log(
            read_log(log, max_gap=float("inf") if split_gaps else MAX_GAP),
            DEFAULT_METHOD if method is None else method,
            start,
            folder=(log.parent if out is None else out),
            stem=log.stem,
            settle=settle,
            zero_phase=zero_phase,
            file=log.name,
        )
    except (ValueError, OSError) as error:
        _fail(str(error))
    for notice in result.notices:
        typer.echo(f"Note: {notice}")
    for table in result.tables:
        _console.print(table.to_rich())
    typer.echo(f"Calibrated walk: {result.walk}\nParameters:      {result.parameters}")
    typer.echo(f"Report:          {result.page}")


@calibrate.command("bench")
def calibrate_bench(
    weighings: Annotated[Path, typer.Argument(help="A CSV: load_kg or load_N, and raw_..._count per cell.")],
    out: Annotated[Path | None, typer.Option(help="Where to write the map as JSON.")] = None,
) -> None:
    """Fit a line to each cell's readings under known weights (CoP paper, Eqs. 1, 2)."""
    from surefoot.experiments.calibrate_bench import fit_weighings

    try:
        table, path = fit_weighings(weighings, weighings.with_suffix(".map.json") if out is None else out)
    except (ValueError, OSError) as error:
        _fail(str(error))
    _console.print(table.to_rich())
    typer.echo(f"Map: {path}")


@app.command()
def view(
    feed: Annotated[
        str, typer.Option(help="CoP fed back: true, none (drifting raw), tare, quasi-static or window.")
    ] = "window",
    speed: Annotated[float, typer.Option(help="Walking speed in m/s.")] = 0.04,
    seed: Annotated[int, typer.Option(help="Seed of the walk and its sensors.")] = 0,
    duration: Annotated[float, typer.Option(help="Duration in s, 4 s of standing included.")] = 20.0,
    severity: Annotated[float, typer.Option(help="How bad the cells are; 1 as in the bad start.")] = 1.0,
    video: Annotated[Path | None, typer.Option(help="Write an .mp4 here in place of a window.")] = None,
) -> None:
    """Watch the walker in a window, or film it."""
    from surefoot.experiments.video import film_walk, prepare_rendering, watch_walk

    prepare_rendering()
    if video is not None and video.suffix != ".mp4":
        _fail(f"'{video}' must end in .mp4.")
    try:
        if video is None:
            watch_walk(feed, speed=speed, seed=seed, duration=duration, severity=severity)
        else:
            film = film_walk(video, feed, speed=speed, seed=seed, duration=duration, severity=severity)
            typer.echo(f"Film: {film}")
    except (ValueError, OSError, ImportError) as error:
        _fail(str(error))
