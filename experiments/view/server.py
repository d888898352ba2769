"""An empty page and its scene: light to import, so that a browser can load it while a robot gets ready."""

import errno
import socket
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
import viser

FRAMES_PER_SECOND = 30  # how often everything is drawn
PLACE = np.array([0.0, -0.95, 0.0])  # of the middle of the soles, beside the robot, in its leg lengths


def open_server(host: str, port: int, label: str) -> viser.ViserServer:
    """Return a server of an empty page; OSError if the port is in use, or there is no such host."""
    # The library would take the next free port without a word.
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                raise OSError(
                    f"port {port} of {host} is in use or not yours; choose another with --port {port + 1}."
                ) from None
            raise OSError(f"nothing can be served at {host}: {error.strerror or error}.") from None
    with redirect_stdout(StringIO()):  # A frame with addresses, which the command tells in a line.
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    # A page must not open a tunnel to the world, though the library's pages can ask for one.
    server.request_share_url = lambda verbose=True: None
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    # Shadows and reflections cost a computer without a graphics card 9 of 10 frames.
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.configure_environment_map(None)
    server.scene.add_light_ambient("/light", intensity=1.5)
    show_from(server)
    server.gui.add_markdown("The robot gets ready …")
    return server


def address_of(server: viser.ViserServer) -> str:
    """Return where a browser finds a page."""
    return f"http://{server.get_host()}:{server.get_port()}"


def close_server(server: viser.ViserServer) -> None:
    """Stop serving; browsers see that nobody answers."""
    with redirect_stdout(StringIO()):
        server.stop()


def show_from(server: viser.ViserServer, size: float = 1.0, aside: float = 1.0) -> None:
    """Let browsers look from where wide windows see everything."""
    position, look_at = view_of(size, aside)
    camera = server.initial_camera
    # Said again, it would undo what a browser that is there already was told.
    if not np.allclose(camera.position, position, rtol=0.05):
        camera.position, camera.look_at, camera.up = position, look_at, (0.0, 0.0, 1.0)


def view_of(size: float, aside: float, narrow: bool = False) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return where the camera is and where it looks: the scene lies where the panel leaves room.

    All is scaled by ``size`` in m; ``aside`` 1 has the robot and its feet in view, 0 the feet alone.
    """
    x, y, z = PLACE
    if narrow:  # The panel covers the lower right.
        y *= 1.0 - 0.18 * aside
        position, look_at = (x - 2.1, y, z + 2.2), (x - 1.2, y, z)
    else:  # It covers the right.
        y *= 1.3 - 0.4 * aside
        position, look_at = (x - 1.05, y, z + 1.2), (x + 0.1, y, z + 0.1)
    return tuple(size * part for part in position), tuple(size * part for part in look_at)


def when_changed(handle: Any, tell: Callable[[Any], None]) -> None:
    """Tell a control's value when a browser, and not this program, has changed it."""

    def on_change(event: Any) -> None:
        if event.client_id is not None:
            tell(handle.value)

    handle.on_update(on_change)


def set_scene(server: viser.ViserServer, size: float, aside: float = 1.0) -> Any:
    """Set the ground and the camera, behind the robot, as :func:`view_of`; return the ground."""
    show_from(server, size, aside)

    def aim(client: viser.ClientHandle) -> None:
        camera = client.camera
        narrow = camera.image_width < camera.image_height
        camera.up_direction = (0.0, 0.0, 1.0)
        camera.position, camera.look_at = view_of(size, aside, narrow)

    # Of clients that came before there was anything to see, too.
    server.on_client_connect(aim)
    return server.scene.add_grid(
        "/ground",
        # A little lower than soles on it, of which it would cover half.
        position=(0.0, 0.0, -0.004 * size),
        infinite_grid=True,
        cell_size=0.25 * size,
        section_size=size,
        cell_color=(222, 222, 222),
        section_color=(190, 190, 190),
        fade_distance=12.0 * size,
        plane_color=(246, 248, 250),
        plane_opacity=1.0,
    )
