"""``surefoot demo`` and ``surefoot view``: a first picture."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from surefoot.experiments.cli.console import Feeds, Jobs, Out, fail, one_line_errors, show


def demo(
    out: Out = Path("out/demo"),
    seeds: Annotated[int, Option(help="Walks, and walks of each closed loop.", min=1)] = 4,
    jobs: Jobs = 2,
    quick: Annotated[bool, Option("--quick", help="Two seeds and short walks.")] = False,
) -> None:
    """Walk on bad feet and on calibrated ones; write a page with a film, a figure and tables."""
    from surefoot.experiments.demo.page import run_demo
    from surefoot.experiments.demo.presets import demo_options, quick_options

    with one_line_errors(out):
        options = demo_options(out, seeds, jobs)
        report = run_demo(quick_options(options) if quick else options)
    show(report.tables, report.page)


def view(
    feed: Feeds = None,
    speed: Annotated[float, Option(help="Walking speed in m/s.")] = 0.04,
    seed: Annotated[int, Option(help="Seed of the walk and its sensors.")] = 0,
    duration: Annotated[float, Option(help="Duration in s, 4 s of standing included.")] = 20.0,
    severity: Annotated[float, Option(help="How bad the cells are; 1 as in the bad start.")] = 1.0,
    video: Annotated[Path | None, Option(help="Film into this .mp4, .webp or .gif: no window.")] = None,
    feet: Annotated[
        str | None,
        Option(help="Show the feet of this environment, robot or MJCF file instead.", metavar="ENV"),
    ] = None,
    foot: Annotated[list[str] | None, Option(help="A foot's body, the left one first; else guessed.")] = None,
    soles: Annotated[bool, Option("--soles", help="Flat soles for feet without area.")] = False,
    image: Annotated[Path, Option(help="Where the picture of the feet goes.")] = Path("feet.png"),
) -> None:
    """Watch the walker in a window, or film it; or draw a robot with its instrumented soles."""
    if feet is not None:
        _show_feet(feet, foot, soles, image)
        return
    if foot or soles:
        fail("--foot and --soles go with --feet ENV, which says whose feet.")
    from surefoot.experiments.walks.video import ANIMATIONS, film_walks, prepare_rendering, watch_walk

    prepare_rendering()
    feeds = feed or ["window"]
    options: dict[str, Any] = {"speed": speed, "seed": seed, "duration": duration, "severity": severity}
    if video is not None and video.suffix not in (".mp4", *ANIMATIONS):
        fail(f"'{video}' must end in .mp4, .webp or .gif.")
    if video is None and len(feeds) > 1:
        fail("a window shows one feed; film several side by side with --video walk.mp4.")
    try:
        if video is None:
            watch_walk(feeds[0], **options)
        else:
            typer.echo(f"Film: {film_walks(video, feeds, **options)}")
    except (ValueError, OSError, ImportError) as error:
        fail(str(error))


def _show_feet(name: str, feet: list[str] | None, soles: bool, image: Path) -> None:
    """Tell which bodies are a robot's feet, and draw them."""
    from surefoot.experiments.walks.video import prepare_rendering

    prepare_rendering()
    import gymnasium as gym

    from surefoot.experiments.feet import FeetDrawing

    try:
        drawing = FeetDrawing(name, feet or None, soles=soles)
        for line in drawing.words():
            typer.echo(line)
        drawing.draw(image)
    except (ValueError, TypeError, OSError, ImportError, RuntimeError, gym.error.Error) as error:
        fail(str(error))
    typer.echo(f"Picture: {image}")
