"""The ``surefoot`` command."""

from pathlib import Path
from typing import Annotated

import typer

import surefoot
from surefoot.experiments.cli import bench, calibrate, evaluate, sweep, train
from surefoot.experiments.cli.console import console, fail

__all__ = ["app"]

app = typer.Typer(
    name="surefoot",
    help="Honest models of the sensors that biped robots stand on, and calibrators that undo their errors.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(calibrate.app, name="calibrate")
app.add_typer(bench.app, name="bench")
app.command()(train.train)
app.command()(evaluate.evaluate)
app.command()(sweep.sweep)
app.command()(sweep.replay)


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
    from surefoot.experiments.demo.options import DemoOptions
    from surefoot.experiments.demo.page import DemoPage
    from surefoot.experiments.demo.recordings_section import recordings_section
    from surefoot.experiments.demo.run import run_demo

    options = DemoOptions(out=out, seeds=seeds, jobs=jobs)
    if quick:
        options = options.quick()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        fail(f"cannot write to '{out}': {error.strerror}; give another folder with --out.")
    results = run_demo(options)
    page = DemoPage(results, recordings_section(out))
    report = page.write()
    for table in page.tables:
        console.print(table.to_rich())
    typer.echo(f"Report: {report}")


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
    from surefoot.experiments.walks.video import film_walk, prepare_rendering, watch_walk

    prepare_rendering()
    if video is not None and video.suffix != ".mp4":
        fail(f"'{video}' must end in .mp4.")
    try:
        if video is None:
            watch_walk(feed, speed=speed, seed=seed, duration=duration, severity=severity)
        else:
            film = film_walk(video, feed, speed=speed, seed=seed, duration=duration, severity=severity)
            typer.echo(f"Film: {film}")
    except (ValueError, OSError, ImportError) as error:
        fail(str(error))
