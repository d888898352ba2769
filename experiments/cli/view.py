"""``surefoot view``: show a robot in the browser, in a window or in a video, or draw its feet."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from surefoot.experiments.cli.console import Feeds, fail

_PAGE_FEEDS = {"true": "true", "none": "raw"}  # names of feeds on the page (all others are calibrators)
LOOPBACK = "127.0.0.1"


Env = Annotated[
    str | None, Argument(help="Environment on two feet; by default the NAO that walks.", metavar="[ENV]")
]
Controller = Annotated[
    str | None, Option(help="shipped, shipped-randomised, stabiliser, zero, a file .npz, or module:function.")
]
Stream = Annotated[
    Path | None, Option(help="Show a robot's stream of rows instead; a log's description, .json.")
]
Drawn = Annotated[
    str | None, Option(help="Show the feet of this environment, robot or MJCF file instead.", metavar="ENV")
]


def view(
    env: Env = None,
    feed: Feeds = None,
    speed: Annotated[float, Option(help="Walking speed in m/s.")] = 0.04,
    seed: Annotated[int, Option(help="Seed of the walk and its sensors.", min=0)] = 0,
    severity: Annotated[float, Option(help="How bad the cells are; 1 as in the bad start.")] = 1.0,
    controller: Controller = None,
    record: Annotated[Path, Option(help="Folder for what the page records.")] = Path("out/view"),
    log: Annotated[Path | None, Option(help="Show a log instead, from its beginning to its end.")] = None,
    stream: Stream = None,
    stream_port: Annotated[int, Option(help="UDP port that the rows come to.", min=1, max=65535)] = 9870,
    host: Annotated[str, Option(help="Address of the page; 0.0.0.0 lets other computers in.")] = LOOPBACK,
    port: Annotated[int, Option(help="Port of the page.", min=1, max=65535)] = 8080,
    window: Annotated[bool, Option("--window", help="A window of MuJoCo: no page.")] = False,
    video: Annotated[Path | None, Option(help="Film into this .mp4, .webp or .gif: no page.")] = None,
    duration: Annotated[float, Option(help="Of a film or window in s, 4 s of them standing.", min=1)] = 20.0,
    feet: Drawn = None,
    foot: Annotated[list[str] | None, Option(help="A foot's body, the left one first; else guessed.")] = None,
    soles: Annotated[bool, Option("--soles", help="Flat soles for feet without area.")] = False,
    image: Annotated[Path, Option(help="Where the picture of the feet goes.")] = Path("feet.png"),
) -> None:
    """Watch a robot in the browser and change its feet while it walks; or in a window, or film it."""
    feeds = feed or ["window" if window or video else "moment"]
    if feet is not None:
        _show_feet(feet, foot, soles, image)
    elif window or video is not None:
        if env is not None or foot or soles:
            fail("a window and a film show the NAO that walks; leave out ENV, --foot and --soles.")
        _walk(video, feeds, speed=speed, seed=seed, duration=duration, severity=severity)
    elif env is None and (foot or soles):
        fail("--foot and --soles go with --feet ENV or with ENV, which say whose feet.")
    elif len(feeds) > 1:
        fail("the page shows one feed; film several side by side with --video walk.mp4.")
    elif stream is not None:
        address = (host, stream_port)
        more = f"; rows come to UDP port {stream_port}"
        _show_page(
            lambda server: _stream_page(server, stream, feeds[0], address), stream.name, more, host, port
        )
    elif log is not None:
        _show_page(lambda server: _log_page(server, log, feeds[0]), log.name, "", host, port)
    else:
        made: dict[str, Any] = {"seed": seed, "controller": controller, "feet": foot or None, "soles": soles}
        made["start"] = {"speed": speed, "severity": severity}
        live = partial(_live_page, env=env, feed=feeds[0], options=made, folder=record)
        _show_page(live, env, f"; recordings go to '{record}'", host, port)


def _show_page(make: Callable[[Any], Any], name: str | None, more: str, host: str, port: int) -> None:
    try:
        from surefoot.experiments.view.server import address_of, close_server, open_server
    except ModuleNotFoundError as error:
        fail(
            f'the page needs {error.name}; install it with `pip install "surefoot[view]"`, or watch with '
            "--window or --video walk.mp4."
        )
    from surefoot.experiments.study.progress import working

    try:
        server = open_server(host, port, f"surefoot: {name}" if name else "surefoot")
    except OSError as error:
        fail(str(error))
    # The browser can load the page while the robot is being prepared.
    typer.echo(f"Page: {address_of(server)} (Ctrl+C ends it{more})")
    try:
        with working("making ready"):
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


def _live_page(server: Any, env: str | None, feed: str, options: dict[str, Any], folder: Path) -> Any:
    from surefoot.experiments.view.page import Page
    from surefoot.experiments.view.session import WALK, Session

    with _refuse():
        options["start"] |= _choose(feed)
        session = Session(env or WALK, **options)
        with server.atomic():  # draw the complete page at once in a browser that is already connected
            return Page(server, session, folder=folder)


def _log_page(server: Any, log: Path, feed: str) -> Any:
    from surefoot.experiments.logs.format import read_log
    from surefoot.experiments.view.player import LogFeet, LogPage

    with _refuse():
        method = _choose(feed).get("method", "none")
        return LogPage(server, LogFeet(read_log(log, feet_alone=method in ("tare", "none")), method))


def _stream_page(server: Any, description: Path, feed: str, address: tuple[str, int]) -> Any:
    from surefoot.experiments.view.stream import RowSocket, StreamFeet, StreamPage

    with _refuse():
        feet = StreamFeet(description, _choose(feed).get("method", "none"))
        return StreamPage(server, feet, RowSocket(*address))


def _choose(feed: str) -> dict[str, str]:
    """Return the page's feed and calibrator for a name.

    Raises ValueError if the page does not support it.
    """
    from surefoot.experiments.walks.walkers import check_feed
    from surefoot.names import plain_name

    if check_feed(feed) == "weights":
        raise ValueError("'weights' is a feed of films; the page begins on the nominal map.")
    if feed in _PAGE_FEEDS:
        return {"feed": _PAGE_FEEDS[feed]}
    return {"feed": "calibrated", "method": plain_name(feed)}


def _walk(video: Path | None, feeds: list[str], **options: Any) -> None:
    from surefoot.experiments.study.progress import working
    from surefoot.experiments.walks.video import ANIMATIONS, film_walks, prepare_rendering, watch_walk

    prepare_rendering()

    if video is not None and video.suffix not in (".mp4", *ANIMATIONS):
        fail(f"'{video}' must end in .mp4, .webp or .gif.")
    if video is None and len(feeds) > 1:
        fail("a window shows one feed; film several side by side with --video walk.mp4.")
    with _refuse():
        if video is None:
            watch_walk(feeds[0], **options)
        else:
            with working("filming"):
                film = film_walks(video, feeds, **options)
            typer.echo(f"Film: {film}")


def _show_feet(name: str, feet: list[str] | None, soles: bool, image: Path) -> None:
    """Print the bodies that are used as feet, and draw them."""
    from surefoot.experiments.walks.video import prepare_rendering

    prepare_rendering()

    from surefoot.envs import FeetDrawing
    from surefoot.experiments.study.progress import working

    with _refuse():
        with working("looking at the feet"):
            drawing = FeetDrawing(name, feet or None, soles=soles)
            drawing.draw(image)
        for line in drawing.words():
            typer.echo(line)
    typer.echo(f"Picture: {image}")
