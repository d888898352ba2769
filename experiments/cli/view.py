"""``surefoot view``: show a robot, a log or a stream in the browser, or draw a robot's feet."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from surefoot.experiments.cli.console import fail

_PAGE_FEEDS = {"true": "true", "none": "raw"}  # names of feeds on the page (all others are calibrators)
LOOPBACK = "127.0.0.1"


def view(
    env: Annotated[
        str | None, Argument(help="Environment on two feet; by default the NAO that walks.", metavar="[ENV]")
    ] = None,
    feed: Annotated[str, Option(help="true, none, or the method that calibrates.")] = "moment",
    speed: Annotated[float, Option(help="Walking speed in m/s.")] = 0.04,
    seed: Annotated[int, Option(help="Seed of the walk and its sensors.", min=0)] = 0,
    severity: Annotated[float, Option(help="How bad the cells are; 1 as in the bad start.")] = 1.0,
    controller: Annotated[
        str | None,
        Option(help="shipped, shipped-randomised, stabiliser, zero, a file .npz, or module:function."),
    ] = None,
    record: Annotated[Path, Option(help="Folder for what the page records.")] = Path("out/view"),
    log: Annotated[Path | None, Option(help="Play a log instead, from its beginning to its end.")] = None,
    stream: Annotated[
        Path | None, Option(help="Show a robot's stream of rows instead; a log's description, .json.")
    ] = None,
    stream_port: Annotated[int, Option(help="UDP port that receives the rows.", min=1, max=65535)] = 9870,
    host: Annotated[str, Option(help="Address of the page; 0.0.0.0 admits other computers.")] = LOOPBACK,
    port: Annotated[int, Option(help="Port of the page.", min=1, max=65535)] = 8080,
    feet: Annotated[
        str | None,
        Option(help="Draw the feet of this environment, robot or MJCF file instead.", metavar="ENV"),
    ] = None,
    foot: Annotated[
        list[str] | None, Option(help="Body of a foot, the left one first; by default guessed.")
    ] = None,
    soles: Annotated[bool, Option("--soles", help="Flat soles for feet without area.")] = False,
    image: Annotated[Path, Option(help="Where the picture of the feet is written.")] = Path("feet.png"),
) -> None:
    """Watch a robot in the browser and change its feet while it walks; or play a log, or show a stream."""
    if feet is not None:
        _draw_feet(feet, foot, soles, image)
        return
    if env is None and (foot or soles):
        fail("--foot and --soles need --feet ENV or ENV, whose feet they describe.")
    if stream is not None:
        note = f"; rows are received at UDP port {stream_port}"
        _show_page(lambda server: _stream_page(server, stream, feed, (host, stream_port)), note, host, port)
    elif log is not None:
        _show_page(lambda server: _log_page(server, log, feed), "", host, port)
    else:
        options: dict[str, Any] = {"seed": seed, "controller": controller, "feet": foot, "soles": soles}
        start = {"speed": speed, "severity": severity}
        note = f"; recordings are written to '{record}'"
        _show_page(lambda server: _live_page(server, env, feed, start, options, record), note, host, port)


def _show_page(make: Callable[[Any], Any], note: str, host: str, port: int) -> None:
    try:
        from surefoot.experiments.view.scene import close_server, open_server
    except ModuleNotFoundError as error:
        fail(f'the page needs {error.name}; install it with `pip install "surefoot[view]"`.')
    from surefoot.experiments.study.progress import working

    try:
        server = open_server(host, port, "surefoot")
    except OSError as error:
        fail(str(error))
    # The browser can load the page while the robot is being prepared.
    typer.echo(f"Page: http://{server.get_host()}:{server.get_port()} (Ctrl+C ends it{note})")
    try:
        with _refuse(), working("preparing the page"):
            page = make(server)
        page.run()
    except KeyboardInterrupt:
        typer.echo("Stopped.")
    finally:
        close_server(server)


@contextmanager
def _refuse() -> Iterator[None]:
    """Exit with a one-line message if an environment, a log or an option is invalid."""
    import gymnasium as gym

    try:
        yield
    except (ValueError, TypeError, OSError, ImportError, RuntimeError, gym.error.Error) as error:
        fail(str(error))


def _live_page(
    server: Any, env: str | None, feed: str, start: dict[str, Any], options: dict[str, Any], folder: Path
) -> Any:
    from surefoot.experiments.view.page import LivePage
    from surefoot.experiments.view.session import WALK, Session

    session = Session(env or WALK, start=start | _choose(feed), **options)
    with server.atomic():  # shows the complete page at once in a browser that is already connected
        return LivePage(server, session, folder=folder)


def _log_page(server: Any, log: Path, feed: str) -> Any:
    from surefoot.experiments.logs.format import read_log
    from surefoot.experiments.view.page import Page
    from surefoot.experiments.view.rows import NEED_NO_ROBOT, LogFeet

    method = _choose(feed).get("method", "none")
    return Page(server, LogFeet(read_log(log, feet_alone=method in NEED_NO_ROBOT), method))


def _stream_page(server: Any, description: Path, feed: str, address: tuple[str, int]) -> Any:
    from surefoot.experiments.view.page import Page
    from surefoot.experiments.view.rows import RowSocket, StreamFeet

    method = _choose(feed).get("method", "none")
    return Page(server, StreamFeet(description, method, RowSocket(*address)))


def _choose(feed: str) -> dict[str, str]:
    """Return the page's feed and calibrator for a name; ValueError if there is none."""
    from surefoot.experiments.walks.walkers import check_feed
    from surefoot.names import plain_name

    if check_feed(feed) == "weights":
        raise ValueError("'weights' is a feed of evaluations; the page begins on the nominal map.")
    if feed in _PAGE_FEEDS:
        return {"feed": _PAGE_FEEDS[feed]}
    return {"feed": "calibrated", "method": plain_name(feed)}


def _draw_feet(name: str, feet: list[str] | None, soles: bool, image: Path) -> None:
    """Print the bodies that are used as feet, and draw them."""
    from surefoot.experiments.walks.video import prepare_rendering

    prepare_rendering()

    from surefoot.envs import FeetDrawing
    from surefoot.experiments.study.progress import working

    with _refuse(), working("drawing the feet"):
        drawing = FeetDrawing(name, feet or None, soles=soles)
        drawing.draw(image)
    for line in drawing.words():
        typer.echo(line)
    typer.echo(f"Picture: {image}")
